"""What the root tension of steady sliding says of the friction in the tube."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np

from probe_env.chain import FloatArray, air_speed
from probe_env.scene import Probe, Scene

MEASURED: Final = ("root_tension", "inserted_length", "feed_speed", "air_supply_rate", "helix_diameter")
"""What the estimate looks at, SI units."""
SHAPE: Final = ("guide_length", "guide_float_diameter", "carrier_float_diameter", "float_pitch")
"""Figures of the probe that it depends on."""


def friction_from_tension(seen: Mapping[str, FloatArray]) -> FloatArray:
    """Friction coefficient (n,) at which steady sliding has the measured root tension, by bisection.

    Between tip and root dT/ds = q - mu' T / r, mu' = mu (1 - d_f / d_h), with the drag q of the guide's floats, then of
    the carrier's; tension falls as friction rises. Drag, but for the probe's floats, is table 2's.

    Args:
        seen: ``MEASURED``, (n,) each; ``SHAPE`` where the probe is not table 2's.
    """
    tension, length, diameter = (seen[name] for name in ("root_tension", "inserted_length", "helix_diameter"))
    scene = Scene()
    wind = np.array([air_speed(scene, float(q)) for q in seen["air_supply_rate"]]) - seen["feed_speed"]
    table = {name: np.full_like(tension, getattr(scene.probe, name)) for name in SHAPE}
    guide, *diameters, pitch = (seen.get(name, table[name]) for name in SHAPE)
    forces = [_drag_per_metre(d, pitch) * wind * np.abs(wind) for d in diameters]
    guide = np.minimum(guide, length)
    radius = diameter / 2.0
    low, high = np.zeros_like(tension), np.full_like(tension, 2.0)
    for _ in range(30):
        middle = 0.5 * (low + high)
        at_middle = np.zeros_like(tension)
        for force, section in zip(forces, (guide, length - guide), strict=True):
            decay = middle * section / radius
            at_middle = at_middle * np.exp(-decay) - force * radius / middle * np.expm1(-decay)
        low, high = np.where(at_middle > tension, middle, low), np.where(at_middle > tension, high, middle)
    return np.asarray(0.5 * (low + high) / (1.0 - diameters[1] / diameter))


def _drag_per_metre(float_diameter: FloatArray, pitch: FloatArray) -> FloatArray:
    """Drag force a metre over the square of the wind [N s2/m3], after (10)."""
    air, cable = Scene().air, Probe().cable_diameter
    frontal = math.pi / 4.0 * (float_diameter**2 - cable**2)
    return 0.5 * air.drag_coefficient * air.density * frontal / pitch
