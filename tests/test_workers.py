"""Workers: the same results wherever the work runs, and what is lost with a worker is done again."""

import os
import time
from pathlib import Path

import pytest

from agents.design_problem import DesignProblem
from agents.evaluate import Plan, run_plan
from agents.policies import Constant
from agents.workers import Workers
from probe_env import Context, Design, load_contexts
from probe_env.task import TaskConfig

CONFIG = TaskConfig(growing=False, period=0.1, time_limit=0.3, settle_time=0.1)
TWO = Workers(jobs=2)


def square(task):
    return task * task


def test_every_task_comes_back_once():
    assert sorted(TWO.map(square, range(20))) == [(k, k * k) for k in range(20)]


def dying(task):
    """The first worker that gets task 3 dies without a word."""
    folder, number = task
    mark = Path(folder) / "died"
    if number == 3 and not mark.exists():
        mark.touch()
        time.sleep(0.2)
        os._exit(1)
    return number


@pytest.mark.filterwarnings("ignore:a worker was lost")
@pytest.mark.filterwarnings("ignore:A worker stopped")
def test_what_is_lost_with_a_worker_is_done_again(tmp_path):
    found = sorted(result for _, result in TWO.map(dying, [(str(tmp_path), k) for k in range(8)]))
    assert found == list(range(8))
    assert (tmp_path / "died").exists()


def broken(task):
    raise ValueError(f"task {task}")


def test_an_error_in_the_work_is_not_tried_again():
    with pytest.raises(ValueError, match="task 0"):
        list(TWO.map(broken, [0]))


def test_an_evaluation_by_workers_equals_the_local_one(tmp_path):
    plan = Plan(
        {f"{u}": Constant(CONFIG, feed_speed=u) for u in (0.1, 0.2)}, load_contexts("validation")[:3], (0,), CONFIG
    )
    here = run_plan(plan, tmp_path / "here", progress=False)
    there = run_plan(plan, tmp_path / "there", progress=False, workers=TWO)
    assert there.equals(here)


def test_a_design_judged_by_workers_equals_the_local_one():
    problem = DesignProblem((Context(), Context(friction=0.2), Context(helix_diameter=2.0)), "constant")
    point = Design().model_dump()
    assert problem.value(point, TWO) == problem.value(point)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [({"jobs": 0}, "jobs = 0"), ({"address": "10.0.0.1:6379"}, "address = '10.0.0.1:6379' is for backend = 'ray'")],
)
def test_bad_settings_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        Workers(**arguments)
