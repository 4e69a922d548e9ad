"""Settings of the control task: what is acted and observed, limits, weights and sensors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Final, Literal

import numpy as np
import numpy.typing as npt
from pydantic import BeforeValidator, Field, ValidationInfo, model_validator
from pydantic_core import PydanticCustomError

from probe_env.arrays import FloatArray
from probe_env.envs.task.scales import (
    BOTH_WAYS,
    OBSERVATIONS,
    PRIVILEGED,
    PROBE,
    action_of,
    share_between,
    share_of,
    value_at,
)
from probe_env.inspection.sensor import Sensor
from probe_env.scene import Scene
from probe_env.settings import Model, Range, quantity, range_of, tuples

Inspects = Literal["in", "back", "best"]
"""What a metre counts for in an inspection of both passes."""
Measure = Literal["displacement", "velocity", "acceleration", "snr"]
MEASURES: Final[dict[Measure, tuple[str, float]]] = {
    "displacement": ("radial_rms_m", 1e-4),
    "velocity": ("radial_velocity_rms_m_per_s", 5e-3),
    "acceleration": ("radial_acceleration_rms_m_per_s2", 20.0),
    "snr": ("noise_to_signal", 1.0 / 3.0),
}
"""Statistic of a window and default limit of each vibration measure; of snr the noise over a 20 % groove's signal."""


def scene_of(settings: Any) -> Any:
    """What is simulated: table 2's scene where nothing is given, changed by a mapping, or a whole one.

    A mapping of plain values goes through JSON, and so does an environment's ``spec``.

    Raises:
        ValueError: a field that is not known or not valid.
    """
    return Scene.fitted(settings) if isinstance(settings, Mapping) else settings


class Setup(Model):
    """What is simulated."""

    scene: Annotated[Scene, BeforeValidator(scene_of)] = Scene()
    """Tube, probe and air that an episode changes by its context: what a controller may know of the plant."""
    sensor: Sensor = Sensor()
    """What motion does to the signals, and when a flaw is called."""
    growing: bool = True
    """Whether the probe is fed in; else its length is constant."""


class Timing(Model):
    """Control period and times of an episode."""

    period: Annotated[float, quantity(1e-3, 100.0, "s")] = 1.0
    """Control period."""
    time_limit: Annotated[float, quantity(1e-3, 1e5, "s")] = 900.0
    """Time after which an episode is truncated."""
    settle_time: Annotated[float, quantity(1e-3, 100.0, "s")] = 2.0
    """Time for which the probe settles before an episode."""


class Actuators(Model):
    """Feed device and air supply."""

    # a feed that stands still would never end: what is not inspected costs what the slowest feed takes
    feed_speeds: Annotated[tuple[float, float], Range(1e-6, 2.0, "m/s")] = (0.02, 0.4)
    """Slowest and fastest feed: actions of -1 and 1."""
    air_supply_rates: Annotated[tuple[float, float], Range(0.0, 0.2, "m3/s")] = (30.0 / 3600.0, 130.0 / 3600.0)
    """Least and most air: actions of -1 and 1."""
    feed_speed_step: Annotated[float, quantity(0.0, 1.0, "m/s")] = 0.0
    """The feed is set in whole steps of this, the nearest to what is asked for; 0: any."""
    air_supply_step: Annotated[float, quantity(0.0, 0.1, "m3/s")] = 0.0
    """The air is set in whole steps of this; 0: any."""
    ramp: Annotated[float, quantity(1e-3, 1e3, "m/s2")] = 0.5
    """Acceleration with which the feed follows its target."""
    air_lag: Annotated[float, quantity(0.0, 100.0, "s")] = 1.0
    """Time constant with which the air follows its target."""


class Reward(Model):
    """What vibration is compared with, and weights of the reward, see ``rules.reward_terms``."""

    vibration_measure: Measure = "displacement"
    """What is compared with the limit at the sensor; snr: noise over the signal of a 20 % groove."""
    vibration_limit: Annotated[float, Field(gt=0.0)] | None = None
    """Limit of the vibration measure, SI units; none: its usual one, 0.1 mm, 5 mm/s, 20 m/s2 or 1/3."""
    ratio_cap: Annotated[float, quantity(1.0, 100.0, "")] = 3.0
    """Vibration over its limit counts up to this; its cost grows with the square."""
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
    diverged_weight: Annotated[float, quantity(0.0, 1e4, "")] = 10.0
    """Cost of a simulation that diverges."""


class Limits(Model):
    """Limits of the root tension: when drive is lost, and what the cable should bear."""

    required_tension: Annotated[float, quantity(0.0, 1e3, "N")] = 0.8
    """Mean root tension that drives the probe; with less it is slack."""
    lost_drive_periods: Annotated[int, Field(ge=1, le=1000)] = 3
    """Consecutive slack periods after which the drive is lost and the episode ends."""
    lost_drive_from: Annotated[float, quantity(0.0, 1e3, "m")] = 15.0
    """Inserted length from which tension must drive the probe."""
    tension_limit: Annotated[float, quantity(0.0, 1e5, "N")] = 110.0
    """What the cable should bear: more is a cost. It strains table 2's cable by 0.1 %; the study gives none."""


class RoundTrip(Model):
    """Passes of the inspection."""

    passes: Literal["in", "both"] = "in"
    """Both: the probe is fed in to the helix's end and drawn back to where it began."""
    inspects: Inspects = "best"
    """What a metre counts for with both passes: insertion, withdrawal, or the better of both in each metre."""

    @property
    def returns(self) -> bool:
        """Whether the probe is drawn back as well."""
        return self.passes == "both"


class Disturbances(Model):
    """What differs from an ideal rig: sensor noise, delay and drop-outs, and friction that drifts."""

    rf_noise: Annotated[float, quantity(0.0, 1.0, "")] = 0.05
    """Relative standard deviation of the eddy-current noise."""
    tension_noise: Annotated[float, quantity(0.0, 1.0, "")] = 0.02
    """Relative standard deviation of the root tension."""
    delay_periods: Annotated[int, Field(ge=0, le=100)] = 0
    """Control periods by which an observation is late, and the actions in it."""
    sensor_dropout: Annotated[float, quantity(0.0, 1.0, "")] = 0.0
    """Share of periods in which eddy-current noise and root tension keep their last value."""
    friction_drift: Annotated[float, quantity(-0.9, 0.9, "")] = 0.0
    """Friction is less at the entrance by this share, and linear up to the context's at the helix's end."""


class Observation(Model):
    """What is observed; changes nothing else."""

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
"""Groups of fields, which settings may name as tables: ``{"reward": {"time_weight": 0.2}}``."""
SHOWN: Final = tuple(Observation.model_fields)
"""Fields of the task that say what is observed, and change nothing else."""


def ungrouped(settings: Any) -> Any:
    """Settings of a task by the flat names of its fields, where some are in the tables of ``GROUPS``.

    Raises:
        PydanticCustomError: a group with a field that is not its own or is given twice.
    """
    if not isinstance(settings, Mapping) or not set(settings) & set(GROUPS):
        return settings
    flat = {name: value for name, value in settings.items() if name not in GROUPS}
    for group in set(settings) & set(GROUPS):
        table, accepted = settings[group], ", ".join(GROUPS[group].model_fields)
        if not isinstance(table, Mapping) or not set(table) <= set(GROUPS[group].model_fields):
            text = f"{group} = {table!r}: must be a table of {accepted}"
            raise PydanticCustomError("group", "{text}", {"text": text})
        if twice := set(table) & set(flat):
            text = f"{group}.{min(twice)}: given twice, in the group and by itself"
            raise PydanticCustomError("group", "{text}", {"text": text})
        flat |= table
    return flat


class TaskConfig(Observation, Disturbances, Limits, Reward, Actuators, Timing, RoundTrip, Setup):
    """Settings of the control task, SI units: the fields of all groups.

    Every field is read by its name, ``config.time_weight``. Settings may name it so, or in the table of its group.
    """

    @model_validator(mode="before")
    @classmethod
    def _takes_groups(cls, settings: Any, info: ValidationInfo) -> Any:
        # what a validator returns is taken for Python's, and JSON has no tuples
        return ungrouped(tuples(settings) if info.mode == "json" else settings)

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> TaskConfig:
        """See ``Model.model_copy``; groups are accepted."""
        return super().model_copy(update=ungrouped(update or {}), deep=deep)

    @model_validator(mode="after")
    def _ranges_ascend(self) -> TaskConfig:
        for name in ("feed_speeds", "air_supply_rates"):
            (low, high), known = getattr(self, name), range_of(type(self), name)
            if known and not known.low <= low < high <= known.high:
                raise PydanticCustomError(
                    "range",
                    f"{name} = ({low!r}, {high!r}) must ascend within the accepted range {known.low:g} to"
                    f" {known.high:g} {known.unit}",
                )
        return self

    @model_validator(mode="after")
    def _passes_need_a_length_that_changes(self) -> TaskConfig:
        if self.returns and not self.growing:
            raise PydanticCustomError(
                "passes", 'passes = "both" needs growing = true: the probe is fed in and drawn back'
            )
        return self

    @property
    def limit(self) -> float:
        """Limit of the vibration measure, SI units."""
        return self.vibration_limit or MEASURES[self.vibration_measure][1]

    @property
    def observations(self) -> dict[str, tuple[float, float, str]]:
        """Name -> (low, high, meaning) of this variant's observation."""
        visible = {k: v for k, v in OBSERVATIONS.items() if k != "root_tension" or self.observe_root_tension}
        both = BOTH_WAYS if self.returns else {}
        return visible | both | (PRIVILEGED if self.privileged else {}) | (PROBE if self.observe_probe else {})

    @property
    def full_observation(self) -> TaskConfig:
        """The same task with everything observed: every policy looks at what it is meant to."""
        return self.model_copy(update=dict.fromkeys(SHOWN, True))

    @property
    def standstill(self) -> np.float32:
        """The feed action that stands still: as far below -1 as no feed at all is below the slowest.

        No action space has it, and agents do not choose it: ``Episodes`` takes it from who replays what a rig did.
        """
        return np.float32(action_of(share_between(0.0, self.feed_speeds)))

    def targets(self, actions: npt.ArrayLike, allow_standstill: bool = False) -> FloatArray:
        """(N, 2) target feed speed [m/s] and air supply [m3/s] of actions (N, 2) in [-1, 1].

        ``allow_standstill``: the feed action may also be ``standstill``, and the feed speed is 0 then.

        Raises:
            ValueError: an action of the wrong shape, not finite or out of range.
        """
        values = np.asarray(actions, dtype=float)
        if values.ndim != 2 or values.shape[1] != 2:
            raise ValueError(f"action has shape {values.shape[1:]}; the accepted shape is (2,): feed speed, air supply")
        bad = ~(np.abs(values) <= 1.0 + 1e-6)
        stands = bad[:, 0] & (values[:, 0] == self.standstill) & allow_standstill
        bad[stands, 0] = False
        if bad.any():
            row, column = np.argwhere(bad)[0]
            raise ValueError(f"action[{column}] = {float(values[row, column])!r} is outside the accepted range -1 to 1")
        ranges = (self.feed_speeds, self.air_supply_rates)
        shares = share_of(values)
        requested = self._in_steps(np.column_stack([value_at(shares[:, k], range_) for k, range_ in enumerate(ranges)]))
        requested[stands, 0] = 0.0
        return requested

    def given(self, feed_speed: FloatArray | float, air_supply_rate: FloatArray | float) -> FloatArray:
        """(N, 2) what feed device and air supply give where these are asked for [m/s], [m3/s]: the nearest they can."""
        requested = ((feed_speed, self.feed_speeds), (air_supply_rate, self.air_supply_rates))
        return self._in_steps(np.column_stack([np.clip(value, *range_) for value, range_ in requested]))

    def _in_steps(self, requested: FloatArray) -> FloatArray:
        ranges = (self.feed_speeds, self.air_supply_rates)
        for column, step in enumerate((self.feed_speed_step, self.air_supply_step)):
            if step > 0.0:
                requested[:, column] = np.clip(step * np.round(requested[:, column] / step), *ranges[column])
        return requested

    def actions(self, feed_speed: FloatArray | float, air_supply_rate: FloatArray | float) -> FloatArray:
        """(N, 2) actions that ask for feed speeds [m/s] and air supplies [m3/s], or the nearest in the task's range."""
        requested = ((feed_speed, self.feed_speeds), (air_supply_rate, self.air_supply_rates))
        return np.column_stack(
            [action_of(share_between(np.clip(value, *range_), range_)) for value, range_ in requested]
        )

    def action(self, feed_speed: float, air_supply_rate: float) -> npt.NDArray[np.float32]:
        """(2,) the action that asks for a feed speed [m/s] and an air supply [m3/s].

        Raises:
            ValueError: out of the task's range.
        """
        for name, value, (low, high) in (
            ("feed_speed", feed_speed, self.feed_speeds),
            ("air_supply_rate", air_supply_rate, self.air_supply_rates),
        ):
            if not abs(action_of(share_between(value, (low, high)))) <= 1.0 + 1e-6:
                raise ValueError(f"{name} = {value!r} is outside the task's range {low:g} to {high:g}")
        action: npt.NDArray[np.float32] = self.actions(feed_speed, air_supply_rate)[0].astype(np.float32)
        return action


def describe(config: TaskConfig) -> dict[str, Any]:
    """Layout of the observation and the task's settings, for files that must agree with an environment."""
    return {"observations": list(config.observations), "task": config.model_dump(mode="json")}
