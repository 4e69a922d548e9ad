"""Rules of the task: what a control period of N probes is worth, what in it is unsafe, and when an episode ends.

Every array has one entry a probe. Costs count what is unsafe in a period, as in safe reinforcement learning: they enter
neither the reward nor the simulation.
"""

from __future__ import annotations

from functools import reduce
from operator import or_
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from probe_env.arrays import BoolArray, FloatArray
from probe_env.envs.task.config import TaskConfig

END_TOLERANCE: Final = 1e-6
"""[m] of the helix's end at which an insertion is complete; actions are float32."""
FAILURES: Final = ("lost_drive", "diverged")
"""Endings before all is inspected."""
ENDINGS: Final = ("complete", *FAILURES)
"""Endings that terminate an episode. Each is a KPI, 0 or 1; an episode with none of them ran out of time."""


class Score(NamedTuple):
    """What a control period of N probes is worth, and which episodes end with it; (N,) each."""

    rewards: dict[str, FloatArray]
    """Named terms of the reward."""
    costs: dict[str, FloatArray]
    """Named terms of the cost, 0 or 1."""
    endings: dict[str, BoolArray]
    """Which episodes end, by how: see ``ending``."""
    reward: FloatArray
    """Sum of the terms; 0 for probes that were not stepped."""

    @property
    def terminated(self) -> BoolArray:
        """Ended by what happened."""
        return reduce(or_, (self.endings[name] for name in ENDINGS))

    @property
    def truncated(self) -> BoolArray:
        """Ended by the time limit alone."""
        return self.endings["out_of_time"] & ~self.terminated

    def kpis(self, k: int) -> dict[str, float]:
        """How the episode of probe ``k`` ended: 1 for what ended it, else 0."""
        return {name: float(self.endings[name][k]) for name in (*FAILURES, "complete")}


def score(
    config: TaskConfig,
    stepped: BoolArray,
    endings: dict[str, BoolArray],
    costs: dict[str, FloatArray],
    *,
    inspected: FloatArray,
    squares: FloatArray,
    air: FloatArray,
    uninspected: FloatArray,
    action_change: FloatArray,
) -> Score:
    """Score of a control period in which some probes were ``stepped`` (N,).

    ``endings`` are those of ``ending`` and ``costs`` those of ``cost_terms``; the other arguments are as of
    ``reward_terms``, but ``uninspected`` is what is left to inspect now [m] and counts where an episode ends.
    """
    left = np.where(any_ending(endings) & config.growing, uninspected, 0.0)
    seconds = np.full(len(stepped), config.period)
    rewards = reward_terms(
        config, inspected, squares, seconds, air, left, endings["diverged"], action_change=action_change
    )
    return Score(rewards, costs, endings, np.where(stepped, sum(rewards.values()), 0.0))


def ending(
    config: TaskConfig,
    inserted: FloatArray,
    helix_length: FloatArray,
    slack_steps: npt.NDArray[np.integer[Any]],
    time: FloatArray,
    stepped: BoolArray,
    diverged: BoolArray,
) -> dict[str, BoolArray]:
    """Which of N episodes end with a period, by ``ENDINGS`` and "out_of_time"; only those that were stepped do.

    Lengths are in m, times in s; ``slack_steps`` (N,) counts the consecutive slack periods.
    """
    good = stepped & ~diverged
    complete = good & (inserted >= helix_length - END_TOLERANCE) & config.growing
    lost = (slack_steps >= config.lost_drive_periods) & good & ~complete
    late = stepped & (time >= config.time_limit - 1e-9)
    return {"complete": complete, "lost_drive": lost, "diverged": diverged & stepped, "out_of_time": late}


def any_ending(endings: dict[str, BoolArray]) -> BoolArray:
    """(N,) which episodes end at all."""
    return reduce(or_, endings.values())


def consecutive_slack(before: npt.NDArray[np.integer[Any]], is_slack: BoolArray) -> npt.NDArray[np.integer[Any]]:
    """Consecutive slack periods, after so many ``before`` and one that was slack or not."""
    return np.where(is_slack, before + 1, 0)


def drive_counts(config: TaskConfig, inserted: FloatArray) -> BoolArray:
    """Whether tension must drive a probe at this inserted length [m]; near the entrance it need not."""
    return np.asarray(inserted >= config.lost_drive_from)


def slack(config: TaskConfig, tension: FloatArray, inserted: FloatArray) -> BoolArray:
    """Whether the root tension [N] is too little to drive the probe."""
    return np.asarray((tension < config.required_tension) & drive_counts(config, inserted))


def travel(config: TaskConfig, before: FloatArray, after: FloatArray, feed_speed: FloatArray) -> FloatArray:
    """Length inspected in a period [m]: that between two inserted lengths, or by the feed speed at constant length."""
    return after - before if config.growing else feed_speed * config.period


def air_used(config: TaskConfig, before: FloatArray, after: FloatArray) -> FloatArray:
    """Air [m3] used in a period, by the supply rates [m3/s] around it."""
    return 0.5 * (np.abs(before) + np.abs(after)) * config.period


COSTS: Final = {
    "lost_drive": "the mean root tension is below what the drive needs, where that counts",
    "tension": "the root tension was above its limit",
    "buckling": "the mean pressure at the root is more than the cable bears between two floats",
}
"""Named parts of the cost, and when each is 1."""


def cost_terms(
    config: TaskConfig, is_slack: BoolArray, tension: FloatArray, greatest: FloatArray, buckling_load: FloatArray
) -> dict[str, FloatArray]:
    """Named parts (N,) of a period's cost, 0 or 1 each; their sum is the cost.

    A cable bears pressure for a shorter time than its own sideways swing (10 ms for table 2's pitch), so the mean
    counts for buckling; the peak strains it.

    Args:
        config: the limits.
        is_slack: (N,) whether the root tension is too little to drive the probe.
        tension: (N,) mean root tension [N], below 0 under pressure.
        greatest: (N,) greatest root tension [N].
        buckling_load: (N,) of the cable between two floats [N].
    """
    unsafe = is_slack, greatest > config.tension_limit, -tension > buckling_load
    return {name: np.asarray(is_so, dtype=float) for name, is_so in zip(COSTS, unsafe, strict=True)}


def costs(
    config: TaskConfig, squares: FloatArray | float, seconds: FloatArray | float, air: FloatArray | float
) -> dict[str, FloatArray | float]:
    """What is taken from the reward, by name: of metres times their ``capped_square``, of seconds and of air [m3]."""
    return {
        "vibration": config.vibration_weight * squares,
        "time": config.time_weight * seconds,
        "air": config.air_weight * air,
    }


def capped_square(config: TaskConfig, ratio: FloatArray) -> FloatArray:
    """Vibration cost of a metre by the ratio of vibration to its limit, capped at ``ratio_cap``."""
    return np.asarray(np.minimum(ratio, config.ratio_cap) ** 2)


def metre_cost(
    config: TaskConfig, squares: FloatArray | float, feed: FloatArray | float, air: FloatArray | float
) -> FloatArray:
    """Cost (N,) of a metre, without progress, by its (mean) ``capped_square``, feed speed [m/s] and air [m3/s]."""
    vibration, *each_second = costs(config, squares, 1.0, air).values()
    return np.asarray(sum((cost / feed for cost in each_second), start=vibration))


def metre_reward(config: TaskConfig, cost: FloatArray) -> FloatArray:
    """Reward of a metre with a ``metre_cost``, or with the mean of many."""
    return np.asarray(config.progress_weight - cost)


def uninspected_weight(config: TaskConfig) -> float:
    """Cost of a metre that was not inspected: the greatest that inspecting one can cost.

    So neither ending early nor crawling to the time limit pays.
    """
    slowest, most_air = config.feed_speeds[0], config.air_supply_rates[1]
    jerk = config.jerk_weight * 8.0 / slowest / config.period
    return config.progress_weight + float(metre_cost(config, config.ratio_cap**2, slowest, most_air)) + jerk


def reward_terms(
    config: TaskConfig,
    inspected: FloatArray | float,
    squares: FloatArray | float,
    seconds: FloatArray | float,
    air: FloatArray | float,
    uninspected: FloatArray | float = 0.0,
    diverged: BoolArray | float = 0.0,
    *,
    action_change: FloatArray | None = None,
) -> dict[str, FloatArray]:
    """Named terms (N,) of the reward of a period or a whole insertion; the reward is their sum.

    Args:
        config: the weights.
        inspected: [m].
        squares: metres times the ``capped_square`` of their vibration.
        seconds: [s].
        air: used [m3].
        uninspected: [m] left where the episode ends, else 0.
        diverged: whether the simulation diverged.
        action_change: (N, 2) the action less the one before; None: without the term "jerk".
    """
    terms = {"progress": np.asarray(config.progress_weight * inspected)}
    terms |= {name: -np.asarray(cost) for name, cost in costs(config, squares, seconds, air).items()}
    if action_change is not None:
        terms["jerk"] = -config.jerk_weight * (action_change**2).sum(axis=1)
    return terms | {
        "uninspected": np.asarray(-uninspected_weight(config) * uninspected),
        "diverged": np.asarray(-config.diverged_weight * diverged),
    }
