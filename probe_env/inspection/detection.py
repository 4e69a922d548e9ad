"""Threshold from the rate of false calls, probability of detection (POD), and flaw depths with POD 50 and 90 %.

A flaw is called where the filtered signal, in standard deviations of its noise, exceeds z. In Gaussian noise
POD(a | position) = Phi(SNR(a) - z); otherwise the observed distribution of the motion is used.
"""

import math
from typing import Final

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr, ndtri

from probe_env.arrays import FloatArray
from probe_env.inspection.sensor import GROOVE, UPCROSSINGS, Sensor

DEPTHS: Final = np.geomspace(0.02, 1.0, 21)
"""Flaw depths of the POD curves, fractions of the wall."""
EDGES: Final = np.linspace(-16.0, 16.0, 129)
"""Bin edges of the histogram of excursions."""
MIDDLES: Final = 0.5 * (EDGES[1:] + EDGES[:-1])
MIN_GAUSSIAN: Final = 1e-3
"""Least fraction of Gaussian electronic noise in the filtered noise; it makes the curves smooth."""
SMALLEST: Final = 1e-9
"""Least probability, and least distance from 1, of a POD curve in interpolation."""
WORST: Final = 1.0
"""Depth returned if the POD of a through hole is below the level."""


def threshold(sensor: Sensor, length: float) -> float:
    """Threshold z that noise exceeds ``sensor.false_calls`` times in a tube of this length [m].

    Filtered Gaussian noise crosses z upwards ``UPCROSSINGS / w * exp(-z^2 / 2)`` times per metre at any feed speed
    (S. O. Rice, Bell System Technical Journal 24, 1945).
    """
    crossings = UPCROSSINGS * length / sensor.flaw_width
    return math.sqrt(2.0 * math.log(max(crossings / sensor.false_calls, 1.0)))


def snr_at(sensor: Sensor, groove: FloatArray, depths: FloatArray = DEPTHS) -> FloatArray:
    """(n, d) signal-to-noise ratio at depths (d,), fractions of the wall, from that of the 20 % groove (n,)."""
    return np.asarray(np.asarray(groove)[:, None] * (np.asarray(depths) / GROOVE) ** sensor.depth_exponent)


def pod_gaussian(snr: FloatArray, z: float) -> FloatArray:
    """POD of a flaw with this signal-to-noise ratio in Gaussian noise."""
    return np.asarray(ndtr(np.asarray(snr) - z))


def pod_empirical(snr: FloatArray, z: float, fraction: FloatArray, counts: FloatArray) -> FloatArray:
    """(n, d) POD with the observed distribution of the filtered motion.

    ``fraction`` (n,) is the fraction of the noise variance that is motion, ``counts`` (len(MIDDLES),) its histogram.
    """
    filled = counts > 0
    weights, motion = counts[filled] / counts.sum(), MIDDLES[filled]
    fraction = np.clip(fraction, 0.0, 1.0 - MIN_GAUSSIAN)[:, None]
    values = np.zeros_like(snr)
    for weight, excursion in zip(weights, motion, strict=True):
        values += weight * ndtr((snr - z + np.sqrt(fraction) * excursion) / np.sqrt(1.0 - fraction))
    return values


def threshold_empirical(z: float, lengths: FloatArray, fraction: FloatArray, counts: FloatArray) -> float:
    """Threshold that the observed noise exceeds over the same share of the length as Gaussian noise exceeds ``z``.

    It is never below ``z``, because one tube has few excursions. ``lengths`` (n,) are those of the intervals [m]; the
    other arguments are those of ``pod_empirical``.
    """
    weights = lengths / lengths.sum()

    def above(level: float) -> float:
        exceeded = pod_empirical(np.zeros((len(fraction), 1)), level, fraction, counts)[:, 0]
        return float((weights * exceeded).sum() / ndtr(-z) - 1.0)

    return z if above(z) <= 0.0 else float(brentq(above, z, EDGES[-1] + 2.0 * z, xtol=1e-3))


def depths_found(pod: FloatArray, level: float, depths: FloatArray = DEPTHS) -> FloatArray:
    """(n,) least depths with a POD of at least ``level`` on curves (n, d); ``WORST`` if there is none.

    The probit of a curve is interpolated linearly, which is exact in one interval if the amplitude is linear in depth.
    """
    probit = ndtri(np.clip(np.maximum.accumulate(pod, axis=1), SMALLEST, 1.0 - SMALLEST)) - ndtri(level)
    after = np.clip((probit < 0.0).sum(axis=1), 1, len(depths) - 1)
    rows = np.arange(len(pod))
    low, high = probit[rows, after - 1], probit[rows, after]
    fraction = np.clip(-low / np.where(high > low, high - low, 1.0), 0.0, 1.0)
    interpolated = depths[after - 1] + fraction * (depths[after] - depths[after - 1])
    return np.asarray(np.where(probit[:, -1] < 0.0, WORST, interpolated))


def depth_found(pod: FloatArray, level: float, depths: FloatArray = DEPTHS) -> float:
    """``depths_found`` for one curve (d,)."""
    return float(depths_found(np.asarray(pod)[None], level, depths)[0])
