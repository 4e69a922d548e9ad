"""Folders of results: identity, lock, kills and resuming, checksums. Each command has one test in tests/cli."""

import itertools
import json
import random
import re
import subprocess
from contextlib import nullcontext
from functools import partial
from pathlib import Path

import numpy as np
import optuna
import pandas as pd
import pytest
from kills import killed_at

from probe_agents.records import manifest, result_folder
from probe_agents.records.atomic import write_atomically
from probe_agents.records.models import Key, Stored
from probe_agents.records.result_folder import Journal, ResultFolder, check_hashes, run_lock, sealed
from probe_agents.records.searches import open_study
from probe_agents.records.tables import read_parquet
from probe_env.files import FileError

IDENTITY = {"task": {"period": 1.0, "observe_air": True}, "fidelity": "fast", "tubes": [{"friction": 0.2}]}
VALUES = (0.1, -2.5e-7, 3.0, 1e300)


class Row(Stored):
    key: Key
    values: list[float]


def folder_of(path, **changes):
    return ResultFolder(path, IDENTITY | changes, free=("task.observe_air",))


def work(path):
    """Three rows, a table and a manifest, as every command stores them."""
    journal = Journal(path / "rows.jsonl", Row)
    with folder_of(path).open("rows.jsonl") as folder:
        done = journal.read()
        with journal.appending() as append:
            for k in range(3):
                key = f"{k:016x}"
                if key not in done:
                    append({"key": key, "values": [k * value for value in VALUES]})
        rows = [row["values"] for row in journal.read().values()]
        write_atomically(path / "table.csv", pd.DataFrame(rows).to_csv(index=False))
        folder.write_manifest("table.csv", command="probe-env x")


@pytest.fixture
def finished(tmp_path):
    work(tmp_path / "folder")
    return tmp_path / "folder"


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def flips(content, count, seed=0):
    """Copies of a file's content with one bit changed each."""
    rng = random.Random(seed)
    for position in rng.sample(range(8 * len(content)), min(count, 8 * len(content))):
        damaged = bytearray(content)
        damaged[position // 8] ^= 1 << position % 8
        yield bytes(damaged)


def refusals(path, count, read, check, place=""):
    """How many flips are refused by file and place; what is read of the others is checked."""
    refused = 0
    for damaged in flips(path.read_bytes(), count):
        path.write_bytes(damaged)
        try:
            good = check(read())
        except FileError as error:
            good = str(error).startswith(f"{path}: {place}")
            refused += 1
        assert good
    return refused


@pytest.mark.parametrize("point", ["os.fsync", "os.replace"])
@pytest.mark.parametrize("after", [False, True])
def test_killed_work_continues_to_the_same_bytes(point, after, finished, tmp_path):
    """Killed at every write: three lines; setting, table and manifest."""
    whole = contents(finished)
    for number in itertools.count(1):
        folder = tmp_path / str(number)
        if not killed_at(point, number, work, folder, after=after):
            break
        stored = Journal(folder / "rows.jsonl", Row).read() if (folder / "rows.jsonl").exists() else {}
        assert all(f'"{key}"'.encode() in whole["rows.jsonl"] for key in stored)
        work(folder)
        assert contents(folder) == whole
    assert number - 1 == {"os.fsync": 6, "os.replace": 3}[point]
    assert contents(folder) == whole


@pytest.mark.parametrize(
    "rest", ["", '{"key": "0000', "seven", "\0" * 100, '{"key": "0000000000000002", "values": []}']
)
def test_only_an_incomplete_last_line_is_removed(rest, finished):
    whole, path = contents(finished), finished / "rows.jsonl"
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(lines[:2]) + rest)
    assert len(Journal(path, Row).read()) == 2
    work(finished)
    assert contents(finished) == whole


CODE = "the code changed since these episodes were simulated"
ADVICE = "choose another folder or delete this one"


@pytest.mark.parametrize(
    ("changes", "code", "message"),
    [
        ({}, {}, ""),
        ({"task": {"period": 1.0, "observe_air": False}}, {}, ""),
        ({}, {"commit": "bbb"}, f"{CODE} (commit aaa, now bbb): {ADVICE}"),
        ({}, {"version": "9.9"}, f"{CODE} (version 0.1.0, now 9.9): {ADVICE}"),
        ({"task": {"period": 2.0, "observe_air": True}}, {}, "with other settings (task.period 1.0, now 2.0): choose"),
        ({"task": {"observe_air": True}}, {}, "with other settings (task.period 1.0, now null): choose"),
        ({"tubes": [], "fidelity": "study"}, {}, 'with other settings (fidelity "fast", now "study"; also tubes): ch'),
        ({"probes": "random"}, {}, 'with other settings (probes null, now "random"): choose'),
    ],
)
def test_another_identity_is_refused_and_nothing_changed(changes, code, message, tmp_path, monkeypatch):
    monkeypatch.setattr(result_folder, "commit", lambda: "aaa")
    work(tmp_path)
    before = contents(tmp_path)
    for name, value in code.items():
        monkeypatch.setattr(result_folder, name, lambda *_, value=value: value)
    place = f"^{re.escape(str(tmp_path))}: .*{re.escape(message)}"
    with pytest.raises(FileError, match=place) if message else nullcontext():
        folder_of(tmp_path, **changes).check("rows.jsonl")
    assert contents(tmp_path) == before


def test_a_free_setting_is_stored_again(finished):
    with folder_of(finished, task={"period": 1.0, "observe_air": False}).open():
        pass
    assert json.loads((finished / "setting.json").read_text())["task"]["observe_air"] is False


def test_a_damaged_or_missing_identity_is_refused(finished):
    setting = finished / "setting.json"
    for content in ("{}", "seven", ""):
        setting.write_text(content)
        with pytest.raises(FileError, match=r"setting\.json: "):
            work(finished)
    setting.unlink()
    with pytest.raises(FileError, match=r"setting\.json: missing next to rows\.jsonl: restore the file"):
        work(finished)


def test_a_folder_that_is_not_utf_8_is_refused(tmp_path):
    with pytest.raises(FileError, match=r"\\udcff: the name of the folder is not UTF-8"):
        folder_of(tmp_path / "\udcff")
    assert not list(tmp_path.iterdir())


def test_a_second_process_is_refused(tmp_path):
    with run_lock(tmp_path), pytest.raises(FileError, match="another process is working there: wait for it"):
        work(tmp_path)
    work(tmp_path)
    assert not (tmp_path / "lock").exists()


def test_flipped_bits_of_a_journal_are_not_read(finished):
    """A line that is no longer read is simulated again; a flip in the name of the checksum changes no value."""
    path = finished / "rows.jsonl"
    rows = Journal(path, Row).read()

    def check(read):
        return len(read) >= 2 and all(read[key]["values"] == rows[key]["values"] for key in read)

    assert refusals(path, 1500, Journal(path, Row).read, check, "line ") > 1000


def test_lines_without_a_checksum_are_read(finished):
    path = finished / "rows.jsonl"
    rows = Journal(path, Row).read()
    lines = [{name: value for name, value in row.items() if name != "crc"} for row in rows.values()]
    path.write_text("".join(f"{json.dumps(line)}\n" for line in lines))
    assert list(Journal(path, Row).read().values()) == lines
    assert all(sealed(line)["crc"] == row["crc"] for line, row in zip(lines, rows.values(), strict=True))


def test_flipped_bits_of_files_in_the_manifest_are_named(finished):
    check_hashes(finished, "table.csv", "setting.json", "not listed")
    for name in ("table.csv", "setting.json"):
        content = (finished / name).read_bytes()
        for damaged in flips(content, 50):
            (finished / name).write_bytes(damaged)
            with pytest.raises(FileError, match=rf"{name}: its content is not what manifest\.json says"):
                check_hashes(finished, name)
        (finished / name).write_bytes(content)
    check_hashes(finished, "table.csv", "setting.json")


def test_a_damaged_parquet_file_is_named(tmp_path):
    """Also its metadata, which pandas reads as JSON."""
    path = tmp_path / "table.parquet"
    pd.DataFrame({"x": np.arange(20.0), "name": ["a"] * 20}).to_parquet(path, index=False)
    read = partial(read_parquet, path, {"x": "maybe", "name": "name"})
    assert refusals(path, 1500, read, lambda table: isinstance(table, pd.DataFrame)) > 500


def test_flipped_bits_of_the_journal_of_a_search_are_not_read(tmp_path):
    path, space = tmp_path / "study.jsonl", {"x": optuna.distributions.FloatDistribution(0.0, 1.0)}

    study = partial(open_study, path, "known", ["minimize"])

    def trials():
        return [(trial.state, trial.value, trial.params) for trial in study().get_trials()]

    for value in (1.0, 0.25):
        study().tell(study().ask(space), value)
    whole = trials()

    def check(read):  # a trial of the last line is repeated
        return all(trial in whole for trial in read if trial[0].name == "COMPLETE")

    assert refusals(path, 300, trials, check) > 200


def test_the_commit_is_that_of_the_code_without_configs(tmp_path, monkeypatch):
    """Demo, edit of a schedule, demo: the same commit, whether the edit is committed or not."""
    monkeypatch.setattr(manifest, "CHECKOUT", tmp_path)

    def git(*arguments):
        identity = ("-c", "user.name=a", "-c", "user.email=a@b.c", "-c", "commit.gpgsign=false")
        subprocess.run(["git", *identity, *arguments], cwd=tmp_path, check=True, capture_output=True)

    def change(name, text="b", commit=False):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
        if commit:
            git("add", ".")
            git("commit", "-m", name)
        return manifest.commit.__wrapped__()

    assert manifest.commit.__wrapped__() == "unknown"
    git("init")
    example, code = "configs/schedules/example.csv", "probe_env/scene.py"
    change(example, "a", commit=True)
    first = change(code, "a", commit=True)
    assert len(first) == 12
    assert change(example) == first
    assert change("configs/tubes/mine.toml") == first  # not tracked
    assert change("docs/start.md", commit=True) == first
    assert change("probe_env/data/map.npz") == first  # what a study has just made
    assert change(code) == f"{first}+changes"
    assert change("agents/new.py") == f"{first}+changes"
    second = change(code, commit=True)
    assert second not in (first, f"{first}+changes")
    assert change(example, "c", commit=True) == second


def test_evaluate_after_an_edit_simulates_only_that_schedule(tmp_path, monkeypatch, capsys):
    from probe_agents.cli import main

    monkeypatch.chdir(tmp_path)
    head = "inserted_length_m,feed_speed_m_per_s,air_supply_m3_per_h\n"
    run = ["evaluate", "constant", "mine.csv", "--limit", "1", "--fidelity", "surrogate", "--output", "out"]
    for feed, lines in ((0.3, 2), (0.2, 3), (0.2, 3)):
        Path("mine.csv").write_text(f"{head}5,{feed},63\n")
        assert main(run) == 0
        assert len(Path("out/episodes.jsonl").read_text().splitlines()) == lines
    with monkeypatch.context() as patch:
        patch.setattr(result_folder, "commit", lambda: "0123456789ab")
        assert main(run) == 2
    assert "out: the code changed since these episodes were simulated (commit " in capsys.readouterr().err
    monkeypatch.chdir(tmp_path / "out")
    assert main(["evaluate", "."]) == 0  # the report of this folder
