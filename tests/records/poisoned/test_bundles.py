"""Damaged agents, laws and maps: one line that names the file, within seconds and little memory."""

import io
import json
import shutil
import warnings
import zipfile

import numpy as np
import pytest
import torch
from poisons import ANYWHERE, FAST, JSON
from safetensors.numpy import load, save

from agents.policies.bundle import Description, Network, _hash, build_policy, load_bundle, write_bundle
from agents.policies.law import Law
from agents.policies.view import View
from agents.records.arrays import read_weights
from probe_env.envs.task import TaskConfig
from probe_env.envs.vibration_map import STORED as MAP
from probe_env.envs.vibration_map import VibrationMap
from probe_env.files import FileError

WEIGHT = "mlp_extractor.policy_net.0.weight"


@pytest.fixture(scope="session")
def bundle(tmp_path_factory):
    path = tmp_path_factory.mktemp("bundle") / "agent.safetensors"
    torch.manual_seed(0)
    description = Description(
        algorithm="ppo", network=Network(net_arch=(8,)), view=View(averages=(5.0,)), task=TaskConfig(), trained={}
    )  # fmt: skip
    write_bundle(path, description, build_policy(description))
    return path


def resealed(change):
    """Damage the description and the weights and hash them again, so that only their content is wrong."""

    def damage(path):
        text, _, weights = read_weights(path)
        description = json.loads(text)
        change(description, weights)
        text = json.dumps(description)
        path.write_bytes(save(weights, {"description": text, "hash": _hash(text, weights)}))

    return damage


def weight_as(value):
    return resealed(lambda _, weights: weights.update({WEIGHT: value(weights[WEIGHT])}))


def described(**changes):
    def change(description, _):
        for name, value in changes.items():
            description[name] = (description[name] or {}) | value if isinstance(value, dict) else value

    return resealed(change)


def one_byte(path):
    content = bytearray(path.read_bytes())
    content[-100] ^= 0xFF
    path.write_bytes(content)


def metadata(**changes):
    """Other metadata of the same weights; None takes an entry out."""

    def damage(path):
        text, digest, weights = read_weights(path)
        entries = {"description": text, "hash": digest} | changes
        path.write_bytes(save(weights, {name: value for name, value in entries.items() if value is not None}))

    return damage


BUNDLES = {name: ANYWHERE[name] for name in ("pipe", "folder", "huge", "empty", "binary")} | {
    "cut off": lambda path: path.write_bytes(path.read_bytes()[:-30]),
    "huge header": lambda path: path.write_bytes((1 << 45).to_bytes(8, "little") + b"{}"),
    "wrong byte": one_byte,
    "no metadata": lambda path: path.write_bytes(save(load(path.read_bytes()))),
    "no hash": metadata(hash=None),
    "no description": metadata(description=None),
    "another hash": metadata(hash="0" * 32),
    "a deep description": metadata(description="[" * 100_000),
    "NaN": weight_as(lambda old: old * np.float32("nan")),
    "infinite": weight_as(lambda old: old + np.float32("inf")),
    "enormous": weight_as(lambda old: old + np.float32(1e30)),
    "integers": weight_as(lambda old: old.astype(int)),
    "double": weight_as(lambda old: old.astype(float)),
    "another shape": weight_as(lambda old: old.T.copy()),
    "missing": resealed(lambda _, weights: weights.pop(WEIGHT)),
    "more": resealed(lambda _, weights: weights.update({"more": np.zeros(3, np.float32)})),
    "ten thousand averages": described(view={"averages": [5.0] * 10_000}),
    "ten thousand observations": described(view={"observations": ["rf_noise"] * 10_000}),
    "a huge network": described(network={"net_arch": [4096] * 8}),
    "a wider network": described(network={"net_arch": [64]}),
    "no network": described(network={"net_arch": "wide"}),
    "no such algorithm": described(algorithm="a2c"),
    "another format": described(format=2),
    "tubes of an unknown field": described(tubes={"foo": [1.0, 2.0]}),
    "tubes of a name for the terminal": described(tubes={"\x1b[31m": [1.0, 2.0]}),
    "tubes that end before they begin": described(tubes={"friction": [0.3, 0.1]}),
    "tubes of NaN": described(tubes={"friction": [float("nan"), 0.3]}),
}


def failures_of(damages, whole, path, load):
    """Names of the damages that are not refused in one line that names the file."""
    failures = []
    for name, damage in damages.items():
        shutil.copy(whole, path)
        damage(path)
        try:
            load(path)
            failures.append(name)
        except FileError as error:
            failures += [] if str(path) in str(error) and str(error).isprintable() else [name]
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    return failures


def test_bundles(bundle, tmp_path, refused):
    assert failures_of(BUNDLES, bundle, tmp_path / "agent.safetensors", load_bundle) == []
    path = shutil.copy(bundle, tmp_path / "agent.safetensors")
    one_byte(path)
    refused(["evaluate", path, *FAST], f"{path}: changed or cut off")


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


def test_feedback_laws(tmp_path, refused):
    path = tmp_path / "law.json"
    path.write_text(json.dumps(LAW))
    assert Law.read(path).friction == (0.1, 0.3)
    whole = shutil.copy(path, tmp_path / "whole.json")
    laws = {name: lambda path, law=law: path.write_text(json.dumps(LAW | law)) for name, law in LAWS.items()}
    assert failures_of(JSON | laws, whole, path, Law.read) == []
    path.write_text(json.dumps(LAW | LAWS["unknown field"]))
    refused(["evaluate", path, *FAST], f"{path}: ")


def arrays_as(change):
    def damage(path):
        with np.load(path) as file:
            arrays = {name: file[name] for name in file.files}
        np.savez(path, **change(arrays))

    return damage


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


MAPS = {name: ANYWHERE[name] for name in ("pipe", "folder", "huge", "empty", "binary")} | {
    "cut off": lambda path: path.write_bytes(path.read_bytes()[:-30]),
    "bomb": member("weights0.npy", header((1 << 23,)) + b"\0" * (1 << 25), zipfile.ZIP_DEFLATED),
    "huge header": member("weights9.npy", header((1 << 45,))),
    "negative shape": member("weights9.npy", header((-1,))),
    "structured": member("weights9.npy", header((1,), [("a", "<f4")]) + b"\0" * 4),
    "objects": member("weights9.npy", header((1,), "|O") + b"\0" * 8),
    "not a .npy": member("script.py", b"print()"),
    "twice": member("weights0.npy", header((1,)) + b"\0" * 4),
    "NaN": arrays_as(lambda arrays: arrays | {"weights0": arrays["weights0"] * np.nan}),
    "other layers": arrays_as(lambda arrays: arrays | {"weights1": arrays["weights1"][:3]}),
    "one layer": arrays_as(lambda arrays: {name: arrays[name] for name in ("weights0", "biases0")}),
    "text": arrays_as(lambda arrays: arrays | {"biases0": np.array(["a"])}),
}


def test_maps(tmp_path, monkeypatch):
    monkeypatch.setattr("agents.records.arrays.MOST_BYTES", 1 << 24)  # a bomb of 32 MiB will do
    assert failures_of(MAPS, MAP, tmp_path / "map.npz", VibrationMap.load) == []
