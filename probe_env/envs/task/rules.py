"""Rules of the task: rewards, costs and endings of a control period of N probes.

Every array has one entry per probe. Costs count unsafe events, as in safe reinforcement learning. They change neither
the reward nor the simulation.
"""

from collections.abc import Callable
from functools import reduce
from operator import or_
from typing import Any, Final, NamedTuple, TypedDict, Unpack

import numpy as np
import numpy.typing as npt

from probe_env.arrays import BoolArray, FloatArray
from probe_env.envs.task.config import TaskConfig

END_TOLERANCE: Final = 1e-6
"""Distance from the end of the helix at which an insertion is complete [m]; actions are float32."""


class Situation(NamedTuple):
    """What decides about the end of an episode, (N,) each; SI units."""

    inserted: FloatArray
    helix_length: FloatArray
    slack_periods: npt.NDArray[np.integer[Any]]
    """Number of consecutive slack periods."""
    stepped: BoolArray
    diverged: BoolArray


ENDINGS: Final[dict[str, Callable[[TaskConfig, Situation], BoolArray]]] = {
    "complete": lambda config, now: ~now.diverged & (now.inserted >= now.helix_length - END_TOLERANCE) & config.growing,
    "lost_drive": lambda config, now: ~now.diverged & (now.slack_periods >= config.lost_drive_periods),
    "diverged": lambda config, now: now.diverged,
}
"""Endings that terminate an episode, the first that applies. Each is a KPI, 0 or 1; with none of them time ran out."""
FAILURES: Final = ("lost_drive", "diverged")
"""Endings by failure."""


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


def ending(config: TaskConfig, now: Situation, time: FloatArray) -> dict[str, BoolArray]:
    """(N,) whether stepped episodes end, by ``ENDINGS`` and "out_of_time" at times (N,) [s]."""
    ends, left = {}, now.stepped
    for name, applies in ENDINGS.items():
        ends[name] = applies(config, now) & left
        left = left & ~ends[name]
    return ends | {"out_of_time": now.stepped & (np.rint(time / config.period) >= config.max_periods)}


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


COSTS: Final[dict[str, Callable[[TaskConfig, BoolArray, FloatArray, FloatArray, FloatArray], BoolArray]]] = {
    "lost_drive": lambda config, is_slack, tension, max_tension, buckling_load: is_slack,
    "tension": lambda config, is_slack, tension, max_tension, buckling_load: max_tension > config.tension_limit,
    "buckling": lambda config, is_slack, tension, max_tension, buckling_load: -tension > buckling_load,
}
"""Cost terms: whether each is 1, by the arguments of ``cost_terms``."""


def cost_terms(
    config: TaskConfig, is_slack: BoolArray, tension: FloatArray, max_tension: FloatArray, buckling_load: FloatArray
) -> dict[str, FloatArray]:
    """Cost terms (N,) of a period by name, 0 or 1 each; their sum is the cost.

    Buckling uses the mean, because the cable survives compression shorter than its bending period (10 ms for table 2's
    pitch). The tension limit uses the peak, which strains the cable.

    Args:
        config: the limits.
        is_slack: (N,) whether the root tension is too low to drive the probe.
        tension: (N,) mean root tension [N], negative under compression.
        max_tension: (N,) maximum root tension [N].
        buckling_load: (N,) of the cable between two floats [N].
    """
    arguments = config, is_slack, tension, max_tension, buckling_load
    return {name: np.asarray(exceeded(*arguments), dtype=float) for name, exceeded in COSTS.items()}


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
    slowest, max_air = config.feed_speeds[0], config.air_supply_rates[1]
    jerk = config.jerk_weight * 8.0 / slowest / config.period  # both actions change by 2, squared
    return config.progress_weight + float(metre_cost(config, config.ratio_cap**2, slowest, max_air)) + jerk


class Quantities(TypedDict, total=False):
    """What the reward is computed from, (N,) each, of a period or of a whole insertion; SI units."""

    inspected: FloatArray | float
    """[m]."""
    squares: FloatArray | float
    """``capped_square`` of the vibration, integrated over the inspected length [m]."""
    seconds: FloatArray | float
    """[s]."""
    air: FloatArray | float
    """Used [m3]."""
    action_change: FloatArray
    """(N, 2) change of the action."""
    uninspected: FloatArray | float
    """Remaining length [m] if the episode ends, else 0."""
    diverged: BoolArray | float
    """Whether the simulation diverged."""
    shaped: FloatArray | float
    """Inserted length, and at the end all that remains [m]."""


def _cost(values: FloatArray) -> FloatArray:
    return -values


TERMS: Final[dict[str, tuple[str | Callable[[TaskConfig], float], str, Callable[[FloatArray], FloatArray]]]] = {
    "progress": ("progress_weight", "inspected", np.positive),
    "vibration": ("vibration_weight", "squares", _cost),
    "time": ("time_weight", "seconds", _cost),
    "air": ("air_weight", "air", _cost),
    "jerk": ("jerk_weight", "action_change", lambda change: -(change**2).sum(axis=1)),
    "uninspected": (uninspected_weight, "uninspected", _cost),
    "diverged": ("diverged_weight", "diverged", _cost),
    "shaping": ("shaping_weight", "shaped", np.positive),
}
"""Reward terms: a weight (field of the task, or function of it) times a function of one of ``Quantities``."""


def reward_terms(config: TaskConfig, **quantities: Unpack[Quantities]) -> dict[str, FloatArray]:
    """Reward terms (N,) by name, those of ``TERMS`` whose quantity is an argument; the reward is their sum."""
    terms = {}
    for name, (weight, quantity, value) in TERMS.items():
        if quantity in quantities:
            factor = getattr(config, weight) if isinstance(weight, str) else weight(config)
            values: FloatArray = np.asarray(quantities[quantity], dtype=np.float64)  # type: ignore[literal-required]
            terms[name] = factor * value(values)
    return terms
