"""A shield around any policy: it refuses feed and air with which the probe would soon have too little drive.

What a rig measures says how the root tension will come out: friction is read from the tension (the closed form of
steady sliding), and with it the tension of what the policy wants is foreseen. It goes with the square of the wind
relative to the probe, w = Q / (a - A_c) - u. Over the task's ranges Q changes w by some 70 m/s and u by 0.4 m/s, so
that the nearest feed and air with enough wind are more air: slower feed hardly helps, and is the last resort.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from agents.policies.domain import Domain
from agents.records.code_hash import class_hash
from agents.rollouts.plan import Policy
from probe_env.arrays import BoolArray, FloatArray
from probe_env.envs.task import TaskConfig
from probe_env.envs.task.observations import in_si_units
from probe_env.physics.closed_forms import friction_from_tension, sliding_tension
from probe_env.physics.model.chain import air_speed

PREFIX: Final = "shielded:"
"""Before a policy's name: with the shield."""
FRICTIONS: Final = (0.02, 1.0)
"""What a tension may be read as; too much drag or too little reads as friction as well."""
LAGS_AHEAD: Final = 12.0
"""Lags of the air in which it has come: three of them, under a time-lapse of four."""


@dataclass
class Shielded:
    """A policy whose feed and air keep a margin of drive; within the margin its actions stay bit for bit.

    Attributes:
        config: the task that it acts in.
        policy: made for this task.
        margin: root tension that is kept over the one that the drive needs.
        average: time constant of the friction's average [s].
        prior: friction that an episode begins with.
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

    def predict(
        self,
        observation: npt.NDArray[np.floating],
        state: Any = None,
        episode_start: BoolArray | None = None,
        deterministic: bool = False,
    ) -> tuple[npt.NDArray[np.float32], Any]:
        """Actions for observations (d,) or (N, d), and the state to give back next time."""
        rows = np.atleast_2d(observation)
        inner, friction = (None, np.full(len(rows), self.prior)) if state is None else state
        if episode_start is not None:
            friction = np.where(episode_start, self.prior, friction)
        given, inner = self.policy.predict(rows, inner, episode_start, deterministic)
        actions, seen = np.array(given, dtype=np.float32), in_si_units(self.config, rows)
        gain = -np.expm1(-self.config.period / self.average)
        friction = friction + gain * (np.clip(friction_from_tension(seen, self.config.scene), *FRICTIONS) - friction)
        wanted = self.config.targets(actions, may_stand=True)
        kept = self._kept(wanted, seen, friction)
        changed = kept != wanted
        actions[changed] = self.config.actions(*kept.T).astype(np.float32)[changed]
        return (actions[0] if np.ndim(observation) == 1 else actions), (inner, friction)

    def describe(self) -> dict[str, Any]:
        """What it is, as JSON-ready data, with the policy and a hash of its code; equal for equal policies."""
        own = {"policy": type(self).__name__, "margin": self.margin, "average": self.average, "prior": self.prior}
        return own | {"of": self.policy.describe(), "written": class_hash(type(self.policy), "predict")}

    def _kept(self, wanted: FloatArray, seen: dict[str, FloatArray], friction: FloatArray) -> FloatArray:
        """(N, 2) feed speed [m/s] and air supply [m3/s] nearest to what is wanted that keep the margin."""
        config, air_speed_of_unit = self.config, air_speed(self.config.scene, 1.0)
        still = {"feed_speed": np.zeros(len(wanted)), "air_supply_rate": np.full(len(wanted), 1.0 / air_speed_of_unit)}
        in_unit_wind = sliding_tension(friction, seen | still, config.scene)
        needed = np.sqrt(self.margin * config.required_tension / in_unit_wind)
        feed, air = wanted.T
        # the drive counts from a length on; until then the air must have come
        ahead = config.feed_speeds[1] * (LAGS_AHEAD * config.air_lag + (config.delay_periods + 1) * config.period)
        short = (air * air_speed_of_unit - feed < needed) & (seen["inserted_length"] >= config.lost_drive_from - ahead)
        more = (needed + feed) / air_speed_of_unit
        if config.air_supply_step > 0.0:  # the next whole step, not the nearest
            more = config.air_supply_step * np.ceil(more / config.air_supply_step - 1e-9)
        more = np.clip(more, *config.air_supply_rates)
        slower = np.clip(more * air_speed_of_unit - needed, config.feed_speeds[0], None)
        return np.column_stack([np.where(short, np.minimum(feed, slower), feed), np.where(short, more, air)])


def unshielded(spec: str) -> str:
    """The spec of the policy behind the shield, if there is one."""
    return spec.removeprefix(PREFIX)
