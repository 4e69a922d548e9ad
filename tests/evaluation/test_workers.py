"""Workers: the same results wherever the work runs, and what is lost with a worker is done again."""

import os
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import joblib
import pytest
from kills import alive

from agents.design.problem import DesignProblem
from agents.evaluation.plan import Plan, run_plan
from agents.evaluation.workers import Workers
from agents.policies.fixed import Constant
from probe_env import Context, Design, load_contexts
from probe_env.envs.task import TaskConfig

ROOT = Path(__file__).parents[2]
CONFIG = TaskConfig(growing=False, period=0.1, time_limit=0.3, settle_time=0.1)
TWO = Workers(jobs=2)


def square(task):
    return task * task


def counting(task):
    yield from range(task)


def hesitant(task):
    """Two items, the second only when the first has been seen to arrive."""
    folder, number = task
    yield number
    while not (Path(folder) / f"{number} came").exists():
        time.sleep(0.01)
    yield -number


def halting(task):
    """Three items; the first worker dies after two."""
    folder, number = task
    yield from (10 * number, 10 * number + 1)
    mark = Path(folder) / "died"
    if number == 1 and not mark.exists():
        mark.touch()
        os._exit(1)
    yield 10 * number + 2


def broken(task):
    raise ValueError(f"task {task}")


def sleeping(task):
    yield os.getpid()
    time.sleep(1e6)


def test_every_task_comes_back_once_and_items_come_while_their_task_goes_on(tmp_path):
    """The second would wait for ever if items came with the task's end alone."""
    assert sorted(TWO.map(square, range(20))) == [(k, k * k) for k in range(20)]
    items = []
    for (_, number), item in TWO.stream(hesitant, [(str(tmp_path), k) for k in range(1, 4)]):
        items.append(item)
        (tmp_path / f"{number} came").touch()
    assert sorted(items) == [-3, -2, -1, 1, 2, 3]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:a worker was lost")
def test_what_is_lost_with_a_worker_is_done_again_and_items_come_once(tmp_path):
    items = [item for _, item in TWO.stream(halting, [(str(tmp_path), k) for k in range(3)])]
    assert (tmp_path / "died").exists()
    assert sorted(items) == [0, 1, 2, 10, 11, 12, 20, 21, 22]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:a worker was lost")
def test_a_task_that_always_kills_its_worker_is_an_error():
    with pytest.raises(RuntimeError, match="lost 5 times without finishing anything"):
        list(TWO.map(os._exit, [1]))


def test_an_error_in_the_work_comes_with_its_trace_and_is_not_tried_again():
    with pytest.raises(ValueError, match="task 0") as caught:
        list(TWO.map(broken, [0]))
    assert "in broken" in str(caught.value.__cause__)


def test_workers_that_nobody_waits_for_end():
    stream = TWO.stream(sleeping, [0])
    _, process = next(stream)
    stream.close()
    assert not alive(process)


@pytest.mark.slow
def test_workers_end_with_a_command_that_is_killed():
    code = "from test_workers import *; print(next(TWO.stream(sleeping, [0]))[1], flush=True); os.kill(os.getpid(), 9)"
    paths = os.pathsep.join([str(Path(__file__).parent), str(ROOT / "tests"), *filter(None, sys.path)])
    ended = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, env=os.environ | {"PYTHONPATH": paths}
    )
    process, patience = int(ended.stdout), 100
    while patience and alive(process):
        time.sleep(0.1)
        patience -= 1
    assert patience


def test_a_cluster_s_items_come_with_the_task_s_end(monkeypatch):
    """Ray's part of joblib, with threads in the place of a cluster."""

    @contextmanager
    def cluster(_):
        with joblib.parallel_config(backend="threading"):
            yield lambda: 2

    monkeypatch.setattr(Workers, "_cluster", cluster)
    items = list(Workers(2, "ray").stream(counting, [1, 2, 3, 4, 5]))
    assert sorted(items) == sorted((task, item) for task in (1, 2, 3, 4, 5) for item in range(task))
    assert sorted(Workers(2, "ray").map(square, range(9))) == [(k, k * k) for k in range(9)]


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
    for arguments, message in (
        ({"jobs": 0}, "jobs = 0"),
        ({"address": "10.0.0.1:6379"}, "address = '10.0.0.1:6379' is for backend = 'ray'"),
    ):
        with pytest.raises(ValueError, match=message):
            Workers(**arguments)
