"""The control task: what is acted, observed, rewarded, and when it ends. Knows no simulator and no environment.

Everything is for N probes at once, one row or entry a probe.
"""

from __future__ import annotations

from typing import Annotated, Any, Final, Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from probe_env.arrays import BoolArray, FloatArray
from probe_env.design import RANGES
from probe_env.settings import Model, quantity

Measure = Literal["displacement", "velocity", "acceleration"]
MEASURES: Final[dict[Measure, tuple[str, float]]] = {
    "displacement": ("radial_rms_m", 1e-4),
    "velocity": ("radial_velocity_rms_m_per_s", 5e-3),
    "acceleration": ("radial_acceleration_rms_m_per_s2", 20.0),
}
"""Statistic of a window and default limit of each vibration measure."""
TERMS: Final = ("progress", "vibration", "time", "air", "jerk", "uninspected", "diverged")
ACCELEROMETER_FLOOR: Final = 1e-2  # [m/s2] rms, its own noise
RF_FLOOR: Final = 1e-6  # [m] of radial rms: noise of the eddy-current signal at rest
LOAD_CELL: Final = 1e4  # [N], the range that it is built for: overloaded it shows its end
SHOWN: Final = ("observe_root_tension", "privileged", "observe_probe")
"""Fields of the task that say what is observed, and change nothing else."""

OBSERVATIONS: Final[dict[str, tuple[float, float, str]]] = {
    "inserted_length": (0.0, 20.0, "cable in the helix / 60 m"),
    "remaining_length": (-1.0, 20.0, "length still to feed / 60 m"),
    "feed_speed": (0.0, 6.0, "applied feed speed / (0.4 m/s)"),
    "air_supply_rate": (0.0, 6.0, "applied air supply / (130 m3/h)"),
    "radial_acceleration": (-3.0, 8.0, "log10 of the radial accelerometer's rms / (1 m/s2)"),
    "axial_acceleration": (-3.0, 8.0, "log10 of the axial accelerometer's rms / (1 m/s2)"),
    "rf_noise": (-4.0, 5.0, "log10 of the eddy-current noise, as radial rms / 0.1 mm; 5 % sensor noise"),
    "root_tension": (-500.0, 500.0, "mean root tension / 20 N; 2 % sensor noise; the load cell ends at 10 kN"),
    "previous_feed_action": (-1.5, 1.5, "action before, feed speed"),
    "previous_air_action": (-1.5, 1.5, "action before, air supply"),
    "helix_diameter": (0.0, 4000.0, "helix diameter / 2.5 m"),
}
"""Name -> (low, high, meaning) of what a rig can measure; no valid run reaches a bound but that of the load cell.

Inserted length, feed, air and helix end at what scenes and tasks accept; radial signals at a displacement of 1 m,
where a probe counts as diverged. Ten times table 2's drag pulls with 2.4 kN in a straight tube."""
PRIVILEGED: Final[dict[str, tuple[float, float, str]]] = {
    "friction": (0.0, 4.0, "friction coefficient / 0.25"),
    "contact_stiffness": (0.0, 1000.0, "contact stiffness / (1e5 N/m)"),
    "drag_factor": (0.0, 10.0, "drag over that of table 2"),
}
PROBE: Final[dict[str, tuple[float, float, str]]] = {
    name: (-2000.0, 2000.0, f"{name.replace('_', ' ')}: 0 to 1 in the design space, {low:g} to {high:g} {unit}")
    for name, (low, high, unit) in RANGES.items()
}
"""The probe that was built, for controllers of many probes."""
UNITS: Final = {
    "inserted_length": 60.0, "remaining_length": 60.0, "feed_speed": 0.4, "air_supply_rate": 130.0 / 3600.0,
    "rf_noise": 1e-4, "radial_acceleration": 1.0, "axial_acceleration": 1.0, "root_tension": 20.0,
    "helix_diameter": 2.5, "friction": 0.25, "contact_stiffness": 1e5, "drag_factor": 1.0,
}  # fmt: skip
"""What an observation is a multiple, or the logarithm of a multiple, of [SI unit]."""
LOGARITHMIC: Final = ("rf_noise", "radial_acceleration", "axial_acceleration")


class TaskConfig(Model):
    """Control period, limits and weights of the task, SI units.

    Weights: reward per metre inspected, per metre at the vibration limit (grows with the square, up to
    ``ratio_cap`` squared), per second, per m3 of air, and per squared change of the action.
    """

    growing: bool = True
    period: Annotated[float, quantity(1e-3, 100.0, "s")] = 1.0
    time_limit: Annotated[float, quantity(1e-3, 1e5, "s")] = 900.0
    settle_time: Annotated[float, quantity(1e-3, 100.0, "s")] = 2.0
    feed_speeds: tuple[float, float] = (0.02, 0.4)
    air_supply_rates: tuple[float, float] = (30.0 / 3600.0, 130.0 / 3600.0)
    ramp: Annotated[float, quantity(1e-3, 1e3, "m/s2")] = 0.5
    air_lag: Annotated[float, quantity(0.0, 100.0, "s")] = 1.0
    vibration_measure: Measure = "displacement"
    vibration_limit: Annotated[float, Field(gt=0.0)] | None = None
    ratio_cap: Annotated[float, quantity(1.0, 100.0, "")] = 3.0
    progress_weight: Annotated[float, quantity(0.0, 1e3, "1/m")] = 1.0
    vibration_weight: Annotated[float, quantity(0.0, 1e3, "1/m")] = 1.0
    time_weight: Annotated[float, quantity(0.0, 1e3, "1/s")] = 0.1
    air_weight: Annotated[float, quantity(0.0, 1e3, "1/m3")] = 0.2
    jerk_weight: Annotated[float, quantity(0.0, 1e3, "")] = 0.005
    diverged_weight: Annotated[float, quantity(0.0, 1e4, "")] = 10.0
    required_tension: Annotated[float, quantity(0.0, 1e3, "N")] = 0.8
    lost_drive_periods: Annotated[int, Field(ge=1, le=1000)] = 3
    lost_drive_from: Annotated[float, quantity(0.0, 1e3, "m")] = 15.0
    observe_root_tension: bool = True
    privileged: bool = False
    observe_probe: bool = False

    @model_validator(mode="after")
    def _ranges_ascend(self) -> TaskConfig:
        for name, most in (("feed_speeds", 2.0), ("air_supply_rates", 0.2)):
            low, high = getattr(self, name)
            if not 0.0 <= low < high <= most:
                raise PydanticCustomError(
                    "range", f"{name} = ({low!r}, {high!r}) must ascend within the accepted range 0 to {most}"
                )
        return self

    @property
    def limit(self) -> float:
        """Limit of the vibration measure, SI units."""
        return self.vibration_limit or MEASURES[self.vibration_measure][1]

    @property
    def uninspected_weight(self) -> float:
        """Cost of a metre that was not inspected: the greatest that inspecting one can cost.

        So neither ending early nor crawling to the time limit pays.
        """
        seconds = 1.0 / self.feed_speeds[0]
        jerk = self.jerk_weight * 8.0 * seconds / self.period
        air = self.air_weight * self.air_supply_rates[1] * seconds
        vibration = self.vibration_weight * self.ratio_cap**2
        return self.progress_weight + vibration + self.time_weight * seconds + air + jerk

    @property
    def observations(self) -> dict[str, tuple[float, float, str]]:
        """Name -> (low, high, meaning) of this variant's observation."""
        shown = {k: v for k, v in OBSERVATIONS.items() if k != "root_tension" or self.observe_root_tension}
        return shown | (PRIVILEGED if self.privileged else {}) | (PROBE if self.observe_probe else {})

    @property
    def all_shown(self) -> TaskConfig:
        """The same task with everything observed: every policy looks at what it is meant to."""
        return self.model_copy(update=dict.fromkeys(SHOWN, True))

    def targets(self, actions: npt.ArrayLike) -> FloatArray:
        """(N, 2) target feed speed [m/s] and air supply [m3/s] of actions (N, 2) in [-1, 1].

        Raises:
            ValueError: an action of the wrong shape, not finite or out of range.
        """
        values = np.asarray(actions, dtype=float)
        if values.ndim != 2 or values.shape[1] != 2:
            raise ValueError(f"action has shape {values.shape[1:]}; the accepted shape is (2,): feed speed, air supply")
        bad = ~(np.abs(values) <= 1.0 + 1e-6)
        if bad.any():
            row, column = np.argwhere(bad)[0]
            raise ValueError(f"action[{column}] = {values[row, column]!r} is outside the accepted range -1 to 1")
        low, high = np.array([self.feed_speeds, self.air_supply_rates]).T
        return np.asarray(low + 0.5 * (np.clip(values, -1.0, 1.0) + 1.0) * (high - low))

    def action(self, feed_speed: float, air_supply_rate: float) -> npt.NDArray[np.float32]:
        """(2,) the action that asks for a feed speed [m/s] and an air supply [m3/s].

        Raises:
            ValueError: out of the task's range.
        """
        parts = []
        for name, value, (low, high) in (
            ("feed_speed", feed_speed, self.feed_speeds),
            ("air_supply_rate", air_supply_rate, self.air_supply_rates),
        ):
            part = 2.0 * (value - low) / (high - low) - 1.0
            if not abs(part) <= 1.0 + 1e-6:
                raise ValueError(f"{name} = {value!r} is outside the task's range {low:g} to {high:g}")
            parts.append(min(max(part, -1.0), 1.0))
        return np.array(parts, dtype=np.float32)


def observe(config: TaskConfig, measured: dict[str, FloatArray], noise: FloatArray) -> npt.NDArray[np.float32]:
    """(N, d) observation of what was measured, with standard normal ``noise`` (N, 2) for RF noise and tension."""
    felt: dict[str, FloatArray] = measured | {
        "radial_acceleration": np.hypot(measured["radial_acceleration_rms_m_per_s2"], ACCELEROMETER_FLOOR),
        "axial_acceleration": np.hypot(measured["axial_acceleration_rms_m_per_s2"], ACCELEROMETER_FLOOR),
        "rf_noise": np.hypot(measured["radial_rms_m"], RF_FLOOR) * np.exp(0.05 * noise[:, 0]),
        "root_tension": np.clip(measured["tension_mean_n"] * (1.0 + 0.02 * noise[:, 1]), -LOAD_CELL, LOAD_CELL),
        "previous_feed_action": measured["feed_action"],
        "previous_air_action": measured["air_action"],
    }

    def column(name: str) -> FloatArray:
        if name in RANGES:
            low, high, _ = RANGES[name]
            return (felt[name] - low) / (high - low)
        value = felt[name] / UNITS.get(name, 1.0)
        return np.asarray(np.log10(value) if name in LOGARITHMIC else value)

    return np.column_stack([column(name) for name in config.observations]).astype(np.float32)


def in_si_units(config: TaskConfig, observation: npt.NDArray[np.floating[Any]]) -> dict[str, FloatArray]:
    """What observations (N, d) say, by name and in SI units (N,): the inverse of ``observe``.

    ``rf_noise`` is the radial rms [m] that would make it, accelerations are rms [m/s2], actions stay as they are.

    Raises:
        ValueError: the observations are not this task's.
    """
    if observation.ndim != 2 or observation.shape[1] != len(config.observations):
        raise ValueError(
            f"observation of shape {observation.shape} is not (N, {len(config.observations)}), as this task's are"
        )

    def value(name: str, column: FloatArray) -> FloatArray:
        if name in RANGES:
            low, high, _ = RANGES[name]
            return low + column * (high - low)
        return UNITS.get(name, 1.0) * (10.0**column if name in LOGARITHMIC else column)

    columns = zip(config.observations, observation.astype(float).T, strict=True)
    return {name: value(name, column) for name, column in columns}


def reward_terms(
    config: TaskConfig,
    travel: FloatArray,
    ratio: FloatArray,
    air: FloatArray,
    action_change: FloatArray,
    uninspected: FloatArray,
    diverged: BoolArray,
) -> dict[str, FloatArray]:
    """Named terms (N,) of one period's reward; their sum is the reward.

    Args:
        config: weights.
        travel: of the sensor in the period [m].
        ratio: vibration over its limit.
        air: used in the period [m3].
        action_change: (N, 2) action minus the one before.
        uninspected: length left [m] where the episode ends, else 0.
        diverged: whether the simulation diverged in this period.
    """
    return {
        "progress": config.progress_weight * travel,
        "vibration": -config.vibration_weight * travel * np.minimum(ratio, config.ratio_cap) ** 2,
        "time": np.full_like(travel, -config.time_weight * config.period),
        "air": -config.air_weight * air,
        "jerk": -config.jerk_weight * (action_change**2).sum(axis=1),
        "uninspected": -config.uninspected_weight * uninspected,
        "diverged": -config.diverged_weight * diverged,
    }


def describe(config: TaskConfig) -> dict[str, Any]:
    """Layout of the observation and the task's settings, for files that must agree with an environment."""
    return {"observations": list(config.observations), "task": config.model_dump(mode="json")}
