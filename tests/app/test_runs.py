"""Runs of the app: stored as by the command, whatever happens to the worker."""

import json
import os
import signal
import time

import numpy as np
import pandas as pd
import pytest

from probe_agents.app.run_store import new_folder, read_request, stored_run, stored_runs
from probe_agents.app.runs import MANUAL, Command, ProbeShape, RunQueue, RunRequest, flaw_signal
from probe_agents.evaluation.folder import episodes_of
from probe_agents.evaluation.run import evaluate_plan, plan_of
from probe_agents.policies.cases import read_case
from probe_env.inspection.detection import threshold
from probe_env.inspection.sensor import GROOVE, Sensor
from probe_env.inspection.snr import FREQUENCY

LONG = 120.0
"""Time limit for a run of seconds [s]."""


@pytest.fixture(scope="module")
def queue():
    queue = RunQueue()
    yield queue
    queue.close()


@pytest.fixture
def tube(tmp_path):
    """A tube of 7 m, in which an insertion is short."""
    path = tmp_path / "short.toml"
    path.write_text("[tube]\nhelix_length = 7.0\n[contact]\nfriction = { low = 0.1, high = 0.2 }\n")
    return path


class SlowRequest(RunRequest):
    """A request that takes 0.2 s to send."""

    def __reduce__(self):
        time.sleep(0.2)
        return RunRequest.model_validate_json, (self.model_dump_json(),)


def request(folder, short, **changes):
    return RunRequest(**({"policies": ("constant", "pi"), "output": folder, "tube": short, "limit": 2} | changes))


def wait_for(condition, run):
    deadline = time.monotonic() + LONG
    while not condition():
        assert run.state in ("waiting", "running"), run.problem
        assert time.monotonic() < deadline
        time.sleep(0.005)


def wait_paused(run, until=lambda: True):
    wait_for(lambda: run.paused and until(), run)


def ended(queue, run, state="finished"):
    """Wait for the end of a run, which may be added only now."""
    run = queue.add(run) if isinstance(run, RunRequest) else run
    assert queue.wait(run, LONG)
    assert run.state == state
    return run


def test_a_run_equals_the_evaluation_of_the_command_bit_for_bit(queue, tube, tmp_path):
    run = ended(queue, request(tmp_path / "app", tube))
    assert (run.done, run.info.planned) == (4, 4)
    plan = plan_of(run.request.policies, read_case(tube, "test", 2), 1, "fast")
    table = evaluate_plan(plan, tmp_path / "command")
    stored = pd.read_parquet(tmp_path / "app" / "episodes.parquet")
    pd.testing.assert_frame_equal(stored, table, check_exact=True)
    assert episodes_of(tmp_path / "app").read() == episodes_of(tmp_path / "command").read()
    assert (tmp_path / "app" / "report.html").exists()
    shape, last = run.frame.shape, run.trace(run.frame.unit)  # heading and picture are of the same insertion
    assert shape.observation["inserted_length"] == pytest.approx(last["inserted_length"][-1], rel=1e-6)
    for unit in plan.episode_ids():
        trace = run.trace(unit)
        episode = table[(table["policy"] == unit[0]) & (table["context"] == unit[1])].iloc[0]
        assert trace["reward"][-1] == episode["reward"]
        assert trace["time"][-1] == episode["inspection_time_s"]
    command = json.loads((tmp_path / "app" / "manifest.json").read_text())["command"]
    assert command == f"probe-env evaluate constant pi --tube {tube} --limit 2 --fidelity fast --output {tmp_path}/app"


def test_pause_step_and_slow_motion_change_nothing(queue, tube, tmp_path):
    plain, watched = (request(tmp_path / name, tube, policies=("constant",), limit=1) for name in ("plain", "watched"))
    unit = ("constant", 0, 0)
    run, other = queue.add(watched, [Command("pause")]), queue.add(plain)
    assert queue.wait(other, 0.01) is False  # it waits for the paused one
    wait_paused(run)
    for steps in range(1, 4):
        queue.send(run, Command("step"))
        wait_paused(run, lambda steps=steps: len(run.trace(unit)["time"]) == steps)
    queue.send(run, Command("slow motion"))
    wait_for(lambda: run.motion is not None, run)
    shape, length = run.frame.shape, run.motion.inserted_length[0]
    assert length == pytest.approx(run.trace(unit)["inserted_length"][-1])
    assert shape.position.max() <= length + 1e-9
    assert shape.observation["inserted_length"] == pytest.approx(length, rel=1e-6)  # float32
    queue.send(run, Command("continue"))
    ended(queue, run)
    ended(queue, other)
    tables = [pd.read_parquet(folder / "episodes.parquet") for folder in (plain.output, watched.output)]
    pd.testing.assert_frame_equal(*tables, check_exact=True)


def test_a_stopped_run_is_resumed_by_its_stored_request(queue, tube, tmp_path):
    whole = request(tmp_path / "whole", tube)
    run = queue.add(SlowRequest(**dict(whole)))
    wait_for(lambda: run.state == "running", run)
    queue.send(run, Command("pause"))  # not lost, though the run has only begun
    wait_paused(run)
    queue.send(run, Command("stop"))
    ended(queue, run, "stopped")
    assert stored_run(whole.output).outcome == "interrupted: 0 of 4 insertions are stored"
    assert read_request(whole.output) == whole
    ended(queue, read_request(whole.output))
    assert stored_run(whole.output).complete
    assert [entry.folder for entry in stored_runs(tmp_path)] == [whole.output]


@pytest.mark.slow
def test_a_killed_worker_loses_no_finished_insertion(queue, tube, tmp_path):
    """It is killed when the first insertion is stored, while ``slow`` is still under way at ten periods a second."""
    killed = request(tmp_path / "killed", tube, policies=("constant", "slow"), limit=1)
    run = queue.add(killed, [Command("pace", (10.0,))])
    wait_for(lambda: episodes_of(killed.output).read(), run)
    os.kill(queue._process.pid, signal.SIGKILL)
    ended(queue, run, "failed")
    assert "the worker process died (exit status -9): finished insertions are stored" in run.problem
    ended(queue, read_request(killed.output))
    lines = (killed.output / "episodes.jsonl").read_text().splitlines()
    assert len(lines) == 2  # nothing lost, nothing repeated
    plan = plan_of(killed.policies, read_case(tube, "test", 1), 1, "fast")
    assert {key for key, *_ in plan.planned()} == episodes_of(killed.output).read().keys()


def test_a_manual_drive_is_a_policy_of_the_evaluation(queue, tube, tmp_path):
    manual = request(tmp_path / "hand", tube, policies=("constant",), limit=1, manual=True)
    run = queue.add(manual, [Command("pause"), Command("setting", (0.1, 0.02))])
    wait_paused(run)
    for feed in (0.1, 0.3):
        queue.send(run, Command("setting", (feed, 0.02)))
        queue.send(run, Command("step"))
    queue.send(run, Command("continue"))
    ended(queue, run)
    feed = run.trace((MANUAL, 0, 0))["target_feed_speed"]
    assert feed[:3] == pytest.approx([0.1, 0.3, 0.3], rel=1e-6)  # float32 actions
    table = pd.read_parquet(manual.output / "episodes.parquet")
    assert set(table["policy"]) == {MANUAL, "constant"}
    assert np.isfinite(table["reward"]).all()
    assert "by-hand.csv" in (manual.output / "report.html").read_text()
    with pytest.raises(ValueError, match="cannot be resumed"):
        read_request(manual.output)


def test_invalid_requests_fail_with_the_message_of_the_command(queue, tube, tmp_path):
    for changes, message in (
        ({"policies": ("nobody",)}, "unknown policy 'nobody'"),
        ({"limit": 49}, "limit = 49 is outside the accepted range 0 (all) to 48"),
        ({"fidelity": "quick"}, "fidelity = 'quick' is not one of"),
        ({"tube": "nowhere.toml"}, "no such file: nowhere.toml"),
    ):
        assert message in ended(queue, request(tmp_path / "refused", tube, **changes), "failed").problem
        assert not (tmp_path / "refused").exists()


def test_folders_are_numbered_and_never_used_twice(tmp_path):
    assert new_folder(tmp_path, "My schedule").name == "001-my-schedule"
    assert new_folder(tmp_path, "../..").name == "002-run"
    (tmp_path / "damaged").mkdir()
    (tmp_path / "damaged" / "request.json").write_text("{}")
    for folder in ("001-my-schedule", "damaged"):
        with pytest.raises((FileNotFoundError, ValueError), match="request"):
            read_request(tmp_path / folder)


def still(feed=0.2, seconds=1.0):
    """A probe that does not vibrate."""
    count = round(seconds / 1e-3)
    time, tube = 1e-3 * (np.arange(count) + 1 - count), {"sensor": 0, "bore": 0.0242, "helix_length": 60.0}
    signal = {"signal_time": time, "signal_radial": np.zeros(count), "spectrum": np.zeros(len(FREQUENCY))}
    floats = dict.fromkeys(("position", "axial", "radial", "tension", "lever", "outer_gap"), np.zeros(0))
    return ProbeShape(**floats, **tube, **signal, feed_speed=feed, observation={})


def test_snr_of_a_groove_without_vibration():
    """7.5 at 0.2 m/s, in proportion to the depth, and to the root of the time at the flaw."""
    for feed, depth, snr in ((0.2, GROOVE, 7.5), (0.2, 2.0 * GROOVE, 15.0), (0.1, GROOVE, 7.5 * 2.0**0.5)):
        assert flaw_signal(Sensor(), still(feed), 0.5, depth).snr == pytest.approx(snr, rel=2e-3)


def test_the_filtered_signal_of_a_flaw_is_as_high_as_its_ratio():
    """But for noise of deviation 1, of which the highest of a few samples is taken: -4 to +5, with a chance of 1e-4."""
    for before in (0.3, 0.5, 0.7):
        signal = flaw_signal(Sensor(), still(), before, 2.0 * GROOVE)
        assert -4.0 < signal.filtered - signal.snr < 5.0
        assert signal.time[signal.near] == pytest.approx(-before, abs=0.051)  # half of 20 mm at 0.2 m/s
        assert signal.filtered > signal.threshold == threshold(Sensor(), 60.0)
        shallow = flaw_signal(Sensor(), still(), before, 0.01)
        assert shallow.filtered < shallow.threshold
    for shape in (still(feed=0.0), still(seconds=0.05)):
        assert flaw_signal(Sensor(), shape, 0.5, GROOVE) is None
