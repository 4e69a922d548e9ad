"""Policies around a policy: a shield that maintains a margin of drive, a speed limit, a schedule for the withdrawal."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from probe_agents.policies.fixed import STUDY_AIR
from probe_agents.policies.policy import Domain, ObservationPolicy, Policy
from probe_env.arrays import BoolArray, FloatArray
from probe_env.envs.task.config import TaskConfig
from probe_env.envs.task.observations import in_si_units
from probe_env.physics.closed_forms import entrance_tension, friction_from_tension, rising_root, sliding_tension
from probe_env.physics.model.chain import air_speed
from probe_env.schedule import Schedule

PREFIX: Final = "shielded:"
"""Prefix of a policy's name that adds the shield."""
FRICTIONS: Final = (0.02, 1.0)
"""Range of the friction estimate of a shield; an error of the drag appears as friction as well."""
LAGS_AHEAD: Final = 12.0
"""Response time of the air in units of its lag: three lags, at a time-lapse of four."""
SIGNED: Final = ("feed_speed", "air_supply_rate", "root_tension")
"""Observations whose sign depends on the direction."""


@dataclass
class Shielded(ObservationPolicy):
    """A policy whose feed and air maintain a margin of drive; within the margin its actions are unchanged.

    The friction estimated from the root tension gives the tension at the requested feed and air, which increases with
    the wind w = Q / (a - A_c) - u. The range of Q changes w by about 70 m/s, that of u by 0.4 m/s, so the shield
    increases the air and reduces the feed only if that is not enough.

    Attributes:
        config: task that it acts in.
        policy: policy for this task.
        margin: ratio of root tension to required tension.
        average: time constant of the average of the friction [s].
        prior: friction at the start of an episode.
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
            raise ValueError("the shield needs the root tension (observe_root_tension = true)")

    @property
    def domain(self) -> Domain | None:
        """Domain of the policy."""
        return getattr(self.policy, "domain", None)

    def _act(
        self, rows: npt.NDArray[np.floating], state: Any, start: BoolArray, deterministic: bool
    ) -> tuple[npt.NDArray[np.float32], Any]:
        inner, friction = (None, self.prior) if state is None else state
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
        """(N, 2) feed speed [m/s] and air supply [m3/s] nearest to the targets (N, 2) that satisfy the margin."""
        config, air_speed_of_unit = self.config, air_speed(self.config.scene, 1.0)
        none = np.zeros(len(targets))
        required = self.margin * config.required_tension + entrance_tension(config.scene, measured["helix_diameter"])

        def excess(square: FloatArray) -> FloatArray:
            drive = {"feed_speed": none, "air_supply_rate": np.sqrt(square) / air_speed_of_unit}
            return sliding_tension(friction, measured | drive, config.scene) - required

        needed = np.sqrt(rising_root(excess, none, none + (config.air_supply_rates[1] * air_speed_of_unit) ** 2))
        feed, air = targets.T
        # lost drive is scored beyond a length; the air must have reached its target by then
        ramp = np.ptp(config.air_supply_rates) / (config.air_ramp or np.inf)  # [s], from least to most
        ahead = config.feed_speeds[1] * (
            LAGS_AHEAD * config.air_lag + ramp + (config.delay_periods + 1) * config.period
        )
        short = (air * air_speed_of_unit - feed < needed) & (
            measured["inserted_length"] >= config.lost_drive_from - ahead
        )
        more = (needed + feed) / air_speed_of_unit
        if config.air_supply_step > 0.0:  # the next larger step, not the nearest
            more = config.air_supply_step * np.ceil(more / config.air_supply_step - 1e-9)
        more = np.clip(more, *config.air_supply_rates)
        slower = np.clip(more * air_speed_of_unit - needed, config.feed_speeds[0], None)
        return np.column_stack([np.where(short, np.minimum(feed, slower), feed), np.where(short, more, air)])


@dataclass
class SpeedLimited(ObservationPolicy):
    """A policy whose feed stays at most at ``permitted_feed`` of the task, in every pass that is scored.

    Attributes:
        config: task that it acts in.
        policy: policy for this task.
    """

    config: TaskConfig
    policy: Policy

    def _act(
        self, rows: npt.NDArray[np.floating], state: Any, start: BoolArray, deterministic: bool
    ) -> tuple[npt.NDArray[np.float32], Any]:
        requested, state = self.policy.predict(rows, state, start, deterministic)
        actions, config = np.array(requested, dtype=np.float32), self.config
        feed, air = config.targets(actions, allow_standstill=True).T
        too_fast = feed > config.permitted_feed
        if config.returns and config.scored_pass != "best":
            inserting = in_si_units(config, rows)["direction"] > 0.0
            too_fast &= inserting == (config.scored_pass == "insertion")
        slower = config.actions(np.full_like(feed, config.permitted_feed), air)
        actions[too_fast] = slower.astype(np.float32)[too_fast]
        return actions, state

    def describe(self) -> dict[str, Any]:
        """JSON-ready description."""
        return {
            "policy": type(self).__name__, "permitted_feed": self.config.permitted_feed, "of": self.policy.describe()
        }  # fmt: skip


def fastest_withdrawal(config: TaskConfig) -> Schedule:
    """The fastest withdrawal, with the air of the study or the nearest possible; as permitted if it is scored."""
    fastest = config.feed_speeds[1] if config.scored_pass == "insertion" else config.permitted_feed
    feed, air = config.feasible(fastest, STUDY_AIR)[0]
    return Schedule("inserted_length", "linear", (0.0,), (float(feed),), (float(air),))


@dataclass
class RoundTripPolicy(ObservationPolicy):
    """A policy for the insertion, and a schedule over inserted length for the withdrawal.

    Attributes:
        config: the task of both passes.
        insertion: policy of the insertion, made for ``insertion_task`` of the task.
        withdrawal: schedule of the withdrawal.
    """

    config: TaskConfig
    insertion: Policy
    withdrawal: Schedule

    def _act(
        self, rows: npt.NDArray[np.floating], state: Any, start: BoolArray, deterministic: bool
    ) -> tuple[npt.NDArray[np.float32], Any]:
        """Actions; in the withdrawal they are the schedule's, and the inner policy gets observations without signs."""
        names, measured = list(self.config.observations), in_si_units(self.config, rows)
        withdrawn, visible = measured["direction"] < 0.0, rows.copy()
        for column in (k for k, name in enumerate(names) if name in SIGNED):
            visible[withdrawn, column] = np.abs(visible[withdrawn, column])
        visible = np.delete(visible, names.index("direction"), axis=1)
        actions, state = self.insertion.predict(visible, state, start, deterministic)
        withdrawal = self.config.actions(*self.withdrawal.at(measured["inserted_length"])).astype(np.float32)
        return np.where(withdrawn[:, None], withdrawal, np.atleast_2d(actions)), state

    def describe(self) -> dict[str, Any]:
        """JSON-ready description."""
        schedule = {name: getattr(self.withdrawal, name) for name in ("position", "feed_speed", "air_supply_rate")}
        return {"policy": type(self).__name__, "forth": self.insertion.describe(), "back": schedule}


def insertion_task(config: TaskConfig) -> TaskConfig:
    """The task of the insertion alone."""
    return config.model_copy(update={"passes": "in"})
