"""Signal-to-noise behind the matched filter, from spectra of the sensor's motion; all densities are one-sided.

A flaw that is passed at u has the spectrum A (w/u) G(f w/u); in noise of the density S = k1^2 S_y + S_e the filter that
is matched to both gives SNR^2 = 4 A^2 (w/u)^2 integral over f > 0 of |G(f w/u)|^2 / S(f) df.

Spectra are of the last second of motion, and a mean over the seconds before. Sine tapers (Riedel and Sidorenko, IEEE
Transactions on Signal Processing 43, 1995) give ``TAPERS`` nearly independent estimates from one second, which a Hann
window would use for one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import brentq

from probe_env.arrays import FloatArray
from probe_env.inspection.sensor import Sensor, energy_above, power

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
    """The weight r that a mean of spectra keeps when the next one is taken, after ``passed`` [s] of motion.

    Spectra overlap: the last second is wholly in the newest, and 1 - j passed / SPAN of the j-th before it is of that
    second, too. So (1 - r) sum over j >= 0 of r^j (1 - j passed / SPAN) = ``OWN``, which falls with r from 1 to 0.
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
    """
    r, tapers = kept(passed), _tapers()

    def correlation(steps: int) -> float:  # of a density of white noise with that ``steps`` of ``STEP`` later
        return float(((tapers[:, steps:] @ tapers[:, : COUNT - steps].T) ** 2).sum() / TAPERS)

    shared = sum(r**j * correlation(round(j * passed / STEP)) for j in range(1, math.ceil(SPAN / passed)))
    freedom = 2 * TAPERS * (1.0 + r) / (1.0 - r) / (1.0 + 2.0 * shared)
    return freedom / (freedom - 2.0)


_PLACE: Final = np.arange(COUNT) - 0.5 * (COUNT - 1)
SLOPE: Final = _PLACE / np.sqrt((_PLACE**2).sum())
"""(COUNT,) of unit energy and no mean."""


def straightened(samples: FloatArray, sample_period: float) -> FloatArray:
    """(N, COUNT) means over ``STEP`` of the last ``SPAN`` of samples (N, k), without their straight line."""
    each = round(STEP / sample_period)
    # sums: ``mean`` costs as much again as its sum
    means = samples[:, -COUNT * each :].reshape(len(samples), COUNT, each).sum(axis=2) / each
    level = means - means.sum(axis=1, keepdims=True) / COUNT
    # no matrix product: it would round a row otherwise in another company
    return np.asarray(level - (level * SLOPE).sum(axis=1, keepdims=True) * SLOPE)


def density(motion: FloatArray) -> FloatArray:
    """(N, m) one-sided spectral density at ``FREQUENCY``, of straightened samples (N, COUNT); [m2/Hz] of metres.

    What the means over ``STEP`` take from it is given back. The resolution is (TAPERS + 1) / SPAN, 5 Hz.
    """
    spectra = np.fft.rfft(motion[:, None, :] * _tapers(), axis=2)[:, :, 1 : COUNT // 2]
    powers = (spectra.real**2 + spectra.imag**2).sum(axis=1) / TAPERS
    return np.asarray(2.0 * STEP * powers / AVERAGED**2)


SLOWEST: Final = 0.01
"""[m/s]: below it a flaw's band has no line of the spectrum, and the figures of this speed are given."""
LINE: Final = 1.0 / SPAN


class FilteredSignal(NamedTuple):
    """The motion of N probes in a period behind the filter for a groove of 20 %, or of one without the first axis."""

    snr: FloatArray  # (N,) signal-to-noise of the groove
    share: FloatArray  # (N,) of the filtered noise's variance that is the sensor's motion
    peak_to_peak: FloatArray  # (N,) of the motion signal [V]
    excursions: FloatArray  # (N, COUNT) filtered motion over its expected deviation


def snr_of_groove(sensor: Sensor, feed: FloatArray, motion: FloatArray) -> FloatArray:
    """(N,) signal-to-noise of the 20 % groove at feeds (N,) [m/s] of any sign.

    ``motion`` (N, m) is the one-sided density of the radial motion at ``FREQUENCY`` [m2/Hz]; beyond it there is none.
    """
    passing = passing_time(sensor, feed)
    noise = sensor.seen_gain**2 * motion + sensor.noise_density
    return _snr(sensor, passing, power(FREQUENCY * passing[:, None]) / noise)


def passing_time(sensor: Sensor, feed: FloatArray | float) -> FloatArray:
    """Time in which a flaw is passed [s]."""
    return np.asarray(sensor.flaw_width / np.maximum(np.abs(feed), SLOWEST))


def _snr(sensor: Sensor, passing: FloatArray, weights: FloatArray) -> FloatArray:
    """(N,) signal-to-noise of the groove by the flaw's power over the noise (N, m) at ``FREQUENCY``."""
    inner = weights.sum(axis=1) * LINE
    above = energy_above((FREQUENCY[-1] + 0.5 * LINE) * passing) / (passing * sensor.noise_density)
    return np.asarray(2.0 * sensor.groove_signal * passing * np.sqrt(inner + above))


def unbiased(sensor: Sensor, spectrum: FloatArray, inverse: float) -> FloatArray:
    """(..., m) density of the motion [m2/Hz], from its mean density, with which 1/(all noise) is right in the mean.

    A density S from few seconds scatters, and the mean of 1/S is ``inverse``, c, times 1/(mean of S). With the
    electronics' S_e the mean of 1/(S + S_e) is, to second order, (1 + (c - 1) s^2) / (S + S_e), s = S/(S + S_e), where
    S times 1 + (c - 1) s takes that back.
    """
    moved = sensor.seen_gain**2 * spectrum
    return np.asarray(spectrum * (1.0 + (inverse - 1.0) * moved / (moved + sensor.noise_density)))


def filtered_signal(
    sensor: Sensor, feed: FloatArray, motion: FloatArray, spectrum: FloatArray, inverse: float
) -> FilteredSignal:
    """What motion leaves of the signal-to-noise.

    Args:
        sensor: its constants.
        feed: (N,) feed speed [m/s].
        motion: (N, COUNT) of the last second [m], see ``straightened``.
        spectrum: (N, m) its mean density [m2/Hz].
        inverse: the mean of its inverse over the inverse of its mean, see ``inverse``.
    """
    gain, electronics, passing = sensor.seen_gain, sensor.noise_density, passing_time(sensor, feed)
    noise = gain**2 * unbiased(sensor, spectrum, inverse) + electronics
    flaw = power(FREQUENCY * passing[:, None])
    weights, moved = flaw / noise, gain**2 * spectrum
    variance = (weights * moved / noise).sum(axis=1)
    all_of_it = np.maximum((weights * (moved + electronics) / noise).sum(axis=1), 1e-300)
    response = np.zeros((len(motion), COUNT // 2 + 1), dtype=complex)
    # the filter's response: conjugate of the flaw's spectrum i v exp(-v^2 / 2), over the noise
    response.imag[:, 1:-1] = -np.sqrt(flaw) * (1.0 / noise) * (1.0 / AVERAGED)
    filtered = gain * np.fft.irfft(np.fft.rfft(motion, axis=1) * response, COUNT, axis=1)
    # variance is a sum of one-sided densities over lines: times their distance it is that of ``filtered``
    excursions = filtered / np.sqrt(np.maximum(variance * LINE, 1e-300))[:, None]
    peak_to_peak = np.abs(gain) * (motion.max(axis=1) - motion.min(axis=1))
    return FilteredSignal(_snr(sensor, passing, weights), variance / all_of_it, peak_to_peak, excursions)


class SnrEstimator:
    """Signal-to-noise of N sensors from the last second of their radial motion.

    Args:
        sensor: its constants.
        count: N.
        sample_period: of the motion [s], a divisor of 5 ms.

    ``spectrum`` (N, m) is the mean one-sided density of the motion at ``FREQUENCY`` [m2/Hz].
    """

    def __init__(self, sensor: Sensor, count: int, sample_period: float) -> None:
        self.sensor: Final = sensor
        self.sample_period: Final = sample_period
        self._samples = np.zeros((count, round(SPAN / sample_period)))
        self._known = np.zeros(count, dtype=np.int64)
        self.spectrum = np.zeros((count, len(FREQUENCY)))
        self._inverse = np.ones(count)
        self._signal = FilteredSignal(np.zeros(count), np.zeros(count), np.zeros(count), np.zeros((count, COUNT)))

    def fork(self, which: Sequence[int]) -> SnrEstimator:
        """An estimator of copies of some of the probes, with their motion."""
        new, index = SnrEstimator(self.sensor, len(which), self.sample_period), list(which)
        for name in ("_samples", "_known", "spectrum", "_inverse"):
            setattr(new, name, getattr(self, name)[index])
        new._signal = FilteredSignal(*(values[index] for values in self._signal))
        return new

    def reset(self, k: int) -> None:
        """Another episode of probe k begins."""
        self._known[k], self.spectrum[k] = 0, 0.0

    def last(self, k: int) -> FilteredSignal:
        """The signal of probe k in its last period."""
        return FilteredSignal(*(values[k] for values in self._signal))

    def filter_spectrum(self, k: int) -> FloatArray:
        """(m,) density of the motion of probe k as the matched filter weighs by it [m2/Hz]."""
        return unbiased(self.sensor, self.spectrum[k], float(self._inverse[k]))

    def last_second(self, k: int) -> FloatArray:
        """(m,) motion of probe k that is kept, the newest last [m]; less than a second where less is known."""
        known = min(int(self._known[k]), self._samples.shape[1])
        return self._samples[k, self._samples.shape[1] - known :].copy()

    def update(self, which: npt.NDArray[np.integer[Any]], radial: FloatArray, feed: FloatArray) -> FilteredSignal:
        """Add a period of some probes.

        Args:
            which: (n,) their indices.
            radial: (samples, n) their motion [m].
            feed: (n,) feed speed [m/s].
        """
        size = self._samples.shape[1]
        new = radial[-size:].T
        fresh = self._known[which] == 0
        before = np.where(fresh[:, None], new[:, :1], self._samples[which, new.shape[1] :])
        self._samples[which] = samples = np.concatenate([before, new], axis=1)
        self._known[which] += len(radial)
        motion = straightened(samples, self.sample_period)
        # until a second has passed the rest stands still: the same power in the part that is known
        known = self._known[which] * self.sample_period
        if known.min() < SPAN:
            motion *= np.sqrt(np.maximum(SPAN / known, 1.0))[:, None]
        passed = len(radial) * self.sample_period
        gain = np.maximum(1.0 - kept(passed), passed / known)[:, None]
        spectrum = self.spectrum[which]
        spectrum += np.minimum(gain, 1.0) * (density(motion) - spectrum)
        self.spectrum[which], self._inverse[which] = spectrum, inverse(passed)
        signal = filtered_signal(self.sensor, feed, motion, spectrum, inverse(passed))
        for values, latest in zip(self._signal, signal, strict=True):
            values[which] = latest
        return signal
