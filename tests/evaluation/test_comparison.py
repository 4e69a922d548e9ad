"""Comparisons over tubes and seeds: probabilities of improvement and performance profiles against counting by hand."""

import itertools

import numpy as np
import pandas as pd
import pytest

from agents.rollouts.comparison import probability_of_improvement, profiles


def grouped(rewards: dict[str, list[list[float]]]) -> pd.DataFrame:
    """Rewards by policy, training seed and tube."""
    return pd.DataFrame(
        [
            {"policy": name, "agent": agent, "context": tube, "seed": 0, "reward": value, "air_m3": -value}
            for name, rows in rewards.items() for agent, row in enumerate(rows) for tube, value in enumerate(row)
        ]
    )  # fmt: skip


REWARDS = {"a": [[1.0, 5.0, 2.0], [3.0, 4.0, 2.0]], "b": [[2.0, 4.5, 2.0]], "c": [[9.0, 9.0, 9.0]]}


def test_an_improvement_is_counted_tube_by_tube_with_ties_as_half() -> None:
    table = grouped(REWARDS)
    pairs = itertools.product(REWARDS["a"], REWARDS["b"])
    by_hand = np.mean(
        [[1.0 if x > y else 0.5 if x == y else 0.0 for x, y in zip(*pair, strict=True)] for pair in pairs]
    )
    improvement = probability_of_improvement(table, "a", "b")
    assert improvement.mean == pytest.approx(by_hand)
    assert probability_of_improvement(table, "b", "a").mean == pytest.approx(1.0 - by_hand)
    assert 0.0 <= improvement.low <= improvement.mean <= improvement.high <= 1.0
    assert probability_of_improvement(table, "c", "a").text() == "1 [1, 1]"
    assert probability_of_improvement(table, "a", "c", "air_m3").mean == 0.0  # less air is better; it uses more
    with pytest.raises(ValueError, match="same contexts"):
        probability_of_improvement(table[(table["policy"] != "b") | (table["context"] > 0)], "a", "b")


def test_the_interval_covers_what_is_true() -> None:
    """60 samples of 20 tubes with a true probability of 0.7. Bootstraps of 20 cover some 92 % with their 95 %."""
    rng, covered = np.random.default_rng(3), 0
    for _ in range(60):
        better = np.where(rng.random(20) < 0.7, 1.0, -1.0)
        interval = probability_of_improvement(grouped({"a": [better.tolist()], "b": [[0.0] * 20]}), "a", "b")
        covered += interval.low <= 0.7 <= interval.high
    assert covered >= 46  # by luck fewer with 6e-5, a binomial of 60 at 0.92


def test_profiles_fall_from_all_to_none() -> None:
    curves = profiles(grouped(REWARDS), ["a", "c"], np.array([0.0, 2.0, 4.5, 10.0])).set_index("policy")
    assert curves.loc["a", "share"].tolist() == [1.0, 5.0 / 6.0, 1.0 / 6.0, 0.0]
    assert curves.loc["c", "share"].tolist() == [1.0, 1.0, 1.0, 0.0]
    assert (curves["low"] <= curves["share"] + 1e-12).all()
    assert (curves["share"] <= curves["high"] + 1e-12).all()
