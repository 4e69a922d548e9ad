"""A plant as one typed file, ``tube.toml``: its tubes, probe, air, feed device and task, and what is known of them.

The same object goes to ``gymnasium.make(..., tube=...)``, to every command as ``--tube`` and into stored results: the
task carries its scene, so that results of different plants never mix.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, ValidationError, model_validator
from pydantic_core import PydanticCustomError
from scipy.stats import qmc

from probe_env.arrays import FloatArray
from probe_env.envs.contexts import Context
from probe_env.envs.plants.figures import Figure, checked, middle, quantiles
from probe_env.envs.task import SHOWN, TaskConfig
from probe_env.scene import Air, Contact, Probe, Scene, Tube
from probe_env.settings import Model, explain, quantity, tuples, within

MOST_TUBES: Final = 4096
FRICTION, STIFFNESS, DRAG = (0.0, 1.0), (1e2, 1e8), (0.0, 10.0)
"""Accepted range of each figure that may be unknown, in the units of its field."""
FACTORS: Final = (0.1, 10.0)
"""Accepted drag of a ``Context`` over the scene's."""
RARE: Final = 1e-6
LONGEST: Final = 60.0  # [m], of a helix that the task's own time limit is for
OF_FEED, OF_AIR = ("feed_speeds", "feed_speed_step", "ramp"), ("air_supply_rates", "air_supply_step", "air_lag")
"""Fields of the task that stand in the tables of the feed device and of the air."""


def _figure(low: float, high: float, unit: str) -> AfterValidator:
    return AfterValidator(lambda figure: checked(figure, low, high, unit))


def _diameters(value: float | tuple[float, ...]) -> float | tuple[float, ...]:
    for diameter in value if isinstance(value, tuple) else (value,):
        try:
            within("helix_diameter", diameter, 0.3, 1e4, "m")
        except ValueError as error:
            raise PydanticCustomError("out_of_range", "{text}", {"text": str(error)}) from None
    return value


class Tubes(Model):
    """Of a plant: one bore and one length, helices of one diameter or of some."""

    helix_diameter: Annotated[
        float | Annotated[tuple[float, ...], Field(min_length=1, max_length=1000)], AfterValidator(_diameters)
    ] = Tube().helix_diameter
    """Of the tube's axis [m], a number or a list."""
    inner_diameter: float = Tube().inner_diameter
    """Of the tubes [m]."""
    helix_length: float = Tube().helix_length
    """Along the tube's axis [m]."""
    straight_length: Annotated[float, quantity(0.0, 1e3, "m")] | None = None
    """Of the rising straight part [m]; kept with the results, nothing is computed from it."""
    support_spacing: Annotated[float, quantity(1e-3, 100.0, "m")] | None = None
    """Between two supports of the tube [m]; kept with the results, nothing is computed from it."""


class Walls(Model):
    """Contact of floats and wall."""

    friction: Annotated[Figure, _figure(*FRICTION, "")] = Contact().friction
    """Coulomb's coefficient [-]: a number, ``{low, high}`` or ``{mean, std}``."""
    stiffness: Annotated[Figure, _figure(*STIFFNESS, "N/m")] = Contact().stiffness
    """Of the wall under a float [N/m], alike."""
    walls: Literal["both", "inner"] = "both"
    """Walls that floats touch."""


class Supply(Model):
    """Air and how it is supplied."""

    density: float = Air().density
    """Of the air [kg/m3]."""
    drag_coefficient: Annotated[Figure, _figure(*DRAG, "")] = Air().drag_coefficient
    """Of a float [-]: a number, ``{low, high}`` or ``{mean, std}``."""
    air_supply_rates: tuple[float, float] | None = None
    """Least and most [m3/s]; default: the task's."""
    air_supply_step: float | None = None
    """Smallest step in which it is set [m3/s]; 0: any."""
    air_lag: float | None = None
    """Time constant with which it follows [s]."""


class FeedDevice(Model):
    """What feeds the cable."""

    feed_speeds: tuple[float, float] | None = None
    """Least and most [m/s]; default: the task's."""
    feed_speed_step: float | None = None
    """Smallest step in which it is set [m/s]; 0: any."""
    ramp: float | None = None
    """Acceleration of the feed [m/s2]."""


class Plant(Model):
    """Tubes, probe and task of a plant; what is left out is table 2's and the task's own."""

    tube: Tubes = Tubes()
    probe: Probe = Probe()
    contact: Walls = Walls()
    air: Supply = Supply()
    feed: FeedDevice = FeedDevice()
    task: dict[str, Any] = Field(default_factory=dict)
    """Fields of ``TaskConfig``: limits, weights, sensors."""

    @model_validator(mode="before")
    @classmethod
    def _takes_lists(cls, given: Any) -> Any:
        return tuples(dict(given)) if isinstance(given, Mapping) else given

    @model_validator(mode="after")
    def _is_possible(self) -> Self:
        misplaced = {**dict.fromkeys(OF_FEED, "feed"), **dict.fromkeys(OF_AIR, "air"), "scene": "tube"}
        for name in self.task:
            if name in misplaced or name in SHOWN:
                place = f"stands in [{misplaced[name]}]" if name in misplaced else "is set by who looks at it"
                raise PydanticCustomError("task", "{text}", {"text": f"task.{name}: {place}"})
        least, most = self._drag_factors(np.array([RARE, 1.0 - RARE]))
        low, high = FACTORS
        if not low <= least <= most <= high:
            text = f"air.drag_coefficient: {least:g} to {most:g} times its median is beyond {low:g} to {high:g} times"
            raise PydanticCustomError("drag", "{text}", {"text": text})
        try:
            self._scenes()
            self.configured()
        except ValidationError as error:
            field = str((error.errors()[0]["loc"] or ("",))[0])
            table = "task" if field in TaskConfig.model_fields or field in self.task else ""
            text = explain(error, "feed" if field in OF_FEED else "air" if field in OF_AIR else table)
            raise PydanticCustomError("plant", "{text}", {"text": text}) from error
        return self

    @property
    def diameters(self) -> tuple[float, ...]:
        """Of the helices [m]."""
        given = self.tube.helix_diameter
        return given if isinstance(given, tuple) else (given,)

    @property
    def scene(self) -> Scene:
        """A tube of the plant with the median of what is not known, the probe inserted as far as it goes up to 50 m."""
        return self._scenes()[0]

    def _scenes(self) -> list[Scene]:
        """One for each helix diameter."""
        tube = self.tube.model_dump(include={"inner_diameter", "helix_length"})
        rest = {
            "probe": self.probe,
            "contact": {
                "friction": middle(self.contact.friction, *FRICTION),
                "stiffness": middle(self.contact.stiffness, *STIFFNESS),
                "walls": self.contact.walls,
            },
            "air": {
                "density": self.air.density,
                "drag_coefficient": middle(self.air.drag_coefficient, *DRAG),
            },
        }
        return [Scene.fitted({"tube": tube | {"helix_diameter": diameter}, **rest}) for diameter in self.diameters]

    def configured(
        self, defaults: Mapping[str, Any] | None = None, changes: Mapping[str, Any] | None = None
    ) -> TaskConfig:
        """The plant's task: an environment's defaults below what the plant says, ``changes`` above it.

        A helix of more than 60 m has more time, in proportion, unless a time limit is given.

        Raises:
            ValueError: a field that is not known or not valid.
        """
        device = {
            name: getattr(part, name) for part, names in ((self.feed, OF_FEED), (self.air, OF_AIR)) for name in names
        }
        values: dict[str, Any] = {"scene": self._scenes()[0]}
        if self.tube.helix_length > LONGEST:
            values["time_limit"] = TaskConfig().time_limit * self.tube.helix_length / LONGEST
        values |= dict(defaults or {}) | {name: value for name, value in device.items() if value is not None}
        return TaskConfig.model_validate(tuples(values | self.task | dict(changes or {})))

    def _drag_factors(self, shares: FloatArray) -> FloatArray:
        """(n,) drag over its median at shares (n,) in (0, 1)."""
        usual = middle(self.air.drag_coefficient, *DRAG)
        drag = quantiles(self.air.drag_coefficient, shares, *DRAG)
        return drag / usual if usual > 0.0 else np.ones(len(shares))

    def contexts(self, count: int, seed: int = 0) -> tuple[Context, ...]:
        """So many tubes: helices in turn, and friction, stiffness and drag spread over what is known of them.

        Every prefix is as balanced as it can be (Halton's sequence, scrambled by the seed); a longer list begins as a
        shorter one.

        Raises:
            ValueError: the number is out of range.
        """
        if not 1 <= count <= MOST_TUBES:
            raise ValueError(f"tubes = {count!r} is outside the accepted range 1 to {MOST_TUBES}")
        shares = qmc.Halton(3, rng=np.random.default_rng([2026, seed])).random(count)
        friction = quantiles(self.contact.friction, shares[:, 0], *FRICTION)
        stiffness = quantiles(self.contact.stiffness, shares[:, 1], *STIFFNESS)
        factor = np.clip(self._drag_factors(shares[:, 2]), *FACTORS)  # but for one in a million within it
        return tuple(
            Context(
                friction=round(float(friction[k]), 4),
                contact_stiffness=float(f"{stiffness[k]:.4g}"),
                drag_factor=round(float(factor[k]), 4),
                helix_diameter=self.diameters[k % len(self.diameters)],
            )
            for k in range(count)
        )


GivenPlant = Plant | str | Path | Mapping[str, Any] | None
"""A plant, its file or its fields."""


def plant_of(given: GivenPlant) -> Plant | None:
    """A plant by its file, its fields or itself; None is none.

    Raises:
        FileNotFoundError: no such file.
        ValueError: a field that is not known or not valid; names the file and every offending field.
    """
    if given is None or isinstance(given, Plant):
        return given
    if isinstance(given, Mapping):
        return Plant.model_validate(given)
    return Plant.from_toml(given)
