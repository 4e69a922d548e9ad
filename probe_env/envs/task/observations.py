"""Scales: measured values as an observation, an observation in SI units, and values in a range as actions in [-1, 1].

Everything is for N probes at once, one row or entry a probe.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from probe_env.arrays import FloatArray
from probe_env.design import RANGES

if TYPE_CHECKING:
    from probe_env.envs.task.config import TaskConfig

ACCELEROMETER_FLOOR: Final = 1e-2  # [m/s2] rms, its own noise
RF_FLOOR: Final = 1e-6  # [m] of radial rms: noise of the eddy-current signal at rest
LOAD_CELL: Final = 1e4  # [N], the range that it is built for: overloaded it shows its end
OBSERVATIONS: Final[dict[str, tuple[float, float, str]]] = {
    "inserted_length": (0.0, 20.0, "cable in the helix / 60 m"),
    "remaining_length": (-1.0, 20.0, "length still to feed / 60 m"),
    "feed_speed": (0.0, 6.0, "applied feed speed / (0.4 m/s)"),
    "air_supply_rate": (0.0, 6.0, "applied air supply / (130 m3/h)"),
    "radial_acceleration": (-3.0, 8.0, "log10 of the radial accelerometer's rms / (1 m/s2)"),
    "axial_acceleration": (-3.0, 8.0, "log10 of the axial accelerometer's rms / (1 m/s2)"),
    "rf_noise": (-4.0, 5.0, "log10 of the eddy-current noise, as radial rms / 0.1 mm; with sensor noise"),
    "root_tension": (-500.0, 500.0, "mean root tension / 20 N; with sensor noise; the load cell ends at 10 kN"),
    "previous_feed_action": (-1.5, 1.5, "action before, feed speed"),
    "previous_air_action": (-1.5, 1.5, "action before, air supply"),
    "helix_diameter": (0.0, 4000.0, "helix diameter / 2.5 m"),
}
"""Name -> (low, high, meaning) of what a rig can measure; no valid run reaches a bound but that of the load cell.

Inserted length, feed, air and helix end at what scenes and tasks accept; radial signals at a displacement of 1 m,
where a probe counts as diverged. Ten times table 2's drag pulls with 2.4 kN in a straight tube."""
BOTH_WAYS: Final[dict[str, tuple[float, float, str]]] = {
    "feed_speed": (-6.0, 6.0, "applied feed speed, below 0 on the way back / (0.4 m/s)"),
    "air_supply_rate": (-6.0, 6.0, "applied air supply, below 0 towards the feed device / (130 m3/h)"),
    "way": (-1.0, 1.0, "1 on the way in, -1 on the way back"),
}
"""What is observed otherwise, or as well, where the probe is drawn back too."""
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


def share_of(action: FloatArray) -> FloatArray:
    """The share of a range, 0 to 1, that an action in [-1, 1] stands for; beyond it the end."""
    return np.asarray(_share(np.clip(action, -1.0, 1.0)))


def action_of(share: FloatArray) -> FloatArray:
    """The inverse of ``share_of``."""
    return 2.0 * share - 1.0


def value_at(share: FloatArray, range_: tuple[float, float]) -> FloatArray:
    """The inverse of ``share_between``."""
    low, high = range_
    return low + share * (high - low)


def action_in(action: FloatArray, range_: tuple[float, float], other: tuple[float, float]) -> FloatArray:
    """The action that asks in an ``other`` range for what an action asks for in a range, within it or not."""
    return action_of(share_between(value_at(_share(action), range_), other))


def share_between(value: FloatArray | float, range_: tuple[float, float]) -> FloatArray:
    """Where in a range a value is: 0 at its low end, 1 at its high one."""
    low, high = range_
    return np.asarray((np.asarray(value, dtype=float) - low) / (high - low))


def _share(action: FloatArray) -> FloatArray:
    return 0.5 * (action + 1.0)


def observe(config: TaskConfig, measured: dict[str, FloatArray], noise: FloatArray) -> npt.NDArray[np.float32]:
    """(N, d) observation of what was measured, with standard normal ``noise`` (N, 2) for RF noise and tension."""
    tension = measured["tension_mean_n"] * (1.0 + config.tension_noise * noise[:, 1])
    felt: dict[str, FloatArray] = measured | {
        "radial_acceleration": np.hypot(measured["radial_acceleration_rms_m_per_s2"], ACCELEROMETER_FLOOR),
        "axial_acceleration": np.hypot(measured["axial_acceleration_rms_m_per_s2"], ACCELEROMETER_FLOOR),
        "rf_noise": np.hypot(measured["radial_rms_m"], RF_FLOOR) * np.exp(config.rf_noise * noise[:, 0]),
        "root_tension": np.clip(tension, -LOAD_CELL, LOAD_CELL),
        "previous_feed_action": measured["feed_action"],
        "previous_air_action": measured["air_action"],
    }

    def column(name: str) -> FloatArray:
        if name in RANGES:
            return share_between(felt[name], RANGES[name][:2])
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
            return value_at(column, RANGES[name][:2])
        return UNITS.get(name, 1.0) * (10.0**column if name in LOGARITHMIC else column)

    columns = zip(config.observations, observation.astype(float).T, strict=True)
    return {name: value(name, column) for name, column in columns}
