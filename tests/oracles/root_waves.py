"""How much of a bending wave leaves the root as an axial one: closed form for floats that do not give way radially.

Of one end's rotation t a clamped piece of cable has the moment S t there and D t at its other end, and the mean height
that makes the arc longer by g l^2 t / 12 r. Derivation: docs/simulation/root.md.
"""

from __future__ import annotations

import math
from typing import Final

from probe_env.scene import Scene

MIDDLE: Final = 3.9266023
"""Beta p of the wave that turns by a quarter from float to float, the middle of the band: tan z = tanh z."""


def near_stiffness(z: float) -> float:
    """S in EI / l of a piece with beta l = z; 4 at rest."""
    return z * (math.sin(z) * math.cosh(z) - math.cos(z) * math.sinh(z)) / (1.0 - math.cos(z) * math.cosh(z))


def far_stiffness(z: float) -> float:
    """D in EI / l; 2 at rest."""
    return z * (math.sinh(z) - math.sin(z)) / (1.0 - math.cos(z) * math.cosh(z))


def lengthening(z: float) -> float:
    """g; 1 at rest. By reciprocity the clamped end's moment under an even load, as a share of w l^2 / 12."""
    s, c, sh, ch = (f(0.5 * z) for f in (math.sin, math.cos, math.sinh, math.cosh))
    return 12.0 / z**2 * (s * ch - c * sh) / (c * sh + s * ch)


def arc_of_rotation(scene: Scene, place: float, z: float = 0.0) -> float:
    """Arc length that the first float's rotation brings in or takes out [m/rad].

    Args:
        scene: tube and probe.
        place: distance of the root from the first float as a share of the pitch, above 0.
        z: beta p of the wave, 0 at rest.
    """
    pitch, radius = scene.probe.float_pitch, 0.5 * scene.tube.helix_diameter
    between, root = (lengthening(z * share) if z else 1.0 for share in (1.0, place))
    return pitch**2 * (between - root * place**2) / (12.0 * radius)


def conversion(scene: Scene, place: float, z: float = MIDDLE) -> float:
    """Amplitude of the axial wave that leaves over that of the bending wave that comes to the root [m/rad].

    The first float turns by 2 D sin q / |S_root + i D sin q| of the wave, whose q from float to float is given by
    cos q = -S / D.
    """
    across = math.sqrt(far_stiffness(z) ** 2 - near_stiffness(z) ** 2)
    return arc_of_rotation(scene, place, z) * 2.0 * across / math.hypot(near_stiffness(z * place) / place, across)
