"""Features and actions of a trained agent: equal in training, evaluation and pictures."""

from typing import Annotated, Any, Self

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from pydantic import BeforeValidator, Field, model_validator

from probe_env.envs.task.config import TaskConfig
from probe_env.envs.task.observations import in_si_units
from probe_env.envs.task.scales import (
    OBSERVATIONS,
    action_of,
    fraction_between,
    fraction_of,
    geometric_at,
    geometric_fraction,
    value_at,
    with_present_names,
)
from probe_env.physics.closed_forms import MEASURED, SHAPE, friction_from_tension
from probe_env.settings import Model, quantity

Rows = npt.NDArray[np.floating[Any]]
TimeConstant = Annotated[float, quantity(0.1, 1e4, "s")]
CREDIBLE, MIDDLE, HALF_RANGE = (0.05, 0.35), 0.175, 0.075


class View(Model):
    """Some of the task's observations with running averages, and a logarithmic feed action.

    ``friction_estimate`` adds the friction estimated from the root tension. Equal steps of the feed action are equal
    ratios of speed; without ``logarithmic_feed`` it is the task's action. The air action spans the task's range above
    ``least_air_supply_rate`` [m3/s]: less air loses the drive, which is too rare in training to be learnt.
    """

    observations: Annotated[
        tuple[str, ...], Field(min_length=1, max_length=64), BeforeValidator(with_present_names)
    ] = tuple(OBSERVATIONS)
    averages: Annotated[tuple[TimeConstant, ...], Field(max_length=16)] = (5.0, 20.0)
    friction_estimate: bool = False
    least_air_supply_rate: Annotated[float, quantity(0.0, 0.2, "m3/s")] = 0.0
    logarithmic_feed: bool = True

    @model_validator(mode="after")
    def _estimable(self) -> Self:
        missing = [name for name in MEASURED if name not in self.observations]
        if self.friction_estimate and missing:
            raise ValueError(f"friction_estimate needs the observations {', '.join(missing)}")
        return self

    @property
    def size(self) -> int:
        """Number of features."""
        return (len(self.observations) + self.friction_estimate) * (1 + len(self.averages))

    @property
    def spaces(self) -> tuple[gym.spaces.Box, gym.spaces.Box]:
        """Spaces of features and actions."""
        features = gym.spaces.Box(-np.inf, np.inf, (self.size,), dtype=np.float32)
        return features, gym.spaces.Box(-1.0, 1.0, (2,), dtype=np.float32)

    def columns(self, config: TaskConfig) -> list[int]:
        """Indices of its observations among the task's."""
        names = list(config.observations)
        missing = [name for name in self.observations if name not in names]
        if missing:
            raise ValueError(
                f"observations = {', '.join(missing)} are not observed in this task: {', '.join(names)}"
                + ('; "direction" needs passes = "both"' if "direction" in missing else "")
            )
        if self.least_air_supply_rate >= config.air_supply_rates[1]:
            raise ValueError(
                f"least_air_supply_rate = {self.least_air_supply_rate!r} m3/s must be below the task's "
                f"air_supply_rates[1] = {config.air_supply_rates[1]!r} m3/s"
            )
        return [names.index(name) for name in self.observations]

    def features(
        self, config: TaskConfig, rows: Rows, memory: Rows | None, new: npt.NDArray[np.bool_]
    ) -> tuple[npt.NDArray[np.float32], Rows]:
        """Features (N, size) of observations (N, d), and the memory (N, m) for the next call.

        Args:
            config: task of the observations.
            rows: observations (N, d).
            memory: averages of the last call; None: all episodes are new.
            new: (N,) whether an episode begins.
        """
        visible = np.asarray(rows, dtype=np.float32)[:, self.columns(config)]
        if self.friction_estimate:
            names = [*MEASURED, *(name for name in SHAPE if name in self.observations)]
            physical = in_si_units(config, np.asarray(rows))
            friction = friction_from_tension({name: physical[name] for name in names}, config.scene)
            scaled = (np.clip(friction, *CREDIBLE) - MIDDLE) / HALF_RANGE
            visible = np.column_stack([visible, scaled]).astype(np.float32)
        repeated = np.tile(visible, len(self.averages))
        before = repeated if memory is None else memory
        fractions = -np.expm1(-config.decision_period / np.array(self.averages))
        gains = np.repeat(fractions, visible.shape[1]).astype(np.float32)
        averages = np.where(new[:, None], repeated, before + gains * (repeated - before)).astype(np.float32)
        return np.concatenate([visible, averages], axis=1), averages

    def env_actions(self, config: TaskConfig, actions: Rows) -> npt.NDArray[np.float32]:
        """(N, 2) actions of the environment for the agent's actions."""
        feed, air = fraction_of(np.asarray(actions, dtype=np.float64)).T
        if self.logarithmic_feed:
            feed = fraction_between(geometric_at(feed, config.feed_speeds), config.feed_speeds)
        floor = self._air_floor(config)
        return np.clip(action_of(np.column_stack([feed, floor + (1.0 - floor) * air])), -1.0, 1.0).astype(np.float32)

    def agent_actions(self, config: TaskConfig, actions: Rows) -> npt.NDArray[np.float32]:
        """(N, 2) inverse of ``env_actions``; feed and air below the least are clipped."""
        feed, air = fraction_of(np.asarray(actions, dtype=np.float64)).T
        if self.logarithmic_feed:
            feed = geometric_fraction(value_at(feed, config.feed_speeds), config.feed_speeds)
        floor = self._air_floor(config)
        return np.clip(action_of(np.column_stack([feed, (air - floor) / (1.0 - floor)])), -1.0, 1.0).astype(np.float32)

    def _air_floor(self, config: TaskConfig) -> float:
        range_ = config.air_supply_rates
        return float(fraction_between(max(self.least_air_supply_rate, range_[0]), range_))
