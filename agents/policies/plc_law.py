"""Feedback laws for a PLC: fast with little air up to an onset length, then slow with all the air; ten constants.

The best schedules of the vibration map all have this form. Onset and slow feed depend on the friction, estimated from
the root tension, and on the helix diameter; measured noise shifts the length that counts.

``TrimmedLaw`` adds integral action: past the onset its feed is trimmed until the noise meets an aim. The feed at which
a probe begins to ring is a sharp limit, different in every tube, but its ratio to the law's feed varies little along a
tube. The feed is lowered faster than raised, since ringing costs more than time.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final, Self

import numpy as np

from agents.policies.fixed import FixedPolicy, gain
from agents.policies.on_map import least_air
from agents.policies.policy import Domain, read_model
from probe_env import Scene
from probe_env.arrays import FloatArray
from probe_env.envs.vibration_map import stored_map
from probe_env.physics.closed_forms import drag_per_metre
from probe_env.physics.model.chain import air_speed
from probe_env.settings import Model, quantity

FRICTION: Final = 0.175
DIAMETER: Final = 1.5
LENGTH: Final = 30.0
"""Friction, helix diameter [m] and length [m] that the constants are counted from."""
CREDIBLE: Final = (0.05, 0.35)
"""Friction that is believed."""
SHORTEST: Final = 5.0
"""[m] below which the tension tells nothing of friction."""
MOST_SHIFT: Final = 0.7
"""Greatest logarithm of the factor by which noise lengthens or shortens the probe: a factor of two."""
ITERATIONS: Final = 6
"""Newton's, for the friction: enough for 1e-6 of it (a test)."""
STORED: Final = Path(__file__).parent / "data" / "plc-law.json"
NOISE_AVERAGE: Final = 4.0
"""Time constant of the average of the logarithm of the noise that is compared with the aim [s]."""
UNKNOWN_NOISE: Final = 1e-5
"""Noise at the beginning [m]."""
LOWERED, RAISED = 1.0, 0.5
"""Greatest logarithm of the ratio of noise and aim that counts, for less feed and for more."""
MOST_TRIM: Final = 0.5
"""Greatest logarithm of the factor on the feed, either way."""
STORED_TRIM: Final = Path(__file__).parent / "data" / "trimmed-law.json"


class Constants(Model):
    """The ten constants."""

    average: Annotated[float, quantity(1.0, 1000.0, "s")] = 15.0
    """Time constant of the averages of friction and noise."""
    onset_length: Annotated[float, quantity(1.0, 1000.0, "m")] = 25.0
    """Length from which feed is slow and air is strong, at ``FRICTION`` and ``DIAMETER``."""
    onset_friction: Annotated[float, quantity(-10.0, 10.0, "")] = 1.5
    """It goes with friction to the minus this,"""
    onset_diameter: Annotated[float, quantity(-10.0, 10.0, "")] = 1.0
    """and with the helix diameter to this."""
    slow_feed: Annotated[float, quantity(1e-3, 2.0, "m/s")] = 0.16
    """Feed past the onset, where ``LENGTH`` is inserted, at ``FRICTION`` and ``DIAMETER``."""
    slow_length: Annotated[float, quantity(-10.0, 10.0, "")] = 0.8
    """It goes with length to the minus this,"""
    slow_friction: Annotated[float, quantity(-10.0, 10.0, "")] = 0.5
    """with friction to the minus this,"""
    slow_diameter: Annotated[float, quantity(-10.0, 10.0, "")] = 0.3
    """and with the helix diameter to this."""
    quiet: Annotated[float, quantity(1e-7, 1e-2, "m")] = 3e-5
    """Noise, as radial rms, at which length counts as it is,"""
    shift: Annotated[float, quantity(0.0, 2.0, "")] = 0.1
    """else with the factor (noise / quiet) to this."""


class PlantData(Model):
    """What the law takes from the plant: no constants of its own."""

    air_speed_per_supply: float
    """[m/s] of wind a [m3/s] of supply."""
    drag: float
    """Of the floats a metre over the square of the wind [N s2/m3], (10)."""
    float_diameter: float
    """[m]."""
    feed_speeds: tuple[float, float]
    """[m/s]."""
    air_supply_rates: tuple[float, float]
    """[m3/s], the least that schedules blow, see ``on_map.least_air``, and the most."""

    @classmethod
    def of(cls, config: Any) -> Self:
        """Of a task."""
        scene: Scene = config.scene
        return cls(
            air_speed_per_supply=air_speed(scene, 1.0), drag=drag_per_metre(scene),
            float_diameter=scene.probe.carrier_float_diameter, feed_speeds=config.feed_speeds,
            air_supply_rates=(least_air(config), config.air_supply_rates[1]),
        )  # fmt: skip


class Trim(Model):
    """Its two constants, beside the law's ten."""

    aim: Annotated[float, quantity(1e-6, 1e-3, "m")] = 3.5e-5
    """Noise, as radial rms, at which the feed stays as it is."""
    time: Annotated[float, quantity(1.0, 10000.0, "s")] = 80.0
    """In which feed changes by a factor of e where the noise is off by a factor of e."""


def read_constants(path: str | Path = STORED) -> Constants:
    """The ten constants from a file (JSON), see ``read_model``."""
    return read_model(path, Constants, "the constants of a law", "constants")


def read_trim(path: str | Path = STORED_TRIM) -> Trim:
    """The constants of a trim from a file (JSON), see ``read_model``."""
    return read_model(path, Trim, "the constants of a trim", "trim")


def friction_of(tension: FloatArray, measured: dict[str, FloatArray], plant: PlantData) -> FloatArray:
    """Friction (n,) of steady sliding by elementary operations: y = (1 - exp(-x)) / x by Newton, x = mu' L / r.

    y is the tension over what the drag would pull without friction.
    """
    length = np.maximum(measured["inserted_length"], SHORTEST)
    wind = plant.air_speed_per_supply * measured["air_supply_rate"] - measured["feed_speed"]
    share = np.clip(tension / np.maximum(plant.drag * wind * wind * length, 1e-6), 0.01, 0.95)
    x = 1.0 / share
    for _ in range(ITERATIONS):
        fallen = np.exp(-x)
        x = x - (x * share - 1.0 + fallen) / (share - fallen)
    diameter = measured["helix_diameter"]
    friction = x * 0.5 * diameter / length / (1.0 - plant.float_diameter / diameter)
    return np.asarray(np.clip(friction, *CREDIBLE))


def law_at(
    constants: Constants, plant: PlantData, averaged: tuple[FloatArray, FloatArray, FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Feed [m/s] and air [m3/s], (n,) each.

    Args:
        constants: the ten.
        plant: its data.
        averaged: length [m], friction, logarithm of the noise [m] and helix diameter [m], (n,) each.
    """
    c = constants
    inserted, friction, noise, diameter = averaged[0], averaged[1] / FRICTION, averaged[2], averaged[3] / DIAMETER
    shift = np.clip(c.shift * (noise - np.log(c.quiet)), -MOST_SHIFT, MOST_SHIFT)
    length = inserted * np.exp(shift)
    onset = c.onset_length * friction**-c.onset_friction * diameter**c.onset_diameter
    slow = c.slow_feed * (np.maximum(length, 0.1) / LENGTH) ** -c.slow_length * friction**-c.slow_friction
    slow = np.clip(slow * diameter**c.slow_diameter, *plant.feed_speeds)
    fast = length < onset
    return np.where(fast, plant.feed_speeds[1], slow), np.where(fast, *plant.air_supply_rates)


@dataclass
class PlcLaw(FixedPolicy):
    """Acts by the law. Memory: averages of friction and of the logarithm of the noise."""

    constants: Constants = field(default_factory=read_constants)
    memory: ClassVar[int] = 2
    needs: ClassVar[tuple[str, ...]] = ("root_tension",)

    def __post_init__(self) -> None:
        super().__post_init__()
        self._plant = PlantData.of(self.config)

    @property
    def domain(self) -> Domain:
        """Tubes of the map, on which its constants were found."""
        return Domain.of_map(stored_map())

    def start(self, memory: FloatArray) -> None:
        """Memory: usual friction, and noise that shifts nothing."""
        memory[:] = FRICTION, np.log(self.constants.quiet)

    def targets(self, measured: dict[str, FloatArray], memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        """By length, tension, noise and helix diameter."""
        c, plant = self.constants, self._plant
        weight = gain(self.config, c.average)
        memory[:, 0] += weight * (friction_of(measured["root_tension"], measured, plant) - memory[:, 0])
        memory[:, 1] += weight * (np.log(np.maximum(measured["rf_noise"], 1e-7)) - memory[:, 1])
        return law_at(c, plant, (measured["inserted_length"], memory[:, 0], memory[:, 1], measured["helix_diameter"]))

    def describe(self) -> dict[str, Any]:
        """With its constants."""
        return {"policy": type(self).__name__, **self.constants.model_dump()}


@dataclass
class TrimmedLaw(PlcLaw):
    """Acts by the law with its feed trimmed. Memory: the law's, average of the logarithm of the noise, trim."""

    trim: Trim = field(default_factory=read_trim)
    memory: ClassVar[int] = PlcLaw.memory + 2

    def start(self, memory: FloatArray) -> None:
        """Memory: the law's, little noise, and no trim."""
        super().start(memory[:, : PlcLaw.memory])
        memory[:, PlcLaw.memory :] = np.log(UNKNOWN_NOISE), 0.0

    def targets(self, measured: dict[str, FloatArray], memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The law's, with the feed past the onset trimmed."""
        feed, air = super().targets(measured, memory[:, : PlcLaw.memory])
        noise, trim = memory[:, -2], memory[:, -1]
        noise += gain(self.config, NOISE_AVERAGE) * (np.log(np.maximum(measured["rf_noise"], 1e-7)) - noise)
        past = air > self._plant.air_supply_rates[0]  # the onset
        short = np.clip(np.log(self.trim.aim) - noise, -LOWERED, RAISED)
        trim += np.where(past, self.config.period / self.trim.time * short, 0.0)
        np.clip(trim, -MOST_TRIM, MOST_TRIM, out=trim)
        trimmed = np.clip(feed * np.exp(trim), *self._plant.feed_speeds)
        return np.where(past, trimmed, feed), air

    def describe(self) -> dict[str, Any]:
        """With its constants."""
        return super().describe() | self.trim.model_dump()
