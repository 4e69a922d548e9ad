"""A run heard afterwards, a quarter of a second at a time: spectra for its filter, a threshold that knows all of it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from typing import Final

import numpy as np

from probe_env.arrays import FloatArray
from probe_env.inspection.detection import EDGES, threshold, threshold_as_seen
from probe_env.inspection.meter import SPAN, Meter
from probe_env.inspection.sensor import Sensor
from probe_env.inspection.tally import MIDDLE
from probe_env.physics.simulation.signals import SAMPLE_PERIOD

STRETCH: Final = round(0.25 * SPAN / SAMPLE_PERIOD)
"""Samples that the filter weighs by one spectrum: as many as a tally counts of every second."""


def listened(sensor: Sensor, radial: FloatArray, feed: FloatArray) -> Iterator[tuple[int, int, Meter]]:
    """First and last sample of each piece, and a meter that has listened up to there.

    The first piece is half a ``STRETCH``, so that each second ends half a stretch after one.

    Args:
        sensor: its constants.
        radial: (k,) motion [m].
        feed: (k,) feed speed [m/s].
    """
    meter, one = Meter(sensor, 1, SAMPLE_PERIOD), np.zeros(1, dtype=np.int64)
    ends = list(range(STRETCH // 2, len(radial) + 1, STRETCH)) or [len(radial)]
    for begin, end in itertools.pairwise([0, *ends]):
        meter.listen(one, radial[begin:end, None], feed[begin : begin + 1])
        yield begin, end, meter


def centred_spectra(sensor: Sensor, radial: FloatArray, feed: FloatArray) -> FloatArray:
    """(p, m) densities by which the filter of each ``STRETCH`` weighs, of seconds that have it in their middle.

    So an episode's tally counts excursions. An instrument that filters as it goes knows the past alone, and a burst
    that sets in stands out more behind its filter.

    Args:
        sensor: its constants.
        radial: (k,) motion [m].
        feed: (k,) feed speed [m/s].
    """
    heard = [meter.of_filter(0) for _, _, meter in listened(sensor, radial, feed)]
    # a second that ends half a stretch after the one that follows: the last ones have what there is
    last = np.minimum(np.arange(math.ceil(len(radial) / STRETCH)) + 2, len(heard) - 1)
    return np.array(heard)[last]


def threshold_of_all(sensor: Sensor, radial: FloatArray, feed: FloatArray, length: float) -> float:
    """The threshold that a tally would set that had heard every quarter of every second [deviations].

    It weighs an excursion by the length on which it was heard and by the motion's share of the noise there, whether or
    not the motion passes for Gaussian. What an episode tallies is one quarter of four.

    Args:
        sensor: its constants.
        radial: (k,) motion [m].
        feed: (k,) feed speed [m/s].
        length: of the tube [m].
    """
    lengths, shares, counts = [], [], np.zeros(len(EDGES) - 1)
    for begin, end, meter in listened(sensor, radial, feed):
        if end * SAMPLE_PERIOD < SPAN:
            continue  # less than a second is known
        _, share, _, excursions = meter.of(0)
        metres = float(feed[begin:end].sum()) * SAMPLE_PERIOD
        inside = np.clip(excursions[MIDDLE], EDGES[0], EDGES[-1])
        counts += metres * share * np.histogram(inside, EDGES)[0]
        lengths.append(metres)
        shares.append(share)
    z = threshold(sensor, length)
    if not counts.any():
        return z
    return threshold_as_seen(z, np.array(lengths), np.array(shares), counts)
