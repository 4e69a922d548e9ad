"""The spectrum of the sensor's motion: of its last second, and a mean over the seconds before.

Sine tapers (Riedel and Sidorenko, IEEE Transactions on Signal Processing 43, 1995) give ``TAPERS`` nearly independent
estimates from one second, which a Hann window would use for one.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final

import numpy as np

from probe_env.arrays import FloatArray

SPAN: Final = 1.0
"""Of the motion that a spectrum is of [s]: lines 1 Hz apart, the band of the slowest feeds."""
STEP: Final = 5e-3
"""Of the samples behind the means [s]: to 100 Hz; the flaw's band ends at 60 Hz at 0.4 m/s."""
COUNT: Final = round(SPAN / STEP)
TAPERS: Final = 4
MEMORY: Final = 2.0
"""Time constant of the mean of spectra [s], of the motion's own clock: signal-to-noise from it scatters by some 7 %."""
FREEDOM: Final = 2 * TAPERS * round(2.0 * MEMORY / SPAN)
"""Degrees of freedom of such a mean: an exponential one weighs as a plain one over twice its time constant."""
INVERSE: Final = FREEDOM / (FREEDOM - 2.0)
"""The mean of 1/S over 1/(mean of S) for estimates S that are chi-squared."""
FREQUENCY: Final = np.arange(1, COUNT // 2) / SPAN
"""(m,) lines of a spectrum [Hz]; neither the mean nor the end of the band."""


@lru_cache
def _tapers() -> FloatArray:
    """(TAPERS, COUNT), each of unit energy."""
    order, place = np.arange(1, TAPERS + 1)[:, None], np.arange(1, COUNT + 1)
    return np.asarray(np.sqrt(2.0 / (COUNT + 1)) * np.sin(np.pi * order * place / (COUNT + 1)))


@lru_cache
def _line() -> FloatArray:
    """(COUNT,) a slope of unit energy and no mean."""
    place = np.arange(COUNT) - 0.5 * (COUNT - 1)
    return np.asarray(place / np.sqrt((place**2).sum()))


def straightened(samples: FloatArray, sample_period: float) -> FloatArray:
    """(N, COUNT) means over ``STEP`` of the last ``SPAN`` of samples (N, k), without their straight line."""
    each = round(STEP / sample_period)
    means = samples[:, -COUNT * each :].reshape(len(samples), COUNT, each).mean(axis=2)
    level = means - means.mean(axis=1, keepdims=True)
    slope = _line()
    # no matrix product: it would round a row otherwise in another company
    return np.asarray(level - (level * slope).sum(axis=1, keepdims=True) * slope)


def density(motion: FloatArray) -> FloatArray:
    """(N, m) one-sided spectral density at ``FREQUENCY``, of straightened samples (N, COUNT); [m2/Hz] of metres.

    What the means over ``STEP`` take from it is given back. The resolution is (TAPERS + 1) / SPAN, 5 Hz.
    """
    spectra = np.fft.rfft(motion[:, None, :] * _tapers(), axis=2)[:, :, 1 : COUNT // 2]
    powers = (spectra.real**2 + spectra.imag**2).mean(axis=1)
    return np.asarray(2.0 * STEP * powers / np.sinc(FREQUENCY * STEP) ** 2)
