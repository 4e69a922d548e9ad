"""What a period is worth, what in it is unsafe, and when an episode ends.

Everything is for N probes at once, one entry a probe. Costs count what is unsafe in a period, as in safe reinforcement
learning: they enter neither the reward nor the simulation.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from probe_env.arrays import BoolArray, FloatArray

if TYPE_CHECKING:
    from probe_env.envs.task.config import TaskConfig

END_TOLERANCE: Final = 1e-6
"""[m] of the helix's end at which an insertion is complete; actions are float32."""


class Ending(NamedTuple):
    """Which of N episodes end with a period and how, (N,) each."""

    complete: BoolArray
    lost_drive: BoolArray
    diverged: BoolArray
    out_of_time: BoolArray

    @property
    def terminated(self) -> BoolArray:
        """Ended by what happened."""
        return np.asarray(np.logical_or.reduce([getattr(self, name) for name in ENDINGS]))

    @property
    def truncated(self) -> BoolArray:
        """Ended by the time limit alone."""
        return self.out_of_time & ~self.terminated

    @property
    def over(self) -> BoolArray:
        """Ended either way."""
        return self.terminated | self.out_of_time

    def kpis(self, k: int) -> dict[str, float]:
        """How the episode of probe ``k`` ended: 1 for what ended it, else 0."""
        return {name: float(getattr(self, name)[k]) for name in (*FAILURES, "complete")}


ENDINGS: Final = tuple(name for name in Ending._fields if name != "out_of_time")
"""How episodes end by what happened. Each is a KPI, 0 or 1; an episode with none of them ran out of time."""
FAILURES: Final = tuple(name for name in ENDINGS if name != "complete")
"""Those before all is inspected."""


def ending(
    config: TaskConfig,
    inserted: FloatArray,
    helix_length: FloatArray,
    slack_periods: npt.NDArray[np.integer[Any]],
    time: FloatArray,
    stepped: BoolArray,
    diverged: BoolArray,
) -> Ending:
    """Which of N episodes end with a period, and how; only those that were stepped do. Lengths in m, times in s.

    ``slack_periods`` (N,) is how many periods in a row were ``slack``.
    """
    good = stepped & ~diverged
    complete = good & (inserted >= helix_length - END_TOLERANCE) & config.growing
    lost = (slack_periods >= config.lost_drive_periods) & good & ~complete
    return Ending(complete, lost, diverged & stepped, stepped & (time >= config.time_limit - 1e-9))


def slack_in_a_row(before: npt.NDArray[np.integer[Any]], is_slack: BoolArray) -> npt.NDArray[np.integer[Any]]:
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
    """Cost by name of metres times their ``capped_square``, of seconds, and of air [m3]."""
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


class Outcome(NamedTuple):
    """What a period or a whole insertion came to, (N,) each."""

    inspected: FloatArray  # [m]
    squares: FloatArray  # metres times ``capped_square`` of their vibration
    seconds: FloatArray
    air: FloatArray  # [m3]
    uninspected: FloatArray  # [m] left where the episode ends, else 0
    diverged: BoolArray


def reward_terms(
    config: TaskConfig, outcome: Outcome, action_change: FloatArray | None = None
) -> dict[str, FloatArray]:
    """Named terms (N,) of the reward, which is their sum; ``action_change`` (N, 2): the action less the one before."""
    spent = costs(config, outcome.squares, outcome.seconds, outcome.air)
    terms = {"progress": config.progress_weight * outcome.inspected}
    terms |= {name: -np.asarray(cost) for name, cost in spent.items()}
    if action_change is not None:
        terms["jerk"] = -config.jerk_weight * (action_change**2).sum(axis=1)
    return terms | {
        "uninspected": -config.uninspected_weight * outcome.uninspected,
        "diverged": -config.diverged_weight * outcome.diverged,
    }
