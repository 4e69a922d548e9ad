"""What the rest of an insertion is worth by the vibration map: the terminal value of a planner."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from agents.policies.maps.lookup import expected_costs, knots
from probe_env import Context
from probe_env.arrays import FloatArray
from probe_env.envs.task import TaskConfig, metre_reward
from probe_env.envs.vibration_map import CONTEXT, VibrationMap


def worth_of_rest(tube: Context, inserted: FloatArray, config: TaskConfig, vibration: VibrationMap) -> FloatArray:
    """Expected reward of the best schedule from inserted lengths [m] (any shape) to the helix's end."""
    places, worth = _worth(tube, config, vibration)
    return np.interp(inserted, places, worth)


@lru_cache(maxsize=1024)
def _worth(tube: Context, config: TaskConfig, vibration: VibrationMap) -> tuple[FloatArray, FloatArray]:
    """Lengths (k,) [m] and what is to come from each."""
    end = config.scene.tube.helix_length
    places = np.minimum(knots(config), end)
    values = np.array([[getattr(tube, name) for name in CONTEXT]])
    rate = metre_reward(config, expected_costs(values, config, 0.0, vibration)[0].min(axis=1))
    if places[-1] < end:  # as the last knot is
        places, rate = np.append(places, end), np.append(rate, rate[-1])
    steps = 0.5 * (rate[1:] + rate[:-1]) * np.diff(places)
    return places, np.append(np.cumsum(steps[::-1])[::-1], 0.0)
