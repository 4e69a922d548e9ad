"""A plant as one typed file, ``tube.toml``: its tubes, probe, air, feed device and task, and what is known of them.

The same object goes to ``gymnasium.make(..., tube=...)``, to every command as ``--tube`` and into stored results: the
task carries its scene, so that results of different plants never mix. A figure that is not known is a number, a range,
a mean with its standard deviation, or the joint draws of a calibration, read from ``calibration.json``.
"""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

import numpy as np
import numpy.typing as npt
from pydantic import BeforeValidator, Field, FiniteFloat, ValidationError, model_validator
from pydantic_core import PydanticCustomError
from scipy.optimize import linear_sum_assignment
from scipy.stats import qmc, truncnorm

from probe_env.arrays import FloatArray
from probe_env.envs.contexts import Context
from probe_env.envs.task import SHOWN, TaskConfig, ungrouped
from probe_env.files import MEBI, FileError, read_bytes, read_toml
from probe_env.inspection.sensor import Sensor
from probe_env.scene import Air, Contact, Probe, Scene, Tube
from probe_env.settings import Model, Quantity, explain, quantity, range_of, tuples, within


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


MOST_FILE: Final = 16 * MEBI
MOST_DRAWS: Final = 4096
Draws = Annotated[tuple[FiniteFloat, ...], Field(min_length=1, max_length=MOST_DRAWS)]


class Posterior(Model):
    """Equally likely draws; the k-th of all belong together."""

    friction: Draws | None = None
    """[-]."""
    contact_stiffness: Draws | None = None
    """[N/m]."""
    drag_coefficient: Draws | None = None
    """[-]."""
    damping_time: Draws | None = None
    """[s]."""

    @model_validator(mode="after")
    def _belong_together(self) -> Self:
        counts = {len(draws) for draws in self.draws.values()}
        if len(counts) != 1:
            raise PydanticCustomError("draws", "must be as many draws of each quantity, and of one at least")
        return self

    @property
    def draws(self) -> dict[str, FloatArray]:
        """What it tells of, (n,) each."""
        listed = {name: getattr(self, name) for name in type(self).model_fields}
        return {name: np.array(values) for name, values in listed.items() if values is not None}

    @classmethod
    def read(cls, path: Path) -> Self:
        """The draws of a calibration.

        Raises:
            FileNotFoundError: no such file.
            FileError: not a calibration.
        """
        try:
            content = json.loads(read_bytes(path, MOST_FILE))
        except (ValueError, RecursionError) as error:
            if isinstance(error, FileError):
                raise
            raise FileError(path, f"not JSON: {error}") from error
        draws = content.get("draws") if isinstance(content, dict) else None
        if not isinstance(draws, dict):
            raise FileError(path, "draws: missing, so it is not a calibration (probe-env calibrate writes one)")
        if content.get("misspecified") is True:
            warnings.warn(
                f"{path}: the calibration is misspecified: the model cannot have made its logs, whatever friction, and"
                " what is computed with its figures means nothing",
                stacklevel=5,
            )
        try:
            return cls.model_validate(tuples(draws))
        except ValidationError as error:
            raise FileError(path, explain(error, "draws")) from error

    def rows(self, shares: FloatArray) -> dict[str, FloatArray]:
        """Draws (n,) at shares (n,) in (0, 1) of their order by the first quantity; those of a row belong together."""
        draws = self.draws
        order = np.argsort(next(iter(draws.values())), kind="stable")
        rows = order[np.minimum((np.asarray(shares) * len(order)).astype(int), len(order) - 1)]
        return {name: values[rows] for name, values in draws.items()}

    def middle(self, name: str) -> float:
        """Median of a quantity."""
        return float(np.median(self.draws[name]))


def check_draws(posterior: Posterior | None, file: Path | None = None) -> None:
    """Raise ValueError, with a file FileError, if draws are not values that the plant's own fields accept."""
    ranges = {"friction": FRICTION, "contact_stiffness": STIFFNESS, "drag_coefficient": DRAG}
    for name, draws in posterior.draws.items() if posterior else ():
        low, high = ranges.get(name, (0.0, 1.0))
        for value in (draws.min(), draws.max()):
            try:
                within(f"draws.{name}" if file else f"posterior.draws.{name}", float(value), low, high, "")
            except ValueError as error:
                if file:
                    raise FileError(file, str(error)) from None
                raise PydanticCustomError("out_of_range", "{text}", {"text": str(error)}) from None


def with_posterior(given: Mapping[str, Any], folder: Path | None = None) -> dict[str, Any]:
    """A plant's tables with the draws that ``posterior = "calibration.json"`` names, relative to ``folder`` or here.

    Raises:
        FileNotFoundError, FileError: see ``Posterior.read``.
    """
    tables, named = dict(given), given.get("posterior")
    if isinstance(named, str | Path):
        path = (folder or Path()) / named
        tables["posterior"] = Posterior.read(path)
        check_draws(tables["posterior"], path)
    return tables


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
