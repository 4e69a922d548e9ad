"""A plant as one typed file, ``tube.toml``: its tubes, probe, air, feed device and task, and what is known of them.

The same object goes to ``gymnasium.make(..., tube=...)``, to every command as ``--tube`` and into stored results: the
task carries its scene, so that results of different plants never mix.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Final, Self

import numpy as np
from pydantic import BeforeValidator, Field, ValidationError, model_validator
from pydantic_core import PydanticCustomError
from scipy.optimize import linear_sum_assignment
from scipy.stats import qmc

from probe_env.arrays import FloatArray
from probe_env.envs.contexts import Context
from probe_env.envs.plants.posterior import Posterior, check_draws, with_posterior
from probe_env.envs.plants.tables import (
    DRAG,
    FRICTION,
    STIFFNESS,
    FeedDevice,
    Normal,
    Supply,
    Tubes,
    Walls,
    middle,
    quantiles,
)
from probe_env.envs.task import SHOWN, TaskConfig, ungrouped
from probe_env.files import FileError, read_toml
from probe_env.inspection.sensor import Sensor
from probe_env.scene import Probe, Scene
from probe_env.settings import Model, explain, tuples

MOST_TUBES: Final = 4096
FACTORS: Final = (0.1, 10.0)
"""Accepted drag of a ``Context`` over the scene's."""
RARE: Final = 1e-6
LONGEST: Final = 60.0  # [m], of a helix that the task's own time limit is for
OF_FEED, OF_AIR = ("feed_speeds", "feed_speed_step", "ramp"), ("air_supply_rates", "air_supply_step", "air_lag")
"""Fields of the task that stand in the tables of the feed device and of the air."""


class Plant(Model):
    """Tubes, probe and task of a plant; what is left out is table 2's and the task's own."""

    tube: Tubes = Tubes()
    probe: Probe = Probe()
    contact: Walls = Walls()
    air: Supply = Supply()
    feed: FeedDevice = FeedDevice()
    sensor: Sensor = Sensor()
    task: Annotated[dict[str, Any], BeforeValidator(ungrouped)] = Field(default_factory=dict)
    """Fields of ``TaskConfig``, by themselves or in tables of its groups."""
    posterior: Posterior | None = None
    """What a calibration found; it goes before the figures of the same quantities. A file names it by its path."""

    @classmethod
    def from_toml(cls, path: str | Path) -> Self:
        """Read a plant's file, and the calibration beside it where it names one; raises as ``Model.from_toml``."""
        data = read_toml(path)
        try:
            return cls.model_validate(with_posterior(data, Path(path).parent))
        except ValidationError as error:
            raise FileError(path, explain(error)) from error
        except FileError:
            raise
        except (ValueError, OverflowError) as error:
            raise FileError(path, str(error)) from error

    @model_validator(mode="before")
    @classmethod
    def _takes_lists(cls, given: Any) -> Any:
        return tuples(with_posterior(given)) if isinstance(given, Mapping) else given

    @model_validator(mode="after")
    def _is_possible(self) -> Self:
        misplaced = (
            dict.fromkeys(OF_FEED, "feed") | dict.fromkeys(OF_AIR, "air") | {"scene": "tube", "sensor": "sensor"}
        )
        for name in self.task:
            if name in misplaced or name in SHOWN:
                place = f"stands in [{misplaced[name]}]" if name in misplaced else "is set by who looks at it"
                raise PydanticCustomError("task", "{text}", {"text": f"task.{name}: {place}"})
        check_draws(self.posterior)
        least, most = self._drag_factors(np.array([RARE, 1.0 - RARE]))
        low, high = FACTORS
        if not low <= least <= most <= high:
            text = f"air.drag_coefficient: {least:g} to {most:g} times its median is beyond {low:g} to {high:g} times"
            raise PydanticCustomError("drag", "{text}", {"text": text})
        try:
            assert self.scenes
            assert self.config
        except ValidationError as error:
            field = str((error.errors()[0]["loc"] or ("",))[0])
            table = "task" if field in TaskConfig.model_fields or field in self.task else ""
            text = explain(error, "feed" if field in OF_FEED else "air" if field in OF_AIR else table)
            raise PydanticCustomError("plant", "{text}", {"text": text}) from error
        if problem := implausible(self):
            raise PydanticCustomError("plausible", "{text}", {"text": problem})
        return self

    def _middle(self, name: str) -> float:
        """Median of a quantity by the posterior, or by its figure."""
        if self.posterior and name in self.posterior.draws:
            return self.posterior.middle(name)
        figures = {
            "friction": (self.contact.friction, *FRICTION),
            "contact_stiffness": (self.contact.stiffness, *STIFFNESS),
            "drag_coefficient": (self.air.drag_coefficient, *DRAG),
            "damping_time": (self.probe.damping_time, 0.0, 1.0),
        }
        return middle(*figures[name])

    @property
    def diameters(self) -> tuple[float, ...]:
        """Of the helices [m]."""
        given = self.tube.helix_diameter
        return given if isinstance(given, tuple) else (given,)

    @property
    def scene(self) -> Scene:
        """A tube of the plant with the median of what is not known, the probe inserted as far as it goes up to 50 m."""
        return self.scenes[0]

    @cached_property
    def scenes(self) -> tuple[Scene, ...]:
        """A scene for each helix diameter."""
        tube = self.tube.model_dump(include={"inner_diameter", "helix_length"})
        rest = {
            "probe": self.probe.model_copy(update={"damping_time": self._middle("damping_time")}),
            "contact": {
                "friction": self._middle("friction"),
                "stiffness": self._middle("contact_stiffness"),
                "walls": self.contact.walls,
                "cable": self.contact.cable,
            },
            "air": {"density": self.air.density, "drag_coefficient": self._middle("drag_coefficient")},
        }
        return tuple(Scene.fitted({"tube": tube | {"helix_diameter": diameter}, **rest}) for diameter in self.diameters)

    @cached_property
    def config(self) -> TaskConfig:
        """The plant's task."""
        return self._config({}, {})

    def configured(
        self, defaults: Mapping[str, Any] | None = None, changes: Mapping[str, Any] | None = None
    ) -> TaskConfig:
        """The plant's task: an environment's defaults below what the plant says, ``changes`` above it.

        A helix of more than 60 m has more time, in proportion, unless a time limit is given.

        Raises:
            ValueError: a field that is not known or not valid.
        """
        return self._config(defaults or {}, changes or {}) if defaults or changes else self.config

    def _config(self, defaults: Mapping[str, Any], changes: Mapping[str, Any]) -> TaskConfig:
        device = {
            name: getattr(part, name) for part, names in ((self.feed, OF_FEED), (self.air, OF_AIR)) for name in names
        }
        values: dict[str, Any] = {"scene": self.scene, "sensor": self.sensor}
        if self.tube.helix_length > LONGEST:
            values["time_limit"] = TaskConfig().time_limit * self.tube.helix_length / LONGEST
        values |= dict(defaults) | {name: value for name, value in device.items() if value is not None}
        return TaskConfig.model_validate(tuples(values | self.task | ungrouped(dict(changes))))

    def _drag_factors(self, shares: FloatArray) -> FloatArray:
        """(n,) drag over its median at shares (n,) in (0, 1)."""
        usual = self._middle("drag_coefficient")
        if self.posterior and "drag_coefficient" in self.posterior.draws:
            drag = np.quantile(self.posterior.draws["drag_coefficient"], shares)
        else:
            drag = quantiles(self.air.drag_coefficient, shares, *DRAG)
        return drag / usual if usual > 0.0 else np.ones(len(shares))

    def contexts(self, count: int, seed: int = 0) -> tuple[Context, ...]:
        """So many tubes: helices in turn, and friction, stiffness and drag spread over what is known of them.

        Every prefix is as balanced as it can be (Halton's sequence, scrambled by the seed; the diameters equally often,
        each over all of the rest); a longer list begins as a shorter one. What a posterior tells of belongs together;
        its damping is the median in all tubes.

        Raises:
            ValueError: the number is out of range.
        """
        if not 1 <= count <= MOST_TUBES:
            raise ValueError(f"tubes = {count!r} is outside the accepted range 1 to {MOST_TUBES}")
        blocks = -(-count // len(self.diameters))
        shares = qmc.Halton(3, rng=np.random.default_rng([2026, seed])).random(blocks * len(self.diameters))
        helices = _in_turn(shares, self.diameters)
        shares = shares[:count]
        drawn = {
            "friction": quantiles(self.contact.friction, shares[:, 0], *FRICTION),
            "contact_stiffness": quantiles(self.contact.stiffness, shares[:, 1], *STIFFNESS),
        }
        factor = self._drag_factors(shares[:, 2])
        if self.posterior:
            joint = self.posterior.rows(shares[:, 0])
            drawn |= {name: values for name, values in joint.items() if name in drawn}
            if "drag_coefficient" in joint:
                factor = joint["drag_coefficient"] / self._middle("drag_coefficient")
        factor = np.clip(factor, *FACTORS)  # but for one in a million within it
        return tuple(
            Context(
                friction=round(float(drawn["friction"][k]), 4),
                contact_stiffness=float(f"{drawn['contact_stiffness'][k]:.4g}"),
                drag_factor=round(float(factor[k]), 4),
                helix_diameter=helices[k],
            )
            for k in range(count)
        )


def implausible(plant: Plant) -> str:
    """What of a plant is within its range and cannot be meant; empty if nothing."""
    config, scene = plant.config, plant.scene
    for table, name, of, unit in (
        ("feed", "feed_speed_step", "feed_speeds", "m/s"),
        ("air", "air_supply_step", "air_supply_rates", "m3/s"),
    ):
        step, (low, high) = getattr(config, name), getattr(config, of)
        if step > 0.0 and step * math.floor(high / step * (1.0 + 1e-9)) < low * (1.0 - 1e-9):
            return (
                f"{table}.{name} = {step:g} {unit}: no whole step lies within {of}, {low:g} to {high:g} {unit}; give 0"
                " for any, or a smaller one"
            )
    floats = min(scene.probe.guide_float_diameter, scene.probe.carrier_float_diameter)
    clearance = scene.tube.clear_diameter - floats
    if config.vibration_measure == "displacement" and config.limit > clearance:
        return (
            f"task.vibration_limit = {config.limit:g} m is more than the {clearance:.3g} m that the floats have in the"
            " tube: give it in metres, 0.1 mm as 1e-4"
        )
    for name, figure in (
        ("contact.friction", plant.contact.friction),
        ("contact.stiffness", plant.contact.stiffness),
        ("air.drag_coefficient", plant.air.drag_coefficient),
    ):
        if isinstance(figure, Normal) and figure.std > figure.mean:
            return (
                f"{name}.std = {figure.std:g} is more than the mean, {figure.mean:g}: of what is hardly known give low"
                " and high"
            )
    return ""


def _in_turn(shares: FloatArray, diameters: Sequence[float]) -> list[float]:
    """A diameter for each of the tubes: all in every block of so many, each over all that is known of the rest.

    Were they dealt out in their order, every second tube would have one of every second diameter and, Halton's first
    sequence being that of base 2, friction of one half of its range. So a block's diameters are paired with its tubes
    such that sums over the tubes of a diameter so far, of its shares and their squares, stay as small as they can.

    Args:
        shares: (n, 3) of friction, stiffness and drag, n a multiple of the number of diameters.
        diameters: [m].
    """
    centred = np.hstack([shares, shares**2]) - np.repeat([1.0 / 2.0, 1.0 / 3.0], shares.shape[1])
    sums, dealt = np.zeros((len(diameters), centred.shape[1])), []
    for block in centred.reshape(-1, *sums.shape):
        _, tube_of = linear_sum_assignment(((sums[:, None] + block) ** 2).sum(axis=-1))
        sums += block[tube_of]
        dealt += [diameters[k] for k in tube_of.argsort()]
    return dealt


def map_beside(tube: Path) -> Path:
    """Where the vibration map of a plant is kept: beside its file, NAME-map.npz."""
    return tube.with_name(f"{tube.stem}-map.npz")


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
