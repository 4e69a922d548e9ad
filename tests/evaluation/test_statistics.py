"""Intervals that cover the truth, pairing over tubes, summaries, and detection depths over tubes."""

import re
from dataclasses import astuple

import numpy as np
import pandas as pd
import pytest
from oracles.scatter import hits_within
from scipy.optimize import brentq
from scipy.stats import betabinom, binom, norm

from probe_agents.evaluation import figures, statistics
from probe_agents.evaluation.kpis import CORE, HIGH, KPIS
from probe_agents.evaluation.signal import draw_curves
from probe_env import Context
from probe_env.envs.plants import Bundle
from probe_env.envs.task.rules import ENDINGS
from probe_env.inspection.detection import DEPTHS, depth_found, pod_gaussian, snr_at
from probe_env.inspection.metrics import POD_NAMES
from probe_env.inspection.sensor import Sensor


@pytest.mark.processor
def test_intervals_cover_the_truth_as_often_as_they_say(seeds):
    """Means of 30 normal values: 95 % intervals held the true mean in 94.1 +- 0.5 % of 2000 draws.

    Of 200, between 171 and 199 may, and a coverage of 85 % is noticed half of the time.
    """
    rng = np.random.default_rng(seeds(1))
    intervals = [statistics.mean_interval(rng.normal(3.0, 2.0, size=30)) for _ in range(200)]
    assert all(interval.low < interval.mean < interval.high for interval in intervals)
    minimum, maximum = hits_within(200, 0.931, 0.951)
    assert minimum <= sum(interval.low <= 3.0 <= interval.high for interval in intervals) <= maximum


@pytest.mark.processor
def test_ratio_intervals_cover_and_equal_the_normal_ones(seeds):
    """Means of 24 against 24, scatter 10 %: the interval is near mean +- 1.96 standard errors, and covers.

    Of 600 intervals 93 % covered, and their widths were 0.95 to 1.05 times the normal ones, +- 0.018. 80 notice
    a coverage of 78 % half of the time.
    """
    rng, covered = np.random.default_rng(seeds(1)), 0
    for _ in range(80):
        first, second = rng.normal(1.2, 0.12, 24), rng.normal(1.0, 0.1, 24)
        ratio, low, high = astuple(statistics.ratio_interval(first, second))
        half = 1.96 * ratio * np.sqrt(np.var(first) / 24 / 1.44 + np.var(second) / 24)
        assert high - low == pytest.approx(2.0 * half, rel=6.0 * 0.018)  # 80 times a chance of 2e-9, and some skewness
        covered += low <= 1.2 <= high
    minimum, maximum = hits_within(80, 0.92, 0.96)
    assert minimum <= covered <= maximum


@pytest.mark.parametrize("count", [3, 6])
def test_the_last_bit_of_a_value_moves_no_interval(count):
    values = np.random.default_rng(2).normal(10.0, 5.0, count)
    exact = astuple(statistics.mean_interval(values))
    for draw in range(20):
        towards = np.random.default_rng(draw).choice([-np.inf, np.inf], count)
        assert astuple(statistics.mean_interval(np.nextafter(values, towards))) == pytest.approx(exact, rel=1e-12)


def test_means_of_special_cases():
    assert statistics.mean_interval(np.array([2.0])).text() == "2"
    assert statistics.mean_interval(np.full(5, 1.5)) == statistics.Interval(1.5, 1.5, 1.5)
    with pytest.raises(ValueError, match="one or more finite"):
        statistics.mean_interval(np.array([1.0, np.nan]))
    assert set(CORE) | set(HIGH) <= set(KPIS)


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
    difference = statistics.paired_difference(table, "A", "B", "inspection_time_s")
    assert difference.mean == pytest.approx(-41.0, abs=1.0)
    assert difference.high - difference.low < 2.0
    with pytest.raises(ValueError, match="cannot be paired"):
        statistics.paired_difference(table[~((table["policy"] == "A") & (table["context"] == 3))], "A", "B", "reward")
    for rows, words in (
        (table, r"A against B: time -41(\.\d)? s \[-4\d(\.\d)?, -4\d(\.\d)?\], length within"),
        (synthetic(41.0, contexts=1), r"A against B: time -4\d(\.\d)? s, length"),  # one tube has no interval
        (synthetic(0.0), r"A against B: time [+-]\d.* s \[-.*, \+.*\], length"),
    ):
        (line,) = statistics.comparison_lines(rows, "B")
        assert re.match(words, line), line


def test_the_share_of_the_planners_lead():
    rewards = {"planner": [10.0, 14.0], "best-schedule": [2.0, 4.0], "mine": [6.0, 9.5]}
    table = pd.DataFrame(
        dict.fromkeys((*CORE, "complete"), 1.0) | {"policy": name, "context": k, "seed": 0, "reward": value}
        for name, values in rewards.items() for k, value in enumerate(values)
    )  # fmt: skip
    assert statistics.fraction_of_lead(table, "mine").mean == pytest.approx(9.5 / 18.0)
    assert any("over best-schedule 52.8 [" in line for line in statistics.comparison_lines(table, "best-schedule"))
    assert statistics.fraction_of_lead(table[table["context"] == 0], "mine").text(100.0) == "50"
    assert statistics.Interval(2.0, 2.0, 2.0).text() == "2"
    with pytest.raises(ValueError, match="same contexts"):
        statistics.fraction_of_lead(table[(table["policy"] != "mine") | (table["context"] > 0)], "mine")


def runs_of(**rewards):
    """Episodes of policies by their rewards, a row per tube and in it one per training seed."""
    rows = [
        {"policy": policy, "context": context, "seed": 0, "training_seed": seed, "reward": reward}
        for policy, tubes in rewards.items() for context, runs in enumerate(tubes) for seed, reward in enumerate(runs)
    ]  # fmt: skip
    return pd.DataFrame(rows)


def test_probability_of_improvement_over_tubes_and_runs():
    """Pairs of runs: 1 won, 1 drawn and 2 lost in one tube, 4 won in the other.

    Of 30 tubes with one run each and 20 won, the number won in a resample is binomial: fewer than 15 have a chance of
    1.9 %, at most 15 of 4.3 %, and the upper end likewise; of 2,000 draws 2.5 % are 2 and 4 deviations from both.
    """
    table = runs_of(a=[[3.0, 1.0], [5.0, 6.0]], b=[[3.0, 2.0], [1.0, 2.0]])
    forth, back = (statistics.probability_of_improvement(table, *pair) for pair in (("a", "b"), ("b", "a")))
    assert (forth.mean, back.mean) == (pytest.approx(0.5 * (1.5 / 4.0 + 1.0)), pytest.approx(0.5 * (2.5 / 4.0)))
    assert not statistics.probability_of_improvement(runs_of(a=[[1.0]], b=[[0.0]]), "a", "b").low <= 1.0  # no interval
    won = runs_of(a=[[1.0]] * 20 + [[-1.0]] * 10, b=[[0.0]] * 30)
    interval = statistics.probability_of_improvement(won, "a", "b")
    assert (30.0 * interval.low, 30.0 * interval.high) == (15.0, 25.0)
    seeds = runs_of(a=[[1.0, -1.0]] * 30, b=[[0.0]] * 30)  # a seed is drawn for all tubes: none, one or both win
    assert astuple(statistics.probability_of_improvement(seeds, "a", "b")) == (0.5, 0.0, 1.0)
    for other, message in (
        ([[0.0]], "not run in the same tubes"),
        ([[0.0], [0.0, 1.0]], "b was not run equally often"),
    ):
        with pytest.raises(ValueError, match=message):
            statistics.probability_of_improvement(runs_of(a=[[1.0], [2.0]], b=other), "a", "b")


def test_performance_profile_counts_tubes_above_a_reward():
    table = runs_of(a=[[3.0, 1.0], [5.0, 6.0]])
    profile = statistics.performance_profile(table, "a", np.array([0.0, 1.0, 3.0, 5.5, 6.0]))
    assert profile.tolist() == [1.0, 0.75, 0.5, 0.25, 0.0]
    assert len(figures.performance_profiles(table)) > 5000


def test_summary_endings_and_training_seeds():
    table = synthetic(41.0)
    table.loc[0, ["complete", "lost_drive"]] = 0.0, 1.0
    rows = statistics.summarise(table).set_index(["policy", "kpi"])
    times, rewards = table.groupby("policy")["inspection_time_s"], table.groupby("policy")["reward"]
    assert rows.loc[("A", "inspection_time_s"), "worst"] == times.max()["A"]
    assert rows.loc[("A", "reward"), "worst"] == rewards.min()["A"]
    middle = np.sort(times.get_group("B"))[10:30]
    assert rows.loc[("B", "inspection_time_s"), "iqm"] == pytest.approx(middle.mean())
    assert statistics.endings(table).loc["A"].tolist() == [39, 1, 0, 40]
    table = statistics.grouped(pd.DataFrame({"policy": ["ppo@2", "a@b", "ppo"]}))
    assert table.to_dict("list") == {"policy": ["ppo", "a@b", "ppo"], "training_seed": [2, 0, 0]}


def test_a_strained_cable_is_named():
    rows = [("a", 0.0, 0.0), ("a", 2.0, 0.0), ("b", 0.0, 0.0), ("c", 1.0, 40.0)]
    table = pd.DataFrame(rows, columns=["policy", "cost_tension", "cost_buckling"])
    assert statistics.strain_lines(table) == [
        "a: the root was over the tension limit in 1 of 2 episodes, for 2 control periods at most",
        "c: the root was over the tension limit in 1 of 1 episodes, for 1 control period at most",
        "c: the root was compressed beyond the buckling load in 1 of 1 episodes, for 40 control periods at most",
    ]
    assert statistics.strain_lines(table[["policy"]]) == []


def found(**snr):
    """Episodes of policies by the signal-to-noise of the 20 % groove in each of their tubes."""
    rows = []
    for policy, values in snr.items():
        for context, groove in enumerate(values):
            curve = pod_gaussian(snr_at(Sensor(), np.array([groove])), 4.6)[0]
            rows.append({"policy": policy, "context": context, "seed": 0} | dict(zip(POD_NAMES, curve, strict=True)))
    return pd.DataFrame(rows)


def test_equal_tubes_leave_nothing_to_chance_and_one_no_interval():
    for tubes in (6, 1):
        depths = statistics.depths_of(table := found(one=[7.5] * tubes)).iloc[0]
        bound = depths["a90_percent_wall"] if tubes > 1 else np.nan
        assert depths["a90_95_percent_wall"] == pytest.approx(bound, rel=1e-12, nan_ok=True)
        for name, deviations in (("a90_percent_wall", 4.6 + 1.2816), ("a50_percent_wall", 4.6)):
            assert depths[name] == pytest.approx(20.0 * deviations / 7.5, rel=2e-3)
    rows = statistics.summarise(synthetic(41.0, contexts=1))
    assert rows["mean"].notna().all()
    for intervals in (statistics.bands(table), rows):
        assert intervals[["low", "high"]].isna().all(axis=None)


def test_the_bound_is_the_95th_percentile_in_closed_form():
    """12 tubes of either of two kinds: the number of good ones among 24 resampled is binomial.

    Fewer than 8 good ones are drawn with a chance of 3.2 %, at most 8 with 7.6 %: of 2,000 draws the 5 % in between are
    4.4 deviations from both, a chance of 1e-5. Bounds of 90 and 97.5 % would be those of 9 and 7 good ones.
    """
    tubes, kinds = 24, np.array([9.0, 5.0])
    bound = statistics.depths_of(found(p=np.repeat(kinds, tubes // 2))).iloc[0]["a90_95_percent_wall"]
    good, bad = pod_gaussian(snr_at(Sensor(), kinds), 4.6)

    def depth(count):
        return 100.0 * depth_found((count * good + (tubes - count) * bad) / tubes, 0.9)

    assert binom.ppf([0.025, 0.05, 0.1], tubes, 0.5).tolist() == [7.0, 8.0, 9.0]
    assert bound == pytest.approx(depth(8), rel=1e-9)
    assert depth(7) > 1.005 * bound > 1.01 * depth(9)


def test_the_mean_curve_counts_and_not_the_mean_depth():
    """One tube in five where nothing is found: no depth is found with 90 % over all of them."""
    depths = statistics.depths_of(found(p=[8.0, 8.0, 8.0, 8.0, 1e-3])).iloc[0]
    assert depths["a90_percent_wall"] == 100.0
    curve = 0.8 * pod_gaussian(snr_at(Sensor(), np.array([8.0])), 4.6)[0]
    assert depths["a50_percent_wall"] == pytest.approx(100 * depth_found(curve, 0.5), rel=1e-3)


def test_bands_and_curves_of_a_stored_evaluation(tmp_path, capsys):
    """Tables of older versions have no curves, which is refused."""
    drawn = statistics.bands(found(good=[7.0, 8.0, 9.0], bad=[2.0, 3.0, 4.0]))
    assert drawn["pod"].between(drawn["low"] - 1e-12, drawn["high"] + 1e-12).all()
    assert len(drawn) == 2 * len(DEPTHS)
    assert len(figures.curves(drawn)) > 5000
    whole = found(good=[7.0, 8.0, 9.0]).assign(**dict.fromkeys((*KPIS, *Context.model_fields, *ENDINGS), 1.0))
    whole.drop(columns=list(POD_NAMES)).to_parquet(tmp_path / "episodes.parquet", index=False)
    assert statistics.has_curves(whole)
    assert not statistics.has_curves(whole.drop(columns=POD_NAMES[0]))
    with pytest.raises(ValueError, match="its episodes have no detection curves; run the evaluation again"):
        draw_curves(tmp_path, tmp_path / "out")
    whole.to_parquet(tmp_path / "episodes.parquet", index=False)
    draw_curves(tmp_path, tmp_path / "out")
    assert "over 3 tubes" in capsys.readouterr().out
    assert len(pd.read_csv(tmp_path / "out" / "pod.csv")) == len(DEPTHS)
    assert (tmp_path / "out" / "pod.png").exists()


@pytest.mark.parametrize("tubes", [1, 40, 4000])
def test_bundle_hours_of_two_tubes_in_closed_form(tubes):
    """The bootstrap mean of two times is the first (1/4), their mean (1/2) or the second (1/4); s / sqrt(N) is added.

    The ends are percentiles of 2,000 draws: their standard error is sqrt(p (1 - p) / 2000) over the density.
    """
    times = np.array([300.0, 420.0])
    hours = statistics.bundle_hours(times, np.zeros(2, dtype=bool), tubes)[0]
    assert hours.mean == pytest.approx(tubes * 360.0 / 3600.0)
    means, weights, scatter = np.array([300.0, 360.0, 420.0]), np.array([0.25, 0.5, 0.25]), 120.0 / np.sqrt(2.0 * tubes)
    for p, end in ((0.025, hours.low), (0.975, hours.high)):
        exact = brentq(lambda x, p=p: weights @ norm.cdf(x, means, scatter) - p, -1000.0, 2000.0)
        error = np.sqrt(p * (1.0 - p) / 2000) / (weights @ norm.pdf(exact, means, scatter))
        assert abs(end * 3600.0 / tubes - exact) <= 3.9 * error  # chance of 1e-4 each


def test_hours_and_second_passes_of_equal_times():
    """Shares as in Brown, Cai and DasGupta 2001 (Jeffreys, n = 10); one simulated tube has a share but no interval."""
    times, flags = np.full(10, 360.0), np.arange(10) < 1
    hours, fraction, added, every = statistics.bundle_hours(times, flags, 500)
    assert astuple(hours) == pytest.approx((50.0, 50.0, 50.0))
    assert astuple(every) == pytest.approx([50.0 + hours for hours in astuple(added)])
    assert astuple(fraction) == pytest.approx((0.1, 0.011, 0.381), abs=5e-4)
    low, high = betabinom.ppf((0.025, 0.975), 500, 1.5, 9.5) * 0.1
    assert added.mean == pytest.approx(5.0)
    assert (added.low, added.high) == pytest.approx((low, high), rel=0.25)  # 0.6 and 19 h; 5 standard errors of 2000
    ends = [astuple(statistics.bundle_hours(times, np.full(10, again), 500)[1]) for again in (False, True)]
    assert ends == [pytest.approx((0.0, 0.0, 0.217), abs=5e-4), pytest.approx((1.0, 0.783, 1.0), abs=5e-4)]
    hours, fraction, added, _ = statistics.bundle_hours(times[:1], flags[:1], 500)
    assert (hours.text(), fraction.mean, added.text()) == ("50", 1.0, "50")


def test_a_bundle_has_a_row_for_each_policy():
    """300 s and 320 s of two seeds, 20 s of setup and 30 s of withdrawal: 360 s a tube. Loud or incomplete: again."""
    table = pd.DataFrame({
        "policy": ["a"] * 4 + ["b"] * 2, "context": [0, 0, 1, 1, 0, 1], "seed": [0, 1, 0, 1, 0, 0],
        "inspection_time_s": [300.0, 320.0] * 2 + [670.0] * 2, "complete": [1.0] * 5 + [0.0],
        "share_within_limit": [1.0, 0.9, 1.0, 1.0, 1.0, 0.5], "inspected_share": [1.0] * 5 + [0.5],
    })  # fmt: skip
    rows = statistics.bundle_table(table, Bundle(tubes=100, setup_time=20.0, withdrawal_time=30.0)).set_index("policy")
    assert rows["hours"].to_dict() == pytest.approx({"a": 10.0, "b": 20.0})
    assert rows["second_pass_share"].to_dict() == {"a": 0.5, "b": 0.5}
    assert rows["second_pass_hours"].to_dict() == pytest.approx({"a": 5.0, "b": 10.0})
    assert statistics.bundle_table(table.drop(columns="inspected_share"), None).empty
