"""When an episode ends, and what a period or a whole insertion is worth.

Everything is for N probes at once, one entry a probe.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from probe_env.arrays import BoolArray, FloatArray
from probe_env.envs.task.config import TaskConfig
from probe_env.envs.task.metre import costs

END_TOLERANCE: Final = 1e-6
"""[m] of the helix's end at which an insertion is complete; actions are float32."""


class Ending(NamedTuple):
    """Which of N episodes end with a period and how, (N,) each: the only list of how an episode can end."""

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

    def failed(self, k: int) -> dict[str, bool]:
        """Whether the episode of probe ``k`` failed, by each of ``FAILURES``."""
        return {name: bool(getattr(self, name)[k]) for name in FAILURES}

    def kpis(self, k: int) -> dict[str, float]:
        """How the episode of probe ``k`` ended: 1 for what ended it, else 0."""
        return {name: float(value) for name, value in self.failed(k).items()} | {"complete": float(self.complete[k])}


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
    """When an episode ends: the helix's end is reached, drive is lost, the simulation diverged, or time is up.

    Args:
        config: the task.
        inserted: cable in the helix [m].
        helix_length: [m].
        slack_periods: periods in a row that were ``slack``, see ``slack_in_a_row``.
        time: since the episode began [s].
        stepped: whether the episode was stepped in this period; others end in nothing.
        diverged: whether the simulation diverged in it.
    """
    good = stepped & ~diverged
    complete = good & (inserted >= helix_length - END_TOLERANCE) & config.growing
    lost = (slack_periods >= config.lost_drive_periods) & good & ~complete
    return Ending(complete, lost, diverged & stepped, stepped & (time >= config.time_limit - 1e-9))


def slack_in_a_row(before: npt.NDArray[np.integer[Any]], hanging: BoolArray) -> npt.NDArray[np.integer[Any]]:
    """How many periods in a row the cable has hung slack, after so many ``before`` and one that it hung in or not."""
    return np.where(hanging, before + 1, 0)


def drive_counts(config: TaskConfig, inserted: FloatArray) -> BoolArray:
    """Whether a probe that is so far in [m] must be driven by its tension; near the entrance it need not be."""
    return np.asarray(inserted >= config.lost_drive_from)


def slack(config: TaskConfig, tension: FloatArray, inserted: FloatArray) -> BoolArray:
    """Whether the root tension [N] is too little to drive the probe."""
    return np.asarray((tension < config.required_tension) & drive_counts(config, inserted))


def travel(config: TaskConfig, before: FloatArray, after: FloatArray, feed_speed: FloatArray) -> FloatArray:
    """Metres inspected in a period, by the inserted lengths [m] around it, or the feed speed at constant length."""
    return after - before if config.growing else feed_speed * config.period


def air_used(config: TaskConfig, before: FloatArray, after: FloatArray) -> FloatArray:
    """Air [m3] used in a period, by the supply rates [m3/s] around it."""
    return 0.5 * (np.abs(before) + np.abs(after)) * config.period


class Outcome(NamedTuple):
    """What a period or a whole insertion came to, for each of N probes.

    Attributes:
        inspected: by the sensor [m].
        squares: metres times ``capped_square`` of their vibration.
        seconds: that it took.
        air: used [m3].
        uninspected: length left [m] where the episode ends, else 0.
        diverged: whether the simulation diverged.
    """

    inspected: FloatArray
    squares: FloatArray
    seconds: FloatArray
    air: FloatArray
    uninspected: FloatArray
    diverged: BoolArray


def reward_terms(
    config: TaskConfig, outcome: Outcome, action_change: FloatArray | None = None
) -> dict[str, FloatArray]:
    """Named terms (N,) of the reward; their sum is the reward.

    Args:
        config: weights.
        outcome: what is rewarded.
        action_change: (N, 2) action minus the one before; None where no actions were taken.
    """
    spent = costs(config, outcome.squares, outcome.seconds, outcome.air)
    terms = {"progress": config.progress_weight * outcome.inspected}
    terms |= {name: -np.asarray(cost) for name, cost in spent.items()}
    if action_change is not None:
        terms["jerk"] = -config.jerk_weight * (action_change**2).sum(axis=1)
    return terms | {
        "uninspected": -config.uninspected_weight * outcome.uninspected,
        "diverged": -config.diverged_weight * outcome.diverged,
    }
