"""Agents' figures on tables whose answer is known."""

import numpy as np
import pandas as pd
import pytest
from agents.rollouts.statistics import grouped, interquartile_mean
from oracles.scatter import hits_within

from agents.learning.results import (
    difference,
    gain_fraction,
    load_curves,
    markdown,
    over_seeds,
    relative_change,
    throughput,
    verdicts,
)


def table_of(rewards, times=None, shares=None):
    """One row a policy and context; ``rewards`` maps a policy to its values over the contexts."""
    rows = []
    for policy, values in rewards.items():
        for k, value in enumerate(values):
            row = {"policy": policy, "context": k, "seed": 0, "reward": value}
            row["inspection_time_s"] = (times or {}).get(policy, 300.0)
            row["share_within_limit"] = (shares or {}).get(policy, 0.9)
            rows.append(row)
    return grouped(pd.DataFrame(rows))


def test_training_seeds_of_one_method_are_gathered():
    table = table_of({"ppo@0": [1.0, 2.0], "ppo@12": [3.0, 4.0], "best-schedule": [0.0, 0.0]})
    assert table["policy"].tolist() == ["ppo"] * 4 + ["best-schedule"] * 2
    assert table["agent"].tolist() == [0, 0, 12, 12, 0, 0]


def test_interquartile_mean_over_seeds_leaves_an_outlier_out():
    values = {f"ppo@{k}": [r, r + 2.0] for k, r in enumerate([1.0, 2.0, 3.0, 4.0, -1000.0])}
    interval = over_seeds(table_of(values), "ppo", "reward")
    assert interval.mean == pytest.approx(interquartile_mean(np.array([2.0, 3.0, 4.0, 5.0, -999.0])))
    assert interval.mean == pytest.approx(3.0)
    assert interval.low < interval.mean < interval.high


@pytest.mark.processor
def test_the_interval_covers_the_true_mean_as_often_as_it_says(seeds):
    """Independent normal seeds and contexts: 95 % intervals of 300 tables held the truth in 94 +- 1.4 %.

    Of 60, at least 46 must, but for a chance of 1e-4: a coverage of 77 % is noticed half of the time.
    """
    rng, held = np.random.default_rng(seeds(1)), 0
    for _ in range(60):
        contexts = rng.normal(size=24)
        table = table_of({f"a@{k}": contexts + rng.normal(scale=0.5, size=24) for k in range(8)})
        interval = over_seeds(table, "a", "reward")
        held += interval.low <= 0.0 <= interval.high
    least, most = hits_within(60, 0.92, 0.96)
    assert least <= held <= most


def test_share_of_the_gain_and_relative_changes():
    rewards = {"sched": [0.0, 2.0, 4.0], "ppo@0": [7.0, 9.0, 11.0], "top": [10.0, 12.0, 14.0]}
    table = table_of(rewards, {"ppo@0": 240.0}, {"ppo@0": 0.95})
    share = gain_fraction(table, "ppo", "sched", "top")
    assert (share.mean, share.low, share.high) == pytest.approx((0.7, 0.7, 0.7))
    assert relative_change(table, "ppo", "sched", "inspection_time_s").mean == pytest.approx(-0.2)
    words = verdicts(table, "ppo", ["sched"], "top")
    assert "reward +7.0 [+7.0, +7.0]" in words[0]
    assert "inspection time -20 % [-20, -20]" in words[0]
    assert "length out of the limit -50 % [-50, -50]" in words[0]
    assert words[1].startswith("`ppo` reaches 70 [70, 70] %")
    assert "| `ppo` | 1 | 9 [" in markdown(table, ["ppo", "sched"])


def test_seeds_that_differ_widen_the_interval_of_a_difference():
    """The same mean of five seeds, scattered by 5 or not at all, on tubes that do not scatter."""
    close = {f"a@{k}": [1.0] * 8 for k in range(5)} | {"b": [0.0] * 8}
    apart = {f"a@{k}": [1.0 + 5.0 * (k - 2)] * 8 for k in range(5)} | {"b": [0.0] * 8}
    narrow, wide = (difference(table_of(values), "a", "b", "reward") for values in (close, apart))
    assert (narrow.mean, wide.mean) == pytest.approx((1.0, 1.0))
    assert narrow.high - narrow.low == pytest.approx(0.0)
    assert wide.high - wide.low > 5.0
    with pytest.raises(ValueError, match="not run on the same contexts"):
        difference(table_of({"a": [1.0, 2.0], "b": [1.0]}), "a", "b", "reward")


def test_curves_and_throughput(tmp_path):
    for seed in (0, 1):
        folder = tmp_path / f"seed-{seed}"
        folder.mkdir()
        rows = {"seed": seed, "phase": [0, 1], "steps": [0, 1000], "wall_s": [20.0, 20.0], "kernel_s": [15.0, 17.0]}
        rows |= {"reward": -1.0, "inspection_time_s": 300.0, "share_within_limit": 0.9}
        pd.DataFrame(rows | {"validation_s": [10.0, 10.0]}).to_csv(folder / "learning.csv", index=False)
    curves = load_curves(tmp_path)
    assert len(curves) == 4
    figures = throughput(curves, 600)
    assert figures["steps_per_second"] == pytest.approx(1600 / 40.0)
    assert figures["kernel_share"] == pytest.approx(0.8)
    assert figures["minutes_a_seed"] == pytest.approx(1.0)
    with pytest.raises(FileNotFoundError):
        load_curves(tmp_path / "nowhere")
