"""Closed forms of steady sliding and buckling; those without a tube are in ``bare_chains``.

Policies use them to estimate friction, tests to check simulations.
"""

import math
from collections.abc import Callable, Mapping
from typing import Final

import numpy as np
from numba import vectorize

from probe_env.arrays import FloatArray
from probe_env.physics.closed_forms.bare_chains import impact as impact
from probe_env.physics.closed_forms.bare_chains import linear_chain as linear_chain
from probe_env.physics.model.chain import GRAVITY as GRAVITY
from probe_env.physics.model.chain import air_pressure as air_pressure
from probe_env.physics.model.chain import air_speed, build_chain, drag_factors, wall_losses
from probe_env.scene import Probe, Scene

MEASURED: Final = ("root_tension", "inserted_length", "feed_speed", "air_supply_rate", "helix_diameter")
"""Measurements from which friction is estimated, SI units."""
SHAPE: Final = ("guide_length", "guide_float_diameter", "carrier_float_diameter", "float_pitch")
"""Dimensions of the probe in the estimate."""
LOCKED: Final = 1e6
"""Force [N] at which the cable is stuck: it grows exponentially in a bend under compression."""
ROUNDS, TOLERANCE = 60, 1e-6
"""Most iterations of ``rising_root`` (it needs about 25), and its tolerance of the value."""
Sections = list[tuple[FloatArray, FloatArray, FloatArray]]
"""Drag per metre [N/m] at the pressure of the exit, length [m] and d_f / d_h of guide and carrier, (n,) each."""


def steady_root_tension(scene: Scene) -> float:
    """Closed form of the root tension under steady sliding [N], see ``steady_tensions`` and ``entrance_tension``."""
    return float(steady_tensions(scene)[-1] - entrance_tension(scene, np.array(scene.tube.helix_diameter)))


def entrance_tension(scene: Scene, helix_diameter: FloatArray) -> FloatArray:
    """Part EI / (2 r^2) of the root tension (n,) [N] that the feed device does not feel, see ``chain.entrance_force``.

    0 without ``terms.entrance``.
    """
    rigidity = scene.probe.flexural_rigidity if scene.terms.entrance else 0.0
    return np.asarray(2.0 * rigidity / helix_diameter**2)


def steady_tensions(scene: Scene, weight: float | None = None) -> FloatArray:
    """Closed form of the axial force behind every float in steady sliding [N], tip first; negative: compression.

    T = (q r / mu') (1 - exp(-mu' s / r)) at a distance s from the tip, with the mean drag q per metre. Friction acts at
    the surface of the float: mu' = mu (1 - d_f / d_h) under tension, on the inner wall, and mu (1 + d_f / d_h) under
    compression, on the outer wall. Friction reduces the force of the air if the probe moves with the air, and increases
    it otherwise. With two float sizes, q is piecewise constant and T is continuous. In compressible air q has its mean
    over each pitch, see ``drag_factors``.

    With a weight w across the plane of the helix, friction is mu sqrt(N^2 + w^2) with N = T / r. Its moment about the
    cable remains that of mu N, because the contact point moves out of the plane:

        dT/ds = q - mu (sqrt((T / r)^2 + w^2) - d_f / d_h T / r),

    the equation above for w = 0, and T = (q - mu w) s in a straight tube; integrated by Runge-Kutta steps.

    Args:
        scene: probe, tube, friction, air, feed speed and length.
        weight: of the cable per metre, across the plane of the helix [N/m]; default: ``GRAVITY`` times the line density
            if ``contact.weight``, else 0.
    """
    if weight is None:
        weight = scene.probe.line_density * GRAVITY if scene.contact.weight else 0.0
    chain = build_chain(scene)
    exit_speed = air_speed(scene, scene.air_supply_rate)
    relative = exit_speed - scene.feed_speed
    pitch = scene.probe.float_pitch
    radius = scene.tube.helix_diameter / 2.0
    floats = np.arange(chain.node_count - 1) % 4 == 0
    edges = pitch * np.arange(floats.sum() + 1)
    drags = chain.drag[:-1][floats] * relative * abs(relative)
    drags *= drag_factors(scene, edges, scene.inserted_length, scene.feed_speed, exit_speed)
    forward = 1.0 if scene.feed_speed >= 0.0 else -1.0
    coefficient = scene.contact.friction_at(scene.feed_speed)
    tension, tensions = 0.0, []
    for drag, lever in zip(drags, chain.lever[:-1][floats], strict=True):
        side = 1.0 if (tension or drag) >= 0.0 else -1.0
        mu = coefficient * (1.0 - side * lever / radius) * side * forward
        if weight > 0.0:
            friction = forward * coefficient
            tension = _tension_behind(tension, drag / pitch, 1.0, 0.0, pitch, friction, lever / radius, radius, weight)
        elif mu == 0.0:
            tension += drag
        else:
            limit = drag / pitch * radius / mu
            tension = limit + (tension - limit) * math.exp(-mu * pitch / radius)
        tensions.append(tension)
    return np.array(tensions)


def buckling_load(probe: Probe) -> float:
    """Compression [N] at which the cable buckles between two floats: Euler's load of a pitch, pi^2 EI / p^2.

    Floats on a wall restrain the cable sideways but not in rotation. Compression is nearly equal in neighbouring spans,
    which bend to opposite sides and do not restrain each other: each is a bar with hinged ends. The initial deflection
    p^2 / 8 r from the helix (2 mm for table 2) grows near the load but does not change it. If floats have left the
    wall, the cable bends over several pitches and buckles at a lower load.
    """
    return math.pi**2 * probe.flexural_rigidity / probe.float_pitch**2


def drag_per_metre(scene: Scene) -> float:
    """Drag of the carrier's floats per metre, divided by the square of the relative air speed [N s2/m3], after (10)."""
    probe = scene.probe
    return float(_drag_per_metre(scene, np.array(probe.carrier_float_diameter), np.array(probe.float_pitch)))


def friction_from_tension(measurements: Mapping[str, FloatArray], scene: Scene) -> FloatArray:
    """Friction coefficient (n,) at which ``sliding_tension`` is the measured tension, between 0 and 2.

    Tension decreases with friction. The force of the entrance is added to the measured tension.

    Args:
        measurements: ``MEASURED``, (n,) each; also ``SHAPE`` if the probe is not that of the scene.
        scene: bore, air, rest of the probe, and which effects count.
    """
    diameter = measurements["helix_diameter"]
    tension = measurements["root_tension"] + entrance_tension(scene, diameter)
    low, high = np.zeros_like(tension), np.full_like(tension, 2.0)
    if _integrated(scene):
        # clipped: far from the root the steps are bisections
        return rising_root(lambda mu: np.clip(tension - sliding_tension(mu, measurements, scene), -1.0, 1.0), low, high)
    sections = _sections(measurements, scene)
    for _ in range(30):
        middle = 0.5 * (low + high)
        above = _uniform_sliding(middle, sections, diameter / 2.0) > tension
        low, high = np.where(above, middle, low), np.where(above, high, middle)
    return np.asarray(0.5 * (low + high) / (1.0 - sections[-1][2]))


def sliding_tension(
    friction: FloatArray, measurements: Mapping[str, FloatArray], scene: Scene, drag: FloatArray | float = 1.0
) -> FloatArray:
    """Root tension (..., n) [N] of probes that slide steadily into the helix, without the force of the entrance.

    Between tip and root dT/ds = q - mu' T / r, mu' = mu (1 - d_f / d_h), with the drag q per metre of the guide, then
    of the carrier. If air expands or the cable has weight, the equation of ``steady_tensions`` is integrated instead,
    with an error of at most 1e-3.

    Args:
        friction: (..., 1) or (..., n), above 0.
        measurements: ``MEASURED`` without the tension, (n,) each; also ``SHAPE`` if the probe is not that of the scene.
        scene: bore, air, rest of the probe, and which effects count.
        drag: (..., 1) or (..., n), factor of the drag coefficient.
    """
    air, radius, sections = scene.air, measurements["helix_diameter"] / 2.0, _sections(measurements, scene)
    if not _integrated(scene):
        return np.asarray(drag * _uniform_sliding(friction * (1.0 - sections[-1][2]), sections, radius))
    weight = scene.probe.line_density * GRAVITY if scene.contact.weight else 0.0
    expansion = 2.0 * air.exit_pressure if air.compressible else 0.0
    wall, empty = wall_losses(scene, measurements["air_supply_rate"] * air_speed(scene, 1.0))
    square = air.exit_pressure**2 + expansion * empty * (scene.tube.helix_length - measurements["inserted_length"])
    tension = np.zeros(1)
    for force, length, lever in sections:
        growth = expansion * (np.maximum(drag * force, 0.0) * air_speed(scene, 1.0) + wall)
        pull = drag * force * air.exit_pressure
        tension = _tension_behind(tension, pull, square, growth, length, friction, lever, radius, weight)
        square = square + growth * length
    return np.asarray(tension)


@vectorize(cache=True)  # type: ignore[no-untyped-call]
def _tension_behind(tension, pull, square, growth, length, friction, lever, radius, weight):  # type: ignore
    """Tension at the end of a section, see ``steady_tensions``, by Runge-Kutta steps of at most 0.4 r / mu and 2 m.

    ``square`` is p^2 at its start, ``growth`` that of p^2 per metre, ``pull`` the drag per metre times p.
    """
    steps = max(math.ceil(length * max(2.5 * abs(friction) / radius, 0.5)), 1)
    step, t, mu, pull = length / steps, tension / radius, friction / radius, pull / radius

    def slope(q: float, t: float) -> float:
        return q - mu * (math.sqrt(t * t + weight * weight) - lever * t)  # type: ignore[no-any-return]

    q = pull / math.sqrt(square)
    for k in range(steps):
        middle = pull / math.sqrt(square + (k + 0.5) * step * growth)
        end = pull / math.sqrt(square + (k + 1.0) * step * growth)
        first = slope(q, t)
        second = slope(middle, t + 0.5 * step * first)
        third = slope(middle, t + 0.5 * step * second)
        t += step / 6.0 * (first + 2.0 * second + 2.0 * third + slope(end, t + step * third))
        q = end
        if t < -LOCKED:  # it grows exponentially
            break
    return max(t * radius, -LOCKED)


def rising_root(value: Callable[[FloatArray], FloatArray], low: FloatArray, high: FloatArray) -> FloatArray:
    """Arguments (n,) between ``low`` and ``high`` where a rising function is 0, by regula falsi (Illinois).

    ``low`` where it is positive everywhere, ``high`` where it is negative everywhere.
    """
    below, above = value(low), value(high)
    known, bound = (below >= 0.0) | (above < 0.0), np.where(below >= 0.0, low, high)
    root, before = low, np.zeros_like(low)
    for _ in range(ROUNDS):
        root = np.where(known, bound, high - above * (high - low) / np.where(known, 1.0, above - below))
        new = value(root)
        if (known | (np.abs(new) < TOLERANCE)).all():
            break
        side = np.where(new >= 0.0, 1.0, -1.0)
        above = np.where(side > 0.0, new, np.where(side == before, 0.5 * above, above))
        below = np.where(side < 0.0, new, np.where(side == before, 0.5 * below, below))
        low, high, before = np.where(side < 0.0, root, low), np.where(side > 0.0, root, high), side
    return root


def _integrated(scene: Scene) -> bool:
    """Whether the equation of steady sliding has no closed form."""
    return scene.air.compressible or scene.contact.weight


def _sections(measurements: Mapping[str, FloatArray], scene: Scene) -> Sections:
    """Guide and carrier of the probes; in an integration the float at the sensor is one of the guide."""
    length, helix = measurements["inserted_length"], measurements["helix_diameter"]
    wind = np.array([air_speed(scene, float(q)) for q in measurements["air_supply_rate"]]) - measurements["feed_speed"]
    guide, *diameters, pitch = (
        measurements.get(name, np.full_like(length, getattr(scene.probe, name))) for name in SHAPE
    )
    guide = np.minimum(guide + pitch * _integrated(scene), length)
    return [
        (_drag_per_metre(scene, d, pitch) * wind * np.abs(wind), part, d / helix)
        for d, part in zip(diameters, (guide, length - guide), strict=True)
    ]


def _uniform_sliding(friction: FloatArray, sections: Sections, radius: FloatArray) -> FloatArray:
    """Solution of dT/ds = q - mu' T / r at the root; ``friction`` is mu'."""
    tension = np.zeros_like(friction)
    for force, length, _ in sections:
        decay = friction * length / radius
        tension = tension * np.exp(-decay) - force * radius / friction * np.expm1(-decay)
    return tension


def _drag_per_metre(scene: Scene, float_diameter: FloatArray, pitch: FloatArray) -> FloatArray:
    """Drag per metre, divided by the square of the relative air speed [N s2/m3], after (10)."""
    air, cable = scene.air, scene.probe.cable_diameter
    frontal = math.pi / 4.0 * (float_diameter**2 - cable**2)
    return 0.5 * air.drag_coefficient * air.density * frontal / pitch
