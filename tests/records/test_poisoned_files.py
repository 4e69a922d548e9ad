"""Damaged and poisoned files: one line that names the file, within seconds, and nothing is changed or run."""

import contextlib
import hashlib
import io
import json
import os
import shutil
import sqlite3
import subprocess
import sys
import warnings
import zipfile
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch

from agents.cli import main
from agents.design.compare import Comparison
from agents.evaluation.page.stored import read_evaluation
from agents.evaluation.report import write_report
from agents.learning.checkpoints import RUN
from agents.learning.config import Training
from agents.learning.train import CHECKPOINT, train_all
from agents.policies.bundle import Description, Network, _hash, build_policy, save_bundle
from agents.policies.catalogue import name_and_spec, named_policies
from agents.policies.fixed import Constant
from agents.policies.law import Law
from agents.policies.maps.vibration_map import STORED as MAP
from agents.policies.maps.vibration_map import VibrationMap
from agents.policies.view import View
from agents.records.journal import set_aside
from agents.records.models import TRIAL_KPIS
from agents.records.reading import read_csv
from agents.records.tables import FRONT
from agents.rollouts.plan import Plan, run_plan
from agents.rollouts.statistics import grouped
from agents.terminal.tables import print_table
from probe_env import Design, Fidelity
from probe_env.envs.contexts import spread_contexts
from probe_env.envs.task import TaskConfig
from probe_env.fidelity import resolve_fidelity
from probe_env.files import FileError, one_line

ROOT = Path(__file__).parents[2]
POLICIES = ("constant", "slow")
FAST = ["--fidelity", "fast", "--limit", "2"]
KPIS = (
    "inspection_time_s", "inspected_m", "inspected_share", "share_within_limit", "air_m3", "reward",
    "lost_drive_events", "lost_drive", "diverged", "complete", "radial_rms_m", "radial_p99_m", "radial_max_m",
    "radial_acceleration_rms_m_per_s2", "radial_acceleration_p99_m_per_s2", "radial_acceleration_max_m_per_s2",
)  # fmt: skip
HEAD = "inserted_length_m,feed_speed_m_per_s,air_supply_m3_per_h\n"
TRAINING = """
phases = 1
phase_steps = 64
averages = [5.0]
[environment]
num_envs = 4
fidelity = { time_lapse = 20.0 }
[environment.task]
settle_time = 0.1
time_limit = 20.0
[network]
net_arch = [8]
[validation]
limit = 1
fidelity = { time_lapse = 20.0 }
[learning]
n_steps = 16
batch_size = 32
n_epochs = 1
"""


def fingerprint(folder):
    """Every path with what it holds."""
    files = {}
    for path in sorted(folder.rglob("*")):
        whole = path.is_file() and path.stat().st_size < 1 << 26
        files[str(path)] = hashlib.sha256(path.read_bytes()).hexdigest() if whole else str(path.lstat().st_mode)
    return files


@pytest.fixture
def refused(tmp_path, capsys, monkeypatch):
    """Run a command that must be refused in one line about a file, and change nothing."""
    monkeypatch.chdir(tmp_path)

    def run(arguments, *messages):
        before = fingerprint(tmp_path)
        assert main(list(map(str, arguments))) == 2
        printed = capsys.readouterr()
        assert printed.out == ""
        assert printed.err.count("\n") == 1, printed.err
        assert printed.err.startswith("probe-env: error: ")
        assert printed.err.strip().isprintable()
        for text in messages:
            assert text in printed.err
        assert fingerprint(tmp_path) == before
        return printed.err

    return run


# ---- stored evaluations ----


@pytest.fixture(scope="session")
def evaluation(tmp_path_factory):
    """A whole evaluation whose episodes nobody simulated: each has the figures of its place."""
    folder = tmp_path_factory.mktemp("stored") / "evaluation"
    config = TaskConfig().all_shown
    policies, fidelity = named_policies(POLICIES, config), resolve_fidelity("fast")
    plan = Plan(policies, spread_contexts("test", 2), (0,), config, fidelity)
    folder.mkdir()
    (folder / "setting.json").write_text(json.dumps(plan.setting()))
    columns = ("time", "inserted_length", "feed_speed", "air_supply_rate", "radial_rms_m", "tension_mean_n")
    lines = []
    for k, unit in enumerate(plan.units()):
        kpis = dict.fromkeys(KPIS, 1.0 + 0.1 * k) | {"lost_drive": 0.0, "diverged": 0.0, "complete": 1.0}
        profile = {name: [1.0, 2.0, 3.0 + k] for name in columns}
        lines.append(json.dumps({"key": plan.key(unit), "unit": unit, "kpis": kpis, "profile": profile}))
    (folder / "episodes.jsonl").write_text("\n".join(lines) + "\n")
    run_plan(plan, folder, progress=False)
    (folder / "report.json").write_text('{"against": "constant"}')
    return folder


@pytest.fixture
def stored(evaluation, tmp_path):
    return shutil.copytree(evaluation, tmp_path / "evaluation")


def lines_of(path):
    return path.read_bytes().splitlines(keepends=True)


def changed_record(**changes):
    def change(path):
        lines = lines_of(path)
        lines[1] = json.dumps(json.loads(lines[1]) | changes).encode() + b"\n"
        path.write_bytes(b"".join(lines))

    return change


def second_line(content):
    def change(path):
        lines = lines_of(path)
        path.write_bytes(b"".join([lines[0], content, *lines[2:]]))

    return change


def fifo(path):
    path.unlink(missing_ok=True)
    os.mkfifo(path)


def folder_instead(path):
    path.unlink(missing_ok=True)
    path.mkdir()


def huge(path):
    with path.open("wb") as file:
        file.truncate(1 << 42)


ANYWHERE = {
    "pipe": fifo,
    "folder": folder_instead,
    "huge": huge,
    "empty": lambda path: path.write_bytes(b""),
    "binary": lambda path: path.write_bytes(bytes(range(256)) * 8),
    "utf-16": lambda path: path.write_text("{}", encoding="utf-16"),
    "NUL": lambda path: path.write_bytes(b"\0" * 512),
}
JSON = ANYWHERE | {
    "cut off": lambda path: path.write_bytes(path.read_bytes()[: path.stat().st_size // 2]),
    "{}": lambda path: path.write_text("{}"),
    "a list": lambda path: path.write_text("[1]"),
    "nested": lambda path: path.write_text("[" * 100_000),
    "a number": lambda path: path.write_text("9" * 10_000),
}
JOURNAL = {name: ANYWHERE[name] for name in ("pipe", "folder", "huge", "binary", "utf-16", "NUL")} | {
    "half a line": second_line(b'{"key": "0123\n'),
    "no JSON": second_line(b"seven\n"),
    "foreign": second_line(b'{"key": "0123456789abcdef", "kpis": {"reward": 1.0}}\n'),
    "empty line": second_line(b"\n"),
    "NULs": second_line(b"\0" * 40 + b"\n"),
    "nested": second_line(b"[" * 100_000 + b"\n"),
    "a line without end": second_line(b"x" * (5 << 20) + b"\n"),
    "text for a number": changed_record(kpis=dict.fromkeys(KPIS, "high")),
    "NaN": changed_record(kpis=dict.fromkeys(KPIS, float("nan"))),
    "without a KPI": changed_record(kpis={"reward": 1.0}),
    "without a column": changed_record(profile={"time": [1.0]}),
    "a list for the KPIs": changed_record(kpis=[1.0]),
    "no key": changed_record(key=7),
    "torn at the end": lambda path: path.write_bytes(path.read_bytes() + b"\0" * 100),
    "garbage at the end": lambda path: path.write_bytes(path.read_bytes() + b"seven"),
}  # fmt: skip


@pytest.mark.parametrize("damage", JOURNAL)
def test_journals(damage, stored, refused):
    JOURNAL[damage](stored / "episodes.jsonl")
    error = refused(["evaluate", *POLICIES, *FAST, "--output", stored], str(stored / "episodes.jsonl"))
    if damage not in ("pipe", "folder", "huge", "binary", "utf-16", "NUL"):
        assert "line 5" in error if damage.endswith("end") and damage[0] != "a" else "line 2" in error


@pytest.mark.parametrize("damage", [*JSON, "missing", "another task", "no such probes"])
def test_settings(damage, stored, refused):
    path = stored / "setting.json"
    setting = json.loads(path.read_text())
    others = {
        "another task": lambda path: path.write_text(json.dumps(setting | {"task": {"period": "long"}})),
        "no such probes": lambda path: path.write_text(json.dumps(setting | {"probes": "all"})),
        "missing": Path.unlink,
    }
    (JSON | others)[damage](path)
    refused(["evaluate", *POLICIES, *FAST, "--output", stored], str(path))


@pytest.mark.parametrize("name", ["provenance.json", "setting.json", "report.json"])
@pytest.mark.parametrize("damage", JSON)
def test_reports_of_damaged_json(name, damage, stored, refused):
    JSON[damage](stored / name)
    refused(["report", stored], str(stored / name))


@pytest.mark.parametrize("damage", [*JSON, "another tube", "a name for the terminal", "no key"])
def test_what_an_interrupted_evaluation_was_to_hold(damage, stored, refused):
    path = stored / "unfinished.json"
    record = json.loads((stored / "provenance.json").read_text())
    lines = [json.loads(line) for line in lines_of(stored / "episodes.jsonl")]
    episodes = [[line["key"], *line["unit"]] for line in lines]
    held = record | {"contexts": [{}, {}], "episodes": episodes}
    path.write_text(json.dumps(held))
    read_evaluation(stored)
    name = "\x1b[2J"
    others = {
        "another tube": held | {"contexts": [{}]},
        "a name for the terminal": held
        | {"episodes": [[episodes[0][0], name, 0, 0]], "policies": {name: {}} | record["policies"]},
        "no key": held | {"episodes": [["", *episodes[0][1:]]]},
    }
    if damage in others:
        path.write_text(json.dumps(others[damage]))
    else:
        JSON[damage](path)
    refused(["report", stored], str(path))


def rewritten_table(change):
    def damage(path):
        change(pd.read_parquet(path)).to_parquet(path, index=False)

    return damage


TABLES = ANYWHERE | {
    "cut off": lambda path: path.write_bytes(path.read_bytes()[:-100]),
    "other columns": rewritten_table(lambda table: pd.DataFrame({"a": [1]})),
    "without a column": rewritten_table(lambda table: table.drop(columns="radial_rms_m")),
    "text for numbers": rewritten_table(lambda table: table.assign(radial_rms_m="high")),
    "no rows": rewritten_table(lambda table: table[:0]),
    "numbers for names": rewritten_table(lambda table: table.assign(policy=7)),
    "a name for the terminal": rewritten_table(lambda table: table.assign(policy="\x1b[2Jslow")),
    "a formula": rewritten_table(lambda table: table.assign(policy="=1+1")),
    "a long name": rewritten_table(lambda table: table.assign(policy="x" * 10**6)),
    "seeds that are none": rewritten_table(lambda table: table.assign(seed=0.5)),
    "CSV": lambda path: path.write_text("policy,context\na,0\n"),
}


@pytest.mark.parametrize("name", ["episodes.parquet", "profile.parquet"])
@pytest.mark.parametrize("damage", TABLES)
def test_tables(name, damage, stored, refused):
    TABLES[damage](stored / name)
    refused(["report", stored], str(stored / name))


def test_tables_of_more_rows_than_any(stored, refused, monkeypatch):
    monkeypatch.setattr("agents.records.tables.MOST_ROWS", 3)
    refused(["report", stored], f"{stored / 'episodes.parquet'}: 4 rows: a table has 1 to 3")


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("episodes", "reward = nan is not finite"),
        ("profile", "of policies that are not in episodes.parquet"),
        ("against", "against = 'nobody' is not one of the policies"),
    ],
)
def test_tables_that_contradict(table, message, stored, refused):
    if table == "against":
        (stored / "report.json").write_text('{"against": "nobody"}')
    else:
        path = stored / f"{table}.parquet"
        change = {"reward": float("nan")} if table == "episodes" else {"policy": "somebody"}
        pd.read_parquet(path).assign(**change).to_parquet(path, index=False)
    refused(["report", stored], message)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "column 'family' is missing"),
        ("family,value\na,1\n", "column 'time_s' is missing"),
        (",".join(FRONT) + "\npi,high" + ",1" * 6 + "\n", "line 2: value = 'high' is not a number"),
        (",".join(FRONT) + "\npi,1" + ",nan" * 6 + "\n", "time_s = nan is not finite"),
        (",".join(FRONT) + "\npi,1,1\n", "line 2: 3 values for 8 columns"),
        (",".join(FRONT) + ",family\npi,1" + ",1" * 6 + ",pi\n", "2 times"),
        (",".join(FRONT) + "\n=1+1,1" + ",1" * 6 + "\n", "takes for a formula".replace("takes", "take")),
        (",".join(FRONT) + '\n"pi,1\n', "not CSV"),
    ],
)
def test_fronts_beside_an_evaluation(text, message, stored, refused):
    path = stored.parent / "tradeoff" / "front.csv"
    path.parent.mkdir()
    path.write_text(text)
    refused(["report", stored], str(path), message)


def test_a_line_that_an_interrupt_cut_off_is_kept_aside_and_run_again(stored, monkeypatch):
    journal = stored / "episodes.jsonl"
    whole, last = journal.read_bytes(), lines_of(journal)[-1]
    journal.write_bytes(whole[:-40])
    monkeypatch.setattr("agents.rollouts.plan._lines", lambda *_: iter([last.decode()]))
    assert main(["evaluate", *POLICIES, *FAST, "--output", str(stored)]) == 0
    assert journal.read_bytes() == whole
    assert (stored / "episodes.jsonl.cut-off").read_bytes() == last[:-40] + b"\n"


def test_a_whole_line_without_its_end_counts(stored, monkeypatch):
    journal = stored / "episodes.jsonl"
    whole = journal.read_bytes()
    journal.write_bytes(whole[:-1])
    monkeypatch.setattr("agents.rollouts.plan._lines", None)
    assert main(["evaluate", *POLICIES, *FAST, "--output", str(stored)]) == 0
    assert journal.read_bytes() == whole[:-1]  # nothing was to be appended
    set_aside(journal)
    assert journal.read_bytes() == whole


def test_an_interrupted_comparison_names_its_journal(tmp_path, refused):
    design = ROOT / "configs" / "design" / "original.toml"
    output = tmp_path / "compare"
    output.mkdir()
    comparison = Comparison({"original": Design.from_toml(design)}, spread_contexts("test", 1))
    key = comparison.key(Design.from_toml(design), spread_contexts("test", 1)[0])
    good = json.dumps({"key": key, "kpis": dict.fromkeys(TRIAL_KPIS, 1.0)})
    for bad in ("seven", '{"key": "x"}', '{"key": "0123456789abcdef", "kpis": {"reward": 1}}', "[]", "\0"):
        (output / "designs.jsonl").write_text(f"{good}\n{bad}\n{good}\n")
        refused(["compare", design, "--limit", "1", "--output", output], f"{output / 'designs.jsonl'}: line 2: ")


def test_a_comparison_without_designs(refused):
    refused(["compare"], "designs = none: give at least one design file")


# ---- training ----


@pytest.fixture(scope="session")
def trained(tmp_path_factory):
    folder = tmp_path_factory.mktemp("trained")
    (folder / "train.toml").write_text(TRAINING)
    train_all(Training.from_toml(folder / "train.toml"), folder / "run", resume=False)
    return folder


@pytest.fixture
def run(trained, tmp_path):
    return shutil.copytree(trained, tmp_path / "trained")


def resumed(run):
    return ["train", run / "train.toml", "--output", run / "run", "--resume"]


@pytest.mark.parametrize("damage", [*JSON, "missing", "another seed's settings"])
def test_notes_of_runs(damage, run, refused):
    path = run / "run" / "seed-0" / RUN
    others = {"missing": Path.unlink, "another seed's settings": lambda path: path.write_text('{"seed": 0}')}
    (JSON | others)[damage](path)
    refused(resumed(run), str(path))


class Poison:
    """Unpickled, it would write a file."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return (open, (str(self.path), "w"))


def state_changed(change):
    def damage(path):
        state = torch.load(path, weights_only=True)
        change(state)
        torch.save(state, path)

    return damage


def first_weight(state, value):
    name = "mlp_extractor.policy_net.0.weight"
    state["parameters"]["policy"][name] = value(state["parameters"]["policy"][name])


def optimiser_state(state, value):
    entry = state["parameters"]["policy.optimizer"]["state"][0]
    entry["exp_avg"] = value(entry["exp_avg"])


def other_archive(path):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("archive/data.pkl", b"\0" * (1 << 25))


CHECKPOINTS = {name: ANYWHERE[name] for name in ("pipe", "folder", "huge", "empty", "binary")} | {
    "cut off": lambda path: path.write_bytes(path.read_bytes()[: path.stat().st_size // 2]),
    "a byte short": lambda path: path.write_bytes(path.read_bytes()[:-1]),
    "a bomb": other_archive,
    "a list": lambda path: torch.save([1], path),
    "nothing": lambda path: torch.save({}, path),
    "code": lambda path: torch.save(Poison(path.with_name("victim")), path),
    "another network": state_changed(lambda state: first_weight(state, lambda _: torch.zeros(3, 3))),
    "fewer weights": state_changed(lambda state: state["parameters"]["policy"].popitem()),
    "NaN": state_changed(lambda state: first_weight(state, lambda old: old * float("nan"))),
    "double": state_changed(lambda state: first_weight(state, lambda old: old.double())),
    "complex": state_changed(lambda state: first_weight(state, lambda old: old + 1j)),
    "a number for weights": state_changed(lambda state: first_weight(state, lambda _: 1.0)),
    "a huge view": state_changed(lambda state: optimiser_state(state, lambda _: torch.zeros(1).expand(10**12))),
    "NaN in the optimiser": state_changed(lambda state: optimiser_state(state, lambda old: old * float("nan"))),
    "other optimiser": state_changed(
        lambda state: state["parameters"]["policy.optimizer"]["param_groups"][0].update(betas=(0.1, 0.2))
    ),
    "an attribute": state_changed(lambda state: state["counts"].update(policy=1)),
    "a count of truths": state_changed(lambda state: state["counts"].update(num_timesteps=True)),
    "another count": state_changed(lambda state: state["counts"].update(num_timesteps=7)),
    "no rows": state_changed(lambda state: state.update(rows=[])),
    "rows of text": state_changed(lambda state: state.update(rows=["a"])),
    "another seed": state_changed(lambda state: [row.update(seed=3) for row in state["rows"]]),
    "a phase too few": state_changed(lambda state: state["rows"].append(state["rows"][0])),
    "other settings": state_changed(lambda state: state.update(config=_settings(gamma=0.5))),
    "settings of text": state_changed(lambda state: state.update(config="{")),
}


def _settings(**learning):
    training = Training.model_validate_json(json.dumps({"learning": {"n_steps": 16, "batch_size": 32} | learning}))
    return training.model_dump_json()


@pytest.mark.parametrize("damage", CHECKPOINTS)
def test_checkpoints(damage, run, refused):
    path = run / "run" / "seed-0" / CHECKPOINT
    CHECKPOINTS[damage](path)
    refused(resumed(run), str(path))
    assert not path.with_name("victim").exists()


def test_the_whole_checkpoint_goes_on(run):
    assert main(list(map(str, resumed(run)))) == 0


# ---- bundles and maps ----


@pytest.fixture(scope="session")
def bundle(tmp_path_factory):
    path = tmp_path_factory.mktemp("bundle") / "agent.npz"
    torch.manual_seed(0)
    description = Description(
        algorithm="ppo", network=Network(net_arch=(8,)), view=View(averages=(5.0,)), task=TaskConfig(), trained={}
    )  # fmt: skip
    save_bundle(path, description, build_policy(description))
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
    monkeypatch.setattr("agents.records.arrays.MOST_UNPACKED", 1 << 24)  # a bomb of 32 MiB will do
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


@pytest.mark.parametrize("damage", [*ANYWHERE, "cut off", "{}", "a list", "nested", *LAWS])
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
    monkeypatch.setattr("agents.records.arrays.MOST_UNPACKED", 1 << 24)
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


# ---- databases ----


def other_database(path):
    with sqlite3.connect(path) as connection:
        connection.execute("CREATE TABLE accounts (name TEXT)")
    connection.close()


def damaged_database(path):
    other_database(path)
    content = bytearray(path.read_bytes())
    content[100:] = b"\xff" * (len(content) - 100)
    path.write_bytes(content)


DATABASES = {name: ANYWHERE[name] for name in ("pipe", "folder", "huge", "binary", "NUL")} | {
    "another's": other_database,
    "damaged": damaged_database,
    "cut off": lambda path: path.write_bytes(b"SQLite format 3\0"),
}


@pytest.mark.parametrize("damage", DATABASES)
@pytest.mark.parametrize("given", [False, True])
def test_databases(damage, given, tmp_path, refused):
    output = tmp_path / "design"
    output.mkdir()
    DATABASES[damage](output / "study.db")
    storage = ["--storage", f"sqlite:///{output / 'study.db'}"] if given else []
    refused(["design", "--output", output, *storage], str(output / "study.db"))


def test_a_locked_database(tmp_path, refused, monkeypatch):
    monkeypatch.setattr("agents.searches.database.PATIENCE", 0.1)
    output = tmp_path / "design"
    output.mkdir()
    holder = sqlite3.connect(output / "study.db", isolation_level=None)
    holder.execute("CREATE TABLE studies (name TEXT)")
    holder.execute("BEGIN EXCLUSIVE")
    error = refused(["design", "--output", output], f"{output / 'study.db'}: locked by another process")
    assert len(error) < 400
    holder.close()


CELLS = {
    "distribution": "UPDATE trial_params SET distribution_json = '[]'",
    "parameter of text": "UPDATE trial_params SET param_value = 'abc'",
    "parameter of NULL": "UPDATE trial_params SET param_value = NULL",
    "parameter out of range": "UPDATE trial_params SET param_value = 1e9",
    "objective of text": "UPDATE trial_values SET value = 'abc'",
    "kind of objective": "UPDATE trial_values SET value_type = 'FOO'",
    "state": "UPDATE trials SET state = 'FOO'",
    "commit": "UPDATE trial_user_attributes SET value_json = '[1, 2]'",
    "attribute that is no JSON": "UPDATE trial_user_attributes SET value_json = '{'",
    "table": "DROP TABLE trials",
}


@pytest.mark.parametrize("damage", CELLS)
def test_a_whole_database_with_damaged_cells(damage, tmp_path):
    """Nothing is changed, and the error is one line that names the file."""
    import optuna

    from agents.searches.database import open_study

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    path = tmp_path / "study.db"
    study = open_study(f"sqlite:///{path}", "known", ["minimize"], ["x"])
    trial = study.ask({"x": optuna.distributions.FloatDistribution(0.0, 1.0)})
    trial.set_user_attr("commit", "0123456789ab")
    study.tell(trial, 1.0)
    with contextlib.closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("PRAGMA ignore_check_constraints = ON")
        connection.execute(CELLS[damage])
    before = path.read_bytes()
    with pytest.raises(FileError, match=r"study\.db: ") as error:
        open_study(f"sqlite:///{path}", "known", ["minimize"], ["x"])
    assert len(str(error.value)) < 600
    assert "\n" not in str(error.value)
    assert path.read_bytes() == before


def test_a_study_of_another_search(tmp_path):
    import optuna

    from agents.searches.database import open_study

    optuna.logging.set_verbosity(optuna.logging.ERROR)
    storage = f"sqlite:///{tmp_path / 'study.db'}"
    study = open_study(storage, "known", ["minimize"], ["x"])
    study.tell(study.ask({"x": optuna.distributions.FloatDistribution(0.0, 1.0)}), 1.0)
    assert len(open_study(storage, "known", ["minimize"], ["x"]).trials) == 1
    for directions, parameters in ((["maximize"], ["x"]), (["minimize"] * 3, ["x"]), (["minimize"], ["y"])):
        with pytest.raises(FileError, match=r"study\.db: study 'known' is of another search"):
            open_study(storage, "known", directions, parameters)


@pytest.mark.parametrize(
    "storage",
    [
        "postgresql://me:se:cr@et@nowhere.invalid/db",
        "mysql://me:secret@nowhere.invalid/db",
        "nodriver://me:secret@nowhere.invalid/db",
        "redis://:secret@nowhere.invalid",
        "postgresql://nowhere.invalid/db?user=me&password=secret",
        "postgresql://me:secret@nowhere.invalid:port/db",
    ],
)
def test_passwords_are_neither_told_nor_stored(storage, tmp_path, refused, monkeypatch):
    from agents.records.provenance import provenance

    error = refused(["design", "--storage", storage, "--output", tmp_path / "out"], "storage = ", "***")
    monkeypatch.setattr(sys, "argv", ["probe-env", "design", "--storage", storage, f"--storage={storage}"])
    for text in (error, json.dumps(provenance())):
        assert "se:cr" not in text
        assert "secret" not in text
        assert "***" in text


# ---- texts that people write ----


def text(content):
    return lambda path: path.write_text(content, newline="")


TEXTS = ANYWHERE | {
    "Latin-1": lambda path: path.write_bytes("# für\nfeed_speed = 1\n".encode("latin-1")),
    "escape": text("\x1b[2J\n=\x07"),
    "one long line": text("x" * (1 << 20)),
    "nothing to read": lambda path: os.symlink("itself", path.with_name("itself")) or os.replace(
        path.with_name("itself"), path
    ),
}  # fmt: skip
TOMLS = TEXTS | {
    "deep": text("a = " + "[" * 50_000),
    "a deep key": text("a" + ".a" * 30_000 + " = 1"),
    "a long number": text("feed_speed = " + "1" * 10_000),
    "many fields": text("".join(f"field{k} = 1\n" for k in range(5000))),
    "a long value": text("feed_speed = '" + "x" * 500_000 + "'"),
    "large": text("#" * (2 << 20)),
}
SCHEDULES = TEXTS | {
    "many columns": text(",".join(f"c{k}" for k in range(200_000)) + "\n"),
    "a long cell": text(HEAD + "5," + "1" * 200_000 + ",63\n"),
    "an open quote": text(HEAD + '5,"' + "1,63\n" * 100_000),
}


@pytest.mark.parametrize("damage", TOMLS)
@pytest.mark.parametrize("command", ["simulate", "train", "compare", "evaluate"])
def test_toml_files(damage, command, tmp_path, refused):
    path = tmp_path / "file.toml"
    TOMLS[damage](path)
    if damage == "nothing to read":
        path.unlink()
        path.symlink_to(path)
    if damage == "empty" and command in ("simulate", "train", "compare"):
        return  # all settings have defaults
    refused([command, path], str(path))


@pytest.mark.parametrize("damage", SCHEDULES)
def test_schedules(damage, tmp_path, refused):
    path = tmp_path / "file.csv"
    SCHEDULES[damage](path)
    refused(["evaluate", path, *FAST], str(path))


def test_a_byte_order_mark_and_windows_lines_are_read(tmp_path):
    from probe_env import Scene

    path = tmp_path / "scene.toml"
    path.write_bytes(b"\xef\xbb\xbffeed_speed = 0.1\r\n")
    assert Scene.from_toml(path).feed_speed == 0.1


SCENE = str(ROOT / "configs" / "scenes" / "fig11_l10.toml")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--scene.contact.friction", "7"], "--scene.contact.friction: 7.0 is outside the accepted range 0 to 1"),
        (["--scene.feed-speed", "-3"], "--scene.feed_speed: -3.0 m/s is outside the accepted range -2 to 2 m/s"),
        (["--scene.carrier-length", "7.03"], "--scene: carrier_length = 7.03 m must be a whole multiple"),
        (["--scene.tube.helix-diameter", "nan"], "--scene.tube.helix_diameter: nan m is outside"),
    ],
)
def test_options_of_scenes(options, message, refused):
    refused(["simulate", SCENE, *options], message)


def test_fields_of_scenes(tmp_path, refused):
    for content, message in (
        ("feed_sped = 1", "feed_sped"),
        ("[contact]\nfriction = 7", "contact.friction: 7"),
        ("[", "TOML"),
    ):
        (tmp_path / "scene.toml").write_text(content)
        refused(["simulate", tmp_path / "scene.toml"], str(tmp_path / "scene.toml"), message)
    refused(["simulate", tmp_path], str(tmp_path))


# ---- names ----


@pytest.mark.parametrize(
    "name", ["=1+1", "@SUM(A1)", "+1+1", "-1", "\tx", "a\x1b[31mb", "a\nb", "x" * 81, " x", "", "\u202ecsv"]
)
def test_names_that_are_refused(name, refused):
    refused(["evaluate", f"{name}=constant", *FAST], "policy ", "NAME=FILE gives a name")


def schedule_at(path):
    path.parent.mkdir(exist_ok=True)
    path.write_text(HEAD + "5,0.1,63\n")
    return str(path)


def test_files_of_any_name(tmp_path, monkeypatch):
    """A file that is there wins over NAME=FILE; what a spreadsheet takes for a formula is left out of its name."""
    monkeypatch.chdir(tmp_path)
    for file in ("a=b.csv", "-x.csv", "=2.csv", "c@3.csv", "null.csv", "1e5.csv", "d=1/y=2.csv"):
        schedule_at(Path(file))
    given = {
        "a=b.csv": ("a=b", "a=b.csv"), "./a=b.csv": ("a=b", "./a=b.csv"), "n=a=b.csv": ("n", "a=b.csv"),
        "n@1=a=b.csv": ("n@1", "a=b.csv"), "-x.csv": ("x", "-x.csv"), "./-x.csv": ("x", "./-x.csv"),
        "=2.csv": ("2", "=2.csv"), "c@3.csv": ("c@3", "c@3.csv"), "d=1/y=2.csv": ("y=2", "d=1/y=2.csv"),
        "m=d=1/y=2.csv": ("m", "d=1/y=2.csv"), "k=constant": ("k", "constant"), "p=q=pi": ("p=q", "pi"),
        "n=no.csv": ("n", "no.csv"), "null.csv": ("null", "null.csv"), "1e5.csv": ("1e5", "1e5.csv"),
    }  # fmt: skip
    assert {spec: name_and_spec(spec) for spec in given} == given
    assert list(named_policies(["a=b.csv", "./-x.csv", "n@1=d=1/y=2.csv"], TaskConfig())) == ["a=b", "x", "n@1"]


def test_options_end_where_the_user_says_so(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    schedule_at(Path("-x.csv"))
    for arguments in (["--limit", "99", "--", "-x.csv"], ["./-x.csv", "--limit", "99"]):
        assert main(["evaluate", *arguments]) == 2
        assert "limit = 99" in capsys.readouterr().err  # so the file was taken


def test_names_like_numbers_and_markup_stay_what_they_are(tmp_path, capsys):
    names = ["null", "1e5", "nan", "NA", "<b>x</b>", "[red]y", "$\\frac$", "_z", "v@²"]
    config = TaskConfig(growing=False, period=0.1, time_limit=0.1, settle_time=0.1)
    plan = Plan(
        {name: Constant(config, feed_speed=0.1 + 0.01 * k) for k, name in enumerate(names)},
        spread_contexts("validation", 2), (0,), config, Fidelity(),
    )  # fmt: skip
    run_plan(plan, tmp_path, progress=False)
    table = read_csv(tmp_path / "episodes.csv", {"policy": "name"})
    assert list(dict.fromkeys(grouped(table)["policy"])) == names
    page = write_report(tmp_path).read_text()
    assert "<b>x" not in page
    assert "&lt;b&gt;x" in page
    assert list(dict.fromkeys(read_csv(tmp_path / "summary.csv", {"policy": "name"})["policy"])) == names
    print_table("[red]title", ["policy"], [[name] for name in names])
    assert "[red]y" in capsys.readouterr().out


def test_what_is_told_is_one_printable_line():
    assert one_line("a\nb\x1b[31m\u202e") == "a; b\\x1b[31m\\u202e"
    assert len(one_line("x" * 10**6)) < 2100
    assert str(FileError("a\nb", "c\nd")).isprintable()


def test_a_refused_file_takes_no_memory(tmp_path, bundle):
    """A process that may take no more than 6 GiB of address space refuses a header of 2**45 numbers."""
    path = Path(shutil.copy(bundle, tmp_path / "agent.npz"))
    ARCHIVES["huge header"](path)
    code = (
        "import resource, sys; from agents.records.arrays import read_arrays; from pathlib import Path;"
        "resource.setrlimit(resource.RLIMIT_AS, (6 << 30,) * 2);"
        "read_arrays(Path(sys.argv[1]), lambda name: 'U' if name in ('hash', 'description') else 'f')"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(path)], capture_output=True, text=True, cwd=ROOT, check=False
    )
    assert "FileError" in done.stderr.splitlines()[-1]
