"""Closed forms of steady sliding, buckling and a straight section; ``bare_chains`` has those without a tube.

Policies estimate friction from them, and tests compare simulations with them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np

from probe_env.arrays import FloatArray
from probe_env.physics.closed_forms.bare_chains import impact as impact
from probe_env.physics.closed_forms.bare_chains import linear_chain as linear_chain
from probe_env.physics.model.chain import air_speed, build_chain
from probe_env.scene import Probe, Scene
from probe_env.settings import within

GRAVITY: Final = 9.80665
"""[m/s2]; in the helix it is left out: its plane is taken as horizontal."""
MEASURED: Final = ("root_tension", "inserted_length", "feed_speed", "air_supply_rate", "helix_diameter")
"""What the estimate looks at, SI units."""
SHAPE: Final = ("guide_length", "guide_float_diameter", "carrier_float_diameter", "float_pitch")
"""Figures of the probe that it depends on."""


def steady_root_tension(scene: Scene) -> float:
    """Closed form of the root tension under steady sliding [N], see ``steady_tensions``."""
    return float(steady_tensions(scene)[-1])


def steady_tensions(scene: Scene) -> FloatArray:
    """Closed form of the axial force behind every float under steady sliding, tip first [N]; below 0 is pressure.

    T = (q r / mu') (1 - exp(-mu' s / r)), s from the tip; q is the mean drag per metre, and friction acts at the
    float's surface: mu' = mu (1 - d_f / d_h) where the probe is pulled, on the inner wall, mu (1 + d_f / d_h) where it
    is pressed, on the outer one. Friction lessens what the air does while the probe moves as the air does, and adds to
    it otherwise. With two float sizes q is piecewise constant and the guide's end tension is carried on.
    """
    chain = build_chain(scene)
    relative = air_speed(scene, scene.air_supply_rate) - scene.feed_speed
    pitch = scene.probe.float_pitch
    radius = scene.tube.helix_diameter / 2.0
    floats = chain.drag[:-1] > 0.0
    tension, tensions = 0.0, []
    for drag, lever in zip(chain.drag[:-1][floats] * relative * abs(relative), chain.lever[:-1][floats], strict=True):
        side = 1.0 if (tension or drag) >= 0.0 else -1.0
        mu = chain.friction * (1.0 - side * lever / radius) * (side if scene.feed_speed >= 0.0 else -side)
        if mu == 0.0:
            tension += drag
        else:
            limit = drag / pitch * radius / mu
            tension = limit + (tension - limit) * math.exp(-mu * pitch / radius)
        tensions.append(tension)
    return np.array(tensions)


def buckling_load(probe: Probe) -> float:
    """Pressure [N] at which the cable buckles between two floats: Euler's load of a pitch, pi^2 EI / p^2.

    Floats that lie on a wall hold the cable there sideways but let it turn, and of equal spans under the same pressure
    neighbours bend to opposite sides, none holding the other: each is a bar with hinged ends. Pressure changes little
    from pitch to pitch, by a float's drag and friction. The helix's bend, p^2 / 8 r of deflection beforehand (2 mm for
    table 2's), grows as the pressure comes near the load but does not change it. It does not hold for floats that have
    left the wall, where the cable bends over several pitches: there it buckles earlier.
    """
    return math.pi**2 * probe.flexural_rigidity / probe.float_pitch**2


def drag_per_metre(scene: Scene) -> float:
    """Drag of the carrier's floats a metre over the square of the wind [N s2/m3], after (10)."""
    probe = scene.probe
    return float(_drag_per_metre(scene, np.array(probe.carrier_float_diameter), np.array(probe.float_pitch)))


def tension_for_straight(scene: Scene, length: float, incline: float = math.pi / 2.0) -> float:
    """Root tension [N] with which a straight part between feed device and helix is passed; 0 where it needs none.

    At constant speed the feed device holds back with T - (m g (sin a + mu cos a) - q) L, T being the root tension in
    the helix, m g the cable's weight and q the air's drag a metre. It can hold and not push, so that must not fall
    below 0. Bends between the two divide it by exp(mu phi) and leave its sign.

    Args:
        scene: probe, air, friction, feed speed and air supply; its tube's bore goes on in the straight part.
        length: of the straight part [m].
        incline: a of the direction of insertion against the horizontal [rad]: pi / 2 rises, -pi / 2 falls.

    Raises:
        ValueError: a length below 0, or an incline that is none.
    """
    within("length", length, 0.0, 1e4, "m")
    within("incline", incline, -math.pi / 2.0, math.pi / 2.0, "rad")
    wind = air_speed(scene, scene.air_supply_rate) - scene.feed_speed
    weight = scene.probe.line_density * GRAVITY
    uphill = weight * (math.sin(incline) + scene.contact.friction * math.cos(incline))
    return max(uphill - drag_per_metre(scene) * wind * abs(wind), 0.0) * length


def friction_from_tension(seen: Mapping[str, FloatArray], scene: Scene) -> FloatArray:
    """Friction coefficient (n,) at which steady sliding has the measured root tension, by bisection.

    Between tip and root dT/ds = q - mu' T / r, mu' = mu (1 - d_f / d_h), with the drag q of the guide's floats, then of
    the carrier's; tension falls as friction rises.

    Args:
        seen: ``MEASURED``, (n,) each; ``SHAPE`` where the probe is not the scene's.
        scene: bore, air and probe.
    """
    tension, diameter = seen["root_tension"], seen["helix_diameter"]
    pulled = _pulled_sections(seen, scene)
    radius = diameter / 2.0
    low, high = np.zeros_like(tension), np.full_like(tension, 2.0)
    for _ in range(30):
        middle = 0.5 * (low + high)
        above = _sliding_tension(middle, pulled, radius) > tension
        low, high = np.where(above, middle, low), np.where(above, high, middle)
    carrier = seen.get("carrier_float_diameter", np.full_like(tension, scene.probe.carrier_float_diameter))
    return np.asarray(0.5 * (low + high) / (1.0 - carrier / diameter))


def sliding_tension(friction: FloatArray, seen: Mapping[str, FloatArray], scene: Scene) -> FloatArray:
    """Root tension (..., n) of steady sliding [N], as ``friction_from_tension`` has it.

    Args:
        friction: (..., 1) or (..., n), above 0.
        seen: ``MEASURED`` but the tension, (n,) each; ``SHAPE`` where the probe is not the scene's.
        scene: bore, air and probe.
    """
    diameter = seen["helix_diameter"]
    carrier = seen.get("carrier_float_diameter", np.full_like(diameter, scene.probe.carrier_float_diameter))
    return _sliding_tension(friction * (1.0 - carrier / diameter), _pulled_sections(seen, scene), diameter / 2.0)


def _pulled_sections(seen: Mapping[str, FloatArray], scene: Scene) -> list[tuple[FloatArray, FloatArray]]:
    """Drag a metre [N/m] and length [m] of the guide, then of the carrier, (n,) each."""
    length = seen["inserted_length"]
    wind = np.array([air_speed(scene, float(q)) for q in seen["air_supply_rate"]]) - seen["feed_speed"]
    guide, *diameters, pitch = (seen.get(name, np.full_like(length, getattr(scene.probe, name))) for name in SHAPE)
    guide = np.minimum(guide, length)
    sections = (guide, length - guide)
    return [
        (_drag_per_metre(scene, d, pitch) * wind * np.abs(wind), section)
        for d, section in zip(diameters, sections, strict=True)
    ]


def _sliding_tension(
    friction: FloatArray, pulled: list[tuple[FloatArray, FloatArray]], radius: FloatArray
) -> FloatArray:
    """dT/ds = q - mu' T / r, solved from the tip to the root; ``friction`` is mu'."""
    tension = np.zeros_like(friction)
    for force, section in pulled:
        decay = friction * section / radius
        tension = tension * np.exp(-decay) - force * radius / friction * np.expm1(-decay)
    return tension


def _drag_per_metre(scene: Scene, float_diameter: FloatArray, pitch: FloatArray) -> FloatArray:
    """Drag force a metre over the square of the wind [N s2/m3], after (10)."""
    air, cable = scene.air, scene.probe.cable_diameter
    frontal = math.pi / 4.0 * (float_diameter**2 - cable**2)
    return 0.5 * air.drag_coefficient * air.density * frontal / pitch
