"""Provenance and publishing: clean commits only, on scratch repositories."""

import json
import subprocess
from dataclasses import dataclass
from pathlib import Path

import pytest

from agents.publishing import places
from agents.publishing import stages as results
from agents.publishing.places import in_its_place, place
from agents.publishing.stages import Stage, load_stages, run_results
from agents.records import provenance
from agents.records.provenance import changed_code, commit, in_history


def git(folder, *arguments):
    identity = ("-c", "user.name=test", "-c", "user.email=test@localhost")
    return subprocess.run(
        ["git", *identity, *arguments], cwd=folder, check=True, capture_output=True, text=True
    ).stdout.strip()


def forget():
    commit.cache_clear()
    changed_code.cache_clear()


@pytest.fixture
def checkout(tmp_path, monkeypatch):
    """A repository with code, configuration, shipped data and results in it."""
    for name in ("probe_env/a.py", "agents/b.py", "agents/policies/data/map.json", "configs/c.toml", "results/old.csv"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("1\n")
    git(tmp_path, "init", "-q")
    git(tmp_path, "add", "-A")
    git(tmp_path, "commit", "-qm", "first")
    for part in (provenance, places, results):
        monkeypatch.setattr(part, "CHECKOUT", tmp_path)
    monkeypatch.setattr(results, "RECORDS", tmp_path / "results" / "records")
    monkeypatch.setattr(results, "WORK", tmp_path / "output" / "results")
    monkeypatch.chdir(tmp_path)
    forget()
    yield tmp_path
    forget()


def test_results_and_shipped_data_do_not_make_a_commit_unclean(checkout):
    head = git(checkout, "rev-parse", "--short=12", "HEAD")
    for name in ("results/new.csv", "agents/policies/data/map.json", "README.md"):
        (checkout / name).write_text("2\n")
    assert commit() == head
    assert in_history(head)


@pytest.mark.parametrize("name", ["agents/b.py", "agents/new.py", "probe_env/a.py", "configs/c.toml"])
def test_code_and_configuration_do(checkout, name):
    (checkout / name).write_text("2\n")
    assert commit().endswith("+changes")
    assert changed_code() == (name,)
    assert not in_history(commit())


def test_a_dirty_tree_publishes_elsewhere_and_says_so(checkout):
    @dataclass(frozen=True)
    class Command:
        output: Path
        target: Path | None = None
        folder: Path = Path("results/read")
        trials: int = 3

    clean = Command(Path("results/evaluation"), Path("agents/policies/data/map.npz"))
    assert in_its_place(clean) == clean
    forget()
    (checkout / "agents" / "b.py").write_text("2\n")
    with pytest.warns(UserWarning, match=r"agents/b\.py differ from the commit: writing to output/unpublished/results"):
        assert place(Path("results/evaluation")) == Path("output/unpublished/results/evaluation")
    with pytest.warns(UserWarning, match="clean commits only"):
        moved = in_its_place(clean)
    assert moved == Command(
        Path("output/unpublished/results/evaluation"), Path("output/unpublished/agents/policies/data/map.npz")
    )
    assert place(Path("output/mine")) == Path("output/mine")
    with pytest.warns(UserWarning, match="clean commits only"):  # a pattern of files, not a folder
        assert place(Path("configs/tubes/snr-map.npz")) == Path("output/unpublished/configs/tubes/snr-map.npz")
    assert place(Path("configs/tubes/mine.toml")) == Path("configs/tubes/mine.toml")
    assert place(checkout.parent / "results" / "mine") == checkout.parent / "results" / "mine"


def stage(**changes):
    given = {
        "name": "numbers",
        "command": "simulate configs/c.toml --output {work}",
        "publish": {"results/numbers": ("*.csv",)},
        "code": ("agents.study.cases:run_case",),
        "reads": ("configs/*.toml",),
        "minutes": 1.0,
    }
    return Stage(**(given | changes))


@pytest.fixture
def ran(checkout, monkeypatch):
    """What the stages' commands were; each writes one table. ``fails`` makes the next one fail half-way."""
    calls, real = [], subprocess.run

    def run(command, **arguments):
        if command[0] == "git":
            return real(command, **arguments)
        work = checkout / command[command.index("--output") + 1]
        work.mkdir(parents=True, exist_ok=True)
        calls.append((command[3:], arguments["env"][provenance.STAGE_VARIABLE], sorted(p.name for p in work.iterdir())))
        (work / ("half.txt" if fails else "table.csv")).write_text("x\n1\n")
        return subprocess.CompletedProcess(command, fails.pop() if fails else 0)

    fails = []
    monkeypatch.setattr(results.subprocess, "run", run)
    calls_and_fails = calls, fails
    return calls_and_fails


def test_a_stage_is_published_and_then_up_to_date(checkout, ran, monkeypatch, capsys):
    calls, _ = ran
    monkeypatch.setattr(results, "load_stages", lambda: (stage(),))
    assert stage().stale() == "never made"
    run_results((), only_list=True)
    assert "about 0.0 hours" in capsys.readouterr().out
    assert not calls
    run_results(())
    assert (checkout / "results" / "numbers" / "table.csv").read_text() == "x\n1\n"
    record = json.loads((checkout / "results" / "records" / "numbers.json").read_text())
    assert record["commit"] == commit()
    assert record["files"] == ["results/numbers/table.csv"]
    assert stage().stale() == ""
    run_results(())
    assert len(calls) == 1


def test_what_makes_a_stage_stale_is_named(checkout, ran, monkeypatch):
    monkeypatch.setattr(results, "load_stages", lambda: (stage(),))
    run_results(("numbers",))
    assert stage(command="simulate other.toml --output {work}").stale() == "command changed"
    assert stage(code=("agents.study.cases:run_study",)).stale() == "code changed"
    assert stage(publish={"results/numbers": ("*.csv", "*.json")}).stale() == "files are missing"
    (checkout / "configs" / "c.toml").write_text("2\n")
    assert stage().stale() == "inputs changed"
    (checkout / "configs" / "c.toml").write_text("1\n")
    (checkout / "results" / "numbers" / "table.csv").unlink()
    assert stage().stale() == "files are missing"


def test_what_reads_a_stale_stage_is_stale(checkout, ran, monkeypatch, capsys):
    calls, _ = ran
    second = stage(name="more", publish={"results/more": ("*.csv",)}, reads=("results/numbers/*.csv",))
    assert results.sources(second, (stage(), second)) == ["numbers"]
    monkeypatch.setattr(results, "load_stages", lambda: (stage(), second))
    run_results(("more",))
    assert [call[1] for call in calls] == ["numbers", "more"]
    (checkout / "configs" / "c.toml").write_text("2\n")
    run_results(("more",), only_list=True)
    assert "numbers will change" in capsys.readouterr().out
    (checkout / "configs" / "c.toml").write_text("1\n")
    (checkout / "results" / "numbers" / "table.csv").unlink()
    run_results(("more",))
    assert [call[1] for call in calls] == ["numbers", "more", "numbers"]  # it came out as it was


def test_a_stage_that_failed_publishes_nothing_and_goes_on_in_its_folder(checkout, ran, monkeypatch):
    calls, fails = ran
    monkeypatch.setattr(results, "load_stages", lambda: (stage(),))
    fails.append(3)
    with pytest.raises(RuntimeError, match="stage numbers failed"):
        run_results(())
    assert not (checkout / "results" / "numbers").exists()
    run_results(())
    assert calls[0][0] == calls[1][0]  # the same folder
    assert "half.txt" in calls[1][2]  # with what was there
    assert (checkout / "results" / "numbers" / "table.csv").exists()


def test_a_dirty_tree_runs_nothing(checkout, ran, monkeypatch):
    calls, _ = ran
    monkeypatch.setattr(results, "load_stages", lambda: (stage(),))
    (checkout / "configs" / "c.toml").write_text("2\n")
    forget()
    with pytest.raises(ValueError, match=r"commit first: configs/c\.toml"):
        run_results(())
    assert not calls


def test_the_shipped_stages_are_valid_and_their_code_and_inputs_exist():
    for each in load_stages():
        assert len(each.state()["code"]) == 16
        for pattern in each.reads:
            assert list(results.CHECKOUT.glob(pattern)), f"{each.name}: {pattern}"
        assert each.plants == ("--tube" in each.command or each.name == "plants")
        assert each.returns == (
            each.name.startswith(("optimise-passes", "passes", "turning")) or "--passes" in each.command
        )
    known = {each.name: each for each in load_stages()}
    assert results.sources(known["headroom"], load_stages()) == ["map", "optimise"]
    assert results.sources(known["snr"], load_stages()) == ["optimise", "plc", "snr-map", "snr-schedules"]
    with pytest.raises(ValueError, match="stage = 'nothing' is not one of"):
        run_results(("nothing",))
