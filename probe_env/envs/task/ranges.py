"""Where a value lies in a range, and the action that stands for it."""

from __future__ import annotations

import numpy as np

from probe_env.arrays import FloatArray


def share_of(action: FloatArray) -> FloatArray:
    """The share of a range, 0 to 1, that an action in [-1, 1] stands for; beyond it the end."""
    return np.asarray(_share(np.clip(action, -1.0, 1.0)))


def action_of(share: FloatArray) -> FloatArray:
    """The inverse of ``share_of``."""
    return 2.0 * share - 1.0


def value_at(share: FloatArray, range_: tuple[float, float]) -> FloatArray:
    """The inverse of ``share_between``."""
    low, high = range_
    return low + share * (high - low)


def action_in(action: FloatArray, range_: tuple[float, float], other: tuple[float, float]) -> FloatArray:
    """The action that asks in an ``other`` range for what an action asks for in a range, within it or not."""
    return action_of(share_between(value_at(_share(action), range_), other))


def share_between(value: FloatArray | float, range_: tuple[float, float]) -> FloatArray:
    """Where in a range a value is: 0 at its low end, 1 at its high one."""
    low, high = range_
    return np.asarray((np.asarray(value, dtype=float) - low) / (high - low))


def _share(action: FloatArray) -> FloatArray:
    return 0.5 * (action + 1.0)
