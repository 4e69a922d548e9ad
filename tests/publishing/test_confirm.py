"""Whether rewritten code gives the same: what is compared, what is kept, and that a difference is not."""

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import tomli_w

from agents.publishing import confirm, stages, trees
from agents.publishing.confirm import SAMPLES, additions, confirm_results, first_difference, sampled
from agents.publishing.stages import Stage, load_stages
from agents.publishing.trees import put_inputs, share_compiled
from probe_env.kernel_cache import STAMP

OLD = "0123456789abcdef"
RECORD = {
    "command": "evaluate pi --limit 24 --output {work}", "commit": "abc", "packages": {},
    "machine": {"processor": "p", "cores": 2, "system": "s"}, "code": OLD, "inputs": "", "seconds": 1.0,
    "files": ["results/numbers/table.csv"],
}  # fmt: skip


def folder(place, table="a,commit\n1,x\n", value=1.0):
    place.mkdir(parents=True)
    (place / "table.csv").write_text(table)
    np.savez(place / "map.npz", weights=np.array([value]))
    (place / "notes.json").write_text("{}")
    return place


def compared(before, now):
    """As if the first had been published."""
    return first_difference(before, now, {path.name: path for path in before.iterdir()})


@pytest.mark.parametrize(
    ("change", "difference"),
    [
        ({}, ""),
        ({"table": "a,commit\n1,y\n"}, ""),  # another commit says nothing of the numbers
        ({"table": "a,commit\n1.0000000001,x\n"}, "table.csv differs"),
        ({"table": "a,b,commit\n1,2,x\n"}, ""),  # what is written besides changes nothing that was there
        ({"table": "a,commit\n0,x\n1,x\n2,x\n"}, ""),
        ({"table": "b,commit\n1,x\n"}, "table.csv differs"),
        ({"table": "a,commit\n2,x\n"}, "table.csv differs"),
        ({"value": 1.0 + 2.0**-52}, "map.npz differs"),
    ],
)
def test_every_digit_counts_and_only_numbers_do(tmp_path, change, difference):
    assert compared(folder(tmp_path / "before"), folder(tmp_path / "now", **change)) == difference


def test_only_what_is_published_counts(tmp_path):
    """A column that the stored table has not, and a file that is not published, may differ."""
    one = folder(tmp_path / "before", "a,b,commit\n1,2,x\n")
    other = folder(tmp_path / "now", "a,b,commit\n1,3,x\n", value=2.0)
    stored = folder(tmp_path / "stored", "a,commit\n1,y\n5,y\n")
    names = {"table.csv": stored / "table.csv"}
    assert first_difference(one, other, names) == ""
    assert first_difference(one, other, names | {"map.npz": stored / "map.npz"}) == "map.npz differs"
    (stored / "table.csv").write_text("b,a,commit\n2,1,y\n")
    assert first_difference(one, other, names) == "table.csv differs"


def test_what_is_written_besides_is_told(tmp_path):
    one, other = folder(tmp_path / "before"), folder(tmp_path / "now", "a,b,c,commit\n0,2,,x\n1,2,,x\n")
    assert additions(one, other) == ["table.csv: 2 new columns (b, ...), 1 new rows"]
    assert additions(one, one) == []
    (other / "table.csv").write_text("a,commit\n0,x\n1,x\n")
    assert additions(one, other) == ["table.csv: 1 new rows"]
    assert compared(other, one) == "table.csv differs"  # what is lost is a difference


def test_a_file_that_is_not_there_is_a_difference(tmp_path):
    one, other = folder(tmp_path / "before"), folder(tmp_path / "now")
    (other / "map.npz").unlink()
    assert compared(one, other) == "the files differ: map.npz"
    shutil.rmtree(one)
    one.mkdir()
    assert "holds nothing to compare" in compared(one, other)


@pytest.mark.parametrize(("source", "shared"), [("x = 1\n", True), ("x = 2\n", False)])
def test_kernels_are_compiled_once_where_the_simulator_is_the_same(tmp_path, monkeypatch, source, shared):
    monkeypatch.setattr(trees, "CHECKOUT", tmp_path / "here")
    for place, text in (("here", "x = 1\n"), ("there", source)):
        folder = tmp_path / place / "probe_env/physics"
        folder.mkdir(parents=True)
        (folder / "kernel.py").write_text(text)
    compiled = Path("probe_env/physics/__pycache__/kernel.advance-1.py311.nbi")
    (tmp_path / "here" / compiled).parent.mkdir()
    files = (compiled, compiled.with_name(STAMP))  # without the stamp they would be forgotten there
    for file in files:
        (tmp_path / "here" / file).write_bytes(b"code")
    share_compiled(tmp_path / "there")
    assert all((tmp_path / "there" / file).exists() is shared for file in files)


def test_a_sample_is_the_command_with_other_options():
    assert sampled("evaluate 'a b' --limit 24 --output {work}", {"limit": "1"}) == (
        "evaluate 'a b' --limit 1 --output '{work}'"
    )
    assert sampled("evaluate pi", {"limit": "1"}) == "evaluate pi --limit 1"


def test_every_sample_finds_what_it_reads(monkeypatch, tmp_path):
    """A file beside the samples, wherever the code is that runs; and there are scripts where they are named."""
    ran = []
    done = subprocess.CompletedProcess([], 0)
    monkeypatch.setattr(confirm.subprocess, "run", lambda words, **_: ran.append(words) or done)
    for one in load_stages():
        if one.sample or one.script:
            confirm._run(one, one.command, tmp_path / "tree", tmp_path / "work")
    assert len(ran) > 40
    files = {word for words in ran for word in words if str(SAMPLES) in word}
    assert {Path(word).suffix for word in files} == {".py", ".toml"}
    assert all(Path(word).is_file() for word in files)
    assert not any("{" in word for words in ran for word in words)


@pytest.fixture
def stage(tmp_path, monkeypatch):
    """A stage whose code has changed; ``outputs`` is what its samples write, before and now."""
    one = Stage(
        name="numbers", command=RECORD["command"], publish={"results/numbers": ("*.csv", "*.npz")},
        code=("agents.study.cases:run_case",), sample={"limit": "1"}, minutes=1.0,
    )  # fmt: skip
    monkeypatch.setattr(stages, "CHECKOUT", tmp_path)
    for module in (stages, confirm):
        monkeypatch.setattr(module, "RECORDS", tmp_path / "results" / "records")
    for module in (confirm, trees):
        monkeypatch.setattr(module, "CHECKOUT", tmp_path)
    monkeypatch.setattr(confirm, "WORK", tmp_path / "output")
    monkeypatch.setattr(confirm, "load_stages", lambda: (one,))
    monkeypatch.setattr(confirm, "states_in", lambda tree: {})
    monkeypatch.setattr(confirm, "in_history", lambda _: True)
    monkeypatch.setattr(confirm, "commit", lambda: "def")
    monkeypatch.setattr(confirm, "committed_at", lambda name: {"abc": 2, "def": 3}.get(name, 1))
    monkeypatch.setattr(trees, "checked_out", lambda name: _Tree(tmp_path / name))
    state = one.state()
    (tmp_path / "results" / "records").mkdir(parents=True)
    (tmp_path / "results" / "numbers").mkdir()
    (tmp_path / "results" / "numbers" / "table.csv").write_text(f"a,code\n1,{OLD}\n")
    np.savez(tmp_path / "results" / "numbers" / "map.npz", weights=np.array([1.0]))
    path = tmp_path / "results" / "records" / "numbers.json"
    path.write_text(json.dumps(RECORD | {"inputs": state["inputs"]}))
    return one, path, state


class _Tree:
    def __init__(self, place):
        self.place = place

    def __enter__(self):
        return self.place

    def __exit__(self, *_):
        pass


def outputs(monkeypatch, before, now):
    ran = []

    def run(one, command, tree, place):
        ran.append((sampled(command, one.sample), tree.name))
        folder(Path(place), value=before if tree.name == "abc" else now)

    monkeypatch.setattr(confirm, "_run", run)
    return ran


def test_results_are_kept_under_the_new_hash_where_the_sample_agrees(stage, monkeypatch, tmp_path, capsys):
    one, path, state = stage
    assert one.stale() == "code changed"
    ran = outputs(monkeypatch, 1.0, 1.0)
    confirm_results(("numbers",))
    assert [command for command, _ in ran] == ["evaluate pi --limit 1 --output '{work}'"] * 2
    assert ran[0][1] == "abc"
    kept = json.loads(path.read_text())
    assert kept["code"] == state["code"]
    assert kept["commit"] == "abc"  # they are still what that commit made
    assert kept["confirmed"][0]["from"] == OLD
    assert kept["confirmed"][0]["sample"] == {"limit": "1"}
    assert (tmp_path / "results" / "numbers" / "table.csv").read_text() == f"a,code\n1,{OLD}\n"  # as it was made
    assert "numbers: the same: kept" in capsys.readouterr().out
    confirm_results(())
    assert "numbers: up to date" in capsys.readouterr().out


def test_the_code_before_runs_once_however_often_the_present_one_is_mended(stage, monkeypatch, tmp_path):
    ran = outputs(monkeypatch, 1.0, 2.0)
    with pytest.raises(RuntimeError, match="differs"):
        confirm_results(("numbers",))
    later = outputs(monkeypatch, 1.0, 1.0)
    confirm_results(("numbers",))
    assert [tree for _, tree in ran] == ["abc", tmp_path.name]
    assert [tree for _, tree in later] == [tmp_path.name]


def test_results_are_kept_without_a_sample_where_only_the_measure_changed(stage, monkeypatch, tmp_path):
    """Up to date at a commit which by today's hash and list of inputs is what is here; what differs is not kept."""
    one, path, state = stage
    table = tmp_path / "results" / "numbers" / "table.csv"
    table.write_text("a\n1\n")
    record = json.loads(path.read_text()) | {"inputs": "of other files"}
    path.write_text(json.dumps(record))
    then = {name: record[name] for name in state}
    monkeypatch.setattr(confirm, "states_in", lambda tree: {"numbers": then})
    for by_today, answer in (({}, "code and inputs changed"), ({"numbers": state | {"code": "x"}}, "changed: make it")):
        monkeypatch.setattr(confirm, "states_by_today", lambda tree, known=by_today: known)
        assert answer in confirm.confirm(one, trees_at(tmp_path))
    monkeypatch.setattr(confirm, "states_by_today", lambda tree: {"numbers": state})
    monkeypatch.setattr(confirm, "states_in", lambda tree: {"numbers": then | {"code": "other"}})
    assert "make it again" in confirm.confirm(one, trees_at(tmp_path))
    monkeypatch.setattr(confirm, "states_in", lambda tree: {"numbers": then})
    assert confirm.confirm(one, trees_at(tmp_path)) == "by today's measure the same code and inputs: kept"
    assert one.stale() == "commit abc is not in the history"
    entry = json.loads(path.read_text())["confirmed"][0]
    assert (entry["from"], entry["sample"]) == (OLD, {})  # none was run


def trees_at(folder):
    return lambda name: folder / name


def test_a_tree_is_measured_by_todays_list_and_hash(stage, tmp_path, monkeypatch):
    """Its code and files, by a list of stages and a hash that are not its own; stages of later code are left out."""
    one, *_ = stage
    today, tree = tmp_path / "today", tmp_path / "tree"
    for place in (today / "configs", tree / "agents", tree / "probe_env"):
        place.mkdir(parents=True)
    root = Path(stages.__file__).parents[2]
    (today / "agents").symlink_to(root / "agents")
    one = one.model_copy(update={"reads": ("notes.txt",)})
    later = one.model_copy(update={"name": "later", "code": ("agents.study.later:run",)})
    listed = [each.model_dump() for each in (later, one)]
    (today / "configs" / "results.toml").write_text(tomli_w.dumps({"stage": listed}))
    monkeypatch.setattr(trees, "CHECKOUT", today)
    trees.states_by_today.cache_clear()
    for package in ("agents", "probe_env"):
        shutil.copytree(
            root / package, tree / package, dirs_exist_ok=True, ignore=shutil.ignore_patterns("*.nb?", "*.npz")
        )
    (tree / "notes.txt").write_text("1")
    (tmp_path / "notes.txt").write_text("1")
    assert trees.states_by_today(tree) == {"numbers": one.state()}
    trees.states_by_today.cache_clear()
    (tree / "notes.txt").write_text("2")
    cases = tree / "agents" / "study" / "cases.py"
    cases.write_text(cases.read_text().replace("def run_case(", "def run_case(extra: int, ", 1))
    other = trees.states_by_today(tree)["numbers"]
    assert [name for name, value in one.state().items() if other[name] != value] == ["code", "inputs"]
    trees.states_by_today.cache_clear()
    cases.unlink()  # as one that is too old
    assert trees.states_by_today(tree) == {}


def test_all_stages_can_be_compared_with_one_commit(stage, monkeypatch, tmp_path):
    """It is checked out once, and a stage that was stale then is not kept by it."""
    one, path, _ = stage
    many = tuple(one.model_copy(update={"name": name}) for name in ("numbers", "letters"))
    monkeypatch.setattr(confirm, "load_stages", lambda: many)
    (path.parent / "letters.json").write_text(path.read_text())
    then = {key: json.loads(path.read_text())[key] for key in ("command", "code", "inputs")}
    states = {"numbers": then, "letters": then | {"code": "another"}}
    monkeypatch.setattr(confirm, "states_in", lambda tree: states)
    opened = []
    monkeypatch.setattr(trees, "checked_out", lambda name: opened.append(name) or _Tree(tmp_path / name))
    ran = outputs(monkeypatch, 1.0, 1.0)
    with pytest.raises(RuntimeError, match="stage letters: its results were not up to date at 123"):
        confirm_results((), "123")
    assert opened == ["123"]
    assert [tree for _, tree in ran] == ["123", tmp_path.name]
    assert json.loads(path.read_text())["confirmed"]


def test_both_samples_have_the_inputs_of_today(stage, tmp_path):
    """They may have moved, and may have been published after the commit that the results name."""
    one = stage[0].model_copy(update={"reads": ("data/*.npz", "agents/*/agent.npz")})
    tree = tmp_path / "tree"
    for name, text in {"data/map.npz": "new", "agents/a/agent.npz": "a", "agents/b/agent.npz": "b"}.items():
        for place in (tmp_path / name, tree / name.replace("data/", "elsewhere/")):
            place.parent.mkdir(parents=True, exist_ok=True)
            place.write_text(text if place.is_relative_to(tmp_path / "data") else "old")
    (tmp_path / "agents/b/agent.npz").write_text("b")
    put_inputs(one, tree)
    assert (tree / "elsewhere" / "map.npz").read_text() == "new"
    assert (tree / "agents" / "b" / "agent.npz").read_text() == "b"
    (tree / "third").mkdir()
    (tree / "third" / "map.npz").write_text("old")
    with pytest.raises(RuntimeError, match=r"map.npz has 2 places"):
        put_inputs(one, tree)


def test_rows_that_carry_a_hash_get_the_new_one_and_stay_otherwise(stage, monkeypatch, tmp_path, capsys):
    """The sample knows which hash took the place of which, a method at a time; its rows may end in another order."""
    _, path, _ = stage
    old, new = ("a" * 16, "b" * 16), ("b" * 16, "c" * 16)
    samples = {"abc": [f"1,{old[0]},x", f"2,{old[1]},x"], "now": [f"2,{new[1]},y", f"1,{new[0]},y"]}

    def run(one, command, tree, place):
        rows = samples["abc" if tree.name == "abc" else "now"]
        folder(Path(place), table="\n".join(["a,code,commit", *rows]) + "\n")

    monkeypatch.setattr(confirm, "_run", run)
    table = tmp_path / "results" / "numbers" / "table.csv"
    lines = ["a,code,commit", f"1,{old[0]},x", f"2,{old[1]},x", f"3,{'d' * 16},x", ""]
    table.write_text("\n".join(lines))
    confirm_results(("numbers",))
    assert table.read_text().splitlines() == [lines[0], f"1,{new[0]},x", f"2,{new[1]},x", lines[3]]
    assert json.loads(path.read_text())["confirmed"]
    assert "the same: kept, but for 1 rows of other code" in capsys.readouterr().out
    before = stages.content(table)
    table.write_text(table.read_text().replace(new[0], old[0]))
    assert stages.content(table) == before  # what reads the table is not made again for that
    table.write_text(table.read_text().replace("\n3,", "\n4,"))
    assert stages.content(table) != before


def test_a_difference_keeps_them_stale(stage, monkeypatch):
    _, path, _ = stage
    text = path.read_text()
    outputs(monkeypatch, 1.0, 2.0)
    with pytest.raises(RuntimeError, match=r"stage numbers: map.npz differs; the results are stale"):
        confirm_results(())
    assert path.read_text() == text


def test_what_cannot_be_compared_is_told(stage, monkeypatch, capsys):
    one, path, _ = stage
    outputs(monkeypatch, 1.0, 1.0)
    path.write_text(json.dumps(RECORD | {"inputs": "other"}))
    confirm_results(())
    assert "code and inputs changed: make it again" in capsys.readouterr().out
    path.write_text(json.dumps(RECORD | {"inputs": one.state()["inputs"]}))
    monkeypatch.setattr(confirm, "load_stages", lambda: (one.model_copy(update={"sample": {}}),))
    confirm_results(())
    assert "no sample is known" in capsys.readouterr().out
    with pytest.raises(ValueError, match="stage = 'letters' is not one of numbers"):
        confirm_results(("letters",))
    monkeypatch.setattr(confirm, "in_history", lambda _: False)
    with pytest.raises(ValueError, match="clean commits only"):
        confirm_results(())
