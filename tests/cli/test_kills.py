"""Stopped at a defined point, evaluations, studies, maps and comparisons continue to the same bytes.

Real kills of the folder of results are in tests/records, searches and trainings in their rooms.
"""

import pytest
from kills import Killed, hook_replace, hook_sync, stop
from plans import make_plan

from probe_agents.design import compare as design
from probe_agents.design.trials import DesignTrials
from probe_agents.evaluation.plan import run_plan
from probe_agents.studies import vibration_map
from probe_agents.studies.compare import write_comparison
from probe_agents.studies.run import expand, run_study
from probe_agents.studies.spec import Study
from probe_env import Context, Design, load_contexts
from probe_env.envs.task.config import TaskConfig


def evaluate(folder):
    run_plan(make_plan(4, 3, seeds=(0,)), folder, batch=2, progress=False)


def study(folder):
    study = Study(
        question="?", policies=({"name": "constant", "feed_speed": (0.1, 0.2)}, "pi"), contexts="validation", limit=2,
        set={"task.time_limit": 2.0, "task.settle_time": 0.1}, vary={"task.ramp": (0.5, 0.1)},
    )  # fmt: skip
    settings = expand(study)
    write_comparison(study, settings, run_study(settings, folder), folder)


def make_map(folder):
    vibration_map.run(folder, trials=1)


def compare(folder):
    designs = {"a": Design(), "b": Design(guide_length=5.0)}
    design.compare(designs, DesignTrials((Context(), Context(friction=0.2))), folder)


@pytest.mark.parametrize(
    ("work", "episodes", "stops", "results"),
    [
        (
            evaluate, 12,
            (
                (hook_sync, "episodes.jsonl", 4), (hook_sync, "episodes.jsonl", 5), (hook_replace, "episodes.csv", 1),
                (hook_replace, "profile.parquet", 1), (hook_replace, "manifest.json", 1),
            ),
            ("episodes.csv", "episodes.parquet", "profile.parquet", "manifest.json"),
        ),
        (study, 12, ((hook_sync, "episodes.jsonl", 4), (hook_replace, "comparison.csv", 1)), ("comparison.csv",)),
        (compare, 4, ((hook_sync, "designs.jsonl", 1),), ("designs.csv",)),
        pytest.param(
            make_map, 14, ((hook_replace, "vibration-map.npz", 1), (hook_replace, "vibration-map.json", 1)),
            ("vibration-map.npz",), marks=pytest.mark.slow,
        ),
    ],
)  # fmt: skip
def test_work_that_is_stopped_continues_to_the_same_bytes(work, episodes, stops, results, tmp_path, monkeypatch):
    monkeypatch.setattr(design, "BATCH", 2)
    monkeypatch.setattr(vibration_map, "TaskConfig", lambda: TaskConfig(time_limit=2.0, settle_time=0.1))
    monkeypatch.setattr(vibration_map, "load_contexts", lambda s: load_contexts(s)[: vibration_map.HELD_OUT + 2])
    run, whole = tmp_path / "run", tmp_path / "whole"

    def journal():
        return b"".join(path.read_bytes() for path in sorted(run.rglob("*.jsonl"), reverse=True))

    before = b""
    for hook, name, count in stops:
        with monkeypatch.context() as patch:
            hook(name, count, stop, patch)
            with pytest.raises(Killed):
                work(run)
        assert journal().startswith(before)  # nothing is lost, nothing is run twice
        before = journal()
        assert 0 < before.count(b"\n") <= episodes
    for folder in (run, whole):
        work(folder)
    assert journal().startswith(before)
    assert journal().count(b"\n") == episodes
    for name in results:
        assert (run / name).read_bytes() == (whole / name).read_bytes()
    assert not [path for path in run.rglob(".*") if path.is_file()]
