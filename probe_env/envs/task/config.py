"""Settings of the control task: actions, observations, limits, weights and sensors."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cached_property
from typing import Annotated, Any, Final, Literal

import numpy as np
import numpy.typing as npt
from pydantic import BeforeValidator, Field, ValidationInfo, model_validator

from probe_env.arrays import FloatArray
from probe_env.envs.task.scales import (
    OBSERVATIONS,
    PRIVILEGED,
    PROBE,
    ROUND_TRIP,
    action_of,
    as_actions,
    fraction_between,
)
from probe_env.inspection.instrument import Instrument
from probe_env.inspection.sensor import Sensor
from probe_env.scene import Scene
from probe_env.settings import Model, Range, quantity, range_of, tuples

OLD_NAMES: Final = {"inspects": "scored_pass"}
"""Fields under the names that stored files may have."""
OLD_PASSES: Final = {"in": "insertion", "back": "withdrawal"}
ScoredPass = Literal["insertion", "withdrawal", "best"]
"""Scored pass of a round trip: insertion, withdrawal, or the better of both."""
Measure = Literal["displacement", "velocity", "acceleration", "snr"]
MEASURES: Final[dict[Measure, tuple[str, float]]] = {
    "displacement": ("radial_rms_m", 1e-4),
    "velocity": ("radial_velocity_rms_m_per_s", 5e-3),
    "acceleration": ("radial_acceleration_rms_m_per_s2", 20.0),
    "snr": ("noise_to_signal", 1.0 / 3.0),
}
"""Statistic of a window and default limit of each vibration measure; of snr the noise over a 20 % groove's signal."""


def scene_of(settings: Any) -> Any:
    """A scene from a ``Scene``, from all its fields as files store them, or from changed fields of the default scene.

    The default is table 2 with all that the study leaves out, ``Scene().whole()``.
    """
    if not isinstance(settings, Mapping):
        return settings
    scene = Scene.fitted(settings)
    stored = settings.keys() >= Scene.model_fields.keys() - {"terms"}  # old files lack it
    return scene if stored else scene.whole().model_copy(update=settings)


class Setup(Model):
    """Scene, sensor and inserted length."""

    scene: Annotated[Scene, BeforeValidator(scene_of)] = Scene().whole()
    """Base scene: tube, probe and air, before the context of an episode is applied."""
    sensor: Sensor = Sensor()
    """Sensor: noise by motion, and threshold of a flaw call."""
    instrument: Instrument | None = None
    """Instrument and procedure, which limit the feed of policies in evaluations; None: not known."""
    growing: bool = True
    """Whether the probe is fed in; else its length is constant."""


class Timing(Model):
    """Control period and times of an episode."""

    period: Annotated[float, quantity(1e-3, 100.0, "s")] = 1.0
    """Control period."""
    periods_per_action: Annotated[int, Field(ge=1, le=1000)] = 1
    """Control periods for which the environment applies an action."""
    time_limit: Annotated[float, quantity(1e-3, 1e5, "s")] = 900.0
    """Time after which an episode is truncated."""
    settle_time: Annotated[float, quantity(1e-3, 100.0, "s")] = 2.0
    """Time for which the probe settles before an episode."""


class Actuators(Model):
    """Feed device and air supply."""

    # 0 is excluded: the cost of an uninspected metre is that of the slowest feed
    feed_speeds: Annotated[tuple[float, float], Range(1e-6, 2.0, "m/s")] = (0.02, 0.4)
    """Slowest and fastest feed: actions of -1 and 1."""
    air_supply_rates: Annotated[tuple[float, float], Range(0.0, 0.2, "m3/s")] = (30.0 / 3600.0, 130.0 / 3600.0)
    """Least and most air: actions of -1 and 1."""
    change_per_action: Annotated[float, quantity(0.0, 1.0, "")] = 0.0
    """Change of the targets by an action of 1, as a fraction of their ranges; 0: the action is the target itself."""
    feed_decrease_per_action: Annotated[float, quantity(0.0, 1.0, "")] = 0.0
    """The same for a decrease of the feed; 0: ``change_per_action``."""
    logarithmic_change: bool = False
    """Whether it is the logarithm of the feed that changes: equal actions change the feed by equal ratios."""
    feed_speed_step: Annotated[float, quantity(0.0, 1.0, "m/s")] = 0.0
    """Resolution of the feed speed: targets are rounded to multiples of it; 0: continuous."""
    air_supply_step: Annotated[float, quantity(0.0, 0.1, "m3/s")] = 0.0
    """Resolution of the air supply: targets are rounded to multiples of it; 0: continuous."""
    ramp: Annotated[float, quantity(1e-3, 1e3, "m/s2")] = 0.5
    """Acceleration with which the feed follows its target."""
    air_lag: Annotated[float, quantity(0.0, 100.0, "s")] = 1.0
    """Time constant with which the air follows its target."""
    air_ramp: Annotated[float, quantity(1e-6, 1.0, "m3/s2")] | None = None
    """Largest change of the air supply per second: its target follows an action at this rate; None: at once."""


class Reward(Model):
    """Vibration limit and weights of the reward, see ``rules.reward_terms``."""

    vibration_measure: Measure = "displacement"
    """Measure of vibration at the sensor; snr: noise over the signal of a 20 % groove."""
    vibration_limit: Annotated[float, Field(gt=0.0)] | None = None
    """Limit of the vibration measure, SI units; default by measure: 0.1 mm, 5 mm/s, 20 m/s2 or 1/3."""
    ratio_cap: Annotated[float, quantity(1.0, 100.0, "")] = 3.0
    """Cap of the ratio of vibration to its limit; the cost grows with the square of the ratio."""
    progress_weight: Annotated[float, quantity(0.0, 1e3, "1/m")] = 1.0
    """Reward per metre inspected."""
    vibration_weight: Annotated[float, quantity(0.0, 1e3, "1/m")] = 1.0
    """Cost per metre at the vibration limit."""
    time_weight: Annotated[float, quantity(0.0, 1e3, "1/s")] = 0.1
    """Cost per second."""
    air_weight: Annotated[float, quantity(0.0, 1e3, "1/m3")] = 0.2
    """Cost per cubic metre of air."""
    jerk_weight: Annotated[float, quantity(0.0, 1e3, "")] = 0.005
    """Cost of the squared change of the action."""
    shaping_weight: Annotated[float, quantity(0.0, 1e3, "1/m")] = 0.0
    """Reward per metre inserted, and for every remaining metre at the end: the same sum for every episode of a tube.

    The environment adds it as the term "shaping"; KPIs leave it out."""
    diverged_weight: Annotated[float, quantity(0.0, 1e4, "")] = 10.0
    """Cost of a simulation that diverges."""


class Limits(Model):
    """Limits of the root tension: lost drive, and strength of the cable."""

    required_tension: Annotated[float, quantity(0.0, 1e3, "N")] = 0.8
    """Mean root tension needed to drive the probe; below it the probe is slack."""
    lost_drive_periods: Annotated[int, Field(ge=1, le=1000)] = 3
    """Consecutive slack periods after which the drive is lost and the episode ends."""
    lost_drive_from: Annotated[float, quantity(0.0, 1e3, "m")] = 15.0
    """Inserted length from which tension must drive the probe."""
    tension_limit: Annotated[float, quantity(0.0, 1e5, "N")] = 110.0
    """Root tension above which a cost is counted. It strains table 2's cable by 0.1 %, an assumption."""


class RoundTrip(Model):
    """Passes of the inspection."""

    passes: Literal["in", "both"] = "in"
    """in: insertion only. both: insertion to the end of the helix and withdrawal to the initial length."""
    scored_pass: Annotated[ScoredPass, BeforeValidator(lambda name: OLD_PASSES.get(name, name))] = "best"
    """Scored pass with both passes: insertion, withdrawal, or the better of both in each metre."""

    @property
    def returns(self) -> bool:
        """Whether the episode includes withdrawal."""
        return self.passes == "both"


class Disturbances(Model):
    """Sensor noise, delay and drop-outs, and friction that drifts along the tube."""

    rf_noise: Annotated[float, quantity(0.0, 1.0, "")] = 0.05
    """Relative standard deviation of the eddy-current noise."""
    tension_noise: Annotated[float, quantity(0.0, 1.0, "")] = 0.02
    """Relative standard deviation of the root tension."""
    delay_periods: Annotated[int, Field(ge=0, le=100)] = 0
    """Delay of the observation, including the previous actions in it, in control periods."""
    sensor_dropout: Annotated[float, quantity(0.0, 1.0, "")] = 0.0
    """Probability per period that eddy-current noise and root tension keep their last value."""
    friction_drift: Annotated[float, quantity(-0.9, 0.9, "")] = 0.0
    """Relative reduction of friction at the entrance; friction is linear up to the context's value at the end."""


class Observation(Model):
    """Optional observations; they do not change the simulation."""

    observe_root_tension: bool = True
    """Whether the root tension is observed."""
    privileged: bool = False
    """Whether friction, contact stiffness and drag are observed, which no rig can measure."""
    observe_probe: bool = False
    """Whether the design of the probe is observed."""


GROUPS: Final[dict[str, type[Model]]] = {
    "timing": Timing, "actuators": Actuators, "reward": Reward, "limits": Limits, "round_trip": RoundTrip,
    "disturbances": Disturbances, "observation": Observation,
}  # fmt: skip
"""Groups of fields, accepted as tables: ``{"reward": {"time_weight": 0.2}}``."""
VISIBLE_FIELDS: Final = tuple(Observation.model_fields)
"""Fields of the task that select observations and change nothing else."""


def renamed(table: Any) -> Any:
    """A table with the present names of fields."""
    if not isinstance(table, Mapping):
        return table
    return {new if (new := OLD_NAMES.get(name, name)) not in table else name: value for name, value in table.items()}


def ungrouped(settings: Any) -> Any:
    """Settings of a task with flat field names, from settings that may use the tables of ``GROUPS``."""
    if not isinstance(settings, Mapping):
        return settings
    settings = renamed(settings)
    flat = {name: value for name, value in settings.items() if name not in GROUPS}
    for group in set(settings) & set(GROUPS):
        table, accepted = renamed(settings[group]), ", ".join(GROUPS[group].model_fields)
        if not isinstance(table, Mapping) or not set(table) <= set(GROUPS[group].model_fields):
            text = f"{group} = {table!r}: must be a table of {accepted}"
            raise ValueError(text)
        if duplicates := set(table) & set(flat):
            text = f"{group}.{min(duplicates)}: given twice, in the group and by itself"
            raise ValueError(text)
        flat |= table
    return flat


class TaskConfig(Observation, Disturbances, Limits, Reward, Actuators, Timing, RoundTrip, Setup):
    """Settings of the control task, SI units: the fields of all groups.

    Every field is an attribute, ``config.time_weight``. Settings may be flat or in the table of their group.
    """

    @model_validator(mode="before")
    @classmethod
    def _takes_groups(cls, settings: Any, info: ValidationInfo) -> Any:
        # JSON has no tuples, and the result is validated as Python input
        return ungrouped(tuples(settings) if info.mode == "json" else settings)

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> TaskConfig:
        """See ``Model.model_copy``; groups are accepted."""
        return super().model_copy(update=ungrouped(update or {}), deep=deep)

    @model_validator(mode="after")
    def _ranges_ascend(self) -> TaskConfig:
        for name in ("feed_speeds", "air_supply_rates"):
            (low, high), accepted = getattr(self, name), range_of(type(self), name)
            if accepted and not accepted.low <= low < high <= accepted.high:
                raise ValueError(
                    f"{name} = ({low!r}, {high!r}) must ascend within the accepted range {accepted.low:g} to"
                    f" {accepted.high:g} {accepted.unit}",
                )
        return self

    @model_validator(mode="after")
    def _instrument_permits_a_feed(self) -> TaskConfig:
        if self.permitted_feed < self.feed_speeds[0]:
            speed, requirement = self.permitted_speed
            in_steps = f" in steps of {self.feed_speed_step:g} m/s" if self.feed_speed_step > 0.0 else ""
            raise ValueError(
                f"instrument.{requirement} permits at most {speed:.4g} m/s, and feed_speeds begin at"
                f" {self.feed_speeds[0]:g} m/s{in_steps}",
            )
        return self

    @model_validator(mode="after")
    def _passes_need_a_length_that_changes(self) -> TaskConfig:
        if self.returns and not self.growing:
            raise ValueError('passes = "both" needs growing = true: the length must change')
        if self.shaping_weight > 0.0 and (self.returns or not self.growing):
            raise ValueError("shaping_weight > 0 needs growing = true and passes = 'in'")
        return self

    @property
    def permitted_speed(self) -> tuple[float, str]:
        """Highest speed that the instrument permits [m/s] and its requirement, see ``Instrument.permitted``."""
        return self.instrument.permitted(self.sensor.flaw_width) if self.instrument else (math.inf, "")

    @property
    def permitted_feed(self) -> float:
        """Fastest feed of the device that the instrument permits [m/s], a whole step of the device.

        The axial vibration of the sensor is not subtracted.
        """
        (speed, _), fastest, step = self.permitted_speed, self.feed_speeds[1], self.feed_speed_step
        if speed >= fastest:
            return fastest
        return step * math.floor(speed / step * (1.0 + 1e-9)) if step > 0.0 else speed

    @property
    def custom_actions(self) -> bool:
        """Whether an action of the environment is not a target for one control period."""
        return self.periods_per_action > 1 or self.change_per_action > 0.0

    @property
    def decision_period(self) -> float:
        """Time between two actions of the environment [s]."""
        return self.period * self.periods_per_action

    @property
    def limit(self) -> float:
        """Limit of the vibration measure, SI units."""
        return self.vibration_limit or MEASURES[self.vibration_measure][1]

    @property
    def max_periods(self) -> int:
        """Number of control periods after which an episode is truncated."""
        return math.ceil((self.time_limit - 1e-9) / self.period)  # 2.1 / 0.7 is more than 3

    @property
    def max_actions(self) -> int:
        """Number of actions of the environment after which an episode is truncated."""
        return math.ceil(self.max_periods / self.periods_per_action)

    @cached_property
    def observations(self) -> dict[str, tuple[float, float, str]]:
        """Name -> (low, high, meaning) of this variant's observation."""
        visible = {k: v for k, v in OBSERVATIONS.items() if k != "root_tension" or self.observe_root_tension}
        both = ROUND_TRIP if self.returns else {}
        return visible | both | (PRIVILEGED if self.privileged else {}) | (PROBE if self.observe_probe else {})

    @property
    def full_observation(self) -> TaskConfig:
        """The same task with all observations, from which every policy selects its own."""
        return self.model_copy(update=dict.fromkeys(VISIBLE_FIELDS, True))

    @property
    def standstill(self) -> np.float32:
        """The feed action of zero feed speed, below -1 on the linear scale.

        It is outside the action space; ``Episodes`` accepts it for replays of logs.
        """
        return np.float32(action_of(fraction_between(0.0, self.feed_speeds)))

    def check_actions(self, actions: npt.NDArray[np.floating], allow_standstill: bool = False) -> None:
        """Raise ValueError unless actions (N, 2) are in [-1, 1], or a feed is ``standstill`` if that is allowed."""
        bad = ~(np.abs(actions.astype(float)) <= 1.0 + 1e-6)
        if allow_standstill:
            bad[:, 0] &= actions[:, 0] != self.standstill
        if bad.any():
            k, column = np.argwhere(bad)[0]
            value = float(actions[k, column])
            raise ValueError(f"action[{column}] = {value!r} is outside the accepted range -1 to 1")

    def targets(self, actions: npt.ArrayLike, allow_standstill: bool = False) -> FloatArray:
        """(N, 2) target feed speed [m/s] and air supply [m3/s] of actions (N, 2); raises as ``check_actions``."""
        given = as_actions(actions, (len(np.atleast_1d(np.asarray(actions))), 2))
        self.check_actions(given, allow_standstill)
        values = given.astype(float)
        low, high = np.array([self.feed_speeds, self.air_supply_rates]).T
        targets: FloatArray = low + 0.5 * (np.minimum(np.maximum(values, -1.0), 1.0) + 1.0) * (high - low)
        for column, step in enumerate((self.feed_speed_step, self.air_supply_step)):
            if step > 0.0:
                targets[:, column] = np.clip(step * np.round(targets[:, column] / step), low[column], high[column])
        below = values[:, 0] < -1.0 - 1e-6
        if below.any():
            targets[below & (values[:, 0] == self.standstill), 0] = 0.0
        return targets

    def feasible(self, feed_speed: FloatArray | float, air_supply_rate: FloatArray | float) -> FloatArray:
        """(N, 2) feasible feed speed [m/s] and air supply [m3/s] nearest to the arguments: clipped and rounded."""
        columns = []
        for value, range_, step in (
            (feed_speed, self.feed_speeds, self.feed_speed_step),
            (air_supply_rate, self.air_supply_rates, self.air_supply_step),
        ):
            nearest = np.clip(value, *range_)
            columns.append(np.clip(step * np.round(nearest / step), *range_) if step > 0.0 else nearest)
        return np.column_stack(columns)

    def actions(self, feed_speed: FloatArray | float, air_supply_rate: FloatArray | float) -> FloatArray:
        """(N, 2) actions of feed speeds [m/s] and air supplies [m3/s], clipped to the task's range."""
        requested = ((feed_speed, self.feed_speeds), (air_supply_rate, self.air_supply_rates))
        return np.column_stack(
            [action_of(fraction_between(np.clip(value, *range_), range_)) for value, range_ in requested]
        )

    def action(self, feed_speed: float, air_supply_rate: float) -> npt.NDArray[np.float32]:
        """(2,) action of a feed speed [m/s] and an air supply [m3/s]."""
        for name, value, (low, high) in (
            ("feed_speed", feed_speed, self.feed_speeds),
            ("air_supply_rate", air_supply_rate, self.air_supply_rates),
        ):
            if not abs(action_of(fraction_between(value, (low, high)))) <= 1.0 + 1e-6:
                raise ValueError(f"{name} = {value!r} is outside the task's range {low:g} to {high:g}")
        action: npt.NDArray[np.float32] = self.actions(feed_speed, air_supply_rate)[0].astype(np.float32)
        return action


def describe(config: TaskConfig) -> dict[str, Any]:
    """Observation layout and settings of the task, stored in files that must match an environment."""
    return {"observations": list(config.observations), "task": config.model_dump(mode="json")}
