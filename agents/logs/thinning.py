"""Fewer rows that feed the same: straight lines in place of the length, within a tolerance, standstills exactly."""

from __future__ import annotations

from typing import Final

import numpy as np

from agents.logs.tables.table import IntArray
from probe_env.arrays import FloatArray

Band = tuple[FloatArray, FloatArray]
STANDSTILL: Final = 2e-3
"""Speed below which a probe stands still [m/s]: a tenth of the slowest feed of the task."""
DWELL: Final = 1.0
"""Shortest standstill that is one [s]."""
ROUNDS: Final = 12
"""Of the search for the worst rows; after that intervals are halved too, so that it ends."""


def held(time: FloatArray, length: FloatArray, band: Band, tolerance: float) -> tuple[FloatArray, IntArray]:
    """The length (n,) with what stands still made constant, never falling, and the first and last rows of standstills.

    A standstill is what moves slower than ``STANDSTILL`` for ``DWELL``, and for at least half of that time may be where
    its median is, by the band and the tolerance [m]: slow creeping goes on creeping.
    """
    low, high = band
    slow = (np.interp(time + DWELL, time, length) - length < STANDSTILL * DWELL) & (time + DWELL <= time[-1])
    edges = np.flatnonzero(np.diff(slow.astype(np.int8), prepend=0, append=0))
    still, ends = length.copy(), [0]
    for first, end in zip(edges[::2], edges[1::2], strict=True):
        last = int(np.searchsorted(time, time[end - 1] + DWELL, side="right")) - 1
        place = np.median(length[first : last + 1])
        begin = first + int(np.searchsorted(high[first : last + 1], place - tolerance, side="left"))
        until = first + int(np.searchsorted(low[first : last + 1], place + tolerance, side="right")) - 1
        begin = max(begin, ends[-1])  # a standstill may begin within a second of the one before
        if time[until] - time[begin] >= max(DWELL, 0.5 * (time[last] - time[first])):
            still[begin : until + 1] = max(place, still[begin - 1] if begin else place)
            ends += [begin, until]
    return np.maximum.accumulate(still), np.array(ends[1:], dtype=np.int64)


def outside(time: FloatArray, rows: IntArray, length: FloatArray, band: Band) -> FloatArray:
    """How far straight lines between the kept ``rows`` of a length (n,) are outside a band [m], (n,); 0 inside."""
    line = np.interp(time, time[rows], length[rows])
    return np.asarray(np.maximum(0.0, np.maximum(line - band[1], band[0] - line)))


def kept_rows(
    time: FloatArray, length: FloatArray, band: Band, ends: IntArray, tolerance: float, every: float
) -> IntArray:
    """Rows (m,) whose straight lines stay within ``tolerance`` [m] of the band, and are at most ``every`` [s] apart.

    Rows of the file that are further apart stay so.

    Args:
        time: (n,) [s].
        length: (n,) [m], within the band.
        band: least and greatest length, (n,) each [m].
        ends: first and last rows of standstills, which are kept.
        tolerance: [m].
        every: [s].
    """
    rows = np.unique(np.concatenate([ends, _regular(time, every)]))
    for number in range(len(time)):
        error = outside(time, rows, length, band)
        worst = np.maximum.reduceat(error, rows)[:-1]
        bad = worst > tolerance
        if not bad.any():
            break
        interval = np.searchsorted(rows, np.flatnonzero(error > tolerance), side="right") - 1
        places = np.flatnonzero(error > tolerance)
        places = places[error[places] == worst[interval]]
        more = [rows, places]
        if number >= ROUNDS:
            more.append((rows[:-1][bad] + rows[1:][bad]) // 2)
        rows = np.unique(np.concatenate(more))
    return rows


def _regular(time: FloatArray, every: float) -> IntArray:
    """The last rows that are at most ``every`` after the one before: a step for each that is kept."""
    rows, last, end = [0], 0, len(time) - 1
    while last < end:
        reached = int(np.searchsorted(time, time[last] + every * (1.0 + 1e-9), side="right")) - 1
        last = max(reached, last + 1)
        rows.append(last)
    return np.array(rows)
