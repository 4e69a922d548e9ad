"""What is unsafe in a control period: costs beside the reward, as safe reinforcement learning has them.

Each of ``COSTS`` is 1 in a period in which it is so and 0 in any other: an episode's cost counts periods. No reward
knows them, and nothing that moves does.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from probe_env.arrays import BoolArray, FloatArray
from probe_env.envs.task.config import TaskConfig

COSTS: Final = {
    "lost_drive": "the mean root tension is below what the drive needs, where that counts",
    "tension": "the root tension was above its limit",
    "buckling": "the mean pressure at the root is more than the cable bears between two floats",
}
"""Named parts of the cost, and when each is 1."""


def cost_terms(
    config: TaskConfig, hanging: BoolArray, tension: FloatArray, greatest: FloatArray, buckling_load: FloatArray
) -> dict[str, FloatArray]:
    """Named parts (N,) of a period's cost, 0 or 1 each; their sum is the cost.

    Friction presses as it pulls, most at the root, so the root tells of the whole probe. A cable bears a pressure that
    is shorter than its own sideways swing (10 ms for table 2's pitch), so the mean counts for buckling; what strains it
    is the peak.

    Args:
        config: the limits.
        hanging: (N,) whether the root tension is too little to drive the probe.
        tension: (N,) mean root tension [N], below 0 where the root is pressed.
        greatest: (N,) greatest root tension [N].
        buckling_load: (N,) of the cable between two floats [N].
    """
    unsafe = hanging, greatest > config.tension_limit, -tension > buckling_load
    return {name: np.asarray(is_so, dtype=float) for name, is_so in zip(COSTS, unsafe, strict=True)}
