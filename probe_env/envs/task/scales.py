"""Scales of observations and actions: bounds and units of each observation, and values in a range as [-1, 1]."""

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from probe_env.arrays import FloatArray
from probe_env.design import RANGES

ACCELEROMETER_FLOOR: Final = 1e-2  # [m/s2] rms, noise floor
RF_FLOOR: Final = 1e-6  # [m] radial rms equivalent to the eddy-current noise at rest
LOAD_CELL: Final = 1e4  # [N], range; it saturates under overload
OBSERVATIONS: Final[dict[str, tuple[float, float, str]]] = {
    "inserted_length": (0.0, 20.0, "inserted length / 60 m"),
    "remaining_length": (-1.0, 20.0, "remaining length / 60 m"),
    "feed_speed": (0.0, 6.0, "applied feed speed / (0.4 m/s)"),
    "air_supply_rate": (0.0, 6.0, "applied air supply / (130 m3/h)"),
    "radial_acceleration": (-3.0, 8.0, "log10 of the radial accelerometer's rms / (1 m/s2)"),
    "axial_acceleration": (-3.0, 8.0, "log10 of the axial accelerometer's rms / (1 m/s2)"),
    "rf_noise": (-4.0, 5.0, "log10 of the eddy-current noise, as radial rms / 0.1 mm; with sensor noise"),
    "root_tension": (-500.0, 500.0, "mean root tension / 20 N; with sensor noise; the load cell ends at 10 kN"),
    "previous_feed_action": (-1.5, 1.5, "previous feed action"),
    "previous_air_action": (-1.5, 1.5, "previous air action"),
    "helix_diameter": (0.0, 4000.0, "helix diameter / 2.5 m"),
}
"""Name -> (low, high, meaning) of measurable observations; only the load cell reaches its bound in a valid run.

Inserted length, feed, air and helix end at what scenes and tasks accept; radial signals at a displacement of 1 m,
where a probe counts as diverged. Ten times table 2's drag pulls with 2.4 kN in a straight tube."""
OLD_NAMES: Final = {"way": "direction"}
"""Observations under the names that stored files may have."""
ROUND_TRIP: Final[dict[str, tuple[float, float, str]]] = {
    "feed_speed": (-6.0, 6.0, "applied feed speed, below 0 on withdrawal / (0.4 m/s)"),
    "air_supply_rate": (-6.0, 6.0, "applied air supply, below 0 towards the feed device / (130 m3/h)"),
    "direction": (-1.0, 1.0, "1 on insertion, -1 on withdrawal"),
}
"""Observations of a round trip that replace or extend ``OBSERVATIONS``."""
PRIVILEGED: Final[dict[str, tuple[float, float, str]]] = {
    "friction": (0.0, 4.0, "friction coefficient / 0.25"),
    "contact_stiffness": (0.0, 1000.0, "contact stiffness / (1e5 N/m)"),
    "drag_factor": (0.0, 10.0, "drag relative to table 2"),
}
PROBE: Final[dict[str, tuple[float, float, str]]] = {
    name: (-2000.0, 2000.0, f"{name.replace('_', ' ')}: 0 to 1 in the design space, {low:g} to {high:g} {unit}")
    for name, (low, high, unit) in RANGES.items()
}
"""Properties of the probe, for controllers of many probes."""
UNITS: Final = {
    "inserted_length": 60.0, "remaining_length": 60.0, "feed_speed": 0.4, "air_supply_rate": 130.0 / 3600.0,
    "rf_noise": 1e-4, "radial_acceleration": 1.0, "axial_acceleration": 1.0, "root_tension": 20.0,
    "helix_diameter": 2.5, "friction": 0.25, "contact_stiffness": 1e5, "drag_factor": 1.0,
}  # fmt: skip
"""Scale of an observation, or of the argument of its logarithm [SI unit]."""
LOGARITHMIC: Final = ("rf_noise", "radial_acceleration", "axial_acceleration")


def with_present_names(observations: Any) -> Any:
    """A tuple of names of observations with the present ones; other values unchanged, for their validation."""
    is_sequence = isinstance(observations, tuple | list)  # JSON has no tuples
    return tuple(OLD_NAMES.get(n, n) for n in observations) if is_sequence else observations


def as_actions(actions: npt.ArrayLike, shape: tuple[int, ...]) -> npt.NDArray[Any]:
    """Actions as an array of a shape."""
    values: npt.NDArray[Any]
    try:
        values = np.asarray(actions)
    except ValueError:  # rows of different lengths
        values = np.asarray(None)
    if values.dtype.kind not in "biuf":
        shown = " ".join(repr(actions).split())[:100]
        raise ValueError(f"action = {shown} is not an array of numbers of the accepted shape {shape}")
    if values.shape != shape:
        raise ValueError(f"action has shape {values.shape}; the accepted shape is {shape}")
    return values


def fraction_of(action: FloatArray) -> FloatArray:
    """Position in a range, 0 to 1, of an action clipped to [-1, 1]."""
    return np.asarray(_fraction(np.clip(action, -1.0, 1.0)))


def action_of(fraction: FloatArray) -> FloatArray:
    """The inverse of ``fraction_of``."""
    return 2.0 * fraction - 1.0


def value_at(fraction: FloatArray, range_: tuple[float, float]) -> FloatArray:
    """The inverse of ``fraction_between``."""
    low, high = range_
    return low + fraction * (high - low)


def action_in(action: FloatArray, range_: tuple[float, float], other: tuple[float, float]) -> FloatArray:
    """Convert an action from one range to an ``other`` range; the result may be outside [-1, 1]."""
    return action_of(fraction_between(value_at(_fraction(action), range_), other))


def fraction_between(value: FloatArray | float, range_: tuple[float, float]) -> FloatArray:
    """Position of a value in a range: 0 at its low end, 1 at its high end."""
    low, high = range_
    return np.asarray((np.asarray(value, dtype=float) - low) / (high - low))


def geometric_at(fraction: FloatArray | float, range_: tuple[float, float]) -> FloatArray:
    """Value at a position in a range: equal steps of the position are equal ratios of the value."""
    low, high = range_
    return np.asarray(low * (high / low) ** fraction)


def geometric_fraction(value: FloatArray | float, range_: tuple[float, float]) -> FloatArray:
    """The inverse of ``geometric_at``."""
    low, high = range_
    return np.asarray(np.log(value / low) / np.log(high / low))


def _fraction(action: FloatArray) -> FloatArray:
    return 0.5 * (action + 1.0)
