"""What a policy earns where the vibration is what the map says of the moment: no dynamics, a thousand times cheaper."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from agents.policies.fixed import FixedPolicy
from probe_env import Context
from probe_env.arrays import FloatArray
from probe_env.envs.task import metre_reward
from probe_env.envs.task.observations import RF_FLOOR
from probe_env.envs.vibration_map import CONTEXT, VibrationMap, expected_cost
from probe_env.physics.closed_forms import sliding_tension

START = 5.0
"""[m] inserted at the beginning."""


def quasi_steady_rewards(policy: FixedPolicy, tubes: Sequence[Context], vibration: VibrationMap) -> FloatArray:
    """Expected reward (n,) of insertions, jerk left out, in which tension, noise and cost are those of steady states.

    Args:
        policy: that looks at length, feed, air, tension, noise and helix diameter; its draws are its own.
        tubes: (n,).
        vibration: the map.
    """
    config = policy.config
    values = np.array([[getattr(tube, name) for name in CONTEXT] for tube in tubes])
    column = {name: values[:, k] for k, name in enumerate(CONTEXT)}
    count, end, dt = len(tubes), config.scene.tube.helix_length, config.period
    length, reward, noise = np.full(count, START), np.zeros(count), np.full(count, RF_FLOOR)
    feed = np.full(count, config.feed_speeds[1])
    air = np.full(count, config.air_supply_rates[0])
    memory = np.zeros((count, policy.memory))
    policy.start(memory)
    for step in range(round(config.time_limit / dt)):
        seen = {
            "inserted_length": length, "feed_speed": feed, "air_supply_rate": air, "rf_noise": noise,
            "helix_diameter": column["helix_diameter"], "time": np.full(count, step * dt),
        }  # fmt: skip
        pulled = sliding_tension(column["friction"], seen, config.scene) * column["drag_factor"]
        feed, air = policy.targets(seen | {"root_tension": pulled}, memory)
        left = np.maximum(end - length, 0.0)
        travel = np.minimum(feed * dt, left)
        mean, deviation = vibration.tells(length + 0.5 * travel, feed, air, values, config.scene)
        noise = np.hypot(10.0**mean * 1e-4, RF_FLOOR)
        reward += travel * metre_reward(config, expected_cost(mean, deviation, feed, air, config))
        length = length + travel
        if (left <= 0.0).all():
            break
    return reward - config.uninspected_weight * np.maximum(end - length, 0.0)
