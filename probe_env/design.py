"""Probe designs: the design space and its coordinates.

A guide of more than 10 m cannot be handled and a float of more than 20 mm does not pass the weld projections (study).
The other ranges are assumptions of what can be bought, around the cable of table 2. The drag of a float is taken to be
independent of the pitch: floats in the wake of closer ones have less.
"""

from __future__ import annotations

from typing import Annotated, Any, Final, Self

import numpy as np
import numpy.typing as npt
import tomli_w
from pydantic import Field

from probe_env.arrays import FloatArray
from probe_env.scene import LENGTH_TOLERANCE, Probe, Scene
from probe_env.settings import Model, quantity, range_of

RANGES: Final[dict[str, tuple[float, float, str]]] = {
    "guide_length": (1.0, 10.0, "m"),
    "guide_float_diameter": (0.016, 0.020, "m"),
    "carrier_float_diameter": (0.016, 0.020, "m"),
    "float_pitch": (0.05, 0.15, "m"),
    "tensile_rigidity": (0.5e5, 2.0e5, "N"),
    "flexural_rigidity": (2.5e-2, 1.0e-1, "N m2"),
    "line_density": (0.09, 0.14, "kg/m"),
}
"""Field -> lowest value, highest value, unit: axes of the design space, in the order of ``Design.from_unit``."""

CLEARANCE: Final = 1e-3
"""Least difference in diameter between float and bore, and between float and cable [m]; an assumption: the largest
float of the study leaves 4.2 mm."""


MIN_RANDOM_PITCH: Final = 0.1
"""Shortest pitch of random probes [m]: whole lengths that start at rest need a shorter step than 2e-4 s below."""


def ranges_in(scene: Scene) -> dict[str, tuple[float, float, str]]:
    """``RANGES``, with float diameters limited by the bore and the cable of a scene."""
    maximum, minimum = scene.tube.clear_diameter - CLEARANCE, scene.probe.cable_diameter + CLEARANCE
    cut = dict(RANGES)
    for name in ("guide_float_diameter", "carrier_float_diameter"):
        low, high, unit = RANGES[name]
        cut[name] = (max(low, minimum), min(high, maximum), unit)
        if not cut[name][0] < cut[name][1]:
            raise ValueError(
                f"inner_diameter = {scene.tube.inner_diameter:g} m: no {name} of the design space, {low:g} to {high:g}"
                f" m, fits it and a cable of {scene.probe.cable_diameter:g} m with {CLEARANCE:g} m of clearance"
            )
    return cut


def _accepted(name: str) -> Any:
    """Accepted range of a field: that of ``Probe``, and for the guide up to the end of ``RANGES``."""
    accepted = range_of(Probe, name)
    assert accepted
    high = RANGES[name][1] if name == "guide_length" else accepted.high
    return quantity(accepted.low, high, accepted.unit)


def _space(name: str) -> Any:
    low, high, unit = RANGES[name]
    return Field(description=f"{name.replace('_', ' ')}, searched from {low:g} to {high:g} {unit}")


class Design(Model):
    """Design of a probe: fields of ``scene.Probe``; defaults are those of table 2.

    Lengths are continuous, for searches; the probe has whole pitches, see ``built``. Files must give whole pitches.
    Searches and environments stay within ``RANGES``. Designs are compared over the tube that the sensor reaches with
    the longest guide, so the guide cannot be longer.
    """

    guide_length: Annotated[float, _accepted("guide_length"), _space("guide_length")] = 2.5
    guide_float_diameter: Annotated[float, _accepted("guide_float_diameter"), _space("guide_float_diameter")] = 0.019
    carrier_float_diameter: Annotated[float, _accepted("carrier_float_diameter"), _space("carrier_float_diameter")] = (
        0.019
    )
    float_pitch: Annotated[float, _accepted("float_pitch"), _space("float_pitch")] = 0.1
    tensile_rigidity: Annotated[float, _accepted("tensile_rigidity"), _space("tensile_rigidity")] = 1.1e5
    flexural_rigidity: Annotated[float, _accepted("flexural_rigidity"), _space("flexural_rigidity")] = 4.8e-2
    line_density: Annotated[float, _accepted("line_density"), _space("line_density")] = 0.111

    @classmethod
    def random(cls, rng: np.random.Generator) -> Self:
        """A random design, uniform in the design space with pitches from ``MIN_RANDOM_PITCH``."""
        design = cls.from_unit(rng.random(len(RANGES)))
        low, high, _ = RANGES["float_pitch"]
        fraction = (high - design.float_pitch) / (high - low)
        return design.model_copy(update={"float_pitch": high - fraction * (high - MIN_RANDOM_PITCH)})

    @classmethod
    def from_unit(cls, point: npt.ArrayLike) -> Self:
        """The design at a point (7,) of the unit cube."""
        fractions = np.asarray(point, dtype=float)
        if fractions.shape != (len(RANGES),) or not ((fractions >= 0.0) & (fractions <= 1.0)).all():
            raise ValueError(f"point = {fractions.tolist()} must be {len(RANGES)} numbers within 0 to 1")
        pairs = zip(RANGES.items(), fractions, strict=True)
        return cls(**{name: float(low + fraction * (high - low)) for (name, (low, high, _)), fraction in pairs})

    def to_unit(self) -> FloatArray:
        """Point (7,) of the design in the unit cube."""
        return np.array([(getattr(self, name) - low) / (high - low) for name, (low, high, _) in RANGES.items()])

    @property
    def built(self) -> Design:
        """The design with a pitch of whole millimetres and a guide of whole pitches."""
        pitch = round(self.float_pitch, 3)
        low, high, _ = RANGES["guide_length"]
        low = min(low, self.guide_length)
        floats = min(max(round(self.guide_length / pitch), int(np.ceil(low / pitch - 1e-9))), int(high / pitch + 1e-9))
        return self.model_copy(update={"float_pitch": pitch, "guide_length": round(floats * pitch, 6)})

    @property
    def deviations(self) -> list[str]:
        """Fields outside the design space, with values and ranges."""
        values = ((name, getattr(self, name), *range_) for name, range_ in RANGES.items())
        return [
            f"{name} = {value:g} {unit} is not within {low:g} to {high:g} {unit}"
            for name, value, low, high, unit in values
            if not low <= value <= high
        ]

    def check_whole_pitches(self) -> None:
        """Raise ValueError unless the pitch is in whole millimetres and the guide in whole pitches, as built."""
        for name, step, of in (
            ("float_pitch", 1e-3, "0.001 m"),
            ("guide_length", self.float_pitch, f"float_pitch = {self.float_pitch:g} m"),
        ):
            value, (low, high, _) = getattr(self, name), RANGES[name]
            if abs(value - step * round(value / step)) > LENGTH_TOLERANCE:
                nearest = [round(step * count, 6) for count in (int(value / step), int(value / step) + 1)]
                fit = [near for near in nearest if low <= near <= high] or nearest
                accepted = " or ".join(f"{near:g} m" for near in fit)
                raise ValueError(f"{name} = {value:g} m is not a whole multiple of {of}: give {accepted}")

    def probe(self, base: Probe | None = None) -> Probe:
        """The probe of the design as built; other fields are those of ``base`` (default: table 2)."""
        return (base or Probe()).model_copy(update=self.built.model_dump())

    def cut_to(self, scene: Scene) -> Design:
        """The nearest design whose floats fit the bore and the cable of a scene; ValueError if none fits."""
        ranges_in(scene)
        low, high = scene.probe.cable_diameter + CLEARANCE, scene.tube.clear_diameter - CLEARANCE
        names = ("guide_float_diameter", "carrier_float_diameter")
        cut = {name: min(max(getattr(self, name), low), high) for name in names}
        return self if cut == self.model_dump(include=set(names)) else self.model_copy(update=cut)

    def completed(self, base: Probe) -> Design:
        """The design with fields that were not set taken from a probe."""
        rest = {name: getattr(base, name) for name in RANGES if name not in self.model_fields_set}
        return self.model_copy(update=rest)

    def to_toml(self) -> str:
        """The design as TOML text with all fields."""
        return tomli_w.dumps(self.model_dump())
