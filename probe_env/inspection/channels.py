"""Sensor channels X and Y of a run, from motion, flaws, supports and noise, and the calls of the matched filter."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import repeat
from typing import Final

import numpy as np
from scipy.signal import find_peaks

from probe_env.arrays import FloatArray
from probe_env.inspection.sensor import Sensor, power, shape
from probe_env.inspection.snr import FREQUENCY, SPAN, passing_time

SMOOTHING: Final = 10e-3
"""Averaging time of the channels in plots [s], like the low-pass of an instrument."""
FLAW_REACH: Final = 1.5
"""Distance from a flaw, in widths, beyond which its signal is 0: g(1.5) is below 1e-17."""


@dataclass(frozen=True)
class Flaw:
    """A simulated flaw of the tube."""

    position: float  # of its centre, from the entrance of the helix [m]
    depth: float  # fraction of the wall


@dataclass(frozen=True)
class Recording:
    """Motion of a sensor during a run, k samples; SI units."""

    time: FloatArray  # (k,) evenly spaced
    position: FloatArray  # (k,) of the sensor, from the entrance of the helix
    feed: FloatArray  # (k,) feed speed
    radial: FloatArray  # (k,) displacement
    spectrum: FloatArray  # (p, m) density of the motion in the filter of each of p segments, at ``snr.FREQUENCY``
    segment: int  # samples of a segment

    @property
    def sample_period(self) -> float:
        """Time between samples [s]."""
        return float(self.time[1] - self.time[0])


def channel_fractions(sensor: Sensor, direction: float) -> FloatArray:
    """(2,) components in X and Y of a signal at an angle ``direction`` from the radial direction [rad]."""
    return np.array([math.cos(direction - sensor.angle), math.sin(direction - sensor.angle)])


def along_flaw(sensor: Sensor, voltages: FloatArray) -> FloatArray:
    """(k,) component of the channels (k, 2) in the direction of the flaw, in which calls are made."""
    return np.asarray(voltages @ channel_fractions(sensor, sensor.flaw_angle))


def _pulses(position: FloatArray, centres: Iterable[float], amplitudes: Iterable[float], width: float) -> FloatArray:
    """(k,) sum of flaw shapes of a width [m] around centres [m]."""
    signal = np.zeros(len(position))
    for centre, amplitude in zip(centres, amplitudes, strict=False):
        near = np.abs(position - centre) < FLAW_REACH * width
        signal[near] += amplitude * shape((position[near] - centre) / width)
    return signal


def support_positions(spacing: float, length: float) -> FloatArray:
    """Positions of the supports of the tube [m]; the first is half a spacing from the entrance."""
    return np.arange(0.5 * spacing, length, spacing)


def support_signal(sensor: Sensor, position: FloatArray, supports: FloatArray) -> FloatArray:
    """(k,) voltage of supports [V], equal in both channels."""
    return _pulses(position, supports, repeat(sensor.support_signal), sensor.support_width)


def channels(
    sensor: Sensor,
    motion: Recording,
    bore: float,
    flaws: Sequence[Flaw],
    supports: FloatArray,
    rng: np.random.Generator,
) -> FloatArray:
    """(k, 2) voltages X and Y of a run [V], means subtracted; bore and positions of supports in m."""
    moved = motion.radial - motion.radial.mean()
    voltages = sensor.gain * np.outer(moved, channel_fractions(sensor, 0.0))
    voltages += sensor.square_gain * ((moved / (0.5 * bore)) ** 2)[:, None]
    amplitudes = [float(sensor.amplitude(flaw.depth)) for flaw in flaws]
    signal = _pulses(motion.position, [flaw.position for flaw in flaws], amplitudes, sensor.flaw_width)
    voltages += np.outer(signal, channel_fractions(sensor, sensor.flaw_angle))
    voltages += support_signal(sensor, motion.position, supports)[:, None]
    deviation = math.sqrt(0.5 * sensor.noise_density / motion.sample_period)
    voltages += deviation * rng.normal(size=voltages.shape)
    return np.asarray(voltages - voltages.mean(axis=0))


def smoothed(recording: Recording, values: FloatArray) -> FloatArray:
    """Values (k, ...) averaged over ``SMOOTHING``."""
    width = max(round(SMOOTHING / recording.sample_period), 1)
    kernel = np.full(width, 1.0 / width)
    return np.apply_along_axis(lambda column: np.convolve(column, kernel, "same"), 0, values)


def filtered(sensor: Sensor, recording: Recording, signal: FloatArray) -> FloatArray:
    """(k,) signal (k,) after the filter of each segment, in standard deviations of the filtered noise."""
    around = round(SPAN / recording.sample_period)
    padded = np.pad(signal, around)
    values = np.zeros(len(signal))
    for number, begin in enumerate(range(0, len(signal), recording.segment)):
        part = padded[begin : begin + recording.segment + 2 * around]
        frequency = np.fft.rfftfreq(len(part), recording.sample_period)
        motion = np.interp(frequency, FREQUENCY, recording.spectrum[number], right=0.0)
        noise = sensor.flaw_gain**2 * motion + sensor.noise_density
        gain = np.sqrt(power(frequency * passing_time(sensor, float(recording.feed[begin])))) / noise
        deviation = np.sqrt((gain**2 * noise).sum() * (frequency[1] - frequency[0]))
        out = np.fft.irfft(np.fft.rfft(part) * -1j * gain, len(part)) / deviation
        values[begin : begin + recording.segment] = out[around : around + recording.segment]
    return values


def calls(values: FloatArray, position: FloatArray, z: float, width: float) -> FloatArray:
    """Positions [m] at which filtered values exceed the threshold z; one call, at the maximum, per flaw width."""
    peaks, _ = find_peaks(values, height=z)
    called: list[int] = []
    for peak in sorted(peaks.tolist(), key=lambda k: -values[k]):
        if all(abs(position[peak] - position[other]) > width for other in called):
            called.append(peak)
    return np.sort(position[called]) if called else np.zeros(0)
