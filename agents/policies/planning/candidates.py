"""What a planner tries: the plan that it has, the map's best, and draws around them, wide and near."""

from __future__ import annotations

from typing import Final

import numpy as np

from probe_env.arrays import FloatArray
from probe_env.envs.task import TaskConfig

WIDE: Final = (0.5, 0.25)
"""Standard deviations of a wide draw: of the feed's logarithm, and of the air as a share of its range."""
NEAR: Final = (0.12, 0.06)
"""Of a near one."""


def drawn(kept: FloatArray, mapped: FloatArray, count: int, config: TaskConfig, entropy: list[int]) -> FloatArray:
    """(n, count, 2) feed speeds [m/s] and air supplies [m3/s] to try, as the plant's devices give them.

    The same draws serve all episodes of a time, so that an episode does not depend on what runs beside it.

    Args:
        kept: (n, 2) what is fed and blown now: the first candidate.
        mapped: (n, 2) what the map thinks best: the second, where there are two.
        count: of each, 1 and more.
        config: the task.
        entropy: of the generator.
    """
    rng = np.random.default_rng(entropy)
    tried = np.repeat(kept[:, None], count, axis=1)
    tried[:, 1:2] = mapped[:, None]
    rest = np.arange(2, count)
    normal = np.clip(rng.normal(size=(len(rest), 2)), -3.0, 3.0)
    low, high = config.air_supply_rates
    for row, k in enumerate(rest.tolist()):
        spread = WIDE if row % 2 else NEAR
        centre = mapped if row % 4 == 1 else kept
        tried[:, k, 0] = centre[:, 0] * np.exp(spread[0] * normal[row, 0])
        tried[:, k, 1] = centre[:, 1] + spread[1] * (high - low) * normal[row, 1]
    # as an action says it: a chaotic probe would make something else of the digits that float32 has not
    actions = config.actions(tried[..., 0].ravel(), tried[..., 1].ravel()).astype(np.float32)
    return np.asarray(config.targets(actions)).reshape(tried.shape)
