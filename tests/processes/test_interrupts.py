"""Ctrl-C and SIGTERM: one line that says what is stored, the signal's status, never a traceback."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest
from agents.rollouts.plan import Plan, run_plan
from kills import hook_replace, hook_sync

from agents.cli import main
from agents.design.problem import DesignProblem
from agents.policies.fixed import Constant
from agents.processes import interrupts
from agents.terminal.work import Work
from probe_env import load_contexts
from probe_env.envs.task import TaskConfig

ROOT = Path(__file__).parents[2]
SCENE = str(ROOT / "configs" / "scenes" / "fig11_l10.toml")
CONFIG = TaskConfig(growing=False, period=0.1, time_limit=0.3, settle_time=0.1)
HANGS = 300.0  # [s], of processes that end in 10 s
STATUS = {signal.SIGINT: 130, signal.SIGTERM: 143, signal.SIGHUP: 129}


@pytest.fixture
def hooks(monkeypatch):
    """What the hooks replace is put back."""
    monkeypatch.setattr(os, "fsync", os.fsync)
    monkeypatch.setattr(os, "replace", os.replace)


@pytest.fixture(autouse=True)
def patience(monkeypatch):
    """Here no process is to end before it is unwound, however slow the machine."""
    monkeypatch.setattr(interrupts, "GRACE", 600.0)


def signalling(number):
    return lambda: os.kill(os.getpid(), number)


def last_line(capsys):
    error = capsys.readouterr().err
    assert "Traceback" not in error
    return error.splitlines()[-1]


@pytest.mark.parametrize(("number", "jobs"), [(signal.SIGINT, 1), (signal.SIGTERM, 1), (signal.SIGTERM, 2)])
def test_an_interrupted_evaluation_says_how_many_are_stored_and_goes_on(
    number, jobs, tmp_path, capsys, monkeypatch, hooks
):
    monkeypatch.setattr("agents.policies.places.TaskConfig", lambda: CONFIG)
    handlers = [signal.getsignal(n) for n in STATUS]
    output = tmp_path / "run"
    arguments = ["evaluate", "constant", "pi", "--limit", "3", "--jobs", str(jobs), "--output", str(output)]
    hook_sync("episodes.jsonl", 4, signalling(number))
    assert main(arguments) == STATUS[number]
    said = f"probe-env: interrupted: 4 of 6 episodes are stored in {output}; the same command goes on"
    assert last_line(capsys) == said
    assert len((output / "episodes.jsonl").read_bytes().splitlines()) == 4
    assert [signal.getsignal(n) for n in STATUS] == handlers
    assert main(arguments) == 0
    assert f"2 of 6 episodes to do, stored in {output} one by one" in capsys.readouterr().err
    policies = {"constant": Constant(CONFIG.all_shown)}
    plan = Plan(policies, load_contexts("test")[0:1], (0,), CONFIG.all_shown)
    table = pd.read_parquet(output / "episodes.parquet")
    assert len(table) == 6
    first = table[(table["policy"] == "constant") & (table["context"] == 0)]
    assert first["reward"].tolist() == run_plan(plan, None)["reward"].tolist()


def test_an_interrupted_simulation_has_stored_nothing(tmp_path, capsys, monkeypatch):
    """In the middle of the run, before anything is written."""
    monkeypatch.setattr("agents.evaluation.simulate.point_statistics", lambda *_: os.kill(os.getpid(), signal.SIGINT))
    options = ["--duration", "0.3", "--statistics-from", "0.1", "--output", str(tmp_path / "run")]
    assert main(["simulate", SCENE, *options]) == 130
    assert last_line(capsys) == "probe-env: interrupted: nothing was stored"
    assert not (tmp_path / "run").exists()


def test_files_that_were_written_before_are_named(tmp_path, capsys, hooks):
    output = tmp_path / "run"
    hook_replace("signals.npz", 1, signalling(signal.SIGTERM))
    options = ["--duration", "0.3", "--statistics-from", "0.1", "--output", str(output)]
    assert main(["simulate", SCENE, *options]) == 143
    said = f"scene.toml, results.json are stored in {output}, and nothing else"
    assert last_line(capsys) == f"probe-env: interrupted: {said}"
    assert sorted(path.name for path in output.iterdir()) == ["results.json", "scene.toml"]


def test_an_interrupted_search_says_how_many_designs_are_stored(tmp_path, capsys, monkeypatch):
    asked = []

    def value(self, point, workers=None):
        asked.append(point)
        if len(asked) == 5:
            os.kill(os.getpid(), signal.SIGINT)
        return 10.0 - point["guide_length"], point["guide_length"], 1.0

    monkeypatch.setattr(DesignProblem, "value", value)
    output = tmp_path / "run"
    assert main(["design", "--limit", "1", "--trials", "8", "--output", str(output)]) == 130
    assert f"4 of 8 designs are stored in {output}; the same command goes on" in last_line(capsys)


def test_words():
    work = Work("phase", 8, lambda: 3, Path("output/run"), "the same command with --resume goes on")
    assert work.ahead() == "5 of 8 phases to do, stored in output/run one by one"
    assert work.account() == "3 of 8 phases are stored in output/run; the same command with --resume goes on"
    assert Work("run", 1, lambda: 0, Path("x")).ahead() == "1 run to do, stored in x one by one"
    assert Work("run", 2, lambda: 2, Path("x")).ahead() == ""


def command(prelude, *arguments):
    """The command as a process of its own, with something done to it before; one that hangs is ended and fails."""
    code = f"import os, signal, sys\n{prelude}\nfrom agents.cli import main\nsys.exit(main())"
    asked = [sys.executable, "-c", code, *arguments]
    return subprocess.run(asked, capture_output=True, text=True, cwd=ROOT, timeout=HANGS)


IN_IMPORT = """
class Finder:
    def find_spec(self, name, *_):
        if name == {name!r}:
            os.kill(os.getpid(), signal.{signal})
sys.meta_path.insert(0, Finder())
"""


@pytest.mark.parametrize(
    ("name", "number"),
    [("tyro", signal.SIGINT), ("numba", signal.SIGTERM), ("agents.evaluation.simulate", signal.SIGINT)],
)
def test_in_an_import_the_command_ends_at_once(name, number, tmp_path):
    """The packages of all commands, and those that a command loads itself."""
    prelude = IN_IMPORT.format(name=name, signal=number.name)
    ended = command(prelude, "simulate", SCENE, "--output", str(tmp_path / "run"))
    assert ended.returncode == STATUS[number]
    assert ended.stderr == "probe-env: interrupted: nothing was stored\n"
    assert not (tmp_path / "run").exists()


def test_the_entry_point_loads_no_packages_before_it_hears_signals():
    code = "import sys; import agents.cli; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT).stdout.split()
    ours = [name for name in loaded if name.partition(".")[0] in ("agents", "probe_env")]
    assert sorted(ours) == [
        "agents", "agents.cli", "agents.processes", "agents.processes.interrupts", "agents.terminal",
        "agents.terminal.work",
    ]  # fmt: skip
    assert not {"numpy", "tyro", "pydantic", "typing_extensions"} & set(loaded)


# what a command does in the place of its work
TWICE = """
    try:
        os.kill(os.getpid(), signal.SIGINT)
    finally:
        os.kill(os.getpid(), signal.SIGINT)
        print("unwound")
"""
SWALLOWED = """
    class Finalised:
        def __del__(self):
            os.kill(os.getpid(), signal.SIGINT)
            for _ in range(1000): pass
    Finalised()
    print("went on")
"""
SLOW = """
    import threading
    agents.processes.interrupts.GRACE = 0.1
    try:
        os.kill(os.getpid(), signal.SIGINT)
    finally:
        threading.Event().wait()
"""
UNCOUNTABLE = """
    import threading
    from agents.terminal.work import Work, announce
    agents.processes.interrupts.TELLING = 0.1
    announce(Work("run", 3, lambda: threading.Event().wait(), "x"), quiet=True)
    class Finalised:
        def __del__(self):
            os.kill(os.getpid(), signal.SIGINT)
    Finalised()
    print("went on")
"""


@pytest.mark.parametrize("work", [TWICE, SWALLOWED, SLOW, UNCOUNTABLE], ids=["twice", "swallowed", "slow", "locked"])
def test_where_the_stack_is_not_unwound_the_command_ends_all_the_same(work):
    prelude = f"import agents.cli, agents.processes.interrupts\ndef work(_):{work}\nagents.cli._run = work"
    ended = command(prelude)
    assert (ended.returncode, ended.stdout) == (130, "")
    said = "" if work is UNCOUNTABLE else "probe-env: interrupted: nothing was stored\n"
    assert ended.stderr == said


def test_what_a_script_ignores_stays_ignored():
    """A job in the background of a script ignores SIGINT, one under nohup SIGHUP."""
    prelude = "signal.signal(signal.SIGHUP, signal.SIG_IGN)\nimport agents.cli\n"
    prelude += "agents.cli._run = lambda _: os.kill(os.getpid(), signal.SIGHUP) or 7"
    assert command(prelude).returncode == 7
