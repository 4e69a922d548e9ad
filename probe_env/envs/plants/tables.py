"""The tables of a plant's file: tubes, walls, air and feed device."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field
from pydantic_core import PydanticCustomError

from probe_env.envs.plants.figures import Figure, checked
from probe_env.envs.task import TaskConfig
from probe_env.scene import Air, Contact, Tube
from probe_env.settings import Model, Quantity, Range, quantity, range_of, within

FRICTION, STIFFNESS, DRAG = (0.0, 1.0), (1e2, 1e8), (0.0, 10.0)
"""Accepted range of each figure that may be unknown, in the units of its field."""


class _Figure(Quantity):
    """Range of a figure that may be unknown."""

    def check(self, value: Any) -> Any:
        return checked(value, self.low, self.high, self.unit)


class _Numbers(Quantity):
    """Range of a number, or of each of some."""

    def check(self, value: Any) -> Any:
        for number in value if isinstance(value, tuple) else (value,):
            try:
                within("helix_diameter", number, self.low, self.high, self.unit)
            except ValueError as error:
                raise PydanticCustomError("out_of_range", "{text}", {"text": str(error)}) from None
        return value


def _as_in(model: type[Model], field: str) -> Range:
    """Range of a field that another model checks."""
    known = range_of(model, field)
    assert known is not None
    return Range(known.low, known.high, known.unit)


class Tubes(Model):
    """Of a plant: one bore and one length, helices of one diameter or of some."""

    helix_diameter: Annotated[
        float | Annotated[tuple[float, ...], Field(min_length=1, max_length=1000)], _Numbers(0.3, 50.0, "m")
    ] = Tube().helix_diameter
    """Of the tube's axis [m], a number or a list."""
    inner_diameter: Annotated[float, _as_in(Tube, "inner_diameter")] = Tube().inner_diameter
    """Of the tubes [m]."""
    helix_length: Annotated[float, _as_in(Tube, "helix_length")] = Tube().helix_length
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

    density: Annotated[float, _as_in(Air, "density")] = Air().density
    """Of the air [kg/m3]."""
    drag_coefficient: Annotated[Figure, _Figure(*DRAG, "")] = Air().drag_coefficient
    """Of a float [-]: a number, ``{low, high}`` or ``{mean, std}``."""
    air_supply_rates: Annotated[tuple[float, float] | None, _as_in(TaskConfig, "air_supply_rates")] = None
    """Least and most [m3/s]; default: the task's."""
    air_supply_step: Annotated[float | None, _as_in(TaskConfig, "air_supply_step")] = None
    """Smallest step in which it is set [m3/s]; 0: any."""
    air_lag: Annotated[float | None, _as_in(TaskConfig, "air_lag")] = None
    """Time constant with which it follows [s]."""


class FeedDevice(Model):
    """What feeds the cable."""

    feed_speeds: Annotated[tuple[float, float] | None, _as_in(TaskConfig, "feed_speeds")] = None
    """Least and most [m/s]; default: the task's."""
    feed_speed_step: Annotated[float | None, _as_in(TaskConfig, "feed_speed_step")] = None
    """Smallest step in which it is set [m/s]; 0: any."""
    ramp: Annotated[float | None, _as_in(TaskConfig, "ramp")] = None
    """Acceleration of the feed [m/s2]."""
