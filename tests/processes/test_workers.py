"""Workers: the same results wherever the work runs, and what is lost with a worker is done again."""

import os
import time
from contextlib import contextmanager
from pathlib import Path

import joblib
import pytest
from agents.rollouts.plan import Plan, run_plan
from kills import alive, all_gone, children, kill, killed

from agents.design.problem import DesignProblem
from agents.policies.fixed import Constant
from agents.processes.workers import Workers
from agents.records.atomic import write_atomically
from probe_env import Context, Design, load_contexts
from probe_env.envs.task import TaskConfig

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
def test_what_is_lost_with_a_worker_is_done_again(tmp_path):
    results = sorted(result for _, result in TWO.map(dying, [(str(tmp_path), k) for k in range(8)]))
    assert results == list(range(8))
    assert (tmp_path / "died").exists()


def hesitant(task):
    """Two items, the second only when the first has been seen to arrive."""
    folder, number = task
    yield number
    while not (Path(folder) / f"{number} came").exists():
        time.sleep(0.01)
    yield -number


def test_items_come_while_their_task_goes_on(tmp_path):
    """Would wait for ever if items came with the task's end alone."""
    items = []
    for (_, number), item in TWO.stream(hesitant, [(str(tmp_path), k) for k in range(1, 4)]):
        items.append(item)
        (tmp_path / f"{number} came").touch()
    assert sorted(items) == [-3, -2, -1, 1, 2, 3]


def halting(task):
    """Three items; the first worker dies after two."""
    folder, number = task
    yield from (10 * number, 10 * number + 1)
    mark = Path(folder) / "died"
    if number == 1 and not mark.exists():
        mark.touch()
        os._exit(1)
    yield 10 * number + 2


@pytest.mark.filterwarnings("ignore:a worker was lost")
def test_items_that_came_before_a_worker_was_lost_come_once(tmp_path):
    items = [item for _, item in TWO.stream(halting, [(str(tmp_path), k) for k in range(3)])]
    assert sorted(items) == [0, 1, 2, 10, 11, 12, 20, 21, 22]


@pytest.mark.filterwarnings("ignore:a worker was lost")
def test_a_task_that_always_kills_its_worker_is_an_error():
    with pytest.raises(RuntimeError, match="lost 5 times without finishing anything"):
        list(TWO.map(os._exit, [1]))


def writing(folder):
    """A worker in the middle of a file, without end."""
    os.replace = lambda *_: time.sleep(1e6)
    yield os.getpid()
    write_atomically(Path(folder) / "a.csv", "whole")


def test_workers_that_nobody_waits_for_end_and_leave_no_half_files(tmp_path):
    stream = TWO.stream(writing, [str(tmp_path)])
    _, process = next(stream)
    while not any(path.stat().st_size for path in tmp_path.iterdir()):  # it is in the middle once something is written
        time.sleep(0.01)
    stream.close()
    assert not alive(process)
    assert not list(tmp_path.iterdir())


def test_workers_end_with_a_command_that_is_killed(tmp_path):
    """A busy one and an idle one; the command is killed when it has told who they are."""
    killed(busy, tmp_path / "pids")
    assert all_gone(tmp_path / "pids")


def busy(pids):
    stream = TWO.stream(sleeping, [0.0, 1e6])
    next(stream)
    while len(children()) < 2:
        time.sleep(0.01)
    kill(pids)


def test_a_stream_that_is_still_read_does_not_disturb_another():
    first = TWO.stream(counting, [3, 5])
    begun = [next(first)]
    assert sorted(item for _, item in TWO.stream(counting, [2])) == [0, 1]
    assert sorted(item for _, item in begun + list(first)) == [0, 0, 1, 1, 2, 2, 3, 4]


def counting(task):
    yield from range(task)


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


def sleeping(seconds):
    time.sleep(seconds)
    yield seconds


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
