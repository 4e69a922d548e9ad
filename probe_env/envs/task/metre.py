"""What vibration, time and air cost, and a metre with them: the only place where the weights of these are applied."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from probe_env.arrays import FloatArray

if TYPE_CHECKING:
    from probe_env.envs.task.config import TaskConfig


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
    """What vibration costs a metre, for a ratio of vibration to its limit; beyond ``ratio_cap`` no more."""
    return np.asarray(np.minimum(ratio, config.ratio_cap) ** 2)


def metre_cost(
    config: TaskConfig, squares: FloatArray | float, feed: FloatArray | float, air: FloatArray | float
) -> FloatArray:
    """Cost (N,) of a metre (progress left out): its vibration, and what the seconds that it takes cost.

    Args:
        config: weights.
        squares: ``capped_square`` of the vibration, or its mean.
        feed: feed speed [m/s].
        air: air supply [m3/s].
    """
    vibration, *each_second = costs(config, squares, 1.0, air).values()
    return np.asarray(sum((cost / feed for cost in each_second), start=vibration))


def metre_reward(config: TaskConfig, cost: FloatArray) -> FloatArray:
    """Reward of a metre with a ``metre_cost``, or with the mean of many."""
    return np.asarray(config.progress_weight - cost)
