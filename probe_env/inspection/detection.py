"""What is found: threshold from false calls, probability of detection, and the depths that are found with 50 and 90 %.

A flaw is called where the matched filter, in units of its noise's deviation, exceeds z. Where that noise is Gaussian
POD(a | place) = Phi(SNR(a) - z); else the motion's part of it is taken as it was seen.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr, ndtri

from probe_env.arrays import FloatArray
from probe_env.inspection.sensor import GROOVE, UPCROSSINGS, Sensor

DEPTHS: Final = np.geomspace(0.02, 1.0, 21)
"""Shares of the wall at which curves are kept."""
EDGES: Final = np.linspace(-16.0, 16.0, 129)
"""Of the histogram of excursions."""
MIDDLES: Final = 0.5 * (EDGES[1:] + EDGES[:-1])
LEAST_GAUSSIAN: Final = 1e-3
"""Share of the electronics in the filtered noise that is always taken as Gaussian, so that curves have no steps."""
SMALLEST: Final = 1e-9
"""Probability beyond which curves are cut off."""
WORST: Final = 1.0
"""Depth that is given where even a hole is not found so often."""


def threshold(sensor: Sensor, length: float) -> float:
    """The z that noise alone exceeds ``sensor.false_calls`` times in a tube of this length [m].

    Gaussian noise behind the filter crosses z upwards ``UPCROSSINGS / w * exp(-z^2 / 2)`` times a metre at any feed
    (S. O. Rice, Bell System Technical Journal 24, 1945).
    """
    crossings = UPCROSSINGS * length / sensor.flaw_width
    return math.sqrt(2.0 * math.log(max(crossings / sensor.false_calls, 1.0)))


def snr_at(sensor: Sensor, groove: FloatArray, depths: FloatArray = DEPTHS) -> FloatArray:
    """(n, d) signal-to-noise at depths (d,), shares of the wall, from that of the 20 % groove (n,)."""
    return np.asarray(np.asarray(groove)[:, None] * (np.asarray(depths) / GROOVE) ** sensor.depth_exponent)


def pod_gaussian(snr: FloatArray, z: float) -> FloatArray:
    """Probability that a flaw of this signal-to-noise is called."""
    return np.asarray(ndtr(np.asarray(snr) - z))


def pod_empirical(snr: FloatArray, z: float, share: FloatArray, counts: FloatArray) -> FloatArray:
    """(n, d) the same with the motion's part of the noise distributed as it was seen.

    ``share`` (n,) of the noise's variance is motion, ``counts`` (len(MIDDLES),) are those of its excursions.
    """
    seen = counts > 0
    weights, motion = counts[seen] / counts.sum(), MIDDLES[seen]
    share = np.clip(share, 0.0, 1.0 - LEAST_GAUSSIAN)[:, None]
    values = np.zeros_like(snr)
    for weight, excursion in zip(weights, motion, strict=True):
        values += weight * ndtr((snr - z + np.sqrt(share) * excursion) / np.sqrt(1.0 - share))
    return values


def threshold_empirical(z: float, lengths: FloatArray, share: FloatArray, counts: FloatArray) -> float:
    """The threshold that noise as it was seen exceeds over as much of the length as Gaussian noise does ``z``.

    Never below ``z``: what the few excursions of one tube do not show may come in the next. ``lengths`` (n,) are those
    of the places [m]; the rest as in ``pod_empirical``.
    """
    weights = lengths / lengths.sum()

    def above(level: float) -> float:
        exceeded = pod_empirical(np.zeros((len(share), 1)), level, share, counts)[:, 0]
        return float((weights * exceeded).sum() / ndtr(-z) - 1.0)

    return z if above(z) <= 0.0 else float(brentq(above, z, EDGES[-1] + 2.0 * z, xtol=1e-3))


def depths_found(pod: FloatArray, level: float, depths: FloatArray = DEPTHS) -> FloatArray:
    """(n,) least depths from which a share ``level`` of the flaws is found, by curves (n, d); ``WORST`` where none is.

    Between depths the probit of a curve is a straight line, which that of one place is for an amplitude that goes with
    the depth.
    """
    probit = ndtri(np.clip(np.maximum.accumulate(pod, axis=1), SMALLEST, 1.0 - SMALLEST)) - ndtri(level)
    after = np.clip((probit < 0.0).sum(axis=1), 1, len(depths) - 1)
    rows = np.arange(len(pod))
    low, high = probit[rows, after - 1], probit[rows, after]
    share = np.clip(-low / np.where(high > low, high - low, 1.0), 0.0, 1.0)
    interpolated = depths[after - 1] + share * (depths[after] - depths[after - 1])
    return np.asarray(np.where(probit[:, -1] < 0.0, WORST, interpolated))


def depth_found(pod: FloatArray, level: float, depths: FloatArray = DEPTHS) -> float:
    """``depths_found`` of one curve (d,)."""
    return float(depths_found(np.asarray(pod)[None], level, depths)[0])
