"""Killed at a defined point, everything that stores goes on to what one that was never killed gives."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from agents.study.cases import run_study as run_cases
from kills import all_gone, hook_replace, hook_sync, kill, killed

from agents.design import compare as design_compare
from agents.design.compare import Comparison, compare
from agents.design.search import Kept, search, trials_table
from agents.evaluation.plan import Plan, run_plan
from agents.evaluation.workers import HERE, Workers
from agents.policies.fixed import Constant
from agents.studies.builtin import Request
from agents.studies.compare import write_comparison
from agents.studies.run import expand, run_study
from agents.studies.shipped import vibration_map as fit
from agents.studies.spec import Study
from agents.training.config import Training
from agents.training.train import BEST, CHECKPOINT, CURVE, train_all
from probe_env import Context, Design, Fidelity, load_contexts
from probe_env.envs.task import TaskConfig

CONFIG = TaskConfig(growing=False, period=0.1, time_limit=0.3, settle_time=0.1)
COARSE = Fidelity(time_lapse=20.0)
TWO = Workers(jobs=2)


def plan():
    policies = {f"feed {u:g}": Constant(CONFIG, feed_speed=u) for u in (0.1, 0.2)}
    return Plan(policies, load_contexts("validation")[:3], (0, 1), CONFIG)


def evaluate(folder, workers=HERE, **more):
    return run_plan(plan(), folder, progress=False, workers=workers, **more)


def lines_of(path):
    return [json.loads(line) for line in path.read_bytes().splitlines()]


def hidden(folder):
    return [path.name for path in folder.rglob(".*")]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return evaluate(tmp_path_factory.mktemp("whole"))


def evaluate_until_line(folder, count, workers, pids):
    hook_sync("episodes.jsonl", count, lambda: kill(pids))
    evaluate(folder, workers)


@pytest.mark.parametrize(("count", "workers"), [(1, HERE), (7, HERE), (12, HERE), (1, TWO), (5, TWO)])
def test_an_evaluation_killed_at_a_line_keeps_it_and_goes_on(count, workers, tmp_path, whole):
    """Two policies, three tubes, two seeds: here side by side, with workers in four portions of three."""
    folder, pids = tmp_path / "run", tmp_path / "pids"
    killed(evaluate_until_line, folder, count, workers, pids if workers is TWO else None)
    assert len(lines_of(folder / "episodes.jsonl")) == count
    assert workers is HERE or all_gone(pids)
    resumed = evaluate(folder, workers)
    pd.testing.assert_frame_equal(resumed, whole, check_exact=True)
    keys = [record["key"] for record in lines_of(folder / "episodes.jsonl")]
    assert len(keys) == len(set(keys)) == 12
    assert not hidden(folder)


def evaluate_until_file(folder, name):
    hook_replace(name, 1, kill)
    evaluate(folder)


@pytest.mark.parametrize("name", ["setting.json", "episodes.csv", "profile.parquet", "manifest.json"])
def test_what_a_kill_leaves_of_a_file_is_no_result_and_goes_with_the_next_run(name, tmp_path, whole):
    killed(evaluate_until_file, tmp_path, name)
    assert not (tmp_path / name).exists()
    (left,) = hidden(tmp_path)
    assert left.startswith(f".{name}.")
    assert left.endswith(".tmp")
    pd.testing.assert_frame_equal(evaluate(tmp_path), whole, check_exact=True)
    assert not hidden(tmp_path)


GROWING = TaskConfig(time_limit=2.0, settle_time=0.1)


def sweep(folder):
    study = Study(
        question="?", policies=({"name": "constant", "feed_speed": (0.1, 0.2)}, "pi"), contexts="validation", limit=2,
        set={"task.time_limit": 2.0, "task.settle_time": 0.1}, vary={"task.ramp": (0.5, 0.1)},
    )  # fmt: skip
    settings = expand(study)
    write_comparison(study, settings, run_study(settings, folder), folder)


def make_map(folder):
    fit.make_map(1, Request(folder), folder / "map.npz")


def until(work, folder, hook, name, count):
    make_small(pytest.MonkeyPatch())
    hook(name, count, kill)
    work(folder)


def make_small(patch):
    patch.setattr(fit, "TaskConfig", lambda: GROWING)
    patch.setattr(fit, "load_contexts", lambda split: load_contexts(split)[: fit.HELD_OUT + 2])


KILLS = [
    (sweep, hook_sync, "episodes.jsonl", 4),
    (sweep, hook_replace, "comparison.csv", 1),
    (make_map, hook_replace, "map.npz", 1),
    (make_map, hook_replace, "map.json", 1),
]
EPISODES = {sweep: 12, make_map: 14}
TABLES = {sweep: ("comparison.csv", "episodes.csv"), make_map: ("map.npz",)}


def journal(folder):
    return b"".join(path.read_bytes() for path in sorted(folder.rglob("episodes.jsonl"), reverse=True))


@pytest.mark.slow
@pytest.mark.parametrize(("work", "hook", "name", "count"), KILLS)
def test_a_study_and_a_map_killed_at_an_episode_or_a_file_go_on(work, hook, name, count, tmp_path, monkeypatch):
    """To the same bytes; what was tried in the run that was killed is not tried again."""
    run, whole = tmp_path / "run", tmp_path / "whole"
    killed(until, work, run, hook, name, count)
    tried = journal(run)
    assert tried.count(b"\n") == (count if hook is hook_sync else EPISODES[work])
    make_small(monkeypatch)
    for folder in (run, whole):
        work(folder)
    stored = journal(run)
    assert stored.startswith(tried)
    assert stored.count(b"\n") == EPISODES[work]
    for table in TABLES[work]:
        assert (run / table).read_bytes() == (whole / table).read_bytes()
    assert not hidden(run)


def compare_until(folder, count):
    design_compare.BATCH = 2
    hook_sync("designs.jsonl", count, kill)
    compare(comparison(), folder)


def comparison():
    return Comparison({"a": Design(), "b": Design(guide_length=5.0)}, (Context(), Context(friction=0.2)))


def test_a_comparison_killed_after_a_batch_goes_on(tmp_path, monkeypatch):
    monkeypatch.setattr(design_compare, "BATCH", 2)
    whole = compare(comparison(), tmp_path / "whole")
    killed(compare_until, tmp_path / "run", 1)
    assert len(lines_of(tmp_path / "run" / "designs.jsonl")) == 2
    pd.testing.assert_frame_equal(compare(comparison(), tmp_path / "run"), whole, check_exact=True)
    assert len(lines_of(tmp_path / "run" / "designs.jsonl")) == 4


def study(folder):
    run_cases(Path("configs/scenes"), folder, 2, 0.2, ("l10", "u0"), jobs=1)
    return pd.read_csv(folder / "ensemble.csv").drop(columns="wall_s", errors="ignore").sort_values(["case", "member"])


def study_until(folder, count):
    hook_replace("ensemble.csv", count, kill)
    study(folder)


@pytest.mark.parametrize("count", [1, 3])
def test_a_study_killed_as_it_stores_a_run_goes_on(count, tmp_path):
    """The runs of the charts are stored by the same store, a row as it ends."""
    killed(study_until, tmp_path / "run", count)
    stored = tmp_path / "run" / "ensemble.csv"
    assert (len(pd.read_csv(stored)) if stored.exists() else 0) == count - 1
    resumed, whole = (study(tmp_path / folder).reset_index(drop=True) for folder in ("run", "whole"))
    pd.testing.assert_frame_equal(resumed, whole, check_exact=True)
    assert len(whole) == 4
    assert not hidden(tmp_path / "run")


def closed_form(point):
    return (10.0 - point["guide_length"]) ** 2, 10.0 * point["guide_length"], -point["line_density"]


def searched(folder, value=closed_form):
    axes = {"guide_length": (1.0, 10.0, "m"), "line_density": (0.09, 0.14, "kg/m")}
    starts = [{"guide_length": 5.0, "line_density": 0.1}]
    storage = f"sqlite:///{folder}/study.db"
    return trials_table(search(axes, value, 12, Kept(storage, "known"), population=4, starts=starts))


def search_until(folder, count):
    asked = []

    def value(point):
        asked.append(point)
        if len(asked) == count:
            kill()
        return closed_form(point)

    searched(folder, value)


@pytest.mark.parametrize("count", [1, 4, 6])
def test_a_search_killed_in_a_trial_goes_on(count, tmp_path):
    """In the first start, before the first generation ends, in the second."""
    for name in ("whole", "run"):
        (tmp_path / name).mkdir()
    killed(search_until, tmp_path / "run", count)
    assert searched(tmp_path / "run").equals(searched(tmp_path / "whole"))


TRAINING = Training(
    environment={
        "num_envs": 4, "fidelity": COARSE, "task": {"settle_time": 0.1, "time_limit": 20.0},
    },
    network={"net_arch": (8,)}, validation={"limit": 1, "fidelity": COARSE}, phases=2, phase_steps=64,
    learning={"n_steps": 16, "batch_size": 32, "n_epochs": 2},
)  # fmt: skip


def train_until(folder, name, count):
    hook_replace(name, count, kill)
    train_all(TRAINING, folder, resume=False)


def weights(folder):
    with np.load(folder / "seed-0" / BEST) as file:
        return {name: file[name] for name in file.files if name.startswith("weight:")}


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    folder = tmp_path_factory.mktemp("trained")
    return folder, train_all(TRAINING, folder, resume=False)


@pytest.mark.parametrize(("name", "count"), [(CHECKPOINT, 2), (CURVE, 2)])
def test_a_training_killed_at_a_checkpoint_goes_on(name, count, tmp_path, trained):
    """Before the second checkpoint is there, and after it before the curve says so."""
    folder, curve = trained
    killed(train_until, tmp_path, name, count)
    resumed = train_all(TRAINING, tmp_path, resume=True)
    columns = ["phase", "steps", "reward", "inspection_time_s", "share_within_limit"]
    assert (resumed[columns] == curve[columns]).all(axis=None)
    stored = pd.read_csv(tmp_path / "seed-0" / CURVE)
    assert stored["phase"].tolist() == [1, 2]
    first, second = weights(folder), weights(tmp_path)
    assert first.keys() == second.keys()
    assert all((first[name] == second[name]).all() for name in first)
    assert not hidden(tmp_path)
