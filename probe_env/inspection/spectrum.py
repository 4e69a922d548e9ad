"""The spectrum of the sensor's motion: of its last second, and a mean over the seconds before.

Sine tapers (Riedel and Sidorenko, IEEE Transactions on Signal Processing 43, 1995) give ``TAPERS`` nearly independent
estimates from one second, which a Hann window would use for one.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Final

import numpy as np
from scipy.optimize import brentq

from probe_env.arrays import FloatArray

SPAN: Final = 1.0
"""Of the motion that a spectrum is of [s]: lines 1 Hz apart, the band of the slowest feeds."""
STEP: Final = 5e-3
"""Of the samples behind the means [s]: to 100 Hz; the flaw's band ends at 60 Hz at 0.4 m/s."""
COUNT: Final = round(SPAN / STEP)
TAPERS: Final = 4
OWN: Final = 1.0 - math.exp(-0.5)
"""Share of the last second in the mean of spectra: an exponential mean over 2 s where one is taken a second. A burst
counts for less the more of the mean it is itself, so that what is called hangs on this share: it is the same at any
control period and time-lapse."""
FREQUENCY: Final = np.arange(1, COUNT // 2) / SPAN
"""(m,) lines of a spectrum [Hz]; neither the mean nor the end of the band."""
AVERAGED: Final = np.sinc(FREQUENCY * STEP)
"""(m,) what means over ``STEP`` leave of an amplitude there."""


@lru_cache
def _tapers() -> FloatArray:
    """(TAPERS, COUNT), each of unit energy."""
    order, place = np.arange(1, TAPERS + 1)[:, None], np.arange(1, COUNT + 1)
    return np.asarray(np.sqrt(2.0 / (COUNT + 1)) * np.sin(np.pi * order * place / (COUNT + 1)))


@lru_cache
def kept(passed: float) -> float:
    """The weight r that a mean of spectra keeps when the next one is taken.

    Spectra overlap: the last second is wholly in the newest, and 1 - j passed / SPAN of the j-th before it is of that
    second, too. So (1 - r) sum over j >= 0 of r^j (1 - j passed / SPAN) = ``OWN``, which falls with r from 1 to 0.

    Args:
        passed: between two spectra [s] of the motion.
    """
    if passed >= SPAN:
        return 1.0 - OWN
    j = np.arange(math.ceil(SPAN / passed))
    return float(brentq(lambda r: (1.0 - r) * (r**j * (1.0 - j * passed / SPAN)).sum() - OWN, 0.0, 1.0, xtol=1e-14))


@lru_cache
def inverse(passed: float) -> float:
    """The mean of 1/S over 1/(mean of S), where S is a mean of spectra, see ``kept``, and the motion is Gaussian.

    A spectrum has ``TAPERS`` complex estimates of two degrees of freedom each. The next one has a part of them in
    common, so that the mean is worth (1 + r)/(1 - r) / (1 + 2 sum over j > 0 of r^j (correlation after j passed))
    spectra, and S is nearly chi-squared.

    Args:
        passed: between two spectra [s] of the motion.
    """
    r = kept(passed)
    shared = sum(r**j * _correlation(round(j * passed / STEP)) for j in range(1, math.ceil(SPAN / passed)))
    freedom = 2 * TAPERS * (1.0 + r) / (1.0 - r) / (1.0 + 2.0 * shared)
    return freedom / (freedom - 2.0)


def _correlation(steps: int) -> float:
    """Of a density of white noise with that ``steps`` of ``STEP`` later."""
    tapers = _tapers()
    return float(((tapers[:, steps:] @ tapers[:, : COUNT - steps].T) ** 2).sum() / TAPERS)


@lru_cache
def _line() -> FloatArray:
    """(COUNT,) a slope of unit energy and no mean."""
    place = np.arange(COUNT) - 0.5 * (COUNT - 1)
    return np.asarray(place / np.sqrt((place**2).sum()))


def straightened(samples: FloatArray, sample_period: float) -> FloatArray:
    """(N, COUNT) means over ``STEP`` of the last ``SPAN`` of samples (N, k), without their straight line."""
    each = round(STEP / sample_period)
    # sums: ``mean`` costs as much again as its sum
    means = samples[:, -COUNT * each :].reshape(len(samples), COUNT, each).sum(axis=2) / each
    level = means - means.sum(axis=1, keepdims=True) / COUNT
    slope = _line()
    # no matrix product: it would round a row otherwise in another company
    return np.asarray(level - (level * slope).sum(axis=1, keepdims=True) * slope)


def density(motion: FloatArray) -> FloatArray:
    """(N, m) one-sided spectral density at ``FREQUENCY``, of straightened samples (N, COUNT); [m2/Hz] of metres.

    What the means over ``STEP`` take from it is given back. The resolution is (TAPERS + 1) / SPAN, 5 Hz.
    """
    spectra = np.fft.rfft(motion[:, None, :] * _tapers(), axis=2)[:, :, 1 : COUNT // 2]
    powers = (spectra.real**2 + spectra.imag**2).sum(axis=1) / TAPERS
    return np.asarray(2.0 * STEP * powers / AVERAGED**2)
