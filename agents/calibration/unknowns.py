"""What a log is asked for, and what is held possible before it is looked at."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from scipy.special import ndtr

from probe_env import Plant
from probe_env.arrays import FloatArray
from probe_env.envs.plants.tables import Between, Figure, Normal, quantiles
from probe_env.files import FileError

FRICTION: Final = (0.05, 0.35)
STIFFNESS: Final = (5e4, 1.9e5)  # [N/m]
DAMPING: Final = (4.5e-5, 1.2e-4)
"""[s]; with less the scheme of ``fast`` and ``standard`` diverged at 2e-4 s in some tubes of the bank."""
DRAG: Final = (0.85, 1.15)
"""Of the drag coefficient that the file or table 2 names, where it is not told how well it is known."""


class Unknown(NamedTuple):
    """A quantity that is looked for.

    Attributes:
        table, field: of the plant's file.
        unit: SI.
        low, high: range that the response was learnt in.
        text: for people.
    """

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
"""In the order in which they stand in arrays."""
Quantile = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, eq=False)
class Prior:
    """What is held possible of each unknown: its quantile function, or a number where it is known.

    Attributes:
        known: name -> value of what is not looked for.
        quantile: name -> quantile function of what is.
        ranges: name -> least and greatest value that is held possible.
        assumed: what was assumed, in words.
    """

    known: dict[str, float]
    quantile: dict[str, Quantile]
    ranges: dict[str, tuple[float, float]]
    assumed: tuple[str, ...] = ()

    @property
    def shared(self) -> tuple[str, ...]:
        """What all tubes have alike and is looked for: everything but the friction."""
        return tuple(name for name in self.quantile if name != "friction")

    def values(self, normal: FloatArray, tubes: int) -> FloatArray:
        """(tubes, n, 4) values in the order of ``UNKNOWNS`` at standard normal coordinates (n, tubes + shared).

        The frictions of the tubes come first, so that the prior in these coordinates is standard normal.
        """
        shares = np.clip(ndtr(normal), 1e-9, 1.0 - 1e-9)
        table = np.empty((tubes, len(normal), len(UNKNOWNS)))
        for k, name in enumerate(UNKNOWNS):
            if name in self.known:
                table[:, :, k] = self.known[name]
            elif name == "friction":
                table[:, :, k] = self.quantile[name](shares[:, :tubes]).T
            else:
                table[:, :, k] = self.quantile[name](shares[:, tubes + self.shared.index(name)])
        return table


def prior_of(plant: Plant, file: str = "tube") -> Prior:
    """What a plant's file leaves open: ranges and normals as they stand there, a number is known.

    Friction is always looked for: where the file has a number or nothing, all that the response was learnt for is
    possible, and so it is of the stiffness and the damping where the file says nothing. Drag is then within 15 %.

    Raises:
        FileError: a figure that lies beyond what the response was learnt for; names field, value and range.
    """
    known: dict[str, float] = {}
    quantile: dict[str, Quantile] = {}
    ranges: dict[str, tuple[float, float]] = {}
    assumed = []
    for name, unknown in UNKNOWNS.items():
        table = getattr(plant, unknown.table)
        figure: Figure = getattr(table, unknown.field)
        said = unknown.field in table.model_fields_set
        low, high = unknown.low, unknown.high
        if isinstance(figure, Between | Normal):
            ranges[name] = _within(figure, unknown, file)
            quantile[name] = _quantile(figure, *ranges[name])
            continue
        if said and name != "friction":
            known[name] = _checked(figure, unknown, file)
            continue
        if name == "drag_coefficient":
            low, high = (share * figure for share in DRAG)
        ranges[name] = (low, high)
        quantile[name] = _quantile(Between(low=low, high=high), low, high, geometric=low > 0.0 and name != "friction")
        assumed.append(f"{unknown.text} {low:g} to {high:g}{' ' if unknown.unit else ''}{unknown.unit}")
    return Prior(known, quantile, ranges, tuple(assumed))


def _quantile(figure: Figure, low: float, high: float, geometric: bool = False) -> Quantile:
    if geometric:
        return lambda shares: np.asarray(low * (high / low) ** shares)
    return lambda shares: quantiles(figure, shares, low, high)


def _within(figure: Between | Normal, unknown: Unknown, file: str) -> tuple[float, float]:
    """Least and greatest value of a figure, which must be among those that the response was learnt for."""
    if isinstance(figure, Normal):
        _checked(figure.mean, unknown, file)
        return unknown.low, unknown.high  # cut off there
    return _checked(figure.low, unknown, file), _checked(figure.high, unknown, file)


def _checked(value: float, unknown: Unknown, file: str) -> float:
    if not unknown.low <= value <= unknown.high:
        unit = f" {unknown.unit}" if unknown.unit else ""
        raise FileError(
            file,
            f"{unknown.table}.{unknown.field} = {value:g}{unit} is outside {unknown.low:g} to {unknown.high:g}{unit},"
            " for which the response of the probe was learnt",
        )
    return float(value)
