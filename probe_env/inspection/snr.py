"""Signal-to-noise ratio after the matched filter, from spectra of the sensor's motion; all densities are one-sided.

At feed speed u, a flaw has the spectrum A (w/u) G(f w/u). In noise of density S = k1^2 S_y + S_e, the matched filter
gives SNR^2 = 4 A^2 (w/u)^2 integral over f > 0 of |G(f w/u)|^2 / S(f) df.

The spectrum is an exponential mean of spectra of one second each. Sine tapers (Riedel and Sidorenko, IEEE Transactions
on Signal Processing 43, 1995) give ``TAPERS`` nearly independent estimates per second; a Hann window gives one.
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
"""Duration of the motion in one spectrum [s]: lines 1 Hz apart, the bandwidth at the slowest feeds."""
STEP: Final = 5e-3
"""Sample period of the spectra [s]: up to 100 Hz; at 0.4 m/s the flaw's band ends at 60 Hz."""
COUNT: Final = round(SPAN / STEP)
TAPERS: Final = 4
NEWEST_FRACTION: Final = 1.0 - math.exp(-0.5)
"""Weight of the last second in the mean of spectra: an exponential mean over 2 s at one spectrum per second. Equal
at all control periods and time-lapses, because it determines how far a burst exceeds the noise it is part of."""
FREQUENCY: Final = np.arange(1, COUNT // 2) / SPAN
"""(m,) lines of a spectrum [Hz], without the mean and the end of the band."""
AVERAGED: Final = np.sinc(FREQUENCY * STEP)
"""(m,) gain of averaging over ``STEP`` at these lines."""


@lru_cache
def _tapers() -> FloatArray:
    """(TAPERS, COUNT) sine tapers of unit energy."""
    order, index = np.arange(1, TAPERS + 1)[:, None], np.arange(1, COUNT + 1)
    return np.asarray(np.sqrt(2.0 / (COUNT + 1)) * np.sin(np.pi * order * index / (COUNT + 1)))


@lru_cache
def retained_weight(elapsed: float) -> float:
    """Weight r of the old mean when a spectrum is added after ``elapsed`` [s] of motion.

    Spectra overlap: the share 1 - j elapsed / SPAN of the j-th last spectrum belongs to the last second. r solves
    (1 - r) sum over j >= 0 of r^j (1 - j elapsed / SPAN) = ``NEWEST_FRACTION``; the left side falls with r from 1 to 0.
    """
    if elapsed >= SPAN:
        return 1.0 - NEWEST_FRACTION
    j = np.arange(math.ceil(SPAN / elapsed))
    fractions = 1.0 - j * elapsed / SPAN
    return float(brentq(lambda r: (1.0 - r) * (r**j * fractions).sum() - NEWEST_FRACTION, 0.0, 1.0, xtol=1e-14))


@lru_cache
def inverse_bias(elapsed: float) -> float:
    """Mean of 1/S divided by 1/(mean of S), for the mean spectrum S of Gaussian motion; see ``retained_weight``.

    A spectrum has ``TAPERS`` complex estimates of two degrees of freedom each. Successive spectra are correlated: the
    mean is equivalent to (1 + r)/(1 - r) / (1 + 2 sum over j > 0 of r^j (correlation at a lag of j elapsed))
    independent spectra, and S is nearly chi-squared.
    """
    r, tapers = retained_weight(elapsed), _tapers()

    def correlation(steps: int) -> float:  # of the densities of white noise at a lag of ``steps`` times ``STEP``
        return float(((tapers[:, steps:] @ tapers[:, : COUNT - steps].T) ** 2).sum() / TAPERS)

    shared = sum(r**j * correlation(round(j * elapsed / STEP)) for j in range(1, math.ceil(SPAN / elapsed)))
    freedom = 2 * TAPERS * (1.0 + r) / (1.0 - r) / (1.0 + 2.0 * shared)
    return freedom / (freedom - 2.0)


_OFFSETS: Final = np.arange(COUNT) - 0.5 * (COUNT - 1)
SLOPE: Final = _OFFSETS / np.sqrt((_OFFSETS**2).sum())
"""(COUNT,) of unit energy and no mean."""


def detrended(samples: FloatArray, sample_period: float) -> FloatArray:
    """(N, COUNT) means over ``STEP`` of the last ``SPAN`` of samples (N, k), linear trend subtracted."""
    each = round(STEP / sample_period)
    # a sum: ``mean`` takes twice as long
    means = samples[:, -COUNT * each :].reshape(len(samples), COUNT, each).sum(axis=2) / each
    level = means - means.sum(axis=1, keepdims=True) / COUNT
    # no matrix product: the rounding of a row would depend on the other rows
    return np.asarray(level - (level * SLOPE).sum(axis=1, keepdims=True) * SLOPE)


def density(motion: FloatArray) -> FloatArray:
    """(N, m) one-sided spectral density at ``FREQUENCY`` of detrended samples (N, COUNT) [m]; [m2/Hz].

    The gain of averaging over ``STEP`` is corrected. The resolution is (TAPERS + 1) / SPAN, 5 Hz.
    """
    spectra = np.fft.rfft(motion[:, None, :] * _tapers(), axis=2)[:, :, 1 : COUNT // 2]
    powers = (spectra.real**2 + spectra.imag**2).sum(axis=1) / TAPERS
    return np.asarray(2.0 * STEP * powers / AVERAGED**2)


SLOWEST: Final = 0.01
"""[m/s]; below it no line of the spectrum is in a flaw's band, and results are those at this speed."""
LINE: Final = 1.0 / SPAN


class FilteredSignal(NamedTuple):
    """Result of the matched filter for N probes in one period; for one probe without the first axis."""

    snr: FloatArray  # (N,) signal-to-noise ratio of the 20 % groove
    fraction: FloatArray  # (N,) fraction of the filtered noise variance that is due to motion
    peak_to_peak: FloatArray  # (N,) of the motion signal [V]
    excursions: FloatArray  # (N, COUNT) filtered motion in expected standard deviations


def snr_of_groove(sensor: Sensor, feed: FloatArray, motion: FloatArray) -> FloatArray:
    """(N,) signal-to-noise ratio of the 20 % groove at feed speeds (N,) [m/s] of either sign.

    ``motion`` (N, m) is the one-sided density of the radial motion at ``FREQUENCY`` [m2/Hz], 0 at higher frequencies.
    """
    passing = passing_time(sensor, feed)
    noise = sensor.flaw_gain**2 * motion + sensor.noise_density
    return _snr(sensor, passing, power(FREQUENCY * passing[:, None]) / noise)


def passing_time(sensor: Sensor, feed: FloatArray | float) -> FloatArray:
    """Time in which the sensor moves by a flaw's width [s]."""
    return np.asarray(sensor.flaw_width / np.maximum(np.abs(feed), SLOWEST))


def _snr(sensor: Sensor, passing: FloatArray, weights: FloatArray) -> FloatArray:
    """(N,) signal-to-noise ratio of the groove from weights (N, m), flaw power over noise density at ``FREQUENCY``."""
    inner = weights.sum(axis=1) * LINE
    above = energy_above((FREQUENCY[-1] + 0.5 * LINE) * passing) / (passing * sensor.noise_density)
    return np.asarray(2.0 * sensor.groove_signal * passing * np.sqrt(inner + above))


def unbiased(sensor: Sensor, spectrum: FloatArray, bias: float) -> FloatArray:
    """(..., m) density of the motion [m2/Hz], corrected so that the mean of 1/(total noise) is unbiased.

    An estimated density S scatters: the mean of 1/S is c = ``bias`` times 1/(mean of S). With the electronic noise S_e,
    the mean of 1/(S + S_e) is, to second order, (1 + (c - 1) s^2) / (S + S_e), s = S/(S + S_e). Multiplying S by
    1 + (c - 1) s corrects this.
    """
    moved = sensor.flaw_gain**2 * spectrum
    return np.asarray(spectrum * (1.0 + (bias - 1.0) * moved / (moved + sensor.noise_density)))


def filtered_signal(
    sensor: Sensor, feed: FloatArray, motion: FloatArray, spectrum: FloatArray, bias: float
) -> FilteredSignal:
    """Signal-to-noise ratio and noise after the matched filter, for N probes.

    Args:
        sensor: constants of the sensor.
        feed: (N,) feed speed [m/s].
        motion: (N, COUNT) radial motion of the last second [m], see ``detrended``.
        spectrum: (N, m) mean density of the motion [m2/Hz].
        bias: of the inverse of ``spectrum``, see ``inverse_bias``.
    """
    gain, electronics, passing = sensor.flaw_gain, sensor.noise_density, passing_time(sensor, feed)
    noise = gain**2 * unbiased(sensor, spectrum, bias) + electronics
    flaw = power(FREQUENCY * passing[:, None])
    weights, moved = flaw / noise, gain**2 * spectrum
    variance = (weights * moved / noise).sum(axis=1)
    total = np.maximum((weights * (moved + electronics) / noise).sum(axis=1), 1e-300)
    response = np.zeros((len(motion), COUNT // 2 + 1), dtype=complex)
    # the filter's response: conjugate of the flaw's spectrum i v exp(-v^2 / 2), over the noise
    response.imag[:, 1:-1] = -np.sqrt(flaw) * (1.0 / noise) * (1.0 / AVERAGED)
    filtered = gain * np.fft.irfft(np.fft.rfft(motion, axis=1) * response, COUNT, axis=1)
    # variance is a sum of one-sided densities over lines: times the line spacing it is the variance of ``filtered``
    excursions = filtered / np.sqrt(np.maximum(variance * LINE, 1e-300))[:, None]
    peak_to_peak = np.abs(gain) * (motion.max(axis=1) - motion.min(axis=1))
    return FilteredSignal(_snr(sensor, passing, weights), variance / total, peak_to_peak, excursions)


class SnrEstimator:
    """Estimates the signal-to-noise ratio of N sensors from the last second of their radial motion.

    Args:
        sensor: constants of the sensor.
        count: N.
        sample_period: of the motion [s], a divisor of 5 ms.

    ``spectrum`` (N, m) is the mean one-sided density of the motion at ``FREQUENCY`` [m2/Hz].
    """

    def __init__(self, sensor: Sensor, count: int, sample_period: float) -> None:
        self.sensor: Final = sensor
        self.sample_period: Final = sample_period
        self._samples = np.zeros((count, round(SPAN / sample_period)))
        self._sample_count = np.zeros(count, dtype=np.int64)
        self.spectrum = np.zeros((count, len(FREQUENCY)))
        self._bias = np.ones(count)
        self._signal = FilteredSignal(np.zeros(count), np.zeros(count), np.zeros(count), np.zeros((count, COUNT)))

    def branch(self, which: Sequence[int]) -> SnrEstimator:
        """An estimator of copies of some probes, with their past motion."""
        new, index = SnrEstimator(self.sensor, len(which), self.sample_period), list(which)
        for name in ("_samples", "_sample_count", "spectrum", "_bias"):
            setattr(new, name, getattr(self, name)[index])
        new._signal = FilteredSignal(*(values[index] for values in self._signal))
        return new

    def reset(self, k: int) -> None:
        """Forget the motion of probe k; call this at the start of an episode."""
        self._sample_count[k], self.spectrum[k] = 0, 0.0

    def last(self, k: int) -> FilteredSignal:
        """The signal of probe k in its last period."""
        return FilteredSignal(*(values[k] for values in self._signal))

    def filter_spectrum(self, k: int) -> FloatArray:
        """(m,) density of the motion of probe k in the matched filter [m2/Hz]."""
        return unbiased(self.sensor, self.spectrum[k], float(self._bias[k]))

    def last_second(self, k: int) -> FloatArray:
        """(n,) stored motion of probe k [m], newest last, at most one second."""
        available = min(int(self._sample_count[k]), self._samples.shape[1])
        return self._samples[k, self._samples.shape[1] - available :].copy()

    def update(self, which: npt.NDArray[np.integer[Any]], radial: FloatArray, feed: FloatArray) -> FilteredSignal:
        """Add one period of n probes; returns their filtered signal.

        Args:
            which: (n,) indices of the probes.
            radial: (samples, n) radial motion [m].
            feed: (n,) feed speed [m/s].
        """
        size = self._samples.shape[1]
        new = radial[-size:].T
        fresh = self._sample_count[which] == 0
        before = np.where(fresh[:, None], new[:, :1], self._samples[which, new.shape[1] :])
        self._samples[which] = samples = np.concatenate([before, new], axis=1)
        self._sample_count[which] += len(radial)
        motion = detrended(samples, self.sample_period)
        # in the first second the missing samples are constant: scale the motion to the power of the samples
        seconds = self._sample_count[which] * self.sample_period
        if seconds.min() < SPAN:
            motion *= np.sqrt(np.maximum(SPAN / seconds, 1.0))[:, None]
        elapsed = len(radial) * self.sample_period
        gain = np.maximum(1.0 - retained_weight(elapsed), elapsed / seconds)[:, None]
        spectrum = self.spectrum[which]
        spectrum += np.minimum(gain, 1.0) * (density(motion) - spectrum)
        self.spectrum[which], self._bias[which] = spectrum, inverse_bias(elapsed)
        signal = filtered_signal(self.sensor, feed, motion, spectrum, inverse_bias(elapsed))
        for values, latest in zip(self._signal, signal, strict=True):
            values[which] = latest
        return signal
