"""Ctrl-C and SIGTERM: one line that says what is stored, the signal's status, never a traceback."""

import os
import shlex
import signal
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest
from kills import hook_replace, hook_sync
from plans import CONFIG

from probe_agents.cli import main
from probe_agents.evaluation.plan import Plan, run_plan
from probe_agents.policies.fixed import Constant
from probe_env import load_contexts

ROOT = Path(__file__).parents[2]
SCENE = str(ROOT / "configs" / "scenes" / "fig11_l10.toml")
BRIEF = ["--duration", "0.3", "--statistics-from", "0.1", "--output"]
STATUS = {signal.SIGINT: 130, signal.SIGTERM: 143, signal.SIGHUP: 129}


def signalling(number):
    return lambda *_: os.kill(os.getpid(), number)


def last_line(capsys):
    error = capsys.readouterr().err
    assert "Traceback" not in error
    return error.splitlines()[-1]


@pytest.mark.parametrize(
    ("number", "jobs"), [(signal.SIGINT, 1), pytest.param(signal.SIGTERM, 2, marks=pytest.mark.slow)]
)
def test_interrupted_evaluation_reports_and_continues(number, jobs, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("probe_agents.policies.cases.TaskConfig", lambda: CONFIG)
    handlers = [signal.getsignal(n) for n in STATUS]
    output = tmp_path / "run"
    arguments = ["evaluate", "constant", "pi", "--limit", "3", "--jobs", str(jobs), "--output", str(output)]
    hook_sync("episodes.jsonl", 4, signalling(number), monkeypatch)
    assert main(arguments) == STATUS[number]
    stored = f"4 of 6 episodes are stored in {output}; the same command continues"
    assert last_line(capsys) == f"probe-env: interrupted: {stored}"
    assert len((output / "episodes.jsonl").read_bytes().splitlines()) == 4
    assert [signal.getsignal(n) for n in STATUS] == handlers
    assert main(arguments) == 0
    assert f"2 of 6 episodes to do, stored in {output} one by one" in capsys.readouterr().err
    config, table = CONFIG.full_observation, pd.read_parquet(output / "episodes.parquet")
    plan = Plan({"constant": Constant(config)}, load_contexts("test")[0:1], (0,), config)
    assert len(table) == 6
    first = table[(table["policy"] == "constant") & (table["context"] == 0)]
    assert first["reward"].tolist() == run_plan(plan, None)["reward"].tolist()


def test_interrupted_simulation_names_written_files(tmp_path, capsys, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr("probe_agents.evaluation.simulate.point_statistics", signalling(signal.SIGINT))
        assert main(["simulate", SCENE, *BRIEF, str(tmp_path / "run")]) == 130
    assert last_line(capsys) == "probe-env: interrupted: nothing was stored"
    assert not (tmp_path / "run").exists()
    hook_replace("signals.npz", 1, signalling(signal.SIGTERM), monkeypatch)
    assert main(["simulate", SCENE, *BRIEF, str(tmp_path / "run")]) == 143
    expected = f"scene.toml, results.json are stored in {tmp_path / 'run'}; nothing else is"
    assert last_line(capsys) == f"probe-env: interrupted: {expected}"
    assert sorted(path.name for path in (tmp_path / "run").iterdir()) == ["results.json", "scene.toml"]


def command(prelude, *arguments, pipe=""):
    """The command as a process of its own, after a prelude; one that hangs is ended and fails."""
    code = f"import os, signal, sys\n{prelude}\nfrom probe_agents.cli import main\nsys.exit(main())"
    line = shlex.join([sys.executable, "-c", code, *arguments]) + pipe
    environment = {name: value for name, value in os.environ.items() if name != "OPENBLAS_NUM_THREADS"}
    shell = {"shell": True, "executable": "/bin/bash", "env": environment, "cwd": ROOT, "timeout": 300.0}
    return subprocess.run(line, capture_output=True, text=True, **shell)


BACKEND = """
os.environ["MPLBACKEND"] = "module://of_a_notebook.elsewhere"
import probe_agents.cli
probe_agents.cli._run = lambda _: print(__import__("matplotlib").get_backend())
"""
IN_IMPORT = """
import probe_agents.cli
assert not {"numpy", "tyro", "pydantic", "typing_extensions", "probe_env"} & set(sys.modules)
class Finder:
    def find_spec(self, name, *_):
        if name == "numba":
            os.kill(os.getpid(), signal.SIGTERM)
sys.meta_path.insert(0, Finder())
"""
SWALLOWED_ONCE = """
import probe_agents.cli
class Finalised:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)
        for _ in range(1000): pass
def work(_):
    Finalised()
    os.kill(os.getpid(), signal.SIGINT)
    print("went on")
probe_agents.cli._run = work
"""
MANY_LINES = """
import probe_agents.cli
probe_agents.cli._run = lambda _: [print(os.environ["OPENBLAS_NUM_THREADS"]) for _ in range(100_000)]
"""


STREAMS_CLOSED = """
import probe_agents.cli
def work(_):
    from tqdm import tqdm
    numbers = list(tqdm(range(3)))
    print(numbers)
    with open(sys.argv[1], "w") as file:  # which has no descriptor of a stream, so nothing else is written into it
        file.write(f"{numbers} {file.fileno() > 2}")
    return 0
probe_agents.cli._run = work
"""


@pytest.mark.parametrize("closed", [" 2>&-", " >&-", " >&- 2>&-"])
def test_work_goes_on_where_a_stream_is_closed(closed, tmp_path):
    ended = command(STREAMS_CLOSED, str(tmp_path / "file"), pipe=closed)
    assert ended.returncode == 0
    assert ended.stdout == ("[0, 1, 2]\n" if closed == " 2>&-" else "")
    assert (tmp_path / "file").read_text() == "[0, 1, 2] True"


def test_exit_codes_of_processes(tmp_path):
    """In an import, at the second signal (the first may be swallowed in a finaliser), and behind a closed pipe."""
    ended = command(IN_IMPORT, "simulate", SCENE, "--output", str(tmp_path / "run"))
    assert (ended.returncode, ended.stderr) == (143, "probe-env: interrupted: nothing was stored\n")
    ended = command(SWALLOWED_ONCE)
    assert (ended.returncode, ended.stdout) == (130, "")
    assert ended.stderr.splitlines()[-1] == "probe-env: interrupted: nothing was stored"
    ended = command(MANY_LINES, pipe="| head -1; exit ${PIPESTATUS[0]}")
    assert (ended.returncode, ended.stdout, ended.stderr) == (1, "1\n", "")
    ended = command(BACKEND)  # of a notebook elsewhere, which is not used
    assert (ended.stdout, ended.stderr) == ("agg\n", "")


def test_ignored_signals_and_threads_that_are_set_stay(monkeypatch):
    """A job under nohup has SIGHUP ignored."""
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "2")
    monkeypatch.setenv("MPLBACKEND", "agg")  # main sets it; restored after the test
    monkeypatch.setattr("probe_agents.cli._run", lambda _: os.kill(os.getpid(), signal.SIGHUP) or 7)
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        assert main() == 7
    finally:
        signal.signal(signal.SIGHUP, before)
    assert os.environ["OPENBLAS_NUM_THREADS"] == "2"
