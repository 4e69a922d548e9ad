"""Stopped at a defined point, what stores goes on to what one that was never stopped gives."""

import json

import pandas as pd
import pytest
from kills import Killed, hook_replace, hook_sync, kill, killed, stop

from agents.design import compare as design_compare
from agents.design.compare import compare
from agents.design.trials import DesignTrials
from agents.evaluation.plan import Plan, run_plan
from agents.policies.fixed import Constant
from agents.processes.workers import HERE, Workers
from probe_env import Context, Design, load_contexts
from probe_env.envs.task import TaskConfig

CONFIG = TaskConfig(growing=False, period=0.1, time_limit=0.3, settle_time=0.1)
TWO = Workers(jobs=2)


def evaluate(folder, workers=HERE):
    policies = {f"feed {u:g}": Constant(CONFIG, feed_speed=u) for u in (0.1, 0.2)}
    plan = Plan(policies, load_contexts("validation")[:3], (0, 1), CONFIG)
    return run_plan(plan, folder, progress=False, workers=workers)


def lines_of(path):
    return [json.loads(line) for line in path.read_bytes().splitlines()]


def hidden(folder):
    return [path.name for path in folder.rglob(".*")]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return evaluate(tmp_path_factory.mktemp("whole"))


def test_an_evaluation_stopped_at_a_line_or_a_file_keeps_what_is_stored_and_goes_on(tmp_path, whole, monkeypatch):
    """Two policies, three tubes, two seeds; each line is on the disk before the next episode is run."""
    points = [(hook_sync, "episodes.jsonl", count) for count in (1, 7, 12)]
    names = ("setting.json", "episodes.csv", "profile.parquet", "provenance.json")
    points += [(hook_replace, name, 1) for name in names]
    for hook, name, count in points:
        folder = tmp_path / f"{name}-{count}"
        with monkeypatch.context() as patch:
            hook(name, count, stop, patch)
            with pytest.raises(Killed):
                evaluate(folder)
        if hook is hook_sync:
            assert len(lines_of(folder / name)) == count
        else:
            assert not (folder / name).exists()
        pd.testing.assert_frame_equal(evaluate(folder), whole, check_exact=True)
        keys = [record["key"] for record in lines_of(folder / "episodes.jsonl")]
        assert len(keys) == len(set(keys)) == 12
        assert not hidden(folder)


def evaluate_until_line(folder, count, workers):
    hook_sync("episodes.jsonl", count, kill)
    evaluate(folder, workers)


def evaluate_until_file(folder, name):
    hook_replace(name, 1, kill)
    evaluate(folder)


@pytest.mark.slow
def test_a_killed_evaluation_goes_on(tmp_path, whole):
    """By SIGKILL, with two workers at a line, and here before a file is in its place, which leaves a hidden one."""
    killed(evaluate_until_line, tmp_path / "line", 5, TWO)
    assert len(lines_of(tmp_path / "line" / "episodes.jsonl")) == 5
    pd.testing.assert_frame_equal(evaluate(tmp_path / "line", TWO), whole, check_exact=True)
    killed(evaluate_until_file, tmp_path / "file", "profile.parquet")
    (left,) = hidden(tmp_path / "file")
    assert left.startswith(".profile.parquet.")
    pd.testing.assert_frame_equal(evaluate(tmp_path / "file"), whole, check_exact=True)
    assert not hidden(tmp_path / "file")


def test_a_comparison_stopped_after_a_batch_goes_on(tmp_path, monkeypatch):
    designs, tubes = {"a": Design(), "b": Design(guide_length=5.0)}, (Context(), Context(friction=0.2))
    monkeypatch.setattr(design_compare, "BATCH", 2)
    whole = compare(designs, DesignTrials(tubes), tmp_path / "whole")
    with monkeypatch.context() as patch:
        hook_sync("designs.jsonl", 1, stop, patch)
        with pytest.raises(Killed):
            compare(designs, DesignTrials(tubes), tmp_path / "run")
    assert len(lines_of(tmp_path / "run" / "designs.jsonl")) == 2
    pd.testing.assert_frame_equal(compare(designs, DesignTrials(tubes), tmp_path / "run"), whole, check_exact=True)
    assert len(lines_of(tmp_path / "run" / "designs.jsonl")) == 4
