"""Readers of stored files: what is damaged is refused in one line with the place; nothing is changed."""

import json
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from plans import make_plan
from poisons import ANYWHERE, FAST, JSON, fingerprint

from agents.cli import main
from agents.evaluation.folder import (
    EPISODES,
    EPISODES_NEWER,
    PROFILE,
    Compared,
    Episode,
    Evaluated,
    Setting,
    Unfinished,
    read_episodes,
    read_evaluation,
)
from agents.evaluation.kpis import CORE, KPIS
from agents.evaluation.run import evaluate_plan, kpi_cells
from agents.records.journal import Journal, set_aside
from agents.records.models import read_json
from agents.records.reading import read_csv, read_parquet
from probe_env.files import FileError, one_line, read_text

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def evaluation(tmp_path_factory):
    """A finished evaluation, and in ``unfinished`` what it was to hold."""
    folder = tmp_path_factory.mktemp("stored") / "evaluation"
    plan = make_plan(2, 2, seeds=(0,))
    evaluate_plan(plan, folder)
    record = json.loads((folder / "manifest.json").read_text())
    (folder.parent / "unfinished.json").write_text(json.dumps(record | plan.described()))
    return folder


@pytest.fixture
def stored(evaluation, tmp_path):
    return shutil.copytree(evaluation, tmp_path / "evaluation")


def failures_of(path, damages, read, place=lambda name: ""):
    """Names of damages that a reader takes, refuses without a place, in several lines, or with a change of files."""
    whole, failures = path.read_bytes(), []

    def restore():
        if path.is_dir():
            path.rmdir()
        path.unlink(missing_ok=True)
        path.write_bytes(whole)

    for name, damage in damages.items():
        restore()
        damage(path)
        before = fingerprint(path.parent)
        try:
            read(path)
            failures.append((name, "is read"))
        except FileError as error:
            text = str(error)
            if not text.startswith(f"{path}: {place(name)}") or not text.isprintable():
                failures.append((name, text[:200]))
        if fingerprint(path.parent) != before:
            failures.append((name, "changes files"))
    restore()
    return failures


# ---- journals ----


def lines_of(path):
    return path.read_bytes().splitlines(keepends=True)


def second_line(content):
    def damage(path):
        lines = lines_of(path)
        path.write_bytes(b"".join([lines[0], content, *lines[2:]]))

    return damage


def record_with(**changes):
    def damage(path):
        second_line(json.dumps(json.loads(lines_of(path)[1]) | changes).encode() + b"\n")(path)

    return damage


KPI_NAMES = (*CORE, "complete", "lost_drive", "diverged")
WHOLE_FILE = {name: ANYWHERE[name] for name in ("pipe", "folder", "huge", "binary", "utf-16", "NUL")}
AT_THE_END = {
    "NULs": lambda path: path.write_bytes(path.read_bytes() + b"\0" * 100),
    "garbage": lambda path: path.write_bytes(path.read_bytes() + b"seven"),
}
LINES = {
    "half a line": second_line(b'{"key": "0123\n'),
    "no JSON": second_line(b"seven\n"),
    "foreign": second_line(b'{"key": "0123456789abcdef", "kpis": {"reward": 1.0}}\n'),
    "empty line": second_line(b"\n"),
    "NULs": second_line(b"\0" * 40 + b"\n"),
    "nested": second_line(b"[" * 100_000 + b"\n"),
    "a line without end": second_line(b"x" * (5 << 20) + b"\n"),
    "text for a number": record_with(kpis=dict.fromkeys(KPI_NAMES, "high")),
    "NaN": record_with(kpis=dict.fromkeys(KPI_NAMES, float("nan"))),
    "without a KPI": record_with(kpis={"reward": 1.0}),
    "without a column": record_with(profile={"time": [1.0]}),
    "columns of two lengths": record_with(profile={name: [1.0] for name in PROFILE} | {"time": [1.0, 2.0]}),
    "a list for the KPIs": record_with(kpis=[1.0]),
    "half a probe": record_with(probe={"float_pitch": 0.1}),
    "no key": record_with(key=7),
}


def test_journals(stored):
    def read(path):
        return Journal(path, Episode).read()

    path = stored / "episodes.jsonl"
    assert len(read(path)) == 4
    assert failures_of(path, WHOLE_FILE, read) == []
    assert failures_of(path, LINES, read, lambda _: "line 2: ") == []
    assert failures_of(path, AT_THE_END, read, lambda _: "line 5: ") == []


def test_a_journal_is_set_aside_only_where_a_line_was_cut_off(tmp_path):
    path = tmp_path / "episodes.jsonl"
    set_aside(path)  # there is none
    path.touch()
    set_aside(path)
    assert path.read_bytes() == b""
    path.write_text('{"key": "a"}\n{"key": "b"}')
    set_aside(path)
    assert path.read_text() == '{"key": "a"}\n{"key": "b"}\n'
    path.write_text('{"key": "a"}\n{"key": "b')
    set_aside(path)
    assert path.read_text() == '{"key": "a"}\n'
    assert (tmp_path / "episodes.jsonl.cut-off").read_text() == '{"key": "b\n'


# ---- JSON ----


def test_json_files(stored, evaluation):
    shutil.copy(evaluation.parent / "unfinished.json", stored)
    setting = json.loads((stored / "setting.json").read_text())
    planned = json.loads((stored / "unfinished.json").read_text())
    key, name = planned["episodes"][0][0], "\x1b[2J"
    others = {
        "setting.json": {
            "another task": setting | {"task": {"period": "long"}},
            "no such probes": setting | {"probes": "all"},
        },
        "unfinished.json": {
            "a tube too few": planned | {"contexts": [{}]},
            "a name for the terminal": planned
            | {"episodes": [[key, name, 0, 0]], "policies": {name: {}} | planned["policies"]},
            "no key": planned | {"episodes": [["", *planned["episodes"][0][1:]]]},
        },
    }
    models = {"setting.json": Setting, "manifest.json": Evaluated, "unfinished.json": Unfinished,
              "report.json": Compared}  # fmt: skip
    for file, model in models.items():
        damages = JSON | {
            damage: lambda path, content=content: path.write_text(json.dumps(content))
            for damage, content in others.get(file, {}).items()
        }
        read_json(stored / file, model)
        assert failures_of(stored / file, damages, lambda path, model=model: read_json(path, model)) == [], file


# ---- tables ----


def table_with(change):
    def damage(path):
        change(pd.read_parquet(path)).to_parquet(path, index=False)

    return damage


TABLES = ANYWHERE | {
    "cut off": lambda path: path.write_bytes(path.read_bytes()[:-100]),
    "other columns": table_with(lambda table: pd.DataFrame({"a": [1]})),
    "without a column": table_with(lambda table: table.drop(columns="radial_rms_m")),
    "text for numbers": table_with(lambda table: table.assign(radial_rms_m="high")),
    "no rows": table_with(lambda table: table[:0]),
    "numbers for names": table_with(lambda table: table.assign(policy=7)),
    "a name for the terminal": table_with(lambda table: table.assign(policy="\x1b[2Jslow")),
    "a formula": table_with(lambda table: table.assign(policy="=1+1")),
    "a long name": table_with(lambda table: table.assign(policy="x" * 10**6)),
    "seeds that are none": table_with(lambda table: table.assign(seed=0.5)),
    "CSV": lambda path: path.write_text("policy,context\na,0\n"),
}


def test_parquet_tables(stored, monkeypatch):
    shutil.copy(stored / "episodes.parquet", stored.parent / "whole.parquet")
    readers = {"episodes": read_episodes, "profile": lambda path: read_parquet(path, PROFILE)}
    for name, read in readers.items():
        read(stored / f"{name}.parquet")
        assert failures_of(stored / f"{name}.parquet", TABLES, read) == [], name
    monkeypatch.setattr("agents.records.tables.MOST_ROWS", 3)
    with pytest.raises(FileError, match=r"whole\.parquet: 4 rows: a table has 1 to 3"):
        read_episodes(stored.parent / "whole.parquet")


CURVE = {"family": "name", "value": "maybe", "count": "count", "time_s": "number"}
CSV = {
    "": "column 'family' is missing; found: none",
    "family,value,count\na,1,1\n": "column 'time_s' is missing; found: family, value, count",
    "family,value,count,time_s\npi,high,1,1\n": "row 1: value = 'high' is not a number",
    "family,value,count,time_s\npi,1,1,1\npi,1,1,nan\n": "row 2: time_s = nan is not finite",
    "family,value,count,time_s\npi,1,1,1\npi,1,1,\n": "row 2: time_s = nan is not finite",
    "family,value,count,time_s\npi,1,1.5,1\n": "row 1: count = 1.5 is not a whole number of 0 or more",
    "family,value,count,time_s\npi,1,-1,1\n": "row 1: count = -1 is not a whole number of 0 or more",
    "family,value,count,time_s\npi,1,1,1\npi,1\n": "row 2: 2 values for 4 columns",
    "family,value,count,time_s,family\npi,1,1,1,pi\n": "column 'family' is there 2 times",
    "family,value,count,time_s,a,a\npi,1,1,1,1,1\n": "a column is there twice",
    "family,value,count,time_s\n=1+1,1,1,1\n": "column 'family': '=1+1' is not a name",
    "family,value,count,time_s\n,1,1,1\n": "column 'family': '' is not a name",
    'family,value,count,time_s\n"pi,1,1,1\n': "not CSV: a quote is not closed",
    "family,value,count,time_s\n": "no rows",
    ",".join(["family", "value", "count", "time_s", *(f"c{k}" for k in range(1001))]) + "\n": "1005 columns are more",
}


def test_csv_tables(tmp_path):
    path, failures = tmp_path / "front.csv", []
    for text, message in CSV.items():
        path.write_text(text)
        try:
            read_csv(path, CURVE)
            failures.append((text, "is read"))
        except FileError as error:
            if not str(error).startswith(f"{path}: ") or message not in str(error):
                failures.append((text[:80], str(error)))
    assert failures == []
    path.write_text("family,value,count,time_s\npi,1,1,1\n")
    damages = {name: ANYWHERE[name] for name in ANYWHERE if name != "empty"}
    assert failures_of(path, damages, lambda path: read_csv(path, CURVE)) == []


def test_cells_of_csv_tables_stay_what_they_are(tmp_path):
    """Names and hashes are text, numbers are exact; other columns are what all of their cells allow."""
    path = tmp_path / "table.csv"
    path.write_text(
        "\ufefffamily,value,count,time_s,commit,code,date,truth,number,text,none\r\n"
        'null,,7,0.1,075498296950,12345e678901,2020-01-01,True,075,"a, ""b""",\r\n\r\n'
        "1e5,nan,8.0,1e-5,12345e678901,0,2020-01-02,False,1e400,True,\r\n",
        encoding="utf-8",
    )
    table = read_csv(path, CURVE)
    assert table["family"].tolist() == ["null", "1e5"]
    assert table["value"].isna().all()
    assert table["count"].tolist() == [7, 8]
    assert table["count"].dtype == np.int64
    assert table["time_s"].tolist() == [0.1, 1e-5]
    assert table["commit"].tolist() == ["075498296950", "12345e678901"]
    assert table["code"].tolist() == ["12345e678901", "0"]
    assert table["date"].tolist() == ["2020-01-01", "2020-01-02"]
    assert table["truth"].tolist() == [True, False]
    assert table["number"].tolist() == [75.0, np.inf]
    assert table["text"].tolist() == ['a, "b"', "True"]
    assert table["none"].isna().all()
    rng = np.random.default_rng(0)
    numbers = rng.normal(size=500) * 10.0 ** rng.integers(-300, 300, size=500)
    pd.DataFrame({"x": map(repr, numbers.tolist())}).to_csv(path, index=False)
    assert (read_csv(path, {"x": "number"})["x"].to_numpy() == numbers).all()


def test_kpis_newer_than_a_table_are_neither_demanded_nor_shown(tmp_path, monkeypatch):
    """One that a table has is shown and checked; those of ``CORE`` are demanded."""
    path, table = tmp_path / "whole.csv", pd.read_csv(ROOT / "results" / "evaluation" / "episodes.csv")
    table = table[table["policy"] == table["policy"][0]].iloc[:4]
    table.to_csv(path, index=False)
    monkeypatch.setitem(KPIS, "jolts_per_m", ("jolts", 1.0, "1/m"))
    monkeypatch.setitem(EPISODES_NEWER, "jolts_per_m", "number")
    before = len(kpi_cells(read_episodes(path))[0][1])
    assert before == len(set(KPIS) & set(table.columns)) + 1  # with a90/95, of the curves of detection
    for kind in ("csv", "parquet"):
        newer = tmp_path / f"episodes.{kind}"

        def write(frame, newer=newer, kind=kind):
            getattr(frame, f"to_{kind}")(newer, index=False, **({"na_rep": "nan"} if kind == "csv" else {}))

        write(table.assign(jolts_per_m=2.0))
        assert {len(row) for _, row in kpi_cells(read_episodes(newer))} == {before + 1}
        write(table.assign(jolts_per_m=np.where(table.index == 3, np.nan, 2.0)))
        with pytest.raises(FileError, match=r"row 4: jolts_per_m = nan is not finite"):
            read_episodes(newer)
    for name in CORE:
        table.drop(columns=name).to_csv(tmp_path / "episodes.csv", index=False)
        with pytest.raises(FileError, match=f"column '{name}' is missing"):
            read_episodes(tmp_path / "episodes.csv")
    assert set(EPISODES) <= set(table.columns)


# ---- commands ----


def test_commands_name_the_damaged_file(stored, refused):
    """One damage each: of the journal when it is continued, of the other files when a report is written."""
    (stored / "report.json").write_text('{"against": "nobody"}')
    refused(["evaluate", stored], "report.json: against = 'nobody' is not one of the policies")
    (stored / "report.json").unlink()
    for name, column, value, message in (
        ("profile", "policy", "somebody", "profile.parquet: of policies that are not in episodes.parquet"),
        ("episodes", "reward", float("nan"), "row 1: reward = nan is not finite"),
    ):
        path = stored / f"{name}.parquet"
        pd.read_parquet(path).assign(**{column: value}).to_parquet(path, index=False)
        refused(["evaluate", stored], message)
    (stored / "setting.json").write_text("{}")
    refused(["evaluate", "constant", *FAST, "--output", stored], f"{stored / 'setting.json'}: ")
    (stored / "setting.json").unlink()
    (stored / "episodes.jsonl").write_text("seven\n")
    refused(["evaluate", "constant", *FAST, "--output", stored], f"{stored / 'episodes.jsonl'}: line 1: ")


def test_an_evaluation_without_its_tables(stored, refused):
    (stored / "profile.parquet").unlink()
    refused(["evaluate", stored], f"no such file: {stored / 'profile.parquet'}")
    with pytest.raises(FileNotFoundError):
        read_evaluation(stored)


def test_an_interrupted_comparison_names_its_journal(tmp_path, refused, capsys):
    from agents.design.compare import Comparison, Trial
    from probe_env import Design
    from probe_env.envs.contexts import spread_contexts

    design, output = ROOT / "configs" / "design" / "original.toml", tmp_path / "compare"
    output.mkdir()
    tubes = spread_contexts("test", 1)
    key = Comparison({"original": Design.from_toml(design)}, tubes).key(Design.from_toml(design), tubes[0])
    good = json.dumps({"key": key, "kpis": dict.fromkeys(KPI_NAMES, 1.0)})
    assert Trial.model_validate_json(good).key == key
    for bad in ("seven", '{"key": "x"}', '{"key": "0123456789abcdef", "kpis": {"reward": 1}}', "[]", "\0"):
        (output / "designs.jsonl").write_text(f"{good}\n{bad}\n{good}\n")
        refused(["compare", design, "--limit", "1", "--output", output], f"{output / 'designs.jsonl'}: line 2: ")
    assert main(["compare"]) == 2
    assert "designs = none: give at least one design file" in capsys.readouterr().err


# ---- text ----


def test_the_longest_number_that_can_be_read_is_read(tmp_path):
    path = tmp_path / "numbers.json"
    path.write_text("[\n" + "9" * 4300 + "]")
    assert json.loads(read_text(path)) == [10**4300 - 1]
    path.write_text("[\n" + "9" * 4301 + "]")
    with pytest.raises(FileError, match="line 2: a number of more than 4300 digits"):
        read_text(path)


def test_errors_are_one_printable_line():
    assert one_line("a\nb\x1b[31m\u202e") == "a; b\\x1b[31m\\u202e"
    assert len(one_line("x" * 10**6)) < 2100
    assert str(FileError("a\nb", "c\nd")).isprintable()
