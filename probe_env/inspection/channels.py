"""The two channels of a run: what motion, flaws, supports and noise make of X and Y, and what the filter calls."""

from __future__ import annotations

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

SHOWN: Final = 10e-3
"""[s] over which channels are averaged before they are drawn, as an instrument's low-pass does."""
FLAW_REACH: Final = 1.5
"""Widths from a flaw within which it is seen: g(1.5) is below 1e-17."""


@dataclass(frozen=True)
class Flaw:
    """A flaw that is put into the tube."""

    place: float  # of its middle, from the helix's entrance [m]
    depth: float  # share of the wall


@dataclass(frozen=True)
class Passage:
    """What a sensor went through, k samples; SI units."""

    time: FloatArray  # (k,) evenly spaced
    place: FloatArray  # (k,) of the sensor from the helix's entrance
    feed: FloatArray  # (k,) feed speed
    radial: FloatArray  # (k,) displacement
    spectrum: FloatArray  # (p, m) density by which the filter of each of p stretches weighs, at ``snr.FREQUENCY``
    stretch: int  # samples in one of them

    @property
    def sample_period(self) -> float:
        """Time between samples [s]."""
        return float(self.time[1] - self.time[0])


def looks(sensor: Sensor, direction: float) -> FloatArray:
    """(2,) share that the channels X and Y see of something in a direction from the radial one [rad]."""
    return np.array([math.cos(direction - sensor.angle), math.sin(direction - sensor.angle)])


def along(sensor: Sensor, voltages: FloatArray) -> FloatArray:
    """(k,) the channels (k, 2) turned into the direction of the flaw, in which calls are made."""
    return np.asarray(voltages @ looks(sensor, sensor.flaw_angle))


def _pulses(place: FloatArray, centres: Iterable[float], amplitudes: Iterable[float], width: float) -> FloatArray:
    """(k,) sum of shapes of a width [m] around their centres [m]."""
    signal = np.zeros(len(place))
    for centre, amplitude in zip(centres, amplitudes, strict=False):
        near = np.abs(place - centre) < FLAW_REACH * width
        signal[near] += amplitude * shape((place[near] - centre) / width)
    return signal


def support_places(spacing: float, length: float) -> FloatArray:
    """Places of the tube's supports [m], half a spacing from its entrance on."""
    return np.arange(0.5 * spacing, length, spacing)


def support_signal(sensor: Sensor, place: FloatArray, supports: FloatArray) -> FloatArray:
    """(k,) voltage of supports [V], alike in both channels."""
    return _pulses(place, supports, repeat(sensor.support_signal), sensor.support_width)


def channels(
    sensor: Sensor, passage: Passage, bore: float, flaws: Sequence[Flaw], supports: FloatArray, rng: np.random.Generator
) -> FloatArray:
    """(k, 2) voltages X and Y of a run [V], without their means; bore and places of supports in m."""
    moved = passage.radial - passage.radial.mean()
    voltages = sensor.gain * np.outer(moved, looks(sensor, 0.0))
    voltages += sensor.square_gain * ((moved / (0.5 * bore)) ** 2)[:, None]
    amplitudes = [float(sensor.amplitude(flaw.depth)) for flaw in flaws]
    signal = _pulses(passage.place, [flaw.place for flaw in flaws], amplitudes, sensor.flaw_width)
    voltages += np.outer(signal, looks(sensor, sensor.flaw_angle))
    voltages += support_signal(sensor, passage.place, supports)[:, None]
    deviation = math.sqrt(0.5 * sensor.noise_density / passage.sample_period)
    voltages += deviation * rng.normal(size=voltages.shape)
    return np.asarray(voltages - voltages.mean(axis=0))


def smoothed(passage: Passage, values: FloatArray) -> FloatArray:
    """Values (k, ...) averaged over ``SHOWN``."""
    width = max(round(SHOWN / passage.sample_period), 1)
    kernel = np.full(width, 1.0 / width)
    return np.apply_along_axis(lambda column: np.convolve(column, kernel, "same"), 0, values)


def filtered(sensor: Sensor, passage: Passage, signal: FloatArray) -> FloatArray:
    """(k,) the signal (k,) along the flaw behind the filter of each stretch, over its noise's deviation."""
    around = round(SPAN / passage.sample_period)
    padded = np.pad(signal, around)
    values = np.zeros(len(signal))
    for number, begin in enumerate(range(0, len(signal), passage.stretch)):
        part = padded[begin : begin + passage.stretch + 2 * around]
        frequency = np.fft.rfftfreq(len(part), passage.sample_period)
        motion = np.interp(frequency, FREQUENCY, passage.spectrum[number], right=0.0)
        noise = sensor.seen_gain**2 * motion + sensor.noise_density
        gain = np.sqrt(power(frequency * passing_time(sensor, float(passage.feed[begin])))) / noise
        deviation = np.sqrt((gain**2 * noise).sum() * (frequency[1] - frequency[0]))
        out = np.fft.irfft(np.fft.rfft(part) * -1j * gain, len(part)) / deviation
        values[begin : begin + passage.stretch] = out[around : around + passage.stretch]
    return values


def calls(values: FloatArray, place: FloatArray, z: float, width: float) -> FloatArray:
    """Places [m] at which filtered values exceed the threshold, the highest within a flaw's width."""
    peaks, _ = find_peaks(values, height=z)
    kept: list[int] = []
    for peak in sorted(peaks.tolist(), key=lambda k: -values[k]):
        if all(abs(place[peak] - place[other]) > width for other in kept):
            kept.append(peak)
    return np.sort(place[kept]) if kept else np.zeros(0)
