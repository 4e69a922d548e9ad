"""Evaluation: paired, resumable at any moment, and its statistics are right."""

import json
import re
from collections import deque
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from kills import killed_at
from oracles.scatter import hits_within
from scipy.stats import trim_mean

from agents.evaluation.fidelity_check import Checks
from agents.evaluation.report import evaluate, plan_of
from agents.policies.catalogue import make_policy
from agents.policies.fixed import Constant
from agents.policies.places import place_of
from agents.records.columns import CARRIED, CORE
from agents.rollouts.bootstrap import Interval, chance_of_mean
from agents.rollouts.plan import Plan, episodes_of, per_metre, run_plan
from agents.rollouts.playing import Playing
from agents.rollouts.statistics import (
    endings,
    interquartile_mean,
    mean_interval,
    paired_difference,
    sentences,
    summarise,
)
from probe_env import Context, Fidelity, Scene, load_contexts
from probe_env.design import RANGES
from probe_env.envs.task import TaskConfig
from probe_env.fidelity import BOTH_WAYS

CONFIG = TaskConfig(growing=False, period=0.1, time_limit=0.3, settle_time=0.1)


def plan(contexts=3, policies=2, seeds=(0, 1), config=CONFIG):
    constants = {f"feed {k}": Constant(config, feed_speed=0.1 * (k + 1)) for k in range(policies)}
    return Plan(constants, load_contexts("validation")[:contexts], seeds, config, Fidelity())


def test_the_table_has_every_episode_and_pairs_share_context_and_seed(tmp_path):
    table = run_plan(plan(), tmp_path, progress=False)
    assert len(table) == 2 * 3 * 2
    first, second = (table[table["policy"] == name].reset_index() for name in ("feed 0", "feed 1"))
    for column in ("context", "seed", "friction", "helix_diameter", "drag_factor"):
        assert (first[column] == second[column]).all()
    assert (first["reward"] != second["reward"]).all()
    assert pd.read_csv(tmp_path / "episodes.csv")["reward"].to_numpy() == pytest.approx(table["reward"], rel=1e-6)
    profile = pd.read_parquet(tmp_path / "profile.parquet")
    assert len(profile) == 12  # one metre each: the length is constant
    assert profile["time"].to_numpy() == pytest.approx(0.3)


def test_the_profile_is_per_metre():
    """Periods that end at 5.4, 5.8, 6.0 and 6.5 m: three in the sixth metre, one in the seventh."""
    periods = [(t, length, 0.2, 0.02, rms, 4.0, 2.0 * rms) for t, length, rms in
               ((1, 5.4, 3e-4), (2, 5.8, 4e-4), (3, 6.0, 0.0), (4, 6.5, 1e-4))]  # fmt: skip
    profile = per_metre(periods)
    assert profile["inserted_length"].tolist() == [5.5, 6.5]
    assert profile["time"].tolist() == [3.0, 4.0]
    assert profile["radial_rms_m"] == pytest.approx([np.sqrt(25.0 / 3.0) * 1e-4, 1e-4])
    assert profile["noise_rms_m"] == pytest.approx(2.0 * profile["radial_rms_m"])
    assert profile["feed_speed"] == pytest.approx([0.2, 0.2])


def test_the_profile_of_both_ways_reaches_to_the_turn():
    """It is of the way in, to the end of the period in which the probe turns round."""
    scene = Scene.model_validate({"tube": {"helix_length": 8.0}, "carrier_length": 4.0})
    config = TaskConfig(passes="both", scene=scene, time_limit=100.0)
    whole = Plan({"in and back": make_policy("fast-in", config)}, [Context()], (0,), config, BOTH_WAYS["fast"])
    playing, turned, rows = Playing(whole, deque(whole.units()), 1, 1), [], []
    while not playing.over:
        for ended in playing.step():
            rows = [row[CARRIED.index("inserted_length")] for row in ended.profile]
        turned.append(playing.last.infos[0]["inserted_length"])
    deepest = int(np.argmax(turned))
    assert rows == turned[: deepest + 1]
    assert rows[-1] == pytest.approx(8.0, abs=0.05)


def test_an_episode_does_not_depend_on_its_company(tmp_path):
    alone = run_plan(plan(), tmp_path / "alone", batch=1, progress=False)
    together = run_plan(plan(), tmp_path / "together", batch=16, progress=False)
    pd.testing.assert_frame_equal(alone, together, check_exact=True)


def evaluate_here(folder):
    run_plan(plan(4, 3), folder, batch=2, progress=False)


def test_an_evaluation_killed_at_every_episode_and_table_gives_the_same_table(tmp_path):
    """Killed whenever three more episodes are in the journal, then before each of the five files is in its place."""
    whole = run_plan(plan(4, 3), tmp_path / "whole", batch=2, progress=False)
    folder, stored = tmp_path / "killed", []
    while killed_at("agents.rollouts.plan._line", 4, evaluate_here, folder):
        stored.append(len(episodes_of(folder).read()))
    assert stored == list(range(3, 24, 3))  # of 24; nothing is lost, nothing done twice
    for number in range(1, 6):
        assert killed_at("os.replace", number, evaluate_here, folder)
    resumed = run_plan(plan(4, 3), folder, batch=2, progress=False)
    pd.testing.assert_frame_equal(whole, resumed, check_exact=True)


def test_a_line_that_was_cut_off_is_run_again(tmp_path):
    table = run_plan(plan(), tmp_path, progress=False)
    journal = tmp_path / "episodes.jsonl"
    content = journal.read_bytes()
    journal.write_bytes(content[:-40])
    pd.testing.assert_frame_equal(run_plan(plan(), tmp_path, progress=False), table, check_exact=True)
    assert len(episodes_of(journal.parent).read()) == 12


def test_what_is_done_is_not_done_again_and_another_setting_is_refused(tmp_path, monkeypatch):
    run_plan(plan(), tmp_path, progress=False)
    monkeypatch.setattr("agents.rollouts.playing.Episodes", None)  # running anything would fail
    assert len(run_plan(plan(), tmp_path, progress=False)) == 12
    with pytest.raises(ValueError, match="another setting"):
        run_plan(plan(config=CONFIG.model_copy(update={"time_limit": 0.5})), tmp_path, progress=False)


def test_random_probes_are_the_same_for_all_policies_and_are_told(tmp_path):
    drawn = replace(plan(), probes="random")
    table = run_plan(drawn, tmp_path, progress=False)
    first, second = (table[table["policy"] == name].reset_index() for name in ("feed 0", "feed 1"))
    assert (first[list(RANGES)] == second[list(RANGES)]).all(axis=None)
    assert first["line_density"].nunique() == 6  # a probe for each context and seed
    same_probe = run_plan(plan(), tmp_path / "scene", progress=False)
    assert (table["radial_rms_m"] != same_probe["radial_rms_m"]).all()
    with pytest.raises(ValueError, match=r"another setting .probes"):
        run_plan(plan(), tmp_path, progress=False)


def test_what_is_shown_and_fields_newer_than_the_results_make_no_other_setting(tmp_path):
    table = run_plan(plan(), tmp_path, progress=False)
    setting = json.loads((tmp_path / "setting.json").read_text())
    del setting["probes"], setting["task"]["observe_probe"]
    (tmp_path / "setting.json").write_text(json.dumps(setting))
    resumed = run_plan(plan(config=CONFIG.all_shown), tmp_path, progress=False)
    pd.testing.assert_frame_equal(table, resumed, check_exact=True)
    anew = run_plan(plan(config=CONFIG.all_shown), tmp_path / "anew", progress=False)
    pd.testing.assert_frame_equal(table, anew, check_exact=True)


def test_a_replay_tube_by_tube_would_draw_other_probes(tmp_path):
    with pytest.raises(ValueError, match=r"check_fidelity = 'replayed'.*must be no, half-step or acting"):
        evaluate(plan_of(["constant"], place_of(None, "test", 1), 1, "fast", "random"), tmp_path, Checks("replayed"))
    assert not list(tmp_path.iterdir())


def test_a_changed_policy_is_run_again_under_its_name(tmp_path):
    before = run_plan(plan(), tmp_path, progress=False)
    changed = plan()
    changed.policies["feed 0"] = Constant(CONFIG, feed_speed=0.35)
    after = run_plan(changed, tmp_path, progress=False)
    assert (
        after[after["policy"] == "feed 0"]["reward"].to_numpy() != before[before["policy"] == "feed 0"]["reward"]
    ).all()
    same = [frame[frame["policy"] == "feed 1"] for frame in (before, after)]
    pd.testing.assert_frame_equal(*same, check_exact=True)


@pytest.mark.processor
def test_intervals_cover_the_truth_as_often_as_they_say(seeds):
    """Means of 30 normal values: 95 % intervals held the true mean in 94.1 +- 0.5 % of 2000 draws.

    Of 200, between 171 and 199 may, and a coverage of 85 % is noticed half of the time.
    """
    rng, hits = np.random.default_rng(seeds(1)), 0
    for _ in range(200):
        interval = mean_interval(rng.normal(3.0, 2.0, size=30))
        assert interval.low < interval.mean < interval.high
        hits += interval.low <= 3.0 <= interval.high
    least, most = hits_within(200, 0.931, 0.951)
    assert least <= hits <= most


def test_the_chance_of_a_mean_where_signs_are_as_likely_one_way_as_the_other(seeds):
    """k differences of one sign: 2 of 2^k. Of means of ten true zeros 50 in 1024, the outermost, fall under 0.05."""
    assert chance_of_mean(np.array([1.0, 2.0, 0.5, 3.0, 1.0, 0.0])) == 2 / 2**5
    assert chance_of_mean(-np.ones(8)) == 2 / 2**8
    for no_sign in (np.array([1.0, -1.0]), np.zeros(4), np.array([3.0, 0.0]), np.array([2.0])):
        assert chance_of_mean(no_sign) == 1.0
    rng = np.random.default_rng(seeds(1))
    under = sum(chance_of_mean(rng.standard_t(3, size=10)) < 0.05 for _ in range(400))
    least, most = hits_within(400, 50 / 1024, 50 / 1024)
    assert least <= under <= most
    with pytest.raises(ValueError, match="must be finite"):
        chance_of_mean(np.array([1.0, np.nan]))


def test_means_of_special_cases():
    assert mean_interval(np.array([2.0])) == Interval(2.0, 2.0, 2.0)
    assert mean_interval(np.full(5, 1.5)) == Interval(1.5, 1.5, 1.5)
    with pytest.raises(ValueError, match="must be finite"):
        mean_interval(np.array([1.0, np.nan]))
    values = np.arange(20.0) ** 2
    assert interquartile_mean(values) == trim_mean(values, 0.25)


def synthetic(difference, contexts=40, noise=1.0):
    """Two policies whose contexts differ by much more than the policies do."""
    rng, rows = np.random.default_rng(1), []
    base = rng.normal(300.0, 100.0, size=contexts)
    for policy, shift in (("A", -difference), ("B", 0.0)):
        for context in range(contexts):
            time_ = base[context] + shift + rng.normal(0.0, noise)
            row = dict.fromkeys((*CORE, "complete"), 1.0) | {"lost_drive": 0.0, "diverged": 0.0}
            rows.append(row | {"policy": policy, "context": context, "seed": 0, "inspection_time_s": time_})
    return pd.DataFrame(rows)


def test_pairing_sees_what_the_scatter_between_contexts_hides():
    table = synthetic(41.0)
    difference = paired_difference(table, "A", "B", "inspection_time_s")
    assert difference.mean == pytest.approx(-41.0, abs=1.0)
    assert difference.high - difference.low < 2.0
    with pytest.raises(ValueError, match="nothing to pair"):
        paired_difference(table[~((table["policy"] == "A") & (table["context"] == 3))], "A", "B", "reward")


def test_sentences_say_it_plainly():
    (line,) = sentences(synthetic(41.0), "B")
    assert line.startswith("A takes 41")
    assert "s less [" in line
    (alone,) = sentences(synthetic(41.0, contexts=1), "B")  # one tube has no interval
    assert re.search(r"A takes 4\d(\.\d)? s less than B", alone)
    (none,) = sentences(synthetic(0.0), "B")
    assert "no clearly different amount" in none


def test_summary_and_endings():
    table = synthetic(41.0)
    table.loc[0, ["complete", "lost_drive"]] = 0.0, 1.0
    rows = summarise(table).set_index(["policy", "kpi"])
    assert rows.loc[("A", "inspection_time_s"), "worst"] == table[table["policy"] == "A"]["inspection_time_s"].max()
    assert endings(table).loc["A"].tolist() == [39, 1, 0, 40]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((["constant"], "validation", 99, 1), "limit = 99"),
        ((["constant"], "validation", 0, 0), "seeds = 0"),
        (([], "validation", 0, 1), "at least one is needed"),
        ((["pi", "pi"], "validation", 0, 1), "no name twice"),
        ((["fastest"], "validation", 0, 1), "policy = 'fastest'"),
    ],
)
def test_bad_arguments_are_named_and_nothing_is_written(arguments, message, tmp_path):
    specs, contexts, limit, seeds = arguments
    with pytest.raises(ValueError, match=message):
        evaluate(plan_of(specs, place_of(None, contexts, limit), seeds, "fast"), tmp_path / "out")
    assert not (tmp_path / "out").exists()
