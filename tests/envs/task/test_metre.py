"""What a metre costs is what a period that inspects it is charged, and never more than leaving it out."""

import numpy as np
import pytest

from probe_env.envs.task import Outcome, TaskConfig, capped_square, drive_counts, metre_cost, metre_reward, reward_terms

RNG = np.random.default_rng(7)
N = 200
CONFIG = TaskConfig(vibration_weight=1.7, time_weight=0.13, air_weight=0.31, progress_weight=0.9)


def drawn() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ratios of vibration to its limit, feed speeds and air supplies of N metres, within the task's ranges."""
    ratio = RNG.uniform(0.0, 2.0 * CONFIG.ratio_cap, N)
    return ratio, RNG.uniform(*CONFIG.feed_speeds, N), RNG.uniform(*CONFIG.air_supply_rates, N)


def test_a_metre_earns_what_its_seconds_and_its_air_are_charged() -> None:
    ratio, feed, air = drawn()
    squares, none = capped_square(CONFIG, ratio), np.zeros(N)
    outcome = Outcome(np.ones(N), squares, 1.0 / feed, air / feed, none, none.astype(bool))
    charged = sum(reward_terms(CONFIG, outcome).values())
    assert metre_reward(CONFIG, metre_cost(CONFIG, squares, feed, air)) == pytest.approx(charged, rel=1e-13)


def test_leaving_a_metre_out_never_pays() -> None:
    """Not even at the slowest feed with all the air, the loudest vibration and the action thrown about each period."""
    ratio, feed, air = drawn()
    inspected = metre_reward(CONFIG, metre_cost(CONFIG, capped_square(CONFIG, ratio), feed, air))
    jerk = CONFIG.jerk_weight * 8.0 / feed / CONFIG.period  # both actions from one end to the other: 2^2 + 2^2
    assert (inspected - jerk > -CONFIG.uninspected_weight).all()
    slowest, most = CONFIG.feed_speeds[0], CONFIG.air_supply_rates[1]
    worst = metre_cost(CONFIG, CONFIG.ratio_cap**2, slowest, most) + CONFIG.jerk_weight * 8.0 / slowest / CONFIG.period
    assert CONFIG.uninspected_weight == pytest.approx(float(worst) + CONFIG.progress_weight, rel=1e-14)


def test_drive_counts_from_the_length_on_that_the_task_names() -> None:
    assert drive_counts(CONFIG, np.array([0.0, 14.99, 15.0, 60.0])).tolist() == [False, False, True, True]
