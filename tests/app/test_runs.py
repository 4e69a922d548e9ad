"""Runs of the app: stored as the command stores them, whatever happens to the worker or to who waits for it."""

import os
import signal
import time

import numpy as np
import pandas as pd
import pytest

from agents.app.runs.driven import BY_HAND
from agents.app.runs.frames import COLUMNS, Order
from agents.app.runs.queue import Queue
from agents.app.runs.shelf import described, free_folder, stored_runs, unfinished
from agents.app.runs.wanted import Wanted
from agents.evaluation.folder import episodes_of
from agents.evaluation.report import write_report
from agents.evaluation.run import evaluate_plan, plan_of
from agents.policies.places import place_at

LONG = 120.0
"""[s] that a test waits for a run of seconds: only one that hangs takes so long."""


@pytest.fixture(scope="module")
def queue():
    line = Queue()
    yield line
    line.close()


@pytest.fixture
def tube(tmp_path):
    """A tube of 7 m, in which an insertion is over soon."""
    path = tmp_path / "short.toml"
    path.write_text("[tube]\nhelix_length = 7.0\n[contact]\nfriction = { low = 0.1, high = 0.2 }\n")
    return path


def wanted(folder, short, **changes):
    return Wanted(**({"policies": ("constant", "pi"), "output": folder, "tube": short, "limit": 2} | changes))


def paused_at(queue, run, until):
    """Waits until a run has paused and something holds."""
    deadline = time.monotonic() + LONG
    while not (run.frame and run.frame.paused and until()):
        assert run.state in ("waiting", "running"), run.problem
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_a_run_is_the_evaluation_of_the_same_command_bit_for_bit(queue, tube, tmp_path):
    run = queue.add(wanted(tmp_path / "app", tube))
    assert queue.wait(run, LONG)
    assert (run.state, run.done, run.planned) == ("finished", 4, 4)
    plan = plan_of(run.wanted.policies, place_at(tube, "test", 2), 1, "fast")
    table = evaluate_plan(plan, tmp_path / "command")
    stored = pd.read_parquet(tmp_path / "app" / "episodes.parquet")
    pd.testing.assert_frame_equal(stored, table, check_exact=True)
    assert episodes_of(tmp_path / "app").read() == episodes_of(tmp_path / "command").read()
    for unit in plan.units():
        rows = run.trace(unit)
        episode = table[(table["policy"] == unit[0]) & (table["context"] == unit[1])].iloc[0]
        assert rows[-1, COLUMNS.index("reward")] == episode["reward"]
        assert rows[-1, COLUMNS.index("time")] == episode["inspection_time_s"]
    assert Wanted.of_command(run.wanted.command, run.wanted.output) == run.wanted


def test_pause_step_look_and_go_change_nothing(queue, tube, tmp_path):
    """Slow motion looks at a copy; a paused run shows one period more with every step."""
    plain, watched = (wanted(tmp_path / name, tube, policies=("constant",), limit=1) for name in ("plain", "watched"))
    run = queue.add(watched, [Order("pause")])
    assert queue.wait(queue.add(plain), 0.01) is False  # it is in line behind the one that waits
    paused_at(queue, run, lambda: True)
    for steps in range(1, 4):
        queue.order(run, Order("step"))
        paused_at(queue, run, lambda steps=steps: sum(map(len, run.traces.get(("constant", 0, 0), []))) == steps)
    queue.order(run, Order("look"))
    deadline = time.monotonic() + LONG
    while run.film is None:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    shape = run.frame.shape
    assert run.film.inserted_length[0] == pytest.approx(run.trace(("constant", 0, 0))[-1, 1])
    assert shape.place.max() <= run.film.inserted_length[0] + 1e-9
    assert shape.seen["inserted_length"] == pytest.approx(run.film.inserted_length[0], rel=1e-6)  # float32
    queue.order(run, Order("go"))
    other = queue.runs[-1]
    assert queue.wait(run, LONG)
    assert queue.wait(other, LONG)
    tables = [pd.read_parquet(folder / "episodes.parquet") for folder in (plain.output, watched.output)]
    pd.testing.assert_frame_equal(*tables, check_exact=True)


def test_a_stopped_run_keeps_what_was_finished_and_goes_on(queue, tube, tmp_path):
    whole = wanted(tmp_path / "whole", tube)
    run = queue.add(whole, [Order("pause")])
    paused_at(queue, run, lambda: True)
    queue.order(run, Order("stop"))
    assert queue.wait(run, LONG)
    assert run.state == "stopped"
    assert described(whole.output).outcome == "interrupted: 0 of 4 insertions are stored"
    resumed = unfinished(whole.output)
    assert resumed == whole
    run = queue.add(resumed)
    assert queue.wait(run, LONG)
    assert described(whole.output).whole
    assert [entry.folder for entry in stored_runs(tmp_path)] == [whole.output]


def test_a_killed_worker_loses_nothing_that_was_finished(queue, tube, tmp_path):
    """It is killed when the first insertion is stored, and the run goes on to the table of one that was not.

    ``slow`` has as many periods left then as ``constant`` took, ten a second.
    """
    kept = wanted(tmp_path / "killed", tube, policies=("constant", "slow"), limit=1)
    run = queue.add(kept, [Order("pace", (10.0,))])
    deadline = time.monotonic() + LONG
    while not episodes_of(kept.output).read():
        assert time.monotonic() < deadline
        time.sleep(0.005)
    os.kill(queue._process.pid, signal.SIGKILL)
    assert queue.wait(run, LONG)
    assert run.state == "finished"
    assert "the worker was lost" in run.problem
    lines = (kept.output / "episodes.jsonl").read_text().splitlines()
    assert len(lines) == 2  # nothing is lost, nothing done twice
    plan = plan_of(kept.policies, place_at(tube, "test", 1), 1, "fast")
    assert {key for key, *_ in plan.planned()} == episodes_of(kept.output).read().keys()


def test_what_a_hand_drives_is_a_policy_of_the_evaluation(queue, tube, tmp_path):
    run = queue.add(
        wanted(tmp_path / "hand", tube, policies=("constant",), limit=1, driven=True),
        [Order("pause"), Order("hand", (0.1, 0.02))],
    )
    paused_at(queue, run, lambda: True)
    for feed in (0.1, 0.3):
        queue.order(run, Order("hand", (feed, 0.02)))
        queue.order(run, Order("step"))
    queue.order(run, Order("go"))
    assert queue.wait(run, LONG)
    rows = run.trace((BY_HAND, 0, 0))
    assert rows[:3, COLUMNS.index("target_feed_speed")] == pytest.approx([0.1, 0.3, 0.3], rel=1e-6)  # float32 actions
    table = pd.read_parquet(run.wanted.output / "episodes.parquet")
    assert set(table["policy"]) == {BY_HAND, "constant"}
    assert np.isfinite(table["reward"]).all()
    page = write_report(run.wanted.output).read_text()
    assert "by-hand.csv" in page


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"policies": ("nobody",)}, "policy = 'nobody' is not one of"),
        ({"policies": ("pi", "pi")}, "no name twice"),
        ({"limit": 49}, "limit = 49 is outside the accepted range 0 (all) to 48"),
        ({"seeds": 0}, "seeds = 0 is outside the accepted range 1 to 1000"),
        ({"fidelity": "quick"}, "fidelity = 'quick' is not one of"),
        ({"tube": "nowhere.toml"}, "no such file: nowhere.toml"),
    ],
)
def test_what_the_command_refuses_is_told_in_its_words(queue, tube, tmp_path, changes, message):
    run = queue.add(wanted(tmp_path / "refused", tube, **changes))
    assert queue.wait(run, LONG)
    assert run.state == "failed"
    assert message in run.problem
    assert not (tmp_path / "refused").exists()


def test_folders_are_numbered_and_never_used_twice(tmp_path):
    first = free_folder(tmp_path, "My schedule")
    first.mkdir()
    assert first.name == "001-my-schedule"
    assert free_folder(tmp_path, "../..").name == "002-run"


@pytest.mark.parametrize(
    ("command", "message"),
    [
        ("probe-env app", "not one that goes on here"),
        ("probe-env evaluate pi --finer study", "--finer is an option that this page does not have"),
        ("probe-env evaluate --limit 2", "it names no policy"),
    ],
)
def test_only_what_the_page_can_run_goes_on(command, message, tmp_path):
    with pytest.raises(ValueError, match=message):
        Wanted.of_command(command, tmp_path)
