"""Scene of a simulation: tube, probe, contact, air and feed as frozen, validated models in SI units.

Defaults are table 2 of the study with a carrier of 50 m. Scenes are read from and written to TOML; unknown keys, NaN,
values out of range and impossible geometry raise a ``ValueError`` that names field, value and accepted range.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import tomli_w
from pydantic import ValidationError, model_validator

from probe_env.settings import Model, quantity

LENGTH_TOLERANCE = 1e-6
"""Greatest difference of a cable length from a whole multiple of the float pitch [m]."""
FRICTION_SPEED = 0.2
"""Sliding speed at which the coefficient of friction is ``contact.friction`` [m/s]."""


class Tube(Model):
    """Helical tube, modelled as a circle in a plane."""

    helix_diameter: Annotated[float, quantity(0.3, 1e4, "m")] = 1.2
    """Diameter of the helix, of the tube's axis [m]."""
    inner_diameter: Annotated[float, quantity(5e-3, 0.1, "m")] = 24.2e-3
    """Bore of the tube [m]."""
    helix_length: Annotated[float, quantity(0.1, 1e3, "m")] = 60.0
    """Length of the tube along its axis [m]."""
    ovality: Annotated[float, quantity(0.0, 0.5, "")] = 0.0
    """Largest minus smallest inner diameter, divided by the nominal one [-]; a bent tube is flat in the plane of its
    bend. The cross-section for the air does not change."""

    @property
    def clear_diameter(self) -> float:
        """Inner diameter in the plane of the helix, where the probe swings [m]."""
        return self.inner_diameter * (1.0 - 0.5 * self.ovality)


class Probe(Model):
    """Cable with equally spaced floats: carrier behind the sensor, guide ahead of it."""

    cable_diameter: Annotated[float, quantity(1e-3, 0.05, "m")] = 8.35e-3
    """Diameter of the cable between its floats [m]."""
    line_density: Annotated[float, quantity(0.01, 10.0, "kg/m")] = 0.111
    """Mass per length of the cable with floats [kg/m]."""
    tensile_rigidity: Annotated[float, quantity(1e2, 1e8, "N")] = 1.1e5
    """Tensile rigidity EA of the cable [N]."""
    flexural_rigidity: Annotated[float, quantity(1e-5, 1e2, "N m2")] = 4.8e-2
    """Flexural rigidity EI of the cable [N m2]."""
    damping_time: Annotated[float, quantity(0.0, 1e-2, "s")] = 5.0e-5
    """Ratio of damping to stiffness of the cable [s]."""
    float_pitch: Annotated[float, quantity(0.01, 1.0, "m")] = 0.1
    """Distance between two floats [m]."""
    carrier_float_diameter: Annotated[float, quantity(2e-3, 0.1, "m")] = 19e-3
    """Diameter of the floats behind the sensor [m]."""
    guide_float_diameter: Annotated[float, quantity(2e-3, 0.1, "m")] = 19e-3
    """Diameter of the floats ahead of the sensor [m]."""
    guide_length: Annotated[float, quantity(0.0, 1e3, "m")] = 2.5
    """Length of the cable ahead of the sensor [m]."""


class Contact(Model):
    """Unilateral contact spring and Coulomb friction at every float.

    ``walls="inner"`` is the study's model; ``"both"`` adds the outer wall that keeps the tip in the tube.
    """

    stiffness: Annotated[float, quantity(1e2, 1e8, "N/m")] = 1e5
    """Stiffness of the contact between wall and float [N/m]."""
    friction: Annotated[float, quantity(0.0, 1.0, "")] = 0.15
    """Coefficient of Coulomb friction [-]."""
    walls: Literal["both", "inner"] = "both"
    """Walls that floats touch."""
    cable: bool = False
    """Contact of the cable between floats with the walls, as where compression buckles it."""
    damping: Annotated[float, quantity(0.0, 100.0, "N s/m")] = 0.0
    """Damping of the contact: the wall pushes with k depth + c d(depth)/dt, and never pulls [N s/m]."""
    friction_slope: Annotated[float, quantity(-0.5, 0.5, "s/m")] = 0.0
    """Change of the coefficient of friction per sliding speed [s/m]; ``friction`` is that at ``FRICTION_SPEED``, 0.2
    m/s."""
    weight: bool = False
    """Friction from the weight of the cable, which acts across the plane of the helix (vertical axis): a float has the
    friction mu sqrt(N^2 + w^2), also without contact in the plane, with the weight w of a pitch of cable."""

    def friction_at(self, speed: float) -> float:
        """Coefficient of friction at a sliding speed [m/s]."""
        return max(self.friction + self.friction_slope * (abs(speed) - FRICTION_SPEED), 0.0)


class Air(Model):
    """Air that drags the floats along."""

    density: Annotated[float, quantity(0.01, 100.0, "kg/m3")] = 1.023
    """Density of the air at the exit [kg/m3]."""
    drag_coefficient: Annotated[float, quantity(0.0, 10.0, "")] = 0.44
    """Drag coefficient of a float [-]."""
    compressible: bool = False
    """Expansion of the air on its way to the exit: its pressure drops by the drag of the floats, so that floats near
    the entrance are pulled less."""
    exit_pressure: Annotated[float, quantity(1e3, 1e7, "Pa")] = 101325.0
    """Absolute pressure at the end of the helix where the air leaves, for compressible air [Pa]."""
    darcy_factor: Annotated[float, quantity(0.0, 1.0, "")] = 0.0
    """Darcy friction factor of the tube wall, for compressible air [-]; 0: the floats take the whole pressure drop."""


class Terms(Model):
    """Terms of the model that the study leaves out."""

    shortening: bool = False
    """Shortening of the bent cable between two floats, theta^2 / 2 in its axial strain, without which a span that has
    buckled never unloads."""
    stiction: bool = False
    """Friction that also holds at rest, by a spring that yields at mu N, instead of the sign of the sliding."""
    entrance: bool = False
    """Axial force with which the bent cable behind the entrance resists the feed, (EI / r)^2 / (2 EI) at rest; it
    reduces the root tension."""


class Scene(Model):
    """One probe in one tube at one feed speed [m/s], air supply rate [m3/s] and carrier length [m]."""

    tube: Tube = Tube()
    probe: Probe = Probe()
    contact: Contact = Contact()
    air: Air = Air()
    couple: Literal["frame", "tangent"] = "frame"
    """Reference of the rotation in the couple V l theta of equation (9): the moving frame, as in the study, or the
    tangent of the tube at the node, which is also correct under compression."""
    terms: Terms = Terms()
    feed_speed: Annotated[float, quantity(-2.0, 2.0, "m/s")] = 0.2
    """Feed speed of the cable; negative: withdrawal [m/s]."""
    air_supply_rate: Annotated[float, quantity(-0.2, 0.2, "m3/s")] = 63.0 / 3600.0
    """Air supply behind the probe, as volume at the pressure of the exit; negative: towards the feed device [m3/s].
    1 m3/h is 2.78e-4 m3/s."""
    feed_ripple: Annotated[float, quantity(0.0, 0.5, "")] = 0.0
    """Ripple of the feed device: amplitude of the feed speed's variation, divided by the feed speed [-]."""
    ripple_length: Annotated[float, quantity(1e-4, 10.0, "m")] = 8e-3
    """Cable fed in one period of the ripple, such as the pitch of a tooth [m]; the default is 25 Hz at 0.2 m/s."""
    carrier_length: Annotated[float, quantity(0.0, 1e3, "m")] = 50.0
    """Length of the cable between entrance and sensor [m]."""

    @property
    def inserted_length(self) -> float:
        """Cable inside the helix, carrier + guide [m]."""
        return self.carrier_length + self.probe.guide_length

    @model_validator(mode="after")
    def _geometry_is_possible(self) -> Self:
        tube, probe = self.tube, self.probe
        for name in ("carrier_float_diameter", "guide_float_diameter"):
            diameter = getattr(probe, name)
            if diameter >= tube.clear_diameter:
                oval = f" less half of tube.ovality = {tube.ovality:g}" if tube.ovality else ""
                raise ValueError(
                    f"probe.{name} = {diameter:g} m must be less than tube.inner_diameter = {tube.inner_diameter:g} m"
                    + oval
                )
            if diameter <= probe.cable_diameter:
                raise ValueError(
                    f"probe.{name} = {diameter:g} m must be greater than probe.cable_diameter ="
                    f" {probe.cable_diameter:g} m"
                )
        for name, length in (("carrier_length", self.carrier_length), ("probe.guide_length", probe.guide_length)):
            pitches = round(length / probe.float_pitch)
            if abs(length - pitches * probe.float_pitch) > LENGTH_TOLERANCE:
                raise ValueError(
                    f"{name} = {length:g} m must be a whole multiple of probe.float_pitch ="
                    f" {probe.float_pitch:g} m (nearest: {pitches * probe.float_pitch:g} m)"
                )
        if self.carrier_length < probe.float_pitch - LENGTH_TOLERANCE:
            raise ValueError(
                f"carrier_length = {self.carrier_length:g} m must be at least one probe.float_pitch ="
                f" {probe.float_pitch:g} m, else the sensor sits at the held root"
            )
        if self.inserted_length > tube.helix_length + LENGTH_TOLERANCE:
            raise ValueError(
                f"carrier_length + probe.guide_length = {self.carrier_length:g} + {probe.guide_length:g} m"
                f" must not exceed tube.helix_length = {tube.helix_length:g} m"
            )
        if probe.float_pitch > 0.5 * tube.helix_diameter:
            raise ValueError(
                f"probe.float_pitch = {probe.float_pitch:g} m must not exceed half of tube.helix_diameter ="
                f" {tube.helix_diameter:g} m: the cable between two floats would cut the helix"
            )
        return self

    @property
    def assumptions(self) -> dict[str, Any]:
        """The fields that ``whole`` sets, by their names in files."""
        terms = {f"terms.{name}": on for name, on in self.terms}
        return {
            "contact.weight": self.contact.weight,
            "air.compressible": self.air.compressible,
            "couple": self.couple,
        } | terms

    def whole(self) -> Self:
        """The scene with all that the study leaves out: weight, expanding air, ``terms``, couple from the tangent."""
        return self._with_terms(True, "tangent")

    def study(self) -> Self:
        """The scene without them, the study's model."""
        return self._with_terms(False, "frame")

    def _with_terms(self, on: bool, couple: str) -> Self:
        terms = dict.fromkeys(Terms.model_fields, on)
        update = {"contact": {"weight": on}, "air": {"compressible": on}, "terms": terms, "couple": couple}
        return self.model_copy(update=update)

    @classmethod
    def fitted(cls, values: Mapping[str, Any]) -> Self:
        """A scene from values that differ from table 2; the default carrier is shortened to fit the helix."""
        fields = dict(values)
        try:
            tube = Tube.model_validate(fields.get("tube", {}))
            probe = Probe.model_validate(fields.get("probe", {}))
        except ValidationError:
            return cls.model_validate(fields)  # raises an error with the full name of the field
        max_length = min(cls.model_fields["carrier_length"].default, tube.helix_length - probe.guide_length)
        fields.setdefault("carrier_length", max(whole_pitches(max_length, probe), probe.float_pitch))
        return cls.model_validate(fields)

    def to_toml(self, path: str | Path | None = None) -> str:
        """The scene as TOML text with all fields; also written to ``path`` if given."""
        text = tomli_w.dumps(self.model_dump())
        if path is not None:
            Path(path).write_text(text)
        return text


def whole_pitches(length: float, probe: Probe) -> float:
    """A length rounded down to whole float pitches [m]."""
    return round(int(length / probe.float_pitch + 1e-9) * probe.float_pitch, 6)
