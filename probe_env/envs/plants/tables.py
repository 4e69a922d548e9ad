"""The tables of a plant's file, and uncertain figures: a number, a range, or a mean with its standard deviation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

import numpy as np
import numpy.typing as npt
from pydantic import BeforeValidator, Field, FiniteFloat, model_validator
from pydantic_core import PydanticCustomError
from scipy.stats import truncnorm

from probe_env.arrays import FloatArray
from probe_env.envs.task import TaskConfig
from probe_env.scene import Air, Contact, Tube
from probe_env.settings import Model, Quantity, quantity, range_of, within


class Between(Model):
    """Anything from ``low`` to ``high``, all equally likely."""

    low: FiniteFloat
    high: FiniteFloat

    @model_validator(mode="after")
    def _ascends(self) -> Self:
        if not self.low <= self.high:
            raise PydanticCustomError("range", f"low = {self.low!r} must not exceed high = {self.high!r}")
        return self


class Normal(Model):
    """Normal with a standard deviation, cut off where the figure's accepted range ends."""

    mean: FiniteFloat
    std: Annotated[FiniteFloat, Field(gt=0.0)]


def _described(value: Any) -> Any:
    """A table as the model whose keys it has: pydantic would tell what is wrong with it for each of them."""
    if isinstance(value, Between | Normal) or (isinstance(value, int | float) and not isinstance(value, bool)):
        return value
    for kind in (Between, Normal):
        if isinstance(value, Mapping) and set(value) & set(kind.model_fields):
            return kind.model_validate(dict(value))
    raise PydanticCustomError("figure", "must be a number, a table of low and high, or one of mean and std")


Figure = Annotated[float | Between | Normal, BeforeValidator(_described)]


def quantiles(figure: Figure, shares: npt.ArrayLike, low: float, high: float) -> FloatArray:
    """Values of a figure at shares in (0, 1), of their shape; ``low`` and ``high`` are what is accepted of it."""
    shares = np.asarray(shares, dtype=float)
    match figure:
        case Between():
            return figure.low + shares * (figure.high - figure.low)
        case Normal():
            ends = (low - figure.mean) / figure.std, (high - figure.mean) / figure.std
            return np.asarray(truncnorm.ppf(shares, *ends, loc=figure.mean, scale=figure.std))
        case _:
            return np.full(shares.shape, figure)


def middle(figure: Figure, low: float, high: float) -> float:
    """Median of a figure: what is taken where one value is needed."""
    return float(quantiles(figure, 0.5, low, high))


FRICTION, STIFFNESS, DRAG = (0.0, 1.0), (1e2, 1e8), (0.0, 10.0)
"""Accepted range of each figure that may be unknown, in the units of its field."""


class _Figure(Quantity):
    """Range of a figure that may be unknown (of a normal one, of its mean), or of each of some numbers."""

    name = "value"

    def check(self, value: Any) -> Any:
        named = [(self.name, number) for number in (value if isinstance(value, tuple) else (value,))]
        if isinstance(value, Between | Normal):
            named = [(name, number) for name, number in value.model_dump().items() if name != "std"]
        for name, number in named:
            try:
                within(name, number, self.low, self.high, self.unit)
            except ValueError as error:
                raise PydanticCustomError("out_of_range", "{text}", {"text": str(error)}) from None
        return value


class _Diameters(_Figure):
    name = "helix_diameter"


class Tubes(Model):
    """Of a plant: one bore and one length, helices of one diameter or of some."""

    helix_diameter: Annotated[
        float | Annotated[tuple[float, ...], Field(min_length=1, max_length=1000)], _Diameters(0.3, 50.0, "m")
    ] = Tube().helix_diameter
    """Of the tube's axis [m], a number or a list."""
    inner_diameter: Annotated[float, range_of(Tube, "inner_diameter")] = Tube().inner_diameter
    """Of the tubes [m]."""
    helix_length: Annotated[float, range_of(Tube, "helix_length")] = Tube().helix_length
    """Along the tube's axis [m]."""
    straight_length: Annotated[float, quantity(0.0, 1e3, "m")] | None = None
    """Of the rising straight part [m]; kept with the results, nothing is computed from it."""
    support_spacing: Annotated[float, quantity(1e-3, 100.0, "m")] | None = None
    """Between two supports of the tube [m]; ``probe-env signal`` shows them, nothing else is computed from it."""


class Walls(Model):
    """Contact of floats and wall."""

    friction: Annotated[Figure, _Figure(*FRICTION, "")] = Contact().friction
    """Coulomb's coefficient [-]: a number, ``{low, high}`` or ``{mean, std}``."""
    stiffness: Annotated[Figure, _Figure(*STIFFNESS, "N/m")] = Contact().stiffness
    """Of the wall under a float [N/m], alike."""
    walls: Literal["both", "inner"] = "both"
    """Walls that floats touch."""
    cable: bool = False
    """Whether the cable between floats touches the walls too: needed where it is weak, or fed in hard."""


class Supply(Model):
    """Air and how it is supplied."""

    density: Annotated[float, range_of(Air, "density")] = Air().density
    """Of the air [kg/m3]."""
    drag_coefficient: Annotated[Figure, _Figure(*DRAG, "")] = Air().drag_coefficient
    """Of a float [-]: a number, ``{low, high}`` or ``{mean, std}``."""
    air_supply_rates: Annotated[tuple[float, float] | None, range_of(TaskConfig, "air_supply_rates")] = None
    """Least and most [m3/s]; default: the task's."""
    air_supply_step: Annotated[float | None, range_of(TaskConfig, "air_supply_step")] = None
    """Smallest step in which it is set [m3/s]; 0: any."""
    air_lag: Annotated[float | None, range_of(TaskConfig, "air_lag")] = None
    """Time constant with which it follows [s]."""


class FeedDevice(Model):
    """What feeds the cable."""

    feed_speeds: Annotated[tuple[float, float] | None, range_of(TaskConfig, "feed_speeds")] = None
    """Least and most [m/s]; default: the task's."""
    feed_speed_step: Annotated[float | None, range_of(TaskConfig, "feed_speed_step")] = None
    """Smallest step in which it is set [m/s]; 0: any."""
    ramp: Annotated[float | None, range_of(TaskConfig, "ramp")] = None
    """Acceleration of the feed [m/s2]."""
