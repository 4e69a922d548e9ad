"""Readers and writers of stored files: journals that were cut off, cells of tables, optional columns, manifests."""

import hashlib
import json
import os
import tracemalloc
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from probe_agents.evaluation.folder import Episode, read_episodes
from probe_agents.evaluation.kpis import CORE, KPIS, displayed_kpis
from probe_agents.records import manifest
from probe_agents.records.atomic import write_atomically
from probe_agents.records.manifest import write_json, write_manifest
from probe_agents.records.result_folder import Journal
from probe_agents.records.searches import open_study
from probe_agents.records.tables import read_csv
from probe_agents.terminal.messages import format_error
from probe_env.files import FileError, one_line, read_bytes, read_text

ROOT = Path(__file__).parents[2]


def test_cells_of_csv_tables_keep_their_types(tmp_path):
    """Names and hashes are text, numbers are exact; other columns are what all of their cells allow."""
    path = tmp_path / "table.csv"
    path.write_text(
        "\ufefffamily,value,count,time_s,commit,code,date,truth,number,text,none\r\n"
        'null,,7,0.1,075498296950,12345e678901,2020-01-01,True,075,"a, ""b""",\r\n\r\n'
        "1e5,nan,8.0,1e-5,12345e678901,0,2020-01-02,False,1e400,True,\r\n",
        encoding="utf-8",
    )
    table = read_csv(path, {"family": "name", "value": "maybe", "count": "count", "time_s": "number"})
    for name, values in {
        "family": ["null", "1e5"], "count": [7, 8], "time_s": [0.1, 1e-5], "commit": ["075498296950", "12345e678901"],
        "code": ["12345e678901", "0"], "date": ["2020-01-01", "2020-01-02"], "truth": [True, False],
        "number": [75.0, np.inf], "text": ['a, "b"', "True"],
    }.items():  # fmt: skip
        assert table[name].tolist() == values, name
    assert table["count"].dtype == np.int64
    assert table[["value", "none"]].isna().all(axis=None)
    rng = np.random.default_rng(0)
    numbers = rng.normal(size=500) * 10.0 ** rng.integers(-300, 300, size=500)
    pd.DataFrame({"x": map(repr, numbers.tolist())}).to_csv(path, index=False)
    assert (read_csv(path, {"x": "number"})["x"].to_numpy() == numbers).all()


def test_kpis_may_be_missing_but_are_checked(tmp_path):
    """Those of ``CORE`` are required."""
    path, table = tmp_path / "episodes.csv", pd.read_csv(ROOT / "results" / "evaluation" / "episodes.csv")
    table = table[table["policy"] == table["policy"][0]].iloc[:4]
    some = table.drop(columns="air_m3")
    some.to_csv(path, index=False)
    assert set(displayed_kpis(read_episodes(path))) == set(KPIS) & set(some.columns) | {"a90_95_percent_wall"}
    worse = table.assign(air_m3=np.where(table.index == 3, np.nan, 2.0))
    worse.to_csv(path, index=False, na_rep="nan")
    worse.to_parquet(tmp_path / "episodes.parquet", index=False)
    for damaged in (path, tmp_path / "episodes.parquet"):
        with pytest.raises(FileError, match=r"row 4: air_m3 = nan is not finite"):
            read_episodes(damaged)
    for name in CORE:
        table.drop(columns=name).to_csv(path, index=False)
        with pytest.raises(FileError, match=f"column '{name}' is missing"):
            read_episodes(path)


def test_a_manifest_names_what_made_a_result_and_its_files(tmp_path, monkeypatch):
    (tmp_path / "part").mkdir()
    (tmp_path / "part" / "a.csv").write_bytes(b"a\n1\n")
    monkeypatch.setattr(manifest, "commit", lambda: "0123456789ab+changes")
    write_manifest(tmp_path, ["part/a.csv"], seeds=range(2), command="probe-env x", limit=3)
    record = json.loads((tmp_path / "manifest.json").read_text())
    assert record["files"] == {"part/a.csv": hashlib.sha256(b"a\n1\n").hexdigest()}
    assert (record["seeds"], record["limit"], record["command"]) == ([0, 1], 3, "probe-env x")
    assert (record["commit"], record["clean"], record["version"]) == ("0123456789ab+changes", False, "0.1.0")
    assert {"python", "packages", "machine"} <= set(record)
    both = manifest.origin(commits=["aaa", "bbb", "aaa"])
    assert (both["commit"], both["clean"]) == ("aaa, bbb", True)
    assert manifest.origin(commits=["unknown"])["clean"] is None
    with pytest.raises(FileNotFoundError):
        write_manifest(tmp_path, ["b.csv"])
    write_json(tmp_path / "nan.json", {"a": [float("nan"), 1.0]})
    assert json.loads((tmp_path / "nan.json").read_text()) == {"a": [None, 1.0]}


def test_a_password_in_an_address_is_not_stored():
    command = "probe-env evaluate pi --backend ray --address ray://me:se@cret@host:6379 --limit 2"
    assert manifest.origin(command)["command"] == command.replace("se@cret", "***")
    assert manifest.origin("probe-env evaluate pi")["command"] == "probe-env evaluate pi"


def test_texts_and_errors(tmp_path):
    path = tmp_path / "numbers.json"
    path.write_text("[\n" + "9" * 4300 + "]")
    assert json.loads(read_text(path)) == [10**4300 - 1]
    path.write_text("[\n" + "9" * 4301 + "]")
    with pytest.raises(FileError, match="line 2: a number of more than 4300 digits"):
        read_text(path)
    assert one_line("a\nb\x1b[31m\u202e") == "a; b\\x1b[31m\\u202e"
    assert one_line("a" + "x" * 10**6 + "z") == f"a{'x' * 999} ... {'x' * 999}z"
    assert str(FileError("a\nb", "c\nd")) == "a\\nb: c; d"


def test_a_reader_depends_on_the_true_size(tmp_path, monkeypatch):
    path, fstat = tmp_path / "file", os.fstat
    path.write_bytes(b"x" * 1000)
    tracemalloc.start()
    assert read_bytes(path, 1 << 28) == b"x" * 1000
    assert tracemalloc.get_traced_memory()[1] < 1 << 20
    tracemalloc.stop()
    with pytest.raises(FileError, match="1000 bytes are more than the 999"):
        read_bytes(path, 999)
    path.write_bytes(b"0123456789")
    for reported in (10, 4, 0):  # a file that grows, and one of /proc

        def shorter(handle, reported=reported):
            status = list(fstat(handle))
            status[6] = reported
            return os.stat_result(status)

        monkeypatch.setattr("probe_env.files.os.fstat", shorter)
        assert read_bytes(path, 10) == b"0123456789"
        with pytest.raises(FileError, match=r"more than the 9|10 bytes are more than the 9"):
            read_bytes(path, 9)


def test_errors_of_the_system_name_the_file(tmp_path, monkeypatch):
    def full(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    for path, write in (
        (tmp_path / "a.csv", lambda path: write_atomically(path, "text")),
        (tmp_path / "b\n.jsonl", write_line),
        (tmp_path / "c.jsonl", lambda path: open_study(path, "known", ["minimize"])),
    ):
        with pytest.raises(OSError, match="No space left") as error:
            write(path)
        assert format_error(error.value) == str(path).replace("\n", "\\n") + ": No space left on device"
    assert format_error(MemoryError()) == "not enough memory"
    assert format_error(MemoryError("Unable to allocate 8 GiB")) == "not enough memory: Unable to allocate 8 GiB"


def write_line(path):
    with Journal(path, Episode).appending() as append:
        append({})


def test_a_deleted_working_folder_is_named(tmp_path, monkeypatch):
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    for work in (Path().resolve, Path("output").mkdir):
        with pytest.raises(FileNotFoundError) as error:
            work()
        assert format_error(error.value) == "the working folder was deleted: change to another one"
