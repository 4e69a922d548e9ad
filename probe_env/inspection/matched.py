"""Signal-to-noise behind the matched filter, from spectra; all densities are one-sided.

A flaw that is passed at u has the spectrum A (w/u) G(f w/u); in noise of the density S = k1^2 S_y + S_e the filter that
is matched to both gives SNR^2 = 4 A^2 (w/u)^2 integral over f > 0 of |G(f w/u)|^2 / S(f) df.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from probe_env.arrays import FloatArray
from probe_env.inspection.flaw import energy_above, power
from probe_env.inspection.sensor import Sensor
from probe_env.inspection.spectrum import AVERAGED, COUNT, FREQUENCY, SPAN

SLOWEST: Final = 0.01
"""[m/s]: below it a flaw's band has no line of the spectrum, and the figures of this speed are given."""
LINE: Final = 1.0 / SPAN


class Heard(NamedTuple):
    """What N probes would have shown of a groove of 20 % in a period.

    Attributes:
        snr: (N,) signal-to-noise of the groove.
        share: (N,) of the filtered noise's variance that is the sensor's motion.
        peak_to_peak: (N,) of the motion signal [V].
        excursions: (N, COUNT) filtered motion over its expected deviation.
    """

    snr: FloatArray
    share: FloatArray
    peak_to_peak: FloatArray
    excursions: FloatArray


def snr_of_groove(sensor: Sensor, feed: FloatArray, motion: FloatArray) -> FloatArray:
    """(N,) signal-to-noise of the 20 % groove.

    Args:
        sensor: its constants.
        feed: (N,) feed speed [m/s]; its sign does not matter.
        motion: (N, m) one-sided density of the radial motion at ``FREQUENCY`` [m2/Hz]; beyond it there is none.
    """
    passing = _passing(sensor, feed)
    noise = sensor.seen_gain**2 * motion + sensor.noise_density
    return _snr(sensor, passing, power(FREQUENCY * passing[:, None]) / noise)


def _passing(sensor: Sensor, feed: FloatArray) -> FloatArray:
    """(N,) time in which a flaw is passed [s]."""
    return np.asarray(sensor.flaw_width / np.maximum(np.abs(feed), SLOWEST))


def _snr(sensor: Sensor, passing: FloatArray, weights: FloatArray) -> FloatArray:
    """(N,) signal-to-noise of the groove by the flaw's power over the noise (N, m) at ``FREQUENCY``."""
    inner = weights.sum(axis=1) * LINE
    above = energy_above((FREQUENCY[-1] + 0.5 * LINE) * passing) / (passing * sensor.noise_density)
    return np.asarray(2.0 * sensor.groove_signal * passing * np.sqrt(inner + above))


def unbiased(sensor: Sensor, spectrum: FloatArray, inverse: float) -> FloatArray:
    """(..., m) density of the motion [m2/Hz] with which 1/(all noise) is right in the mean.

    A density S from few seconds scatters, and the mean of 1/S is ``inverse``, c, times 1/(mean of S). With the
    electronics' S_e the mean of 1/(S + S_e) is, to second order, (1 + (c - 1) s^2) / (S + S_e), s = S/(S + S_e), where
    S times 1 + (c - 1) s takes that back.

    Args:
        sensor: its constants.
        spectrum: (..., m) mean density of the motion [m2/Hz].
        inverse: c, see ``spectrum.inverse``.
    """
    moved = sensor.seen_gain**2 * spectrum
    return np.asarray(spectrum * (1.0 + (inverse - 1.0) * moved / (moved + sensor.noise_density)))


def heard(sensor: Sensor, feed: FloatArray, motion: FloatArray, spectrum: FloatArray, inverse: float = 1.0) -> Heard:
    """What motion leaves of the signal-to-noise.

    Args:
        sensor: its constants.
        feed: (N,) feed speed [m/s].
        motion: (N, COUNT) of the last second [m], see ``spectrum.straightened``.
        spectrum: (N, m) its mean density [m2/Hz].
        inverse: the mean of its inverse over the inverse of its mean, see ``spectrum.inverse``.
    """
    gain, electronics, passing = sensor.seen_gain, sensor.noise_density, _passing(sensor, feed)
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
    return Heard(_snr(sensor, passing, weights), variance / all_of_it, peak_to_peak, excursions)


def response_of(
    sensor: Sensor, feed: float, spectrum: FloatArray, signal: FloatArray, sample_period: float
) -> FloatArray:
    """(n,) a signal (n,) [V] behind the matched filter, over its noise's deviation.

    Args:
        sensor: its constants.
        feed: feed speed [m/s].
        spectrum: (m,) density of the motion at ``FREQUENCY`` [m2/Hz].
        signal: (n,) along the direction of the flaw.
        sample_period: [s].
    """
    passing = sensor.flaw_width / max(abs(feed), SLOWEST)
    frequency = np.fft.rfftfreq(len(signal), sample_period)
    noise = sensor.seen_gain**2 * np.interp(frequency, FREQUENCY, spectrum, right=0.0) + sensor.noise_density
    gain = np.sqrt(power(frequency * passing)) / noise
    deviation = np.sqrt((gain**2 * noise).sum() * (frequency[1] - frequency[0]))
    out = np.fft.irfft(np.fft.rfft(signal) * -1j * gain, len(signal))
    return np.asarray(out / deviation)
