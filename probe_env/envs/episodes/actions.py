"""Actions of the environments: targets or changes of them, applied for one or more control periods."""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from probe_env.arrays import BoolArray
from probe_env.envs.episodes.episodes import Episodes, Step
from probe_env.envs.task import rules
from probe_env.envs.task.config import TaskConfig
from probe_env.envs.task.scales import (
    action_of,
    as_actions,
    fraction_between,
    fraction_of,
    geometric_at,
    geometric_fraction,
    value_at,
)

AVERAGED: Final = ("radial_acceleration", "axial_acceleration", "rf_noise", "root_tension")
"""Observations that are averaged over the control periods of an action."""
SUMMED: Final = ("reward_terms", "cost", "cost_terms")
"""Entries of the info that are summed over the control periods of an action."""


def averaged_columns(config: TaskConfig) -> list[int]:
    """Indices of ``AVERAGED`` among the observations of a task."""
    return [k for k, name in enumerate(config.observations) if name in AVERAGED]


def changed_targets(
    config: TaskConfig, targets: npt.NDArray[np.floating], actions: npt.NDArray[np.floating]
) -> npt.NDArray[np.float32]:
    """(N, 2) targets in [-1, 1] after actions (N, 2) that start from targets (N, 2); raises as ``check_actions``."""
    if config.change_per_action == 0.0:
        return np.asarray(actions, dtype=np.float32)
    config.check_actions(actions)
    max_changes = np.full(actions.shape, config.change_per_action)
    max_changes[actions[:, 0] < 0.0, 0] = config.feed_decrease_per_action or config.change_per_action
    positions, feeds = fraction_of(targets.astype(float)), config.feed_speeds
    if config.logarithmic_change:
        positions[:, 0] = geometric_fraction(value_at(positions[:, 0], feeds), feeds)
    positions = np.clip(positions + max_changes * actions, 0.0, 1.0)
    if config.logarithmic_change:
        positions[:, 0] = fraction_between(geometric_at(positions[:, 0], feeds), feeds)
    return action_of(positions).astype(np.float32)


def step_action(
    episodes: Episodes, actions: npt.ArrayLike, shape: tuple[int, ...], active: BoolArray | None = None
) -> Step:
    """Apply actions of the environment, of a shape (N, 2) or (2,), for ``periods_per_action`` control periods.

    Probes that are not active (N,) keep their state; default: all are active.

    Rewards and costs are summed and ``AVERAGED`` observations averaged over the periods; an episode that ends takes no
    further periods.

    Raises:
        ValueError: an action is not valid; nothing has been advanced.
        RuntimeError: an active episode has ended and was not reset.
    """
    config, count = episodes.config, len(episodes)
    given = as_actions(actions, shape).reshape(count, 2).astype(np.float32)
    if not config.custom_actions and config.shaping_weight == 0.0:
        return episodes.step(given, active)
    active = running = np.ones(count, dtype=bool) if active is None else np.array(active, dtype=bool)
    targets = changed_targets(config, episodes.actions, np.where(active[:, None], given, np.float32(0.0)))
    total, before = None, episodes.inserted_length
    columns = averaged_columns(config)
    sums, periods = np.zeros((count, len(columns))), np.zeros((count, 1))
    for _ in range(config.periods_per_action):
        step = episodes.step(targets, running)
        sums += np.where(running[:, None], step.observation[:, columns], 0.0)
        periods += running[:, None]
        total = step if total is None else _merged(total, step)
        running = running & ~(step.terminated | step.truncated)
        if not running.any():
            break
    assert total is not None
    if config.shaping_weight > 0.0:
        ended = total.terminated | total.truncated
        metres = np.where(ended, episodes.helix_length, episodes.inserted_length) - before
        shaping = np.where(active, rules.reward_terms(config, shaped=metres)["shaping"], 0.0)
        for info, value in zip(total.infos, shaping.tolist(), strict=True):
            if info:
                info["reward_terms"]["shaping"] = value
        total = total._replace(reward=total.reward + shaping)
    means = sums / np.maximum(periods, 1.0)
    total.observation[:, columns] = np.where(periods > 0.0, means, total.observation[:, columns])
    return total


def _merged(total: Step, step: Step) -> Step:
    """Sum of the steps so far and a further one."""
    infos = [_sum(old, new) if new else old for old, new in zip(total.infos, step.infos, strict=True)]
    return Step(
        step.observation,
        total.reward + step.reward,
        total.terminated | step.terminated,
        total.truncated | step.truncated,
        infos,
    )


def _sum(old: Mapping[str, Any], new: Mapping[str, Any]) -> dict[str, Any]:
    """The info of a further period with the sums of both."""
    sums: dict[str, Any] = {}
    for name in SUMMED:
        a, b = old[name], new[name]
        sums[name] = {key: a[key] + b[key] for key in b} if isinstance(b, dict) else a + b
    return {**new, **sums}
