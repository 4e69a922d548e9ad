"""A flaw that is put where the sensor passed within the last second: X and Y, and whether it would have been called."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from agents.app.runs.frames import Shape
from probe_env.arrays import BoolArray, FloatArray
from probe_env.inspection.channels import Flaw, Passage, along, channels, filtered, smoothed
from probe_env.inspection.detection import snr_at, threshold
from probe_env.inspection.meter import snr_of_groove
from probe_env.inspection.sensor import Sensor

LEAST: Final = 100
"""Samples that are too few to show."""


class Passed(NamedTuple):
    """What the last second shows.

    Attributes:
        time: (k,) before now [s], at most 0.
        voltages: (k, 2) X and Y [V], smoothed as in every chart.
        near: (k,) whether the sensor is at the flaw, within its width.
        snr: of the flaw, by the spectrum of the motion.
        shown: what is behind the filter at the flaw, over the noise's deviation.
        threshold: that it must exceed to be called.
    """

    time: FloatArray
    voltages: FloatArray
    near: BoolArray
    snr: float
    shown: float
    threshold: float

    @property
    def called(self) -> bool:
        """Whether the flaw is called."""
        return self.shown > self.threshold


def passed(sensor: Sensor, shape: Shape, before: float, depth: float) -> Passed | None:
    """A flaw that was passed ``before`` [s] and is ``depth`` of the wall deep; None while too little has been seen.

    Electronic noise is drawn with a fixed seed, so that what is dragged changes nothing but the flaw.
    """
    time, feed = shape.signal_time, abs(shape.feed_speed)
    if len(time) < LEAST or feed == 0.0:
        return None
    passage = Passage(
        time=time - time[0],
        place=feed * time,
        feed=np.full(len(time), feed),
        radial=shape.signal_radial,
        spectrum=shape.spectrum[None],
        stretch=len(time),
    )
    flaw = Flaw(-feed * before, depth)
    voltages = channels(sensor, passage, shape.bore, [flaw], np.zeros(0), np.random.default_rng(0))
    near = np.abs(passage.place - flaw.place) <= 0.5 * sensor.flaw_width
    behind = filtered(sensor, passage, along(sensor, voltages))
    groove = snr_of_groove(sensor, np.array([feed]), passage.spectrum)
    snr = float(snr_at(sensor, groove, np.array([depth]))[0, 0])
    shown = float(behind[near].max()) if near.any() else 0.0
    return Passed(time, smoothed(passage, voltages), near, snr, shown, threshold(sensor, shape.helix_length))
