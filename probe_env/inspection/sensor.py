"""Model of the remote-field sensor, table ``[sensor]``: signals of motion, flaws and supports, and the flaw shape.

The voltage in each of the channels X and Y is v = k1 n y + k2 (y/R)^2 + A(a) g((s - s0)/w) + electronic noise.
Detection depends only on ratios to the signal of a 20 % groove; two reference points determine them.

The flaw shape g(x) is the derivative of a Gaussian with extremes -1 and 1 at x = +-1/(2 pi). Its spectrum
|G(v)|^2 = e/(2 pi) v^2 exp(-v^2) peaks at v = 1: at feed speed u, the signal of a flaw of width w is around f = u/w.
"""

import math
from typing import Annotated, Final, Self

import numpy as np
from pydantic import model_validator
from scipy.special import erfc

from probe_env.arrays import FloatArray
from probe_env.settings import Model, quantity

ENERGY: Final = math.e / (4.0 * math.sqrt(math.pi))
"""Integral of g^2 over x, and of |G|^2 over both signs of v."""
BAND: Final = math.e * math.sqrt(math.pi) / 4.0
"""Integral of |G(v)|^2 / |G(1)|^2 over v > 0: the bandwidth of a flaw in units of u/w."""
UPCROSSINGS: Final = math.sqrt(1.5)
"""Zero upcrossings of white noise per flaw width after the filter: sqrt of the mean of v^2 over |G|^2 (Rice)."""


def shape(x: FloatArray) -> FloatArray:
    """Flaw shape g at distances x from the flaw, in widths."""
    angle = 2.0 * np.pi * np.asarray(x, dtype=float)
    return np.asarray(-angle * np.exp(0.5 - 0.5 * angle**2))


def power(v: FloatArray) -> FloatArray:
    """Power spectrum |G|^2 of the flaw shape at v = f w / u."""
    square = np.asarray(v, dtype=float) ** 2
    return np.asarray(math.e / (2.0 * np.pi) * square * np.exp(-square))


def energy_above(v: FloatArray) -> FloatArray:
    """Integral of |G|^2 from v > 0 to infinity; at v = 0 half of ``ENERGY``."""
    v = np.asarray(v, dtype=float)
    return np.asarray(math.e / (2.0 * np.pi) * (0.5 * v * np.exp(-(v**2)) + 0.25 * np.sqrt(np.pi) * erfc(v)))


REFERENCE_SPEED: Final = 0.2
"""Feed speed of both reference points [m/s], that of the study's mock-up."""
REFERENCE_RMS: Final = 1e-4
"""Radial rms in the flaw's band at the second reference point [m]: the vibration limit of the task."""
GROOVE: Final = 0.2
"""Depth of the reference groove, fraction of the wall."""


class Sensor(Model):
    """Constants of the sensor and of the calls; replace them by values from the plant's calibration tube."""

    flaw_width: Annotated[float, quantity(1e-3, 0.5, "m")] = 0.02
    """Length of a flaw's signal [m]; assumption: about the bore."""
    groove_signal: Annotated[float, quantity(1e-9, 1e9, "V")] = 1.0
    """A20, signal amplitude of a groove of 20 % of the wall [V]; sets the unit of all voltages."""
    depth_exponent: Annotated[float, quantity(0.2, 4.0, "")] = 1.0
    """Exponent p of A(a) = A20 (a / 20 %)^p; assumption: proportional to the missing metal."""
    quiet_snr: Annotated[float, quantity(0.1, 1000.0, "")] = 7.5
    """Signal-to-noise ratio of the 20 % groove at 0.2 m/s without vibration; published: 6 to 9 in such tubes for outer
    flaws of 20 % all round or of part of the circumference up to 30 % (doi 10.3233/JAE-171237)."""
    shaken_snr: Annotated[float, quantity(0.1, 1000.0, "")] = 3.0
    """Signal-to-noise ratio of the 20 % groove at a radial rms of 0.1 mm in the flaw's band, flaw in the direction
    of the motion; assumption: calls start at 3 times the noise."""
    motion_gain: Annotated[float, quantity(0.0, 1e15, "V/m")] | None = None
    """k1, signal per radial displacement [V/m], if measured; default: follows from ``shaken_snr``."""
    square_gain: Annotated[float, quantity(-1e12, 1e12, "V")] = 35.5
    """k2, signal per (y/R)^2 with the radius R of the bore [V]; assumption: equal to k1 y at y = R."""
    angle: Annotated[float, quantity(-math.pi, math.pi, "rad")] = 0.6
    """Angle of coil X to the radial direction [rad]; assumption: X and Y opposite and unequal (study, figure 3b)."""
    flaw_angle: Annotated[float, quantity(-math.pi, math.pi, "rad")] = 0.0
    """Angle of the flaw to the radial direction [rad]; assumption: 0, the worst case. Another angle does not change k1,
    but reduces the motion signal in the direction of the flaw by its cosine."""
    support_signal: Annotated[float, quantity(0.0, 1e12, "V")] = 3.0
    """Signal amplitude of a tube support [V]; assumption. Subtracted before the matched filter."""
    support_width: Annotated[float, quantity(1e-3, 1.0, "m")] = 0.04
    """Length of a support's signal [m]; assumption."""
    false_calls: Annotated[float, quantity(1e-6, 100.0, "")] = 0.1
    """Nominal number of false calls per tube, which sets the threshold; assumption."""

    @model_validator(mode="after")
    def _vibration_adds_noise(self) -> Self:
        if self.motion_gain is None and not self.shaken_snr < self.quiet_snr:
            raise ValueError(f"shaken_snr = {self.shaken_snr} must be below quiet_snr = {self.quiet_snr}")
        return self

    @property
    def noise_density(self) -> float:
        """Density S_e of the electronic noise in one channel [V2/Hz], one-sided, white; follows from ``quiet_snr``."""
        passing = self.flaw_width / REFERENCE_SPEED
        return 2.0 * ENERGY * passing * (self.groove_signal / self.quiet_snr) ** 2

    @property
    def gain(self) -> float:
        """k1 [V/m]: ``motion_gain``, or from ``shaken_snr`` with motion that is white over the flaw's band."""
        if self.motion_gain is not None:
            return self.motion_gain
        added = self.shaken_snr**-2 - self.quiet_snr**-2
        return self.groove_signal * math.sqrt(2.0 * ENERGY * BAND * added) / REFERENCE_RMS

    @property
    def flaw_gain(self) -> float:
        """Signal per radial displacement [V/m] in the direction of the flaw, in which calls are made."""
        return self.gain * math.cos(self.flaw_angle)

    def amplitude(self, depth: FloatArray | float) -> FloatArray:
        """Signal amplitude A [V] of flaws of these depths, fractions of the wall."""
        return np.asarray(self.groove_signal * (np.asarray(depth, dtype=float) / GROOVE) ** self.depth_exponent)

    def equivalent_rms(self, noise_to_signal: FloatArray) -> FloatArray:
        """Radial rms [m] in the flaw's band that causes this ratio of noise to the signal of the 20 % groove."""
        gain = max(abs(self.flaw_gain), 1e-12)
        return np.asarray(self.groove_signal * math.sqrt(2.0 * ENERGY * BAND) / gain * noise_to_signal)
