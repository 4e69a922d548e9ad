"""Feedback laws for a PLC: fast feed and least air up to an onset length, then slow feed and most air; ten constants.

The best schedules of the vibration map have this form. Onset and slow feed depend on the friction, estimated from the
root tension, and on the helix diameter; measured noise changes the effective length.

``PlcIntegral`` adds integral action: beyond the onset, the feed is trimmed until the noise equals a target. The feed
decreases faster than it increases, since vibration costs more than time.
"""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final, Self

import numpy as np

from probe_agents.policies.fixed import FixedPolicy, gain
from probe_agents.policies.on_map import min_air
from probe_agents.policies.policy import Domain, read_model
from probe_env import Scene
from probe_env.arrays import FloatArray
from probe_env.envs.vibration_map import stored_map
from probe_env.physics.closed_forms import drag_per_metre
from probe_env.physics.model.chain import air_speed
from probe_env.settings import Model, quantity

FRICTION: Final = 0.175
DIAMETER: Final = 1.5
LENGTH: Final = 30.0
"""Reference friction, helix diameter [m] and length [m] of the constants."""
CREDIBLE: Final = (0.05, 0.35)
"""Range to which the friction estimate is clipped."""
SHORTEST: Final = 5.0
"""Shortest inserted length for the friction estimate [m]."""
MAX_SHIFT: Final = 0.7
"""Limit of the logarithm of effective over inserted length: a factor of two."""
ITERATIONS: Final = 6
"""Newton iterations for the friction: relative error below 1e-6 (a test)."""
STORED: Final = Path(__file__).parent / "data" / "plc-law.json"
NOISE_AVERAGE: Final = 4.0
"""Time constant of the average of the logarithm of the noise that is compared with the target [s]."""
UNKNOWN_NOISE: Final = 1e-5
"""Initial noise [m]."""
LOWERED, RAISED = 1.0, 0.5
"""Limits of the logarithm of noise over target, for decreasing and increasing feed."""
MAX_TRIM: Final = 0.5
"""Limit of the magnitude of the logarithm of the factor on the feed."""
STORED_TRIM: Final = Path(__file__).parent / "data" / "trimmed-law.json"


class Constants(Model):
    """The ten constants of the PLC law; those without a unit are exponents or ratios."""

    average: Annotated[float, quantity(1.0, 1000.0, "s")] = 15.0
    """Time constant of the averages of friction and noise."""
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
    """[m3/s]: least air of schedules (``on_map.min_air``) and most air."""

    @classmethod
    def of(cls, config: Any) -> Self:
        """Read the data from a task."""
        scene: Scene = config.scene
        return cls(
            air_speed_per_supply=air_speed(scene, 1.0),
            drag=drag_per_metre(scene),
            float_diameter=scene.probe.carrier_float_diameter,
            feed_speeds=(config.feed_speeds[0], config.permitted_feed),
            air_supply_rates=(min_air(config), config.air_supply_rates[1]),
        )


class Trim(Model):
    """The two constants of the integral action."""

    aim: Annotated[float, quantity(1e-6, 1e-3, "m")] = 3.5e-5
    """Target noise v_a, as radial rms."""
    time: Annotated[float, quantity(1.0, 10000.0, "s")] = 80.0
    """Time constant tau: d(ln feed) / dt = ln(v_a / v) / tau."""


def read_constants(path: str | Path = STORED) -> Constants:
    """Read the ten constants from a file (JSON), see ``read_model``."""
    return read_model(path, Constants, "the constants of a law", "constants")


def read_trim(path: str | Path = STORED_TRIM) -> Trim:
    """Read the constants of the integral action from a file (JSON), see ``read_model``."""
    return read_model(path, Trim, "the constants of a trim", "trim")


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
    diameter = measured["helix_diameter"]
    friction = x * 0.5 * diameter / length / (1.0 - plant.float_diameter / diameter)
    return np.asarray(np.clip(friction, *CREDIBLE))


def law_at(
    constants: Constants, plant: PlantData, averaged: tuple[FloatArray, FloatArray, FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Feed [m/s] and air [m3/s], (n,) each.

    Args:
        constants: the ten constants.
        plant: data of the plant.
        averaged: length [m], friction, logarithm of the noise [m] and helix diameter [m], (n,) each.
    """
    c = constants
    inserted, friction, noise, diameter = averaged[0], averaged[1] / FRICTION, averaged[2], averaged[3] / DIAMETER
    shift = np.clip(c.shift * (noise - np.log(c.quiet)), -MAX_SHIFT, MAX_SHIFT)
    length = inserted * np.exp(shift)
    onset = c.onset_length * friction**-c.onset_friction * diameter**c.onset_diameter
    slow = c.slow_feed * (np.maximum(length, 0.1) / LENGTH) ** -c.slow_length * friction**-c.slow_friction
    slow = np.clip(slow * diameter**c.slow_diameter, *plant.feed_speeds)
    fast = length < onset
    return np.where(fast, plant.feed_speeds[1], slow), np.where(fast, *plant.air_supply_rates)


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
        """Memory: reference friction and reference noise."""
        memory[:] = FRICTION, np.log(self.constants.quiet)

    def targets(self, measured: dict[str, FloatArray], memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Feed and air from length, tension, noise and helix diameter."""
        c, plant = self.constants, self._plant
        weight = gain(self.config, c.average)
        memory[:, 0] += weight * (friction_of(measured["root_tension"], measured, plant) - memory[:, 0])
        memory[:, 1] += weight * (np.log(np.maximum(measured["rf_noise"], 1e-7)) - memory[:, 1])
        return law_at(c, plant, (measured["inserted_length"], memory[:, 0], memory[:, 1], measured["helix_diameter"]))

    def describe(self) -> dict[str, Any]:
        """With its constants."""
        return {"policy": type(self).__name__, **self.constants.model_dump()}


@dataclass
class PlcIntegral(PlcProportional):
    """Applies the law with trimmed feed. Memory: the law's, average of the logarithm of the noise, trim."""

    trim: Trim = field(default_factory=read_trim)
    memory: ClassVar[int] = PlcProportional.memory + 2

    def start(self, memory: FloatArray) -> None:
        """Memory: the law's, low noise, no trim."""
        super().start(memory[:, : PlcProportional.memory])
        memory[:, PlcProportional.memory :] = np.log(UNKNOWN_NOISE), 0.0

    def targets(self, measured: dict[str, FloatArray], memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Feed and air of the law; the feed beyond the onset is trimmed."""
        feed, air = super().targets(measured, memory[:, : PlcProportional.memory])
        noise, trim = memory[:, -2], memory[:, -1]
        noise += gain(self.config, NOISE_AVERAGE) * (np.log(np.maximum(measured["rf_noise"], 1e-7)) - noise)
        past = air > self._plant.air_supply_rates[0]  # the onset
        short = np.clip(np.log(self.trim.aim) - noise, -LOWERED, RAISED)
        trim += np.where(past, self.config.period / self.trim.time * short, 0.0)
        np.clip(trim, -MAX_TRIM, MAX_TRIM, out=trim)
        trimmed = np.clip(feed * np.exp(trim), *self._plant.feed_speeds)
        return np.where(past, trimmed, feed), air

    def describe(self) -> dict[str, Any]:
        """With its constants."""
        return super().describe() | self.trim.model_dump()
