"""Which probe to build: the design space.

The study names 10 m as the longest guide that can be handled and 20 mm as the largest float that passes the weld
projections. The other ranges, around table 2's cable, are assumptions of what can be bought.
"""

from __future__ import annotations

from typing import Annotated, Any, Final, Self

import numpy as np
import numpy.typing as npt
import tomli_w

from probe_env.arrays import FloatArray
from probe_env.scene import Probe, Scene
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
"""Field -> lowest, highest, unit: the axes of the design space, in the order of ``Design.from_unit``."""

CLEARANCE: Final = 1e-3
"""[m] that the design space leaves at least between a float and the bore, and a float and its cable, in diameter; an
assumption: the study's largest float leaves 4.2 mm."""


def ranges_in(scene: Scene) -> dict[str, tuple[float, float, str]]:
    """``RANGES``, those of the floats cut to what fits the bore and the cable of a scene.

    Raises:
        ValueError: no float of the design space fits.
    """
    most, least = scene.tube.clear_diameter - CLEARANCE, scene.probe.cable_diameter + CLEARANCE
    cut = dict(RANGES)
    for name in ("guide_float_diameter", "carrier_float_diameter"):
        low, high, unit = RANGES[name]
        cut[name] = (max(low, least), min(high, most), unit)
        if not cut[name][0] < cut[name][1]:
            raise ValueError(
                f"inner_diameter = {scene.tube.inner_diameter:g} m: no {name} of the design space, {low:g} to {high:g}"
                f" m, fits it and a cable of {scene.probe.cable_diameter:g} m with {CLEARANCE:g} m of clearance"
            )
    return cut


def _axis(name: str) -> Any:
    return quantity(*RANGES[name])


class Design(Model):
    """A probe that can be built: fields of ``scene.Probe`` within what can be bought, table 2's by default."""

    guide_length: Annotated[float, _axis("guide_length")] = 2.5
    guide_float_diameter: Annotated[float, _axis("guide_float_diameter")] = 0.019
    carrier_float_diameter: Annotated[float, _axis("carrier_float_diameter")] = 0.019
    float_pitch: Annotated[float, _axis("float_pitch")] = 0.1
    tensile_rigidity: Annotated[float, _axis("tensile_rigidity")] = 1.1e5
    flexural_rigidity: Annotated[float, _axis("flexural_rigidity")] = 4.8e-2
    line_density: Annotated[float, _axis("line_density")] = 0.111

    @classmethod
    def random(cls, rng: np.random.Generator) -> Self:
        """Drawn evenly from the whole design space."""
        return cls.from_unit(rng.random(len(RANGES)))

    @classmethod
    def from_unit(cls, point: npt.ArrayLike) -> Self:
        """The design at a point (7,) of the unit cube."""
        shares = np.asarray(point, dtype=float)
        if shares.shape != (len(RANGES),) or not ((shares >= 0.0) & (shares <= 1.0)).all():
            raise ValueError(f"point = {point!r} must be {len(RANGES)} numbers within 0 to 1")
        pairs = zip(RANGES.items(), shares, strict=True)
        return cls(**{name: float(low + share * (high - low)) for (name, (low, high, _)), share in pairs})

    def to_unit(self) -> FloatArray:
        """Its point (7,) of the unit cube."""
        return np.array([(getattr(self, name) - low) / (high - low) for name, (low, high, _) in RANGES.items()])

    @property
    def built(self) -> Design:
        """As it is built: the pitch in whole millimetres and the guide in whole pitches."""
        pitch = round(self.float_pitch, 3)
        low, high, _ = RANGES["guide_length"]
        floats = min(max(round(self.guide_length / pitch), int(np.ceil(low / pitch - 1e-9))), int(high / pitch + 1e-9))
        return self.model_copy(update={"float_pitch": pitch, "guide_length": round(floats * pitch, 6)})

    def probe(self, base: Probe | None = None) -> Probe:
        """The probe as it is built; what the design does not name is ``base``'s (default: table 2's)."""
        return (base or Probe()).model_copy(update=self.built.model_dump())

    def cut_to(self, scene: Scene) -> Design:
        """The nearest design whose floats fit the bore and the cable of a scene; itself where they do.

        Raises:
            ValueError: no float of the design space fits.
        """
        ranges = ranges_in(scene)
        cut = {name: min(max(getattr(self, name), low), high) for name, (low, high, _) in ranges.items()}
        return self if cut == self.model_dump() else self.model_copy(update=cut)

    def completed(self, base: Probe) -> Design:
        """The design of which what was not given is a probe's.

        Raises:
            ValueError: such a value is outside the design space.
        """
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
        """The design as TOML text, with every field."""
        return tomli_w.dumps(self.model_dump())
