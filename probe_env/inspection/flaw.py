"""The signal of a flaw: derivative of a Gaussian over the length, and what follows from it in closed form.

g(x) has its extremes of -1 and 1 at x = +-1/(2 pi), and its spectrum |G(v)|^2 = e/(2 pi) v^2 exp(-v^2) peaks at v = 1:
a flaw of width w that is passed at u has its signal around f = u/w.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from scipy.special import erfc

from probe_env.arrays import FloatArray

ENERGY: Final = math.e / (4.0 * math.sqrt(math.pi))
"""Integral of g^2 over x, and of |G|^2 over both signs of v."""
BAND: Final = math.e * math.sqrt(math.pi) / 4.0
"""Integral of |G(v)|^2 / |G(1)|^2 over v > 0: the flaw's band is so many u/w wide [Hz]."""
UPCROSSINGS: Final = math.sqrt(1.5)
"""Of zero by white noise behind the matched filter, a flaw's width: sqrt of the mean of v^2 over |G|^2 (Rice)."""


def shape(x: FloatArray) -> FloatArray:
    """The shape g at distances x from the flaw, in widths."""
    turned = 2.0 * np.pi * np.asarray(x, dtype=float)
    return np.asarray(-turned * np.exp(0.5 - 0.5 * turned**2))


def power(v: FloatArray) -> FloatArray:
    """|G|^2 at v = f w / u."""
    square = np.asarray(v, dtype=float) ** 2
    return np.asarray(math.e / (2.0 * np.pi) * square * np.exp(-square))


def energy_above(v: FloatArray) -> FloatArray:
    """Integral of |G|^2 from v > 0 to infinity; half of ``ENERGY`` from 0."""
    v = np.asarray(v, dtype=float)
    return np.asarray(math.e / (2.0 * np.pi) * (0.5 * v * np.exp(-(v**2)) + 0.25 * np.sqrt(np.pi) * erfc(v)))
