"""Damaged evaluations and comparisons: one line that names the file, and nothing is changed or run."""

import json
import shutil
from pathlib import Path

import pandas as pd
import pytest
from poisons import ANYWHERE, FAST, JSON, KPIS, POLICIES, ROOT

from agents.cli import main
from agents.design.trials import DesignTrials
from agents.evaluation.page.stored import read_evaluation
from agents.policies.catalogue import named_policies
from agents.records.journal import set_aside
from agents.records.models import TRIAL_KPIS
from agents.records.tables import FRONT
from agents.rollouts.plan import Plan, run_plan
from probe_env import Design
from probe_env.envs.contexts import spread_contexts
from probe_env.envs.task import TaskConfig
from probe_env.fidelity import resolve_fidelity


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
    key = DesignTrials(spread_contexts("test", 1)).key(Design.from_toml(design), spread_contexts("test", 1)[0])
    good = json.dumps({"key": key, "kpis": dict.fromkeys(TRIAL_KPIS, 1.0)})
    for bad in ("seven", '{"key": "x"}', '{"key": "0123456789abcdef", "kpis": {"reward": 1}}', "[]", "\0"):
        (output / "designs.jsonl").write_text(f"{good}\n{bad}\n{good}\n")
        refused(["compare", design, "--limit", "1", "--output", output], f"{output / 'designs.jsonl'}: line 2: ")


def test_a_comparison_without_designs(refused):
    refused(["compare"], "designs = none: give at least one design file")
