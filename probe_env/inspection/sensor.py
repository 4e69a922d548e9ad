"""The remote-field sensor as one typed table, ``[sensor]``: signals of motion, flaws and supports, and a flaw's shape.

Along each of the channels X and Y the voltage is v = k1 n y + k2 (y/R)^2 + A(a) g((s - s0)/w) + electronic noise. Only
ratios to the signal of a 20 % groove matter to what is found; two anchors fix them.

The flaw's shape is the derivative of a Gaussian over the length: g(x) has its extremes of -1 and 1 at x = +-1/(2 pi),
and its spectrum |G(v)|^2 = e/(2 pi) v^2 exp(-v^2) peaks at v = 1: a flaw of width w that is passed at u has its signal
around f = u/w.
"""

from __future__ import annotations

import math
from typing import Annotated, Final, Self

import numpy as np
from pydantic import model_validator
from pydantic_core import PydanticCustomError
from scipy.special import erfc

from probe_env.arrays import FloatArray
from probe_env.settings import Model, quantity

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


ANCHOR_SPEED: Final = 0.2
"""[m/s], at which the study's mock-up was inspected: both anchors are of this feed."""
ANCHOR_RMS: Final = 1e-4
"""[m] radial rms in the flaw's band, of the second anchor: the vibration limit of the task."""
GROOVE: Final = 0.2
"""Share of the wall of the groove that the anchors are of."""


class Sensor(Model):
    """Constants of the sensor and of the call; what a plant's own calibration tube replaces."""

    flaw_width: Annotated[float, quantity(1e-3, 0.5, "m")] = 0.02
    """Length over which a flaw is seen [m]; assumption: about the bore."""
    groove_signal: Annotated[float, quantity(1e-9, 1e9, "V")] = 1.0
    """A20, amplitude of a groove of 20 % of the wall [V]; the unit of all voltages, at will."""
    depth_exponent: Annotated[float, quantity(0.2, 4.0, "")] = 1.0
    """p of A(a) = A20 (a / 20 %)^p; assumption: as the metal that is missing."""
    quiet_snr: Annotated[float, quantity(0.1, 1000.0, "")] = 7.5
    """Signal-to-noise of that groove at 0.2 m/s without vibration; published: 6 to 9 for outer flaws of 20 % all
    round, or of part of the circumference up to 30 %, in such tubes (doi 10.3233/JAE-171237)."""
    shaken_snr: Annotated[float, quantity(0.1, 1000.0, "")] = 3.0
    """The same at a radial rms of 0.1 mm in the flaw's band, for a flaw in the motion's direction; assumption: what is
    called is 3 times the noise."""
    motion_gain: Annotated[float, quantity(0.0, 1e15, "V/m")] | None = None
    """k1 [V/m], where it was measured; default: what ``shaken_snr`` says."""
    square_gain: Annotated[float, quantity(-1e12, 1e12, "V")] = 35.5
    """k2 [V], of (y/R)^2 with the bore's radius R; assumption: as strong as k1 y a radius off."""
    angle: Annotated[float, quantity(-math.pi, math.pi, "rad")] = 0.6
    """Of coil X from the radial direction; assumption: X and Y opposite and unequal, as in the study's figure 3(b)."""
    flaw_angle: Annotated[float, quantity(-math.pi, math.pi, "rad")] = 0.0
    """Of the flaw from the radial direction; assumption, the worst: motion and flaw look alike. Another angle leaves k1
    as it is, and the motion's part along the flaw is less by its cosine: that is what turning the phase gains."""
    support_signal: Annotated[float, quantity(0.0, 1e12, "V")] = 3.0
    """Amplitude of a support of the tube [V]; assumption. Drawn, and told apart from flaws by its place."""
    support_width: Annotated[float, quantity(1e-3, 1.0, "m")] = 0.04
    """Of a support's signal [m]; assumption."""
    false_calls: Annotated[float, quantity(1e-6, 100.0, "")] = 0.1
    """Calls a tube where there is no flaw, which set the threshold; assumption."""

    @model_validator(mode="after")
    def _vibration_adds_noise(self) -> Self:
        if self.motion_gain is None and not self.shaken_snr < self.quiet_snr:
            raise PydanticCustomError(
                "range",
                "shaken_snr = {shaken} must be below quiet_snr = {quiet}",
                {"shaken": self.shaken_snr, "quiet": self.quiet_snr},
            )
        return self

    @property
    def noise_density(self) -> float:
        """S_e of the electronics in one channel [V2/Hz], one-sided, white: from the quiet anchor."""
        passing = self.flaw_width / ANCHOR_SPEED
        return 2.0 * ENERGY * passing * (self.groove_signal / self.quiet_snr) ** 2

    @property
    def gain(self) -> float:
        """k1 [V/m]: as given, or from the second anchor with motion that is white over the flaw's band."""
        if self.motion_gain is not None:
            return self.motion_gain
        added = self.shaken_snr**-2 - self.quiet_snr**-2
        return self.groove_signal * math.sqrt(2.0 * ENERGY * BAND * added) / ANCHOR_RMS

    @property
    def flaw_gain(self) -> float:
        """Gain [V/m] of radial motion along the direction of the flaw, in which calls are made."""
        return self.gain * math.cos(self.flaw_angle)

    def amplitude(self, depth: FloatArray | float) -> FloatArray:
        """A [V] of flaws of these depths, shares of the wall."""
        return np.asarray(self.groove_signal * (np.asarray(depth, dtype=float) / GROOVE) ** self.depth_exponent)

    def equivalent_rms(self, noise_to_signal: FloatArray) -> FloatArray:
        """Radial rms [m] in the flaw's band that alone would make this noise over the 20 % groove's signal."""
        gain = max(abs(self.flaw_gain), 1e-12)
        return np.asarray(self.groove_signal * math.sqrt(2.0 * ENERGY * BAND) / gain * noise_to_signal)
