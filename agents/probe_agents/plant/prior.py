"""Unknown parameters of a plant and their prior distribution."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Final, NamedTuple

import numpy as np
from scipy.special import ndtr

from probe_env import Plant
from probe_env.arrays import FloatArray
from probe_env.envs.plants import Between, Figure, Normal, quantiles
from probe_env.files import FileError

FRICTION: Final = (0.05, 0.35)
STIFFNESS: Final = (5e4, 1.9e5)  # [N/m]
DAMPING: Final = (3e-5, 1.2e-4)
"""[s]; that of the response's training."""
DRAG: Final = (0.85, 1.15)
"""Range of the drag coefficient, relative to the value of the plant or of table 2, if no range is given."""


class Unknown(NamedTuple):
    """An unknown parameter: its field in the plant's file, the range of the response's training, its name in tables."""

    table: str
    field: str
    unit: str
    low: float
    high: float
    text: str


UNKNOWNS: Final = {
    "friction": Unknown("contact", "friction", "", *FRICTION, "friction"),
    "contact_stiffness": Unknown("contact", "stiffness", "N/m", *STIFFNESS, "contact stiffness"),
    "drag_coefficient": Unknown("air", "drag_coefficient", "", 0.1, 2.0, "drag coefficient"),
    "damping_time": Unknown("probe", "damping_time", "s", *DAMPING, "damping time"),
}
"""In the order of the columns of arrays."""


@dataclass(frozen=True, eq=False)
class Prior:
    """Prior distribution of the unknowns: fixed values, quantile functions and ranges of the others, by name."""

    fixed: dict[str, float]
    quantile: dict[str, Callable[[FloatArray], FloatArray]]
    ranges: dict[str, tuple[float, float]]
    assumed: list[str]  # ranges that are not in the file, as texts

    @property
    def shared(self) -> tuple[str, ...]:
        """Unknowns shared by all tubes: all except the friction."""
        return tuple(name for name in self.quantile if name != "friction")

    def values(self, normal: FloatArray, tubes: int) -> FloatArray:
        """(tubes, n, 4) values in the order of ``UNKNOWNS`` at standard normal coordinates (n, tubes + shared).

        The frictions of the tubes come first. The prior in these coordinates is standard normal.
        """
        fractions = np.clip(ndtr(normal), 1e-9, 1.0 - 1e-9)
        table = np.empty((tubes, len(normal), len(UNKNOWNS)))
        for k, name in enumerate(UNKNOWNS):
            if name in self.fixed:
                table[:, :, k] = self.fixed[name]
            elif name == "friction":
                table[:, :, k] = self.quantile[name](fractions[:, :tubes]).T
            else:
                table[:, :, k] = self.quantile[name](fractions[:, tubes + self.shared.index(name)])
        return table


def prior_of(plant: Plant, file: str = "tube") -> Prior:
    """The prior of a plant: ranges and normal distributions as in its file; a number is a fixed value.

    The friction is never fixed. Defaults of friction (also if it is a number), stiffness and damping are the training
    ranges of the response, beyond which a value is refused; that of the drag is ``DRAG``.
    """
    prior = Prior({}, {}, {}, [])
    for name, unknown in UNKNOWNS.items():
        table = getattr(plant, unknown.table)
        figure: Figure = getattr(table, unknown.field)
        low, high = unknown.low, unknown.high
        if isinstance(figure, Between):
            low, high = (_checked(value, unknown, file) for value in (figure.low, figure.high))
        elif isinstance(figure, Normal):
            _checked(figure.mean, unknown, file)
        elif name != "friction" and unknown.field in table.model_fields_set:
            prior.fixed[name] = _checked(figure, unknown, file)
            continue
        else:
            if name == "drag_coefficient":
                low, high = (fraction * figure for fraction in DRAG)
            figure = Between(low=low, high=high)
            prior.assumed.append(f"{unknown.text} {low:g} to {high:g} {unknown.unit}".strip())
            if name != "friction":
                prior.quantile[name] = partial(_log_uniform, low, high)
        prior.quantile.setdefault(name, partial(quantiles, figure, low=low, high=high))
        prior.ranges[name] = (low, high)
    return prior


def _log_uniform(low: float, high: float, fractions: FloatArray) -> FloatArray:
    return np.asarray(low * (high / low) ** fractions)


def _checked(value: float, unknown: Unknown, file: str) -> float:
    if not unknown.low <= value <= unknown.high:
        unit = f" {unknown.unit}" if unknown.unit else ""
        problem = f"{value:g}{unit} is outside {unknown.low:g} to {unknown.high:g}{unit}"
        reason = "the training range of the response"
        raise FileError(file, f"{unknown.table}.{unknown.field} = {problem}, {reason}")
    return float(value)
