"""What the vibration map expects of a schedule, within milliseconds: the simulation confirms."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import ndtr

from agents.policies.maps.lookup import FIRST
from agents.policies.places import Place
from probe_env.arrays import FloatArray
from probe_env.envs.surrogate.vibration_map import CONTEXT, expected_cost
from probe_env.envs.task import metre_reward
from probe_env.schedule import Schedule

UNIT: Final = 1e-4
"""Of the map [m]."""
EIGHTY: Final = 1.2816
"""Standard deviations on either side within which 80 % of a normal distribution are."""


@dataclass(frozen=True)
class Expected:
    """Of a schedule in some tubes.

    Attributes:
        length: (m,) middles of the metres [m].
        low, middle, high: (m,) radial rms [m]: median, and the band of 80 % over tubes and scatter.
        within: share of the length within the limit.
        seconds: that the insertion takes.
        air: used [m3].
        reward: mean of an insertion; what is not in the map (jerk, lost drive) is left out.
    """

    length: FloatArray
    low: FloatArray
    middle: FloatArray
    high: FloatArray
    within: float
    seconds: float
    air: float
    reward: float


def expected(schedule: Schedule, place: Place) -> Expected:
    """What is expected in the tubes of a place.

    Raises:
        ValueError: the schedule goes by time, or the task's vibration measure is not the displacement.
    """
    if schedule.over != "inserted_length":
        raise ValueError("the map tells of schedules over inserted length: this one goes by time, the simulation tells")
    config = place.config
    tubes = np.array([[getattr(context, name) for name in CONTEXT] for context in place.contexts])
    length = np.arange(FIRST + 0.5, config.scene.tube.helix_length, 1.0)
    lengths, contexts = np.tile(length, len(tubes)), np.repeat(tubes, len(length), axis=0)
    feed, air = config.given(*schedule.at(lengths)).T
    mean, deviation = place.vibration.tells(lengths, feed, air, contexts, config.scene)
    cost = expected_cost(mean, deviation, feed, air, config)
    of_tubes = mean.reshape(len(tubes), -1)
    middle = of_tubes.mean(axis=0)
    spread = EIGHTY * np.sqrt(of_tubes.var(axis=0) + (deviation.reshape(of_tubes.shape) ** 2).mean(axis=0))
    once = slice(0, len(length))
    return Expected(
        length=length,
        low=UNIT * 10.0 ** (middle - spread),
        middle=UNIT * 10.0**middle,
        high=UNIT * 10.0 ** (middle + spread),
        within=float(ndtr((np.log10(config.limit / UNIT) - mean) / deviation).mean()),
        seconds=float((1.0 / feed[once]).sum()),
        air=float((air[once] / feed[once]).sum()),
        reward=float(len(length) * metre_reward(config, cost.mean())),
    )
