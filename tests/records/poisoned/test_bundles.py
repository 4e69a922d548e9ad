"""Damaged agents, laws and maps: one line that names the file, within seconds and little memory."""

import io
import json
import shutil
import subprocess
import sys
import warnings
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch
from poisons import ANYWHERE, FAST, JSON, ROOT

from agents.policies.bundle import Description, Network, _hash, build_policy, write_bundle
from agents.policies.law import Law
from agents.policies.view import View
from probe_env.envs.task import TaskConfig
from probe_env.envs.vibration_map import STORED as MAP
from probe_env.envs.vibration_map import VibrationMap
from probe_env.files import FileError


@pytest.fixture(scope="session")
def bundle(tmp_path_factory):
    path = tmp_path_factory.mktemp("bundle") / "agent.npz"
    torch.manual_seed(0)
    description = Description(
        algorithm="ppo", network=Network(net_arch=(8,)), view=View(averages=(5.0,)), task=TaskConfig(), trained={}
    )  # fmt: skip
    write_bundle(path, description, build_policy(description))
    return path


def arrays_of(path):
    with np.load(path) as file:
        return {name: file[name] for name in file.files}


def with_arrays(change):
    """Damage the arrays and seal them again, so that only what they hold is wrong."""

    def damage(path):
        arrays = arrays_of(path)
        change(arrays)
        weights = {name.removeprefix("weight:"): value for name, value in arrays.items() if name.startswith("weight:")}
        arrays["hash"] = np.array(_hash(str(arrays["description"]), weights))
        sealed(path, arrays)

    return damage


def sealed(path, arrays):
    with path.open("wb") as file:
        np.savez(file, **arrays)


WEIGHT = "weight:mlp_extractor.policy_net.0.weight"


def weights_as(value):
    return with_arrays(lambda arrays: arrays.update({WEIGHT: value(arrays[WEIGHT])}))


def described(**changes):
    def change(arrays):
        description = json.loads(str(arrays["description"]))
        for name, value in changes.items():
            description[name] = (description[name] or {}) | value if isinstance(value, dict) else value
        arrays["description"] = np.array(json.dumps(description))

    return with_arrays(change)


def member(name, content, compression=zipfile.ZIP_STORED):
    def damage(path):
        with zipfile.ZipFile(path, "a", compression) as archive, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a name twice
            archive.writestr(name, content)

    return damage


def header(shape, descr="<f4"):
    buffer = io.BytesIO()
    np.lib.format.write_array_header_1_0(buffer, {"descr": descr, "fortran_order": False, "shape": shape})
    return buffer.getvalue()


def one_byte(path):
    """Another byte in the middle of the largest array."""
    with zipfile.ZipFile(path) as archive:
        largest = max(archive.infolist(), key=lambda member: member.compress_size)
    content = bytearray(path.read_bytes())
    content[largest.header_offset + 30 + len(largest.filename) + largest.compress_size // 2] ^= 0xFF
    path.write_bytes(content)


def many_members(path):
    with zipfile.ZipFile(path, "a") as archive:
        for k in range(5000):
            archive.writestr(f"weight:{k}.npy", b"")


ARCHIVES = {name: ANYWHERE[name] for name in ("pipe", "folder", "huge", "empty", "binary")} | {
    "cut off": lambda path: path.write_bytes(path.read_bytes()[:-30]),
    "bomb": member("weight:x.npy", header((1 << 23,)) + b"\0" * (1 << 25), zipfile.ZIP_DEFLATED),
    "huge header": member("weight:x.npy", header((1 << 45,))),
    "long header": member("weight:x.npy", b"\x93NUMPY\x02\x00\xff\xff\xff\x0f" + b"{" * 20_000),
    "negative shape": member("weight:x.npy", header((-1,))),
    "structured": member("weight:x.npy", header((1,), [("a", "<f4")]) + b"\0" * 4),
    "objects": member("weight:x.npy", header((1,), "|O") + b"\0" * 8),
    "no array": member("weight:x.npy", b"seven"),
    "not a .npy": member("script.py", b"print()"),
    "many members": many_members,
    "wrong sum": one_byte,
}
BUNDLES = ARCHIVES | {
    "twice": member(f"{WEIGHT}.npy", header((1,)) + b"\0" * 4),
    "NaN": weights_as(lambda old: old * np.float32("nan")),
    "infinite": weights_as(lambda old: old + np.float32("inf")),
    "enormous": weights_as(lambda old: old + np.float32(1e30)),
    "complex": weights_as(lambda old: old.astype(np.complex64)),
    "truths": weights_as(lambda old: old > 0.0),
    "integers": weights_as(lambda old: old.astype(int)),
    "double": weights_as(lambda old: old.astype(float)),
    "half": weights_as(lambda old: old.astype(np.float16)),
    "text": weights_as(lambda old: old.astype(str)),
    "dates": weights_as(lambda old: old.astype("datetime64[s]")),
    "another shape": weights_as(lambda old: old.T.copy()),
    "missing": with_arrays(lambda arrays: arrays.pop(WEIGHT)),
    "more": with_arrays(lambda arrays: arrays.update({"weight:more": np.zeros(3, np.float32)})),
    "ten thousand averages": described(view={"averages": [5.0] * 10_000}),
    "ten thousand observations": described(view={"observations": ["rf_noise"] * 10_000}),
    "a huge network": described(network={"net_arch": [4096] * 8}),
    "a wider network": described(network={"net_arch": [64]}),
    "no network": described(network={"net_arch": "wide"}),
    "no such algorithm": described(algorithm="a2c"),
    "another format": described(format=2),
    "a deep description": with_arrays(lambda arrays: arrays.update(description=np.array("[" * 100_000))),
    "a long description": described(trained={"notes": "x" * (1 << 21)}),
    "no description": with_arrays(lambda arrays: arrays.update(description=np.array(["a", "b"]))),
    "changed": lambda path: sealed(path, arrays_of(path) | {"hash": np.array("0" * 32)}),
    "tubes of an unknown field": described(tubes={"foo": [1.0, 2.0]}),
    "tubes of a name for the terminal": described(tubes={"\x1b[31m": [1.0, 2.0]}),
    "tubes that end before they begin": described(tubes={"friction": [0.3, 0.1]}),
    "tubes of NaN": described(tubes={"friction": [float("nan"), 0.3]}),
}


@pytest.mark.parametrize("damage", BUNDLES)
def test_bundles(damage, bundle, tmp_path, refused, monkeypatch):
    monkeypatch.setattr("probe_env.files.MOST_UNPACKED", 1 << 24)  # a bomb of 32 MiB will do
    path = Path(shutil.copy(bundle, tmp_path / "agent.npz"))
    BUNDLES[damage](path)
    refused(["evaluate", path, *FAST], f"{path}: ")


LAW = {
    "scene": {}, "ranges": {"friction": [0.1, 0.3]}, "friction": [0.1, 0.3], "inserted_length": [5.0, 60.0],
    "tables": [{"helix_diameter": 1.2, "feed_speed": [[0.3, 0.1]] * 2, "air_supply_rate": [[0.01, 0.03]] * 2}],
}  # fmt: skip
LAWS = {
    "unknown field": {"ranges": {"foo": [1.0, 2.0]}},
    "name for the terminal": {"ranges": {"\x1b[31m": [1.0, 2.0]}},
    "range of NaN": {"ranges": {"friction": [float("nan"), 0.3]}},
    "range that ends before it begins": {"ranges": {"friction": [0.3, 0.1]}},
    "friction of NaN": {"friction": [float("nan"), 0.3]},
    "length without end": {"inserted_length": [5.0, float("inf")]},
    "length without beginning": {"inserted_length": [-float("inf"), 60.0]},
    "diameter without end": {"tables": [LAW["tables"][0] | {"helix_diameter": float("inf")}]},
    "feed of NaN": {"tables": [LAW["tables"][0] | {"feed_speed": [[float("nan"), 0.1]] * 2}]},
}


@pytest.mark.parametrize("damage", [*JSON, *LAWS])
def test_feedback_laws(damage, tmp_path, refused):
    path = tmp_path / "law.json"
    path.write_text(json.dumps(LAW | LAWS.get(damage, {})))
    if damage in JSON:
        JSON[damage](path)
    refused(["evaluate", path, *FAST], f"{path}: ")


def test_the_undamaged_law_is_read(tmp_path):
    path = tmp_path / "law.json"
    path.write_text(json.dumps(LAW))
    assert Law.read(path).friction == (0.1, 0.3)


@pytest.mark.parametrize("damage", [*ARCHIVES, "NaN", "other layers", "one layer", "text"])
def test_maps(damage, tmp_path, monkeypatch):
    monkeypatch.setattr("probe_env.files.MOST_UNPACKED", 1 << 24)
    path = Path(shutil.copy(MAP, tmp_path / "map.npz"))
    arrays = arrays_of(path)
    others = {
        "NaN": {"weights0": arrays["weights0"] * np.nan},
        "other layers": {"weights1": arrays["weights1"][:3]},
        "text": {"biases0": np.array(["a"])},
    }
    if damage in ARCHIVES:
        ARCHIVES[damage](path)
    elif damage == "one layer":
        sealed(path, {name: arrays[name] for name in ("weights0", "biases0")})
    else:
        sealed(path, arrays | others[damage])
    with pytest.raises(FileError, match=r"map\.npz: ") as caught:
        VibrationMap.load(path)
    assert str(caught.value).isprintable()


def test_a_refused_file_takes_no_memory(tmp_path, bundle):
    """A process that may take no more than 6 GiB of address space refuses a header of 2**45 numbers."""
    path = Path(shutil.copy(bundle, tmp_path / "agent.npz"))
    ARCHIVES["huge header"](path)
    code = (
        "import resource, sys; from probe_env.files import read_arrays; from pathlib import Path;"
        "resource.setrlimit(resource.RLIMIT_AS, (6 << 30,) * 2);"
        "read_arrays(Path(sys.argv[1]), lambda name: 'U' if name in ('hash', 'description') else 'f')"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(path)], capture_output=True, text=True, cwd=ROOT, check=False
    )
    assert "FileError" in done.stderr.splitlines()[-1]
