"""Rules of the task: rewards, costs and endings of a control period of N probes.

Every array has one entry per probe. Costs count unsafe events, as in safe reinforcement learning. They change neither
the reward nor the simulation.
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
"""Distance from the end of the helix at which an insertion is complete [m]; actions are float32."""
FAILURES: Final = ("lost_drive", "diverged")
"""Endings by failure."""
ENDINGS: Final = ("complete", *FAILURES)
"""Endings that terminate an episode. Each is a KPI, 0 or 1; an episode with none of them ran out of time."""


class Score(NamedTuple):
    """Rewards, costs and endings of a control period of N probes; (N,) each."""

    rewards: dict[str, FloatArray]
    """Named terms of the reward."""
    costs: dict[str, FloatArray]
    """Named terms of the cost, 0 or 1."""
    endings: dict[str, BoolArray]
    """Whether the episode ends, by ending: see ``ending``."""
    reward: FloatArray
    """Sum of the terms; 0 for probes that were not stepped."""

    @property
    def terminated(self) -> BoolArray:
        """(N,) ended by completion or failure."""
        return reduce(or_, (self.endings[name] for name in ENDINGS))

    @property
    def truncated(self) -> BoolArray:
        """(N,) ended by the time limit only."""
        return self.endings["out_of_time"] & ~self.terminated

    def kpis(self, k: int) -> dict[str, float]:
        """Ending of the episode of probe ``k`` by name: 1 for the one that occurred, else 0."""
        return {name: float(self.endings[name][k]) for name in (*FAILURES, "complete")}


def ending(
    config: TaskConfig,
    inserted: FloatArray,
    helix_length: FloatArray,
    slack_steps: npt.NDArray[np.integer[Any]],
    time: FloatArray,
    stepped: BoolArray,
    diverged: BoolArray,
) -> dict[str, BoolArray]:
    """Whether each of N episodes ends in this period, by ``ENDINGS`` and "out_of_time"; only stepped episodes end.

    Lengths are in m, times in s; ``slack_steps`` (N,) counts the consecutive slack periods.
    """
    good = stepped & ~diverged
    complete = good & (inserted >= helix_length - END_TOLERANCE) & config.growing
    lost = (slack_steps >= config.lost_drive_periods) & good & ~complete
    late = stepped & (np.rint(time / config.period) >= config.most_periods)
    return {"complete": complete, "lost_drive": lost, "diverged": diverged & stepped, "out_of_time": late}


def any_ending(endings: dict[str, BoolArray]) -> BoolArray:
    """(N,) whether an episode ends."""
    return reduce(or_, endings.values())


def consecutive_slack(before: npt.NDArray[np.integer[Any]], is_slack: BoolArray) -> npt.NDArray[np.integer[Any]]:
    """(N,) consecutive slack periods: ``before`` + 1 if the period was slack, else 0."""
    return np.where(is_slack, before + 1, 0)


def drive_counts(config: TaskConfig, inserted: FloatArray) -> BoolArray:
    """Whether lost drive is checked at an inserted length [m]; near the entrance it is not."""
    return np.asarray(inserted >= config.lost_drive_from)


def slack(config: TaskConfig, tension: FloatArray, inserted: FloatArray) -> BoolArray:
    """Whether the root tension [N] is too low to drive the probe."""
    return np.asarray((tension < config.required_tension) & drive_counts(config, inserted))


def air_used(config: TaskConfig, before: FloatArray, after: FloatArray) -> FloatArray:
    """Air used in a period [m3], by the supply rates [m3/s] at its ends (trapezoid)."""
    return 0.5 * (np.abs(before) + np.abs(after)) * config.period


COSTS: Final = {
    "lost_drive": "the mean root tension is below the required tension, from lost_drive_from on",
    "tension": "the peak root tension is above tension_limit",
    "buckling": "the mean compression at the root is above the buckling load between two floats",
}
"""Cost terms by name, and when each is 1."""


def cost_terms(
    config: TaskConfig, is_slack: BoolArray, tension: FloatArray, greatest: FloatArray, buckling_load: FloatArray
) -> dict[str, FloatArray]:
    """Cost terms (N,) of a period by name, 0 or 1 each; their sum is the cost.

    Buckling uses the mean, because the cable survives compression shorter than its bending period (10 ms for table 2's
    pitch). The tension limit uses the peak, which strains the cable.

    Args:
        config: the limits.
        is_slack: (N,) whether the root tension is too low to drive the probe.
        tension: (N,) mean root tension [N], negative under compression.
        greatest: (N,) greatest root tension [N].
        buckling_load: (N,) of the cable between two floats [N].
    """
    unsafe = is_slack, greatest > config.tension_limit, -tension > buckling_load
    return {name: np.asarray(is_so, dtype=float) for name, is_so in zip(COSTS, unsafe, strict=True)}


def capped_square(config: TaskConfig, ratio: FloatArray) -> FloatArray:
    """min(ratio, ratio_cap)^2, the unweighted vibration cost of a metre; ratio is vibration over its limit."""
    return np.asarray(np.minimum(ratio, config.ratio_cap) ** 2)


def metre_cost(
    config: TaskConfig, squares: FloatArray | float, feed: FloatArray | float, air: FloatArray | float
) -> FloatArray:
    """Cost (N,) of a metre without progress, from its mean ``capped_square``, feed speed [m/s] and air [m3/s]."""
    return np.asarray(config.vibration_weight * squares + config.time_weight / feed + config.air_weight * air / feed)


def metre_reward(config: TaskConfig, cost: FloatArray) -> FloatArray:
    """Reward of a metre with a ``metre_cost``, or mean reward with a mean cost."""
    return np.asarray(config.progress_weight - cost)


def uninspected_weight(config: TaskConfig) -> float:
    """Charge for an uninspected metre: the largest cost of a metre plus the reward that it would have earned.

    So neither ending early nor crawling to the time limit pays.
    """
    slowest, most_air = config.feed_speeds[0], config.air_supply_rates[1]
    jerk = config.jerk_weight * 8.0 / slowest / config.period  # both actions change by 2, squared
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
    """Reward terms (N,) of a period or a whole insertion by name; the reward is their sum.

    Args:
        config: the weights.
        inspected: [m].
        squares: ``capped_square`` of the vibration, integrated over the inspected length [m].
        seconds: [s].
        air: used [m3].
        uninspected: remaining length [m] if the episode ends, else 0.
        diverged: whether the simulation diverged.
        action_change: (N, 2) change of the action; None: no term "jerk".
    """
    terms = {
        "progress": np.asarray(config.progress_weight * inspected),
        "vibration": -np.asarray(config.vibration_weight * squares),
        "time": -np.asarray(config.time_weight * seconds),
        "air": -np.asarray(config.air_weight * air),
    }
    if action_change is not None:
        terms["jerk"] = -config.jerk_weight * (action_change**2).sum(axis=1)
    return terms | {
        "uninspected": np.asarray(-uninspected_weight(config) * uninspected),
        "diverged": np.asarray(-config.diverged_weight * diverged),
    }
