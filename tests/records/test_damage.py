"""Damaged files: one line that names file and place, within seconds and little memory; nothing is changed."""

import io
import json
import re
import shutil
import warnings
import zipfile
from functools import partial

import numpy as np
import optuna
import pandas as pd
import pytest
import torch
from plans import make_plan
from poisons import ANYWHERE, FAST, JSON, failures_of
from safetensors.numpy import load, save

from probe_agents.cli import main
from probe_agents.design.compare import Trial
from probe_agents.evaluation import folder
from probe_agents.evaluation.folder import PROFILE, Episode, read_episodes
from probe_agents.evaluation.kpis import CORE
from probe_agents.evaluation.run import evaluate_plan
from probe_agents.policies.bundle import Description, StoredNetwork, _hash, build_policy, load_bundle, write_bundle
from probe_agents.policies.trained import read_weights
from probe_agents.policies.view import View
from probe_agents.records.models import read_json
from probe_agents.records.result_folder import Journal
from probe_agents.records.searches import open_study
from probe_agents.records.tables import read_csv, read_parquet
from probe_env import Scene
from probe_env.envs.task.config import TaskConfig
from probe_env.envs.task.scales import OBSERVATIONS
from probe_env.envs.vibration_map import STORED as MAP
from probe_env.envs.vibration_map import VibrationMap
from probe_env.files import FileError
from probe_env.schedule import Schedule

LINES = {name: ANYWHERE[name] for name in ("pipe", "folder", "huge", "binary")}
BINARY = LINES | {"empty": ANYWHERE["empty"]}
NOT_EMPTY = {name: damage for name, damage in ANYWHERE.items() if name != "empty"}
KPI_NAMES = (*CORE, "complete", "lost_drive", "diverged")


def text(content):
    return lambda path: path.write_text(content, newline="")


def cut_off(path):
    path.write_bytes(path.read_bytes()[:-30])


@pytest.fixture(scope="session")
def evaluation(tmp_path_factory):
    """A finished evaluation with an ``unfinished.json`` that fits it."""
    path, plan = tmp_path_factory.mktemp("stored") / "evaluation", make_plan(2, 2, seeds=(0,))
    evaluate_plan(plan, path)
    record = json.loads((path / "manifest.json").read_text())
    (path / "unfinished.json").write_text(json.dumps(record | plan.described()))
    return path


@pytest.fixture
def stored(evaluation, tmp_path):
    return shutil.copytree(evaluation, tmp_path / "evaluation")


def second_line(content):
    def damage(path):
        lines = path.read_bytes().splitlines(keepends=True)
        path.write_bytes(b"".join([lines[0], content, *lines[2:]]))

    return damage


def record_with(**changes):
    def damage(path):
        record = json.loads(path.read_bytes().splitlines()[1]) | changes
        del record["crc"]
        second_line(json.dumps(record).encode() + b"\n")(path)

    return damage


RECORDS = {
    "no JSON": second_line(b"seven\n"),
    "a line without end": second_line(b"x" * (5 << 20) + b"\n"),
    "text for a number": record_with(kpis=dict.fromkeys(KPI_NAMES, "high")),
    "NaN": record_with(kpis=dict.fromkeys(KPI_NAMES, float("nan"))),
    "without a KPI": record_with(kpis={"reward": 1.0}),
    "without a column": record_with(profile={"time": [1.0]}),
    "columns of two lengths": record_with(profile={name: [1.0] for name in PROFILE} | {"time": [1.0, 2.0]}),
    "half a probe": record_with(probe={"float_pitch": 0.1}),
    "no key": record_with(key=7),
}


def test_journals(stored):
    def read(path):
        return Journal(path, Episode).read()

    path = stored / "episodes.jsonl"
    assert len(read(path)) == 4
    assert failures_of(path, LINES, read) == []
    assert failures_of(path, RECORDS, read, "line 2: ") == []
    good = json.dumps({"key": "0123456789abcdef", "kpis": dict.fromkeys(KPI_NAMES, 1.0)})
    path.write_text(f'{good}\n{{"key": "0123456789abcdef", "kpis": {{"reward": 1}}}}\n{good}\n')
    with pytest.raises(FileError, match=r"line 2: kpis: .*radial_rms_m"):
        Journal(path, Trial).read()


def test_json_files(stored):
    setting, planned = (json.loads((stored / f"{name}.json").read_text()) for name in ("setting", "unfinished"))
    (key, *rest), name = planned["episodes"][0], "\x1b[2J"
    others = {
        "setting.json": [setting | {"task": {"period": "long"}}, setting | {"probes": "all"}],
        "unfinished.json": [
            planned | {"contexts": [{}]},
            planned | {"episodes": [[key, name, 0, 0]], "policies": {name: {}} | planned["policies"]},
            planned | {"episodes": [["", *rest]]},
        ],
    }
    models = folder.Setting, folder.Manifest, folder.Unfinished, folder.ReportSettings
    for file, model in zip(("setting.json", "manifest.json", "unfinished.json", "report.json"), models, strict=True):
        damages = JSON | {str(content): text(json.dumps(content)) for content in others.get(file, ())}
        read_json(stored / file, model)
        assert failures_of(stored / file, damages, lambda path, model=model: read_json(path, model)) == [], file


def table_with(change):
    return lambda path: change(pd.read_parquet(path)).to_parquet(path, index=False)


TABLES = ANYWHERE | {
    "cut off": cut_off,
    "other columns": table_with(lambda table: pd.DataFrame({"a": [1]})),
    "without a column": table_with(lambda table: table.drop(columns="radial_rms_m")),
    "text for numbers": table_with(lambda table: table.assign(radial_rms_m="high")),
    "no rows": table_with(lambda table: table[:0]),
    "numbers for names": table_with(lambda table: table.assign(policy=7)),
    "a name for the terminal": table_with(lambda table: table.assign(policy="\x1b[2Jslow")),
    "a formula": table_with(lambda table: table.assign(policy="=1+1")),
    "seeds that are none": table_with(lambda table: table.assign(seed=0.5)),
}


def test_parquet_tables(stored, monkeypatch):
    for name, columns in (("episodes", folder.EPISODES), ("profile", PROFILE)):
        read = partial(read_parquet, columns=columns)
        read(stored / f"{name}.parquet")
        assert failures_of(stored / f"{name}.parquet", TABLES, read) == [], name
    monkeypatch.setattr("probe_agents.records.tables.MAX_ROWS", 3)
    with pytest.raises(FileError, match=r"episodes\.parquet: 4 rows; accepted: 1 to 3"):
        read_episodes(stored / "episodes.parquet")


CURVE = {"family": "name", "value": "maybe", "count": "count", "time_s": "number"}
HEADER = "family,value,count,time_s"
CSV = {
    "": "column 'family' is missing; found: none",
    "family,value,count\na,1,1\n": "column 'time_s' is missing; found: family, value, count",
    f"{HEADER}\npi,high,1,1\n": "row 1: value = 'high' is not a number",
    f"{HEADER}\npi,1,1,1\npi,1,1,nan\n": "row 2: time_s = nan is not finite",
    f"{HEADER}\npi,1,1,1\npi,1,1,\n": "row 2: time_s = nan is not finite",
    f"{HEADER}\npi,1,1.5,1\n": "row 1: count = 1.5 is not a whole number of 0 or more",
    f"{HEADER}\npi,1,-1,1\n": "row 1: count = -1 is not a whole number of 0 or more",
    f"{HEADER}\npi,1,1,1\npi,1\n": "row 2: 2 values for 4 columns",
    f"{HEADER},family\npi,1,1,1,pi\n": "column 'family' occurs 2 times",
    f"{HEADER},a,a\npi,1,1,1,1,1\n": "a column occurs twice",
    f"{HEADER}\n=1+1,1,1,1\n": "column 'family': '=1+1' is not a name",
    f"{HEADER}\n,1,1,1\n": "column 'family': '' is not a name",
    f'{HEADER}\n"pi,1,1,1\n': "not CSV: a quote is not closed",
    f"{HEADER}\n": "no rows",
    ",".join([HEADER, *(f"c{k}" for k in range(1001))]) + "\n": "1005 columns are more",
}


def test_csv_tables(tmp_path):
    path = tmp_path / "front.csv"
    for content, message in CSV.items():
        path.write_text(content)
        with pytest.raises(FileError, match=f"^{re.escape(str(path))}: .*{re.escape(message)}"):
            read_csv(path, CURVE)
    path.write_text(f"{HEADER}\npi,1,1,1\n")
    assert failures_of(path, NOT_EMPTY, lambda path: read_csv(path, CURVE)) == []


def test_commands_name_the_damaged_file(stored, refused, tmp_path, capsys):
    """One damage each: of the journal when it is continued, of the other files when a report is written."""
    (stored / "unfinished.json").unlink()
    (stored / "report.json").write_text('{"against": "nobody"}')
    refused(["evaluate", stored], "report.json: against = 'nobody' is not one of the policies")
    (stored / "report.json").unlink()
    for name in ("profile.parquet", "episodes.parquet", "setting.json"):
        content = (stored / name).read_bytes()
        (stored / name).write_bytes(content[:40] + bytes([content[40] ^ 1]) + content[41:])
        refused(["evaluate", stored], f"{stored / name}: its content is not what manifest.json says")
        if name == "episodes.parquet":
            refused(["signal", "--evaluation", stored], f"{stored / name}: its content is not what manifest.json says")
        (stored / name).write_bytes(content)
    (stored / "profile.parquet").unlink()
    refused(["evaluate", stored], f"no such file: {stored / 'profile.parquet'}")
    output = tmp_path / "short"
    run = ["evaluate", "constant", "--limit", "1", "--fidelity", "surrogate", "--output", str(output)]
    assert main(run) == 0
    capsys.readouterr()
    (output / "episodes.jsonl").write_text("seven\n")
    assert main(run) == 2
    assert f"{output / 'episodes.jsonl'}: line 1: " in capsys.readouterr().err
    (output / "setting.json").write_text("{}")
    refused(run, f"{output / 'setting.json'}: ")


SPACE = {"x": optuna.distributions.FloatDistribution(0.0, 1.0)}


@pytest.fixture
def journal(tmp_path):
    """Journal of a study with one complete trial."""
    study = open_study(tmp_path / "study.jsonl", "known", ["minimize"])
    study.tell(study.ask(SPACE), 1.0)
    return tmp_path / "study.jsonl"


def test_study_continues_after_a_kill(journal):
    open_study(journal, "known", ["minimize"]).ask(SPACE)
    with journal.open("ab") as file:
        file.write(b'{"op_code":6,"worker_id"')  # of a line that was cut off
    study = open_study(journal, "known", ["minimize"])
    assert [trial.state.name for trial in study.get_trials()] == ["COMPLETE", "FAIL"]
    study.tell(study.ask(SPACE), 2.0)
    assert [trial.value for trial in open_study(journal, "known", ["minimize"]).get_trials()] == [1.0, None, 2.0]


def test_searches(journal):
    whole = journal.read_bytes()
    damages = LINES | {
        "a line of something else": lambda path: path.write_bytes(b'{"a": 1}\n' + whole),
        "another value": lambda path: path.write_bytes(whole.replace(b'"values":[1.0]', b'"values":[2.0]')),
        "no study": lambda path: path.write_bytes(whole.split(b"\n", 1)[1]),
    }
    assert failures_of(journal, damages, lambda path: open_study(path, "known", ["minimize"])) == []


WEIGHT = "mlp_extractor.policy_net.0.weight"


@pytest.fixture
def bundle(tmp_path):
    path = tmp_path / "agent.safetensors"
    torch.manual_seed(0)
    description = Description(
        algorithm="ppo", network=StoredNetwork(net_arch=(8,)), view=View(averages=(5.0,)), task=TaskConfig(), trained={}
    )  # fmt: skip
    write_bundle(path, description, build_policy(description))
    return path


def resealed(change=lambda *_: None, **entries):
    """Only the content is wrong: its hash is made again, with other ``entries`` of the metadata; None takes one out."""

    def damage(path):
        content, _, weights = read_weights(path)
        description = json.loads(content)
        change(description, weights)
        content = json.dumps(description)
        metadata = {"description": content, "hash": _hash(content, weights)} | entries
        path.write_bytes(save(weights, {name: value for name, value in metadata.items() if value is not None}))

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


BUNDLES = BINARY | {
    "cut off": cut_off,
    "huge header": lambda path: path.write_bytes((1 << 45).to_bytes(8, "little") + b"{}"),
    "wrong byte": one_byte,
    "no metadata": lambda path: path.write_bytes(save(load(path.read_bytes()))),
    "no description": resealed(description=None),
    "another hash": resealed(hash="0" * 32),
    "a deep description": resealed(description="[" * 100_000),
    "NaN": weight_as(lambda old: old * np.float32("nan")),
    "enormous": weight_as(lambda old: old + np.float32(1e30)),
    "double": weight_as(lambda old: old.astype(float)),
    "another shape": weight_as(lambda old: old.T.copy()),
    "missing": resealed(lambda _, weights: weights.pop(WEIGHT)),
    "more": resealed(lambda _, weights: weights.update({"more": np.zeros(3, np.float32)})),
    "ten thousand averages": described(view={"averages": [5.0] * 10_000}),
    "a wider network": described(network={"net_arch": [64]}),
    "no such algorithm": described(algorithm="a2c"),
    "tubes of an unknown field": described(tubes={"foo": [1.0, 2.0]}),
    "tubes that end before they begin": described(tubes={"friction": [0.3, 0.1]}),
    "tubes of NaN": described(tubes={"friction": [float("nan"), 0.3]}),
}


def test_bundles(bundle, refused):
    whole = bundle.read_bytes()
    described(view={"observations": [*OBSERVATIONS, "heat"]})(bundle)
    refused(["evaluate", bundle, *FAST], f"{bundle}: observations = heat are not observed in this task")
    bundle.write_bytes(whole)
    assert failures_of(bundle, BUNDLES, load_bundle) == []
    one_byte(bundle)
    refused(["evaluate", bundle, *FAST], f"{bundle}: changed or cut off")


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


MAPS = BINARY | {
    "cut off": cut_off,
    "bomb": member("bomb.npy", header((1 << 23,)) + b"\0" * (1 << 25), zipfile.ZIP_DEFLATED),
    "huge header": member("weights9.npy", header((1 << 45,))),
    "objects": member("weights9.npy", header((1,), "|O") + b"\0" * 8),
    "not a .npy": member("script.py", b"print()"),
    "twice": member("weights0.npy", header((1,)) + b"\0" * 4),
    "NaN": arrays_as(lambda arrays: arrays | {"weights0": arrays["weights0"] * np.nan}),
    "one layer": arrays_as(lambda arrays: {name: arrays[name] for name in ("weights0", "biases0")}),
    "text": arrays_as(lambda arrays: arrays | {"biases0": np.array(["a"])}),
}


def test_maps(tmp_path, monkeypatch):
    monkeypatch.setattr("probe_env.files.MAX_BYTES", 1 << 24)  # a bomb of 32 MiB will do
    assert failures_of(shutil.copy(MAP, tmp_path / "map.npz"), MAPS, VibrationMap.load) == []


HEAD = "inserted_length_m,feed_speed_m_per_s,air_supply_m3_per_h\n"


def link_to_itself(path):
    path.unlink()
    path.symlink_to(path)


TEXTS = ANYWHERE | {
    "Latin-1": lambda path: path.write_bytes("# für\nfeed_speed = 1\n".encode("latin-1")),
    "escape": text("\x1b[2J\n=\x07"),
    "link": link_to_itself,
}
TOMLS = {name: TEXTS[name] for name in TEXTS if name != "empty"} | {  # an empty scene is one of defaults
    "deep": text("a = " + "[" * 50_000),
    "a deep key": text("a" + ".a" * 30_000 + " = 1"),
    "a long number": text("feed_speed = " + "1" * 10_000),
}
SCHEDULES = TEXTS | {
    "many columns": text(",".join(f"c{k}" for k in range(200_000)) + "\n"),
    "a long cell": text(HEAD + "5," + "1" * 200_000 + ",63\n"),
    "an open quote": text(HEAD + '5,"' + "1,63\n" * 100_000),
}


def test_scenes_and_schedules(tmp_path):
    for name, read, damages in (("file.toml", Scene.from_toml, TOMLS), ("file.csv", Schedule.read, SCHEDULES)):
        (tmp_path / name).write_text("")
        assert failures_of(tmp_path / name, damages, read) == [], name
    (tmp_path / "scene.toml").write_bytes(b"\xef\xbb\xbffeed_speed = 0.1\r\n")  # byte order mark, Windows lines
    assert Scene.from_toml(tmp_path / "scene.toml").feed_speed == 0.1


def test_commands_refuse_a_damaged_file(tmp_path, refused):
    path = tmp_path / "file.toml"
    ANYWHERE["binary"](path)
    for command in ("simulate", "train", "compare", "evaluate"):
        refused([command, path], str(path))
