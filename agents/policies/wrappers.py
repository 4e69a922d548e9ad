"""Policies around a policy: a shield that keeps a margin of drive, a schedule for the withdrawal."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from agents.policies.fixed import STUDY_AIR
from agents.policies.policy import Domain, Policy
from probe_env.arrays import BoolArray, FloatArray
from probe_env.envs.task import TaskConfig
from probe_env.envs.task.observations import in_si_units
from probe_env.physics.closed_forms import friction_from_tension, sliding_tension
from probe_env.physics.model.chain import air_speed
from probe_env.schedule import Schedule

PREFIX: Final = "shielded:"
"""Before a policy's name: with the shield."""
FRICTIONS: Final = (0.02, 1.0)
"""Range of the friction that a shield reads from the tension; drag that differs reads as friction as well."""
LAGS_AHEAD: Final = 12.0
"""Lags of the air after which it has come: three of them, under a time-lapse of four."""
SIGNED: Final = ("feed_speed", "air_supply_rate", "root_tension")
"""Observations that change their sign with the direction."""


class _Wrapper(ABC):
    """SB3's ``predict`` by a method for (N, d) observations."""

    def predict(
        self,
        observation: npt.NDArray[np.floating],
        state: Any = None,
        episode_start: BoolArray | None = None,
        deterministic: bool = False,
    ) -> tuple[npt.NDArray[np.float32], Any]:
        """Actions for observations (d,) or (N, d), and the state to give back next time."""
        actions, state = self._act(np.atleast_2d(observation), state, episode_start, deterministic)
        return (actions[0] if np.ndim(observation) == 1 else actions), state

    @abstractmethod
    def _act(
        self, rows: npt.NDArray[np.floating], state: Any, start: BoolArray | None, deterministic: bool
    ) -> tuple[npt.NDArray[np.float32], Any]:
        """Actions (N, 2) for observations (N, d), and the next state."""


@dataclass
class Shielded(_Wrapper):
    """A policy whose feed and air keep a margin of drive; within the margin its actions are unchanged.

    The root tension gives the friction (closed form of steady sliding), and with it the tension that the policy's feed
    and air would give. It goes with the square of the wind relative to the probe, w = Q / (a - A_c) - u. The task's
    range of Q changes w by some 70 m/s, that of u by 0.4 m/s: the nearest feed and air with enough wind are more air,
    and slower feed is the last resort.

    Attributes:
        config: the task that it acts in.
        policy: made for this task.
        margin: root tension to keep, over the one that the drive needs.
        average: time constant of the average of the friction [s].
        prior: friction at the beginning of an episode.
    """

    config: TaskConfig
    policy: Policy
    margin: float = 1.5
    average: float = 3.0
    prior: float = 0.175

    def __post_init__(self) -> None:
        if not 1.0 <= self.margin <= 100.0:
            raise ValueError(f"margin = {self.margin!r} is outside the accepted range 1 to 100")
        if not self.config.observe_root_tension:
            raise ValueError("a shield needs a task that shows the root tension")

    @property
    def domain(self) -> Domain | None:
        """That of the policy."""
        return getattr(self.policy, "domain", None)

    def _act(
        self, rows: npt.NDArray[np.floating], state: Any, start: BoolArray | None, deterministic: bool
    ) -> tuple[npt.NDArray[np.float32], Any]:
        inner, friction = (None, np.full(len(rows), self.prior)) if state is None else state
        if start is not None:
            friction = np.where(start, self.prior, friction)
        requested, inner = self.policy.predict(rows, inner, start, deterministic)
        actions, measured = np.array(requested, dtype=np.float32), in_si_units(self.config, rows)
        gain = -np.expm1(-self.config.period / self.average)
        latest = np.clip(friction_from_tension(measured, self.config.scene), *FRICTIONS)
        friction = friction + gain * (latest - friction)
        targets = self.config.targets(actions, allow_standstill=True)
        safe = self._safe(targets, measured, friction)
        changed = safe != targets
        actions[changed] = self.config.actions(*safe.T).astype(np.float32)[changed]
        return actions, (inner, friction)

    def describe(self) -> dict[str, Any]:
        """JSON-ready description."""
        settings = {"margin": self.margin, "average": self.average, "prior": self.prior}
        return {"policy": type(self).__name__, **settings, "of": self.policy.describe()}

    def _safe(self, targets: FloatArray, measured: dict[str, FloatArray], friction: FloatArray) -> FloatArray:
        """(N, 2) feed speed [m/s] and air supply [m3/s] nearest to the targets (N, 2) that keep the margin."""
        config, air_speed_of_unit = self.config, air_speed(self.config.scene, 1.0)
        unit = {"feed_speed": 0.0 * friction, "air_supply_rate": np.full(len(targets), 1.0 / air_speed_of_unit)}
        in_unit_wind = sliding_tension(friction, measured | unit, config.scene)
        needed = np.sqrt(self.margin * config.required_tension / in_unit_wind)
        feed, air = targets.T
        # the drive counts from a length on; until then the air must have come
        ahead = config.feed_speeds[1] * (LAGS_AHEAD * config.air_lag + (config.delay_periods + 1) * config.period)
        short = (air * air_speed_of_unit - feed < needed) & (
            measured["inserted_length"] >= config.lost_drive_from - ahead
        )
        more = (needed + feed) / air_speed_of_unit
        if config.air_supply_step > 0.0:  # the next whole step, not the nearest
            more = config.air_supply_step * np.ceil(more / config.air_supply_step - 1e-9)
        more = np.clip(more, *config.air_supply_rates)
        slower = np.clip(more * air_speed_of_unit - needed, config.feed_speeds[0], None)
        return np.column_stack([np.where(short, np.minimum(feed, slower), feed), np.where(short, more, air)])


def fastest_back(config: TaskConfig) -> Schedule:
    """The fastest withdrawal of the feed device, with the study's air or the nearest possible."""
    feed, air = config.given(config.feed_speeds[1], STUDY_AIR)[0]
    return Schedule("inserted_length", "linear", (0.0,), (float(feed),), (float(air),))


@dataclass
class BothWays(_Wrapper):
    """A policy for the insertion, and a schedule over inserted length for the withdrawal.

    Attributes:
        config: the task of both passes.
        forth: policy of the insertion, made for ``way_in`` of the task.
        back: schedule of the withdrawal.
    """

    config: TaskConfig
    forth: Policy
    back: Schedule

    def _act(
        self, rows: npt.NDArray[np.floating], state: Any, start: BoolArray | None, deterministic: bool
    ) -> tuple[npt.NDArray[np.float32], Any]:
        """Actions; in the withdrawal the inner policy gets feed, air and tension without signs, and is not heeded."""
        names, measured = list(self.config.observations), in_si_units(self.config, rows)
        back, visible = measured["way"] < 0.0, rows.copy()
        for column in (k for k, name in enumerate(names) if name in SIGNED):
            visible[back, column] = np.abs(visible[back, column])
        visible = np.delete(visible, names.index("way"), axis=1)
        actions, state = self.forth.predict(visible, state, start, deterministic)
        withdrawal = self.config.actions(*self.back.at(measured["inserted_length"])).astype(np.float32)
        return np.where(back[:, None], withdrawal, np.atleast_2d(actions)), state

    def describe(self) -> dict[str, Any]:
        """JSON-ready description."""
        way_back = {name: getattr(self.back, name) for name in ("position", "feed_speed", "air_supply_rate")}
        return {"policy": type(self).__name__, "forth": self.forth.describe(), "back": way_back}


def way_in(config: TaskConfig) -> TaskConfig:
    """The task of the insertion alone."""
    return config.model_copy(update={"passes": "in"})
