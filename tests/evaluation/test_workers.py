"""Workers: the same results wherever the work runs, and what is lost with a worker is done again."""

import os
import subprocess
import sys
import time
from operator import neg
from pathlib import Path

import pytest
from kills import alive

from probe_agents.design.trials import DesignProblem
from probe_agents.evaluation.plan import Plan, run_plan
from probe_agents.evaluation.workers import Workers
from probe_agents.policies.fixed import Constant
from probe_env import Context, Design, load_contexts
from probe_env.envs.task.config import TaskConfig

ROOT = Path(__file__).parents[2]
CONFIG = TaskConfig(growing=False, period=0.1, time_limit=0.3, settle_time=0.1)
TWO = Workers(jobs=2)


def halting(task):
    """The first worker with task 1 dies."""
    folder, number = task
    mark = Path(folder) / "died"
    if number == 1 and not mark.exists():
        mark.touch()
        os._exit(1)
    return 10 * number


def broken(task):
    raise ValueError(f"task {task}")


def sleeping(task):
    """Task 0 waits until task 1 has told its process, which then sleeps."""
    folder, number = task
    told = Path(folder) / "process"
    if number:
        told.with_suffix(".part").write_text(str(os.getpid()))
        told.with_suffix(".part").rename(told)
        time.sleep(1e6)
    while not told.exists():
        time.sleep(0.01)
    return int(told.read_text())


def test_every_task_returns_once_or_its_error_with_the_trace():
    with pytest.raises(ValueError, match="task 0") as caught:
        list(TWO.map(broken, [0]))
    assert "in broken" in str(caught.value.__cause__)
    assert sorted(TWO.map(neg, range(20))) == [(k, -k) for k in range(20)]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:a worker was lost")
def test_tasks_lost_with_a_worker_are_repeated(tmp_path):
    """But not a task that always kills its worker."""
    results = [result for _, result in TWO.map(halting, [(str(tmp_path), k) for k in range(3)])]
    assert (tmp_path / "died").exists()
    assert sorted(results) == [0, 10, 20]
    with pytest.raises(RuntimeError, match="lost 5 times without a result"):
        list(TWO.map(os._exit, [1]))


def test_workers_that_nobody_waits_for_end(tmp_path):
    """The first result comes while the other task still runs."""
    results = TWO.map(sleeping, [(str(tmp_path), 0), (str(tmp_path), 1)])
    _, process = next(results)
    results.close()
    assert not alive(process)


@pytest.mark.slow
def test_workers_end_with_a_command_that_is_killed(tmp_path):
    results = f"TWO.map(sleeping, [({str(tmp_path)!r}, 0), ({str(tmp_path)!r}, 1)])"
    code = f"from test_workers import *; print(next({results})[1], flush=True); os.kill(os.getpid(), 9)"
    paths = os.pathsep.join([str(Path(__file__).parent), str(ROOT / "tests"), *filter(None, sys.path)])
    environment = os.environ | {"PYTHONPATH": paths}
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, env=environment)
    process, deadline = int(ended.stdout), time.monotonic() + 10.0
    while alive(process):
        assert time.monotonic() < deadline
        time.sleep(0.1)


@pytest.mark.slow
def test_results_by_workers_equal_the_local_ones(tmp_path):
    policies = {f"{u}": Constant(CONFIG, feed_speed=u) for u in (0.1, 0.2)}
    plan = Plan(policies, load_contexts("validation")[:3], (0,), CONFIG)
    here = run_plan(plan, tmp_path / "here", progress=False)
    assert run_plan(plan, tmp_path / "there", progress=False, workers=TWO).equals(here)
    problem = DesignProblem((Context(), Context(friction=0.2), Context(helix_diameter=2.0)), "constant")
    point = Design().model_dump()
    assert problem.value(point, TWO) == problem.value(point)


def test_bad_settings_are_named():
    with pytest.raises(ValueError, match="jobs = 0"):
        Workers(jobs=0)
    with pytest.raises(ValueError, match=r"address = '10.0.0.1:6379' needs backend = 'ray'"):
        Workers(address="10.0.0.1:6379")
