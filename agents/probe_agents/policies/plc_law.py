"""Feedback laws for a PLC: fast feed and little air up to an onset length, then slow feed and most air.

The best schedules of the vibration map have this form. Onset and slow feed depend on the friction, estimated from the
root tension, and on the helix diameter; measured noise changes the effective length. The least air keeps the root
tension of steady sliding at a multiple of the required one, with this friction.

``PlcIntegral`` adds integral action: beyond the onset, the feed is trimmed until the noise equals a target. The feed
decreases faster than it increases, since vibration costs more than time.
"""

from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final, Self

import numpy as np
from pydantic import model_validator

from probe_agents.policies.fixed import FixedPolicy, gain
from probe_agents.policies.policy import Domain, read_model
from probe_env import Scene
from probe_env.arrays import BoolArray, FloatArray
from probe_env.envs.vibration_map import stored_map
from probe_env.physics.closed_forms import drag_per_metre
from probe_env.physics.model.chain import air_speed
from probe_env.settings import Model, quantity

FRICTION: Final = 0.175
DIAMETER: Final = 1.5
LENGTH: Final = 30.0
"""Reference friction, helix diameter [m] and length [m] of the constants."""
START_FRICTION: Final = 0.25
"""Friction at the start of an insertion: high, so that the drive is not lost before it is measured."""
CREDIBLE: Final = (0.05, 0.35)
"""Range to which the friction is clipped for onset and slow feed."""
APPARENT: Final = (0.05, 2.0)
"""Range of the friction estimate: weight and expanding air, which the estimate lacks, count as friction."""
SHORTEST: Final = 5.0
"""Shortest inserted length for the friction estimate [m]."""
ITERATIONS: Final = 6
"""Newton iterations for the friction: relative error below 1e-6 (a test)."""
STORED, STORED_INTEGRAL = (Path(__file__).parent / "data" / f"{name}.json" for name in ("plc-law", "plc-integral"))
"""Constants of plc-proportional and of plc-integral."""
UNKNOWN_NOISE: Final = 1e-5
"""Initial noise [m]."""


class Constants(Model):
    """The constants of the PLC laws; those without a unit are exponents, fractions, or logarithms of ratios.

    Files may lack some, which then have their defaults; ``noise_average`` that of ``average``.
    """

    average: Annotated[float, quantity(1.0, 1000.0, "s")] = 15.0
    """Time constant of the average of the friction."""
    noise_average: Annotated[float, quantity(1.0, 1000.0, "s")] = 15.0
    """Time constant of the average of the noise for the effective length."""
    fast_feed: Annotated[float, quantity(0.1, 1.0, "")] = 1.0
    """Feed up to the onset, as a fraction of the fastest."""
    fast_air: Annotated[float, quantity(0.0, 1.0, "")] = 0.0
    """Air up to the onset, as a fraction of the range from least to most."""
    slow_air: Annotated[float, quantity(0.0, 1.0, "")] = 1.0
    """Air beyond the onset, as a fraction of the range from least to most."""
    onset_length: Annotated[float, quantity(1.0, 1000.0, "m")] = 25.0
    """Onset length L1 at ``FRICTION`` and ``DIAMETER``: L0 = L1 (mu / 0.175)^-a (D / 1.5 m)^b."""
    onset_friction: Annotated[float, quantity(-10.0, 10.0, "")] = 1.5
    """Exponent a."""
    onset_diameter: Annotated[float, quantity(-10.0, 10.0, "")] = 1.0
    """Exponent b."""
    slow_feed: Annotated[float, quantity(1e-3, 2.0, "m/s")] = 0.16
    """Slow feed u1 at ``LENGTH``, ``FRICTION`` and ``DIAMETER``: u = u1 (L / 30 m)^-c (mu / 0.175)^-d (D / 1.5 m)^e."""
    slow_length: Annotated[float, quantity(-10.0, 10.0, "")] = 0.8
    """Exponent c."""
    slow_friction: Annotated[float, quantity(-10.0, 10.0, "")] = 0.5
    """Exponent d."""
    slow_diameter: Annotated[float, quantity(-10.0, 10.0, "")] = 0.3
    """Exponent e."""
    quiet: Annotated[float, quantity(1e-7, 1e-2, "m")] = 3e-5
    """Reference noise v0, as radial rms: effective length L' = L (v / v0)^s."""
    shift: Annotated[float, quantity(0.0, 2.0, "")] = 0.1
    """Exponent s."""
    max_shift: Annotated[float, quantity(0.0, 5.0, "")] = 0.7
    """Limit of the logarithm of L' / L; the default is a factor of two."""
    margin: Annotated[float, quantity(1.0, 10.0, "")] = 1.5
    """Least ratio of the root tension to the required one, by which the least air is determined."""
    aim: Annotated[float, quantity(1e-6, 1e-3, "m")] = 3.5e-5
    """Target noise v_a of the integral action, as radial rms."""
    trim_time: Annotated[float, quantity(1.0, 10000.0, "s")] = 80.0
    """Time constant tau: d(ln feed) / dt = ln(v_a / v) / tau."""
    trim_average: Annotated[float, quantity(0.1, 1000.0, "s")] = 4.0
    """Time constant of the average of the noise v that is compared with the target."""
    max_excess: Annotated[float, quantity(0.01, 10.0, "")] = 1.0
    """Limit of ln(v / v_a), which decreases the feed."""
    max_deficit: Annotated[float, quantity(0.01, 10.0, "")] = 0.5
    """Limit of ln(v_a / v), which increases the feed."""
    max_decrease: Annotated[float, quantity(0.0, 5.0, "")] = 0.5
    """Limit of the decrease of ln(feed) by the integral action."""
    max_increase: Annotated[float, quantity(0.0, 5.0, "")] = 0.5
    """Limit of the increase of ln(feed) by the integral action."""

    @model_validator(mode="before")
    @classmethod
    def _one_average(cls, fields: Any) -> Any:
        given = isinstance(fields, dict) and "average" in fields
        return {"noise_average": fields["average"], **fields} if given else fields


TRIM: Final = tuple(Constants.model_fields)[tuple(Constants.model_fields).index("aim") :]
"""Constants of the integral action."""


class PlantData(Model):
    """Data of the plant that enter the law."""

    air_speed_per_supply: float
    """Wind per air supply [(m/s) / (m3/s)]."""
    drag: float
    """Drag of the floats per metre over the square of the wind [N s2/m3], (10)."""
    float_diameter: float
    """[m]."""
    feed_speeds: tuple[float, float]
    """Slowest feed, and fastest feed that the instrument permits [m/s]."""
    air_supply_rates: tuple[float, float]
    """Least and most air [m3/s]."""
    required_tension: float
    """Root tension below which the drive is lost [N]."""

    @classmethod
    def of(cls, config: Any) -> Self:
        """Read the data from a task."""
        scene: Scene = config.scene
        return cls(
            air_speed_per_supply=air_speed(scene, 1.0),
            drag=drag_per_metre(scene),
            float_diameter=scene.probe.carrier_float_diameter,
            feed_speeds=(config.feed_speeds[0], config.permitted_feed),
            air_supply_rates=config.air_supply_rates,
            required_tension=config.required_tension,
        )


def read_constants(path: str | Path = STORED) -> Constants:
    """Read the constants from a file (JSON), see ``read_model``."""
    return read_model(path, Constants, "the constants of a law", "constants")


def _log_noise(measured: dict[str, FloatArray]) -> FloatArray:
    return np.asarray(np.log(np.maximum(measured["rf_noise"], 1e-7)))


def friction_of(tension: FloatArray, measured: dict[str, FloatArray], plant: PlantData) -> FloatArray:
    """Friction (n,) of steady sliding: solves y = (1 - exp(-x)) / x for x = mu' L / r by Newton's method.

    y is the ratio of the tension to the tension without friction.
    """
    length = np.maximum(measured["inserted_length"], SHORTEST)
    wind = plant.air_speed_per_supply * measured["air_supply_rate"] - measured["feed_speed"]
    fraction = np.clip(tension / np.maximum(plant.drag * wind * wind * length, 1e-6), 0.01, 0.95)
    x = 1.0 / fraction
    for _ in range(ITERATIONS):
        fallen = np.exp(-x)
        x = x - (x * fraction - 1.0 + fallen) / (fraction - fallen)
    friction = x / _angle(length, measured["helix_diameter"], plant)
    return np.asarray(np.clip(friction, *APPARENT))


def _angle(length: FloatArray, diameter: FloatArray, plant: PlantData) -> FloatArray:
    """Angle (n,) of the cable on the wall [rad]."""
    return np.asarray(2.0 * length / diameter * (1.0 - plant.float_diameter / diameter))


def least_air(
    tension: float, length: FloatArray, friction: FloatArray, diameter: FloatArray, feed: FloatArray, plant: PlantData
) -> FloatArray:
    """Air (n,) [m3/s] for a root tension [N] of steady sliding, the inverse of ``friction_of``, within the range."""
    length = np.maximum(length, SHORTEST)
    x = friction * _angle(length, diameter, plant)
    wind = np.sqrt(tension * x / (plant.drag * length * (1.0 - np.exp(-x))))
    return np.asarray(np.clip((wind + feed) / plant.air_speed_per_supply, *plant.air_supply_rates))


def law_at(
    constants: Constants, plant: PlantData, averaged: tuple[FloatArray, FloatArray, FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Feed [m/s] and air [m3/s], and whether the onset is past, (n,) each.

    Args:
        constants: the constants.
        plant: data of the plant.
        averaged: length [m], friction, logarithm of the noise [m] and helix diameter [m], (n,) each.
    """
    c = constants
    inserted, noise, diameter = averaged[0], averaged[2], averaged[3] / DIAMETER
    friction = np.clip(averaged[1], *CREDIBLE) / FRICTION
    shift = np.clip(c.shift * (noise - np.log(c.quiet)), -c.max_shift, c.max_shift)
    length = inserted * np.exp(shift)
    onset = c.onset_length * friction**-c.onset_friction * diameter**c.onset_diameter
    slow = c.slow_feed * (np.maximum(length, 0.1) / LENGTH) ** -c.slow_length * friction**-c.slow_friction
    slow = np.clip(slow * diameter**c.slow_diameter, *plant.feed_speeds)
    past = length >= onset
    feed, air = np.where(past, slow, c.fast_feed * plant.feed_speeds[1]), np.where(past, c.slow_air, c.fast_air)
    least = least_air(c.margin * plant.required_tension, inserted, averaged[1], averaged[3], feed, plant)
    return feed, (1.0 - air) * least + air * plant.air_supply_rates[1], past


@dataclass
class PlcProportional(FixedPolicy):
    """The PLC law as a policy. Memory: averages of friction and of the logarithm of the noise."""

    constants: Constants = field(default_factory=read_constants)
    memory: ClassVar[int] = 2
    needs: ClassVar[tuple[str, ...]] = ("root_tension",)

    def __post_init__(self) -> None:
        super().__post_init__()
        self._plant = PlantData.of(self.config)

    @property
    def domain(self) -> Domain:
        """Tubes of the vibration map from which the constants were found."""
        return Domain.of_map(stored_map())

    def start(self, memory: FloatArray) -> None:
        """Memory: the start of the friction and reference noise."""
        memory[:] = START_FRICTION, np.log(self.constants.quiet)

    def targets(self, measured: dict[str, FloatArray], memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Feed and air from length, tension, noise and helix diameter."""
        return self._law(measured, memory)[:2]

    def _law(self, measured: dict[str, FloatArray], memory: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
        c, plant = self.constants, self._plant
        friction, noise = friction_of(measured["root_tension"], measured, plant), _log_noise(measured)
        memory[:, 0] += gain(self.config, c.average) * (friction - memory[:, 0])
        memory[:, 1] += gain(self.config, c.noise_average) * (noise - memory[:, 1])
        return law_at(c, plant, (measured["inserted_length"], memory[:, 0], memory[:, 1], measured["helix_diameter"]))

    def describe(self) -> dict[str, Any]:
        """With its constants."""
        return {"policy": type(self).__name__, **self.constants.model_dump()}


@dataclass
class PlcIntegral(PlcProportional):
    """Applies the law with trimmed feed. Memory: the law's, average of the logarithm of the noise, trim."""

    constants: Constants = field(default_factory=partial(read_constants, STORED_INTEGRAL))
    memory: ClassVar[int] = PlcProportional.memory + 2

    def start(self, memory: FloatArray) -> None:
        """Memory: the law's, low noise, no trim."""
        super().start(memory[:, : PlcProportional.memory])
        memory[:, PlcProportional.memory :] = np.log(UNKNOWN_NOISE), 0.0

    def targets(self, measured: dict[str, FloatArray], memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Feed and air of the law; the feed beyond the onset is trimmed."""
        feed, air, past = self._law(measured, memory[:, : PlcProportional.memory])
        c, noise, trim = self.constants, memory[:, -2], memory[:, -1]
        noise += gain(self.config, c.trim_average) * (_log_noise(measured) - noise)
        short = np.clip(np.log(c.aim) - noise, -c.max_excess, c.max_deficit)
        trim += np.where(past, self.config.period / c.trim_time * short, 0.0)
        np.clip(trim, -c.max_decrease, c.max_increase, out=trim)
        trimmed = np.clip(feed * np.exp(trim), *self._plant.feed_speeds)
        return np.where(past, trimmed, feed), air
