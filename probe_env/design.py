"""Probe designs: the design space and its coordinates.

A guide of more than 10 m cannot be handled and a float of more than 20 mm does not pass the weld projections (study).
The other ranges are assumptions of what can be bought, around the cable of table 2.
"""

from __future__ import annotations

from typing import Annotated, Any, Final, Self

import numpy as np
import numpy.typing as npt
import tomli_w

from probe_env.arrays import FloatArray
from probe_env.scene import LENGTH_TOLERANCE, Probe, Scene
from probe_env.settings import Model, quantity

RANGES: Final[dict[str, tuple[float, float, str]]] = {
    "guide_length": (1.0, 10.0, "m"),
    "guide_float_diameter": (0.016, 0.020, "m"),
    "carrier_float_diameter": (0.016, 0.020, "m"),
    "float_pitch": (0.1, 0.15, "m"),
    "tensile_rigidity": (0.5e5, 2.0e5, "N"),
    "flexural_rigidity": (2.5e-2, 1.0e-1, "N m2"),
    "line_density": (0.09, 0.14, "kg/m"),
}
"""Field -> lowest value, highest value, unit: axes of the design space, in the order of ``Design.from_unit``."""

CLEARANCE: Final = 1e-3
"""Least difference in diameter between float and bore, and between float and cable [m]; an assumption: the largest
float of the study leaves 4.2 mm."""


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


def _axis(name: str) -> Any:
    return quantity(*RANGES[name])


class Design(Model):
    """Design of a probe: fields of ``scene.Probe`` within ``RANGES``; defaults are those of table 2."""

    guide_length: Annotated[float, _axis("guide_length")] = 2.5
    guide_float_diameter: Annotated[float, _axis("guide_float_diameter")] = 0.019
    carrier_float_diameter: Annotated[float, _axis("carrier_float_diameter")] = 0.019
    float_pitch: Annotated[float, _axis("float_pitch")] = 0.1
    tensile_rigidity: Annotated[float, _axis("tensile_rigidity")] = 1.1e5
    flexural_rigidity: Annotated[float, _axis("flexural_rigidity")] = 4.8e-2
    line_density: Annotated[float, _axis("line_density")] = 0.111

    @classmethod
    def random(cls, rng: np.random.Generator) -> Self:
        """A random design, uniform in the design space."""
        return cls.from_unit(rng.random(len(RANGES)))

    @classmethod
    def from_unit(cls, point: npt.ArrayLike) -> Self:
        """The design at a point (7,) of the unit cube."""
        fractions = np.asarray(point, dtype=float)
        if fractions.shape != (len(RANGES),) or not ((fractions >= 0.0) & (fractions <= 1.0)).all():
            raise ValueError(f"point = {point!r} must be {len(RANGES)} numbers within 0 to 1")
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
        floats = min(max(round(self.guide_length / pitch), int(np.ceil(low / pitch - 1e-9))), int(high / pitch + 1e-9))
        return self.model_copy(update={"float_pitch": pitch, "guide_length": round(floats * pitch, 6)})

    def check_whole_pitches(self) -> None:
        """Raise ValueError unless the pitch is in whole millimetres and the guide in whole pitches, as built."""
        for name, step, of in (
            ("float_pitch", 1e-3, "0.001 m"),
            ("guide_length", self.float_pitch, f"float_pitch = {self.float_pitch:g} m"),
        ):
            value, (low, high, _) = getattr(self, name), RANGES[name]
            if abs(value - step * round(value / step)) > LENGTH_TOLERANCE:
                nearest = (round(step * count, 6) for count in (int(value / step), int(value / step) + 1))
                accepted = " or ".join(f"{near:g} m" for near in nearest if low <= near <= high)
                raise ValueError(f"{name} = {value:g} m is not a whole multiple of {of}: give {accepted}")

    def probe(self, base: Probe | None = None) -> Probe:
        """The probe of the design as built; other fields are those of ``base`` (default: table 2)."""
        return (base or Probe()).model_copy(update=self.built.model_dump())

    def cut_to(self, scene: Scene) -> Design:
        """The nearest design whose floats fit the bore and the cable of a scene; ValueError if none fits."""
        ranges = ranges_in(scene)
        cut = {name: min(max(getattr(self, name), low), high) for name, (low, high, _) in ranges.items()}
        return self if cut == self.model_dump() else self.model_copy(update=cut)

    def completed(self, base: Probe) -> Design:
        """The design with fields that were not set taken from a probe, which must be in the design space."""
        rest = {name: getattr(base, name) for name in RANGES if name not in self.model_fields_set}
        for name, value in rest.items():
            low, high, unit = RANGES[name]
            if not low <= value <= high:
                raise ValueError(
                    f"{name} is not given, and that of the plant's probe, {value:g} {unit}, is outside the design"
                    f" space, {low:g} to {high:g} {unit}: give it"
                )
        return self.model_copy(update=rest)

    def to_toml(self) -> str:
        """The design as TOML text with all fields."""
        return tomli_w.dumps(self.model_dump())
