"""A plant from one file, ``tube.toml``: tubes, probe, air, feed device and task, with uncertainties.

``gymnasium.make(..., tube=...)`` and ``--tube`` of every command take the same object, and stored results contain it:
the task includes the scene, so that results of different plants are never mixed. An uncertain quantity is a range, a
mean with its standard deviation, or the joint draws of a calibration, read from ``calibration.json``.
"""

import json
import math
import warnings
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Self

import numpy as np
import numpy.typing as npt
from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    FiniteFloat,
    ValidationError,
    ValidationInfo,
    model_validator,
)  # fmt: skip
from scipy.optimize import linear_sum_assignment
from scipy.stats import qmc, truncnorm

from probe_env.arrays import FloatArray
from probe_env.envs.contexts import Context
from probe_env.envs.task.config import MEASURES, VISIBLE_FIELDS, TaskConfig, ungrouped
from probe_env.files import MEBI, FileError, read_bytes
from probe_env.inspection.instrument import Instrument
from probe_env.inspection.sensor import Sensor
from probe_env.physics.closed_forms.route import Route, min_air, one_helix, required_root_tension, route_forces
from probe_env.scene import Air, Contact, Probe, Scene, Tube
from probe_env.settings import Model, Quantity, errors_in, explain, is_number, quantity, range_of, tuples, within


class Between(Model):
    """Uniform distribution from ``low`` to ``high``."""

    low: FiniteFloat
    high: FiniteFloat

    @model_validator(mode="after")
    def _ascends(self) -> Self:
        if not self.low <= self.high:
            raise ValueError(f"low = {self.low!r} must not exceed high = {self.high!r}")
        return self


class Normal(Model):
    """Normal distribution, truncated to the accepted range of the quantity."""

    mean: FiniteFloat
    std: Annotated[FiniteFloat, Field(gt=0.0)]


def _as_figure(value: Any) -> Any:
    """The model whose keys a table has; pydantic would report errors for each model."""
    if isinstance(value, Between | Normal) or is_number(value):
        return value
    for kind in (Between, Normal):
        if isinstance(value, Mapping) and set(value) & set(kind.model_fields):
            return kind.model_validate(dict(value))
    raise ValueError("must be a number, a table of low and high, or one of mean and std")


Figure = Annotated[float | Between | Normal, BeforeValidator(_as_figure)]


def quantiles(figure: Figure, fractions: npt.ArrayLike, low: float, high: float) -> FloatArray:
    """Quantiles of a figure at ``fractions`` in (0, 1), of their shape; ``low`` and ``high`` are its accepted range."""
    fractions = np.asarray(fractions, dtype=float)
    match figure:
        case Between():
            return figure.low + fractions * (figure.high - figure.low)
        case Normal():
            ends = (low - figure.mean) / figure.std, (high - figure.mean) / figure.std
            return np.asarray(truncnorm.ppf(fractions, *ends, loc=figure.mean, scale=figure.std))
        case _:
            return np.full(fractions.shape, figure)


def middle(figure: Figure, low: float, high: float) -> float:
    """Median of a figure, used where one value is needed."""
    return float(quantiles(figure, 0.5, low, high))


FRICTION, STIFFNESS, DRAG, DAMPING = (0.0, 1.0), (1e2, 1e8), (0.0, 10.0), (0.0, 1.0)
"""Accepted range of each uncertain quantity, in the units of its field."""


class _Figure(Quantity):
    """Accepted range of a figure (of the mean of a normal one) or of each number of a list."""

    def check(self, value: Any) -> Any:
        for name, number in _numbers(value):
            within(name, number, self.low, self.high, self.unit)
        return value


def _numbers(value: Any) -> list[tuple[str, float]]:
    """Numbers of a figure, with their keys, or of a tuple; of a normal figure the mean."""
    if isinstance(value, Between | Normal):
        return list(value.model_dump(exclude={"std"}).items())
    return [("", number) for number in (value if isinstance(value, tuple) else (value,))]


class Tubes(Model):
    """Tubes of a plant: one bore, one length, and one or more helix diameters."""

    helix_diameter: Annotated[
        float | Annotated[tuple[float, ...], Field(min_length=1, max_length=1000)], _Figure(0.3, 50.0, "m")
    ] = Tube().helix_diameter
    """Helix diameter of the tube axis [m], a number or a list."""
    inner_diameter: Annotated[float, range_of(Tube, "inner_diameter")] = Tube().inner_diameter
    """Bore [m]."""
    helix_length: Annotated[float, range_of(Tube, "helix_length")] = Tube().helix_length
    """Length of the helix along the tube axis [m]."""
    support_spacing: Annotated[float, quantity(1e-3, 100.0, "m")] | None = None
    """Distance between supports of the tube [m]; used by ``probe-env signal`` only."""


class Walls(Model):
    """Contact of floats and walls."""

    friction: Annotated[Figure, _Figure(*FRICTION, "")] = Contact().friction
    """Friction coefficient [-]: a number, ``{low, high}`` or ``{mean, std}``."""
    stiffness: Annotated[Figure, _Figure(*STIFFNESS, "N/m")] = Contact().stiffness
    """Contact stiffness per float [N/m]: a number, ``{low, high}`` or ``{mean, std}``."""
    walls: Literal["both", "inner"] = "both"
    """Walls that the floats can touch."""
    cable: bool = False
    """Whether the cable between floats can touch the walls: needed for a weak cable or high compression."""


PER_HOUR: Final = {
    "air_supply_rates_m3_per_h": "air_supply_rates", "air_supply_step_m3_per_h": "air_supply_step",
    "air_ramp_m3_per_h_per_s": "air_ramp",
}  # fmt: skip
"""Fields of ``[air]`` in m3/h -> field of ``Supply`` in m3/s."""
MAX_PER_HOUR: Final = 720.0


def supply_in_si(fields: Mapping[str, Any]) -> dict[str, Any]:
    """Fields of ``Supply``, with those of ``PER_HOUR`` in m3/s; raises if one is not valid or given in both units."""
    known = {name: value for name, value in fields.items() if name not in PER_HOUR}
    for name in fields.keys() & PER_HOUR:
        value, si, highest = fields[name], PER_HOUR[name], MAX_PER_HOUR
        numbers = value if isinstance(value, list | tuple) else [value]
        if si in known:
            problem = f"{si} is given, too: leave one out"
        elif not all(is_number(number) and 0.0 <= number <= highest for number in numbers):
            problem = f"must be within 0 to {highest:g} m3/h"
        else:
            known[si] = tuple(n / 3600.0 for n in numbers) if numbers is value else value / 3600.0
            continue
        raise ValueError(f"{name} = {value!r}: {problem}")
    return known


def supply_per_hour(fields: Mapping[str, Any]) -> dict[str, Any]:
    """Fields of ``Supply`` with the air supply in m3/h, for a file."""
    ending = {si: name for name, si in PER_HOUR.items()}
    return {
        ending.get(name, name): value if name not in ending
        else [float(f"{3600.0 * n:.12g}") for n in value] if isinstance(value, list | tuple)
        else float(f"{3600.0 * value:.12g}")
        for name, value in fields.items()
    }  # fmt: skip


class Supply(Model):
    """Air and air supply; the fields of ``PER_HOUR`` are accepted, too."""

    density: Annotated[float, range_of(Air, "density")] = Air().density
    """Air density [kg/m3]."""
    drag_coefficient: Annotated[Figure, _Figure(*DRAG, "")] = Air().drag_coefficient
    """Drag coefficient of a float [-]: a number, ``{low, high}`` or ``{mean, std}``."""
    air_supply_rates: Annotated[tuple[float, float] | None, range_of(TaskConfig, "air_supply_rates")] = None
    """Range of the air supply [m3/s]; default: the task's."""
    air_supply_step: Annotated[float | None, range_of(TaskConfig, "air_supply_step")] = None
    """Resolution of the air supply [m3/s]; 0: continuous."""
    air_lag: Annotated[float | None, range_of(TaskConfig, "air_lag")] = None
    """Time constant of the air supply [s]."""
    air_ramp: Annotated[float | None, range_of(TaskConfig, "air_ramp")] = None
    """Largest change of the air supply per second [m3/s2]; default: no limit."""

    @model_validator(mode="before")
    @classmethod
    def _in_si(cls, fields: Any) -> Any:
        return supply_in_si(fields) if isinstance(fields, Mapping) else fields


class FeedDevice(Model):
    """Feed device."""

    feed_speeds: Annotated[tuple[float, float] | None, range_of(TaskConfig, "feed_speeds")] = None
    """Range of the feed speed [m/s]; default: the task's."""
    feed_speed_step: Annotated[float | None, range_of(TaskConfig, "feed_speed_step")] = None
    """Resolution of the feed speed [m/s]; 0: continuous."""
    ramp: Annotated[float | None, range_of(TaskConfig, "ramp")] = None
    """Acceleration of the feed [m/s2]."""


class Bundle(Model):
    """A bundle of tubes to inspect, for the hours that an evaluation reports."""

    tubes: Annotated[int, Field(ge=1, le=1_000_000)]
    """Number of tubes."""
    setup_time: Annotated[float, quantity(0.0, 1e5, "s")] = 0.0
    """Time per tube that is not simulated [s]: next tube, way to the helix and its first metres."""
    withdrawal_time: Annotated[float, quantity(0.0, 1e5, "s")] | None = None
    """Time per tube to withdraw the probe [s]; not used if the withdrawal is simulated."""
    withdrawal_speed: Annotated[float, quantity(1e-3, 10.0, "m/s")] | None = None
    """Mean speed of the withdrawal [m/s], instead of the time."""

    @model_validator(mode="after")
    def _withdraws_once(self) -> Self:
        if (self.withdrawal_time is None) == (self.withdrawal_speed is None):
            problem = "give withdrawal_time [s] or withdrawal_speed [m/s], one of them"
            raise ValueError(problem)
        return self


MAX_FILE: Final = 16 * MEBI
MAX_DRAWS: Final = 4096
Draws = Annotated[tuple[FiniteFloat, ...], Field(min_length=1, max_length=MAX_DRAWS)]


class Posterior(Model):
    """Joint posterior draws of a calibration, equally likely; the k-th values of all quantities form one draw."""

    friction: Annotated[Draws, _Figure(*FRICTION, "")] | None = None
    """[-]."""
    contact_stiffness: Annotated[Draws, _Figure(*STIFFNESS, "N/m")] | None = None
    """[N/m]."""
    drag_coefficient: Annotated[Draws, _Figure(*DRAG, "")] | None = None
    """[-]."""
    damping_time: Annotated[Draws, _Figure(*DAMPING, "s")] | None = None
    """[s]."""
    misspecified: bool = Field(default=False, exclude=True)
    """Whether the model does not fit the logs of the calibration with any parameters."""

    @model_validator(mode="after")
    def _belong_together(self) -> Self:
        counts = {len(draws) for draws in self.draws.values()}
        if len(counts) != 1:
            raise ValueError("must be as many draws of each quantity, and at least one quantity")
        return self

    @property
    def draws(self) -> dict[str, FloatArray]:
        """Draws (n,) by quantity."""
        listed = {name: getattr(self, name) for name in type(self).model_fields if name != "misspecified"}
        return {name: np.array(values) for name, values in listed.items() if values is not None}

    @classmethod
    def read(cls, path: Path) -> Self:
        """The draws of a calibration."""
        text = read_bytes(path, MAX_FILE)
        try:
            content = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise FileError(path, f"not JSON: {error}") from error
        draws = content.get("draws") if isinstance(content, dict) else None
        if not isinstance(draws, dict):
            raise FileError(path, "draws: missing, so it is not a calibration (probe-env calibrate writes one)")
        misspecified = content.get("misspecified") is True
        if misspecified:
            warnings.warn(
                f"{path}: the calibration is misspecified: the model does not fit its logs with any parameters; do not"
                " use results computed from it",
                stacklevel=5,
            )
        with errors_in(path, "draws"):
            return cls.model_validate(tuples(draws) | {"misspecified": misspecified})

    def rows(self, fractions: FloatArray) -> dict[str, FloatArray]:
        """Joint draws (n,) at ``fractions`` (n,) in (0, 1) of their order by the first quantity."""
        draws = self.draws
        order = np.argsort(next(iter(draws.values())), kind="stable")
        rows = order[np.minimum((np.asarray(fractions) * len(order)).astype(int), len(order) - 1)]
        return {name: values[rows] for name, values in draws.items()}

    def middle(self, name: str) -> float:
        """Median of a quantity."""
        return float(np.median(self.draws[name]))


def _posterior_of(source: Any, info: ValidationInfo) -> Any:
    """The draws of a ``calibration.json``, relative to the "folder" of the context or here."""
    if not isinstance(source, str | Path):
        return source
    try:
        return Posterior.read((info.context or {}).get("folder", Path()) / source)
    except FileNotFoundError as error:
        raise ValueError(f"no such file: {error.filename}") from error


MAX_TUBES: Final = 4096
FACTORS: Final = (0.1, 10.0)
"""Accepted range of the drag factor of a ``Context``."""
RARE: Final = 1e-6
MAX_LENGTH: Final = 60.0  # [m], longest helix for which the default time limit is made
OF_FEED: Final = ("feed_speeds", "feed_speed_step", "ramp")
OF_AIR: Final = ("air_supply_rates", "air_supply_step", "air_lag", "air_ramp")
"""Fields of the task in the tables of the feed device and of the air."""


class Plant(Model):
    """Tubes, probe and task of a plant; defaults are table 2's and the task's."""

    assumptions: Literal["study", "whole"] = "whole"
    """Model of the simulation: that of the study, or with all that it leaves out (``Scene.whole``)."""
    tube: Tubes = Tubes()
    probe: Probe = Probe()
    contact: Walls = Walls()
    air: Supply = Supply()
    feed: FeedDevice = FeedDevice()
    sensor: Sensor = Sensor()
    task: Annotated[dict[str, Any], BeforeValidator(ungrouped)] = Field(default_factory=dict)
    """Fields of ``TaskConfig``, by themselves or in tables of its groups."""
    posterior: Annotated[Posterior | None, BeforeValidator(_posterior_of)] = None
    """Draws of a calibration, which replace the figures of the same quantities; in a file the path to them."""
    route: Annotated[Route, AfterValidator(one_helix)] = ()
    """Segments from the feed device to the end of the tube, one of them the helix; the task's ``required_tension``
    follows from it. Empty: not known."""
    instrument: Instrument | None = None
    """Instrument and procedure; None: not known."""
    bundle: Bundle | None = None
    """Bundle of tubes whose hours are reported; None: no hours."""

    @model_validator(mode="before")
    @classmethod
    def _takes_lists(cls, plant: Any) -> Any:
        if not isinstance(plant, Mapping):
            return plant
        for table, name in (("air", "compressible"), ("contact", "weight")):
            if isinstance(plant.get(table), Mapping) and name in plant[table]:
                raise ValueError(f"{table}.{name}: is set for all terms by assumptions = 'whole' (default) or 'study'")
        return tuples(plant)

    @model_validator(mode="after")
    def _is_possible(self) -> Self:
        misplaced = (
            dict.fromkeys(OF_FEED, "feed")
            | dict.fromkeys(OF_AIR, "air")
            | {"scene": "tube", "sensor": "sensor", "instrument": "instrument"}
        )
        for name in self.task:
            if name in misplaced or name in VISIBLE_FIELDS:
                reason = f"belongs in [{misplaced[name]}]" if name in misplaced else "is set by the policy"
                raise ValueError(f"task.{name}: {reason}")
        minimum, maximum = self._drag_factors(np.array([RARE, 1.0 - RARE]))
        low, high = FACTORS
        if not low <= minimum <= maximum <= high:
            text = (
                f"air.drag_coefficient: {minimum:g} to {maximum:g} times its median is beyond {low:g} to {high:g} times"
            )
            raise ValueError(text)
        try:
            assert self.scenes
            assert self.config
        except ValidationError as error:
            field = str((error.errors()[0]["loc"] or ("",))[0])
            table = "task" if field in TaskConfig.model_fields or field in self.task else ""
            text = explain(error, "feed" if field in OF_FEED else "air" if field in OF_AIR else table)
            raise ValueError(text) from error
        if problem := implausible(self):
            raise ValueError(problem)
        return self

    def _middle(self, name: str) -> float:
        """Median of a quantity from the posterior, else from its figure."""
        if self.posterior and name in self.posterior.draws:
            return self.posterior.middle(name)
        figures = {
            "friction": (self.contact.friction, *FRICTION),
            "contact_stiffness": (self.contact.stiffness, *STIFFNESS),
            "drag_coefficient": (self.air.drag_coefficient, *DRAG),
            "damping_time": (self.probe.damping_time, *DAMPING),
        }
        return middle(*figures[name])

    @property
    def diameters(self) -> tuple[float, ...]:
        """Helix diameters [m]."""
        diameters = self.tube.helix_diameter
        return diameters if isinstance(diameters, tuple) else (diameters,)

    @property
    def scene(self) -> Scene:
        """A tube of the plant with medians of uncertain quantities; the probe is inserted up to 50 m."""
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
        scenes = (Scene.fitted({"tube": tube | {"helix_diameter": diameter}, **rest}) for diameter in self.diameters)
        return tuple(scene.whole() if self.assumptions == "whole" else scene for scene in scenes)

    @cached_property
    def config(self) -> TaskConfig:
        """The plant's task."""
        return self.configured()

    def configured(
        self, defaults: Mapping[str, Any] | None = None, changes: Mapping[str, Any] | None = None
    ) -> TaskConfig:
        """The task of the plant: ``changes`` override the plant, which overrides ``defaults`` of an environment.

        The time limit grows in proportion to a helix longer than 60 m, unless it is set.
        """
        device = {
            name: getattr(part, name) for part, names in ((self.feed, OF_FEED), (self.air, OF_AIR)) for name in names
        }
        values: dict[str, Any] = {"scene": self.scene, "sensor": self.sensor, "instrument": self.instrument}
        if self.tube.helix_length > MAX_LENGTH:
            values["time_limit"] = TaskConfig().time_limit * self.tube.helix_length / MAX_LENGTH
        if self.route:
            values["required_tension"] = self._route_tension
        values |= dict(defaults or {}) | {name: value for name, value in device.items() if value is not None}
        return TaskConfig.model_validate(tuples(values | self.task | ungrouped(dict(changes or {}))))

    @cached_property
    def _route_tension(self) -> float:
        """Root tension that the parts before the helix need [N], at the median friction; most in the largest helix."""
        return required_root_tension(self.route, max(self.scenes, key=lambda scene: scene.tube.helix_diameter))

    def check_route(self, contexts: Sequence[Context] = (), fraction: float = 0.95) -> float:
        """Least air supply rate [m3/s] up to the length in the helix at which lost drive is scored; 0 without a route.

        Args:
            contexts: tubes; friction is taken at their quantile ``fraction`` and drag at 1 - ``fraction``, in the
                smallest helix, which has the least tension. Empty: medians.
            fraction: of the tubes.

        Raises:
            ValueError: the most air of the plant is not enough; names the position of the tip where the probe stops.
        """
        if not self.route:
            return 0.0
        scene = min(self.scenes, key=lambda scene: scene.tube.helix_diameter)
        changes: dict[str, Any] = {"feed_speed": self.config.feed_speeds[0]}
        if contexts:
            drag = np.quantile([context.drag_factor for context in contexts], 1.0 - fraction)
            friction = np.quantile([context.friction for context in contexts], fraction)
            changes["air"] = {"drag_coefficient": float(drag) * scene.air.drag_coefficient}
            changes["contact"] = {"friction": float(friction)}
        scene, maximum = scene.model_copy(update=changes), self.config.air_supply_rates[1]
        forces = route_forces(self.route, scene, maximum)
        air = min_air(self.route, scene)
        short = np.flatnonzero(forces.feed < -1e-9)
        if short.size:
            stop, needed = short[0], air.max()
            more = f"{3600.0 * needed:.4g} m3/h" if math.isfinite(needed) else "no air up to 720 m3/h"
            raise ValueError(
                f"route.{forces.segment[stop]}: the probe stops with its tip {forces.tip[stop]:.3g} m from the feed"
                f" device, which would have to push with {-forces.feed[stop]:.2g} N: the most air of"
                f" air_supply_rates is {3600.0 * maximum:.4g} m3/h, and {more} is enough for the whole route"
            )
        scored_from = forces.tip[forces.in_helix].min() + self.config.lost_drive_from
        return float(air[forces.tip <= scored_from].max())

    def bundle_for(self, config: TaskConfig) -> Bundle | None:
        """The bundle with its withdrawal as a time, for the helix and the route; 0 if the task has both passes."""
        if self.bundle is None:
            return None
        time = 0.0 if config.returns else self.bundle.withdrawal_time
        if time is None:
            assert self.bundle.withdrawal_speed
            length = self.tube.helix_length + sum(segment.length or 0.0 for segment in self.route)
            time = length / self.bundle.withdrawal_speed
        return self.bundle.model_copy(update={"withdrawal_time": time, "withdrawal_speed": None})

    def _drag_factors(self, fractions: FloatArray) -> FloatArray:
        """(n,) drag over its median at shares (n,) in (0, 1)."""
        median = self._middle("drag_coefficient")
        if self.posterior and "drag_coefficient" in self.posterior.draws:
            drag = np.quantile(self.posterior.draws["drag_coefficient"], fractions)
        else:
            drag = quantiles(self.air.drag_coefficient, fractions, *DRAG)
        return drag / median if median > 0.0 else np.ones(len(fractions))

    def contexts(self, count: int, seed: int = 0) -> tuple[Context, ...]:
        """Sample ``count`` tubes with friction, stiffness and drag spread over their distributions.

        Samples are from Halton's sequence, scrambled by the seed, so that every prefix is balanced; the diameters occur
        equally often, each with samples over the whole distribution. A longer list begins with the shorter one. Draws
        of a posterior stay joint; its damping is the median in all tubes.
        """
        if not 1 <= count <= MAX_TUBES:
            raise ValueError(f"tubes = {count!r} is outside the accepted range 1 to {MAX_TUBES}")
        blocks = -(-count // len(self.diameters))
        fractions = qmc.Halton(3, rng=np.random.default_rng([2026, seed])).random(blocks * len(self.diameters))
        helices = _balanced_diameters(fractions, self.diameters)
        fractions = fractions[:count]
        samples = {
            "friction": quantiles(self.contact.friction, fractions[:, 0], *FRICTION),
            "contact_stiffness": quantiles(self.contact.stiffness, fractions[:, 1], *STIFFNESS),
        }
        factor = self._drag_factors(fractions[:, 2])
        if self.posterior:
            joint = self.posterior.rows(fractions[:, 0])
            samples |= {name: values for name, values in joint.items() if name in samples}
            if "drag_coefficient" in joint:
                factor = joint["drag_coefficient"] / self._middle("drag_coefficient")
        factor = np.clip(factor, *FACTORS)  # clips one in a million
        return tuple(
            Context(
                friction=round(float(samples["friction"][k]), 4),
                contact_stiffness=float(f"{samples['contact_stiffness'][k]:.4g}"),
                drag_factor=round(float(factor[k]), 4),
                helix_diameter=helices[k],
            )
            for k in range(count)
        )


def implausible(plant: Plant) -> str:
    """Error message for values that are within their range but implausible; empty if there are none."""
    config, scene = plant.config, plant.scene
    for table, name, of, factor, unit in (
        ("feed", "feed_speed_step", "feed_speeds", 1.0, "m/s"),
        ("air", "air_supply_step", "air_supply_rates", 3600.0, "m3/h"),
    ):
        step, low, high = (factor * value for value in (getattr(config, name), *getattr(config, of)))
        if step > 0.0 and step * math.floor(high / step * (1.0 + 1e-9)) < low * (1.0 - 1e-9):
            return (
                f"{table}.{name} = {step:g} {unit}: no whole step lies within {of}, {low:g} to {high:g} {unit}; use 0"
                " (continuous) or a smaller step"
            )
    try:
        plant.check_route()
    except ValueError as error:
        return str(error)
    floats = min(scene.probe.guide_float_diameter, scene.probe.carrier_float_diameter)
    clearance = scene.tube.clear_diameter - floats
    if config.vibration_measure == "displacement" and config.limit > clearance:
        return (
            f"task.vibration_limit = {config.limit:g} m is more than the {clearance:.3g} m that the floats have in the"
            " tube: the unit is metres, 0.1 mm is 1e-4"
        )
    for name, figure in (
        ("contact.friction", plant.contact.friction),
        ("contact.stiffness", plant.contact.stiffness),
        ("air.drag_coefficient", plant.air.drag_coefficient),
    ):
        if isinstance(figure, Normal) and figure.std > figure.mean:
            return (
                f"{name}.std = {figure.std:g} is more than the mean, {figure.mean:g}: use low and high for a"
                " quantity this uncertain"
            )
    return ""


FAR: Final = 50.0
USUAL: Final = {
    "tube": {"support_spacing": (1.5, "m")},
    "route": {"length": (10.0, "m"), "slope": (90.0, "degrees"), "bend_radius": (1.0, "m")},
    "contact": {"friction": (0.15, ""), "stiffness": (1e5, "N/m")},
    "air": {"air_supply_rates": (0.0175, "m3/s"), "air_lag": (1.0, "s")},
    "feed": {"feed_speeds": (0.1, "m/s"), "ramp": (0.5, "m/s2")},
    "instrument": {"sample_rate": (500.0, "Hz"), "bandwidth": (100.0, "Hz"), "test_frequency": (160.0, "Hz")},
}
"""Usual value and unit by table and field of a plant, where a value in another unit is within the accepted range."""


def unusual(plant: Plant) -> list[str]:
    """Notes on values more than ``FAR`` times larger or smaller than ``USUAL``; zeros are left out."""
    limit = {"vibration_limit": (MEASURES[plant.config.vibration_measure][1], "in SI units")}
    parts: list[tuple[str, Model | None]] = [(f"route.{k}", segment) for k, segment in enumerate(plant.route)]
    parts += [(name, getattr(plant, name)) for name in USUAL if name != "route"] + [("task", plant.config)]
    return [
        f"{table}.{name} = {number:.3g} is far from a usual {f'{usual:g} {unit}'.rstrip()}: is the unit right?"
        for table, part in parts
        for name, (usual, unit) in (USUAL | {"task": limit})[table.partition(".")[0]].items()
        for _, number in _numbers(getattr(part, name, None))
        if number and not 1.0 / FAR <= abs(number) / usual <= FAR
    ]


def _balanced_diameters(fractions: FloatArray, diameters: Sequence[float]) -> list[float]:
    """Diameter of each tube: every block has all diameters, and each diameter has samples over the whole distribution.

    In sequence, every second tube would have every second diameter and, as Halton's first sequence has base 2, friction
    from one half of its range. So diameters are assigned to the tubes of a block such that the sums of centred shares
    and their squares over the tubes of each diameter stay minimal.

    Args:
        fractions: (n, 3) of friction, stiffness and drag, n a multiple of the number of diameters.
        diameters: [m].
    """
    centred = np.hstack([fractions, fractions**2]) - np.repeat([1.0 / 2.0, 1.0 / 3.0], fractions.shape[1])
    sums, assigned = np.zeros((len(diameters), centred.shape[1])), []
    for block in centred.reshape(-1, *sums.shape):
        _, tube_of = linear_sum_assignment(((sums[:, None] + block) ** 2).sum(axis=-1))
        sums += block[tube_of]
        assigned += [diameters[k] for k in tube_of.argsort()]
    return assigned


def map_file(plant_file: Path) -> Path:
    """File of the vibration map of a plant: NAME-map.npz next to the plant's file."""
    return plant_file.with_name(f"{plant_file.stem}-map.npz")


PlantSource = Plant | str | Path | Mapping[str, Any] | None
"""A plant, its file or its fields."""


def plant_of(source: PlantSource) -> Plant | None:
    """A plant from its file, its fields or itself; None for None."""
    if source is None or isinstance(source, Plant):
        return source
    return Plant.model_validate(source) if isinstance(source, Mapping) else Plant.from_toml(source)
