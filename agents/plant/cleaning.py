"""Repairs of a recorded log, each with a bound and counted, and thinning to fewer rows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from agents.plant.quantities import QUANTITIES
from agents.plant.reader import Channels, IntArray, Table
from probe_env.arrays import FloatArray
from probe_env.schedule import POSITIONS
from probe_env.settings import within

Band = tuple[FloatArray, FloatArray]
DIGITS: Final = 6
"""Decimals of seconds and metres that are written."""
USUAL_SPACING: Final = 2.5
"""A gap in time is a step longer than this many median steps."""
AGREEMENT: Final = 0.05, 0.02
"""Accepted difference of the integrated speed from the encoder [m], and as a share of the length."""
STANDSTILL: Final = 2e-3
"""Speed below which a probe stands still [m/s]: a tenth of the slowest feed of the task."""
DWELL: Final = 1.0
"""Duration of the shortest standstill [s]."""
ROUNDS: Final = 12
"""Rounds of the search for the worst rows; later rounds also halve the intervals, so that it ends."""


@dataclass(frozen=True)
class Bounds:
    """Limits of the repairs; a log beyond them is refused."""

    gap: float = 5.0  # in time, bridged by straight lines [s]
    backward: float = 0.02  # motion of the encoder backwards that is taken for noise [m]
    start_length: float = 5.0  # inserted at the beginning of a log without an encoder [m]
    tolerance: float = 1e-3  # of the inserted length after thinning [m]
    every: float = 1.0  # longest time between rows of the clean log [s]

    def __post_init__(self) -> None:
        within("gap", self.gap, 1e-3, 3600.0, "s")
        within("backward", self.backward, 0.0, 1.0, "m")
        within("start_length", self.start_length, 0.0, 1e3, "m")
        within("tolerance", self.tolerance, 1e-5, 0.1, "m")
        within("every", self.every, 1e-3, 3600.0, "s")
        if self.every > self.gap:
            problem = f"every = {self.every:g} s is more than gap = {self.gap:g} s"
            raise ValueError(f"{problem}, and the clean file could not be read")


@dataclass
class Repairs:
    """Counts of repairs."""

    rows: int  # of the file
    untimed: int = 0  # rows without a time, left out
    duplicates: int = 0  # rows at the time of the row before, averaged with it
    gaps: int = 0  # in time, bridged
    longest_gap: float = 0.0  # [s]
    missing: int = 0  # values, interpolated
    backward: int = 0  # rows at which the encoder is behind an earlier row
    most_backward: float = 0.0  # [m]


@dataclass(frozen=True)
class Cleaned:
    """A log at its own rows.

    ``band`` is the smallest length from each row on and the largest up to it: what the encoder's noise leaves open.
    Both equal the length where it only rises.
    """

    time: FloatArray  # (n,) seconds from the first, strictly rising
    length: FloatArray  # (n,) inserted length [m], never falling
    band: Band  # (n,) each [m]
    values: dict[str, FloatArray]  # measured quantities and the air supply, (n,) [SI]
    repairs: Repairs
    notes: tuple[str, ...]  # sentences about what does not agree
    rows: IntArray  # (n,) index of the row of the table


def cleaned(channels: Channels, bounds: Bounds) -> Cleaned:
    """The log with everything repaired that is within the bounds.

    Raises:
        FileError: something is beyond them; names lines, column and value.
    """
    table = channels.table
    timed = np.flatnonzero(~np.isnan(channels.time))
    time, values, rows = _merged(channels, timed)
    steps = np.diff(time)
    _check_gaps(table, rows, steps, "no rows", bounds.gap)
    long = steps[steps > USUAL_SPACING * np.median(steps)]
    count = len(table.lines)
    repairs = Repairs(count, count - len(timed), len(timed) - len(rows), len(long), float(long.max(initial=0.0)))
    for name, column in values.items():
        repairs.missing += int(np.isnan(column).sum())
        values[name] = _bridged(channels, name, time, column, rows, bounds.gap)
    speed, encoder = values.pop("feed_speed", None), values.pop("inserted_length", None)
    length, notes = encoder, tuple[str, ...]()
    if speed is not None:
        means = speed[:-1] if table.steps else 0.5 * (speed[1:] + speed[:-1])
        fed = np.concatenate([[0.0], np.cumsum(means * steps)])
        if length is None:
            length = bounds.start_length + fed
        else:
            by_encoder, (absolute, relative) = length - length[0], AGREEMENT
            excess = np.abs(fed - by_encoder) - (absolute + relative * np.abs(by_encoder))
            if excess[k := int(excess.argmax())] > 0.0:
                notes = (
                    f"The speed column and the encoder disagree: {fed[k]:.4g} m and {by_encoder[k]:.4g} m are fed up to"
                    f" {time[k]:.4g} s, more than {absolute:g} m and {100 * relative:g} % apart; the encoder is taken.",
                )
    assert length is not None  # one of both is there
    high = np.maximum.accumulate(length)
    behind, most = high - length, POSITIONS["inserted_length_m"][1]
    if (back := behind > bounds.backward).any():
        row = int(back.argmax())
        problem = (
            f"the probe moves back to {length[row]:.6g} m from {high[row]:.6g} m, more than the {bounds.backward:g} m"
        )
        hint = "that are taken for noise - a log is of the way in: cut the file there, or --backward"
        name = "feed_speed" if encoder is None else "inserted_length"
        raise table.error(rows[row], f"{problem} {hint}", channels.indices[name])
    if length.max() > most:
        raise table.error(rows[int(length.argmax())], f"a length of {length.max():.6g} m is more than {most:g} m")
    low = np.minimum.accumulate(length[::-1])[::-1]
    repairs.backward, repairs.most_backward = int((behind > 0.0).sum()), float(behind.max())
    rising = np.where(low == high, length, 0.5 * (low + high))  # neither early nor late
    return Cleaned(time, rising, (low, high), values, repairs, notes, rows)


def _merged(channels: Channels, rows: IntArray) -> tuple[FloatArray, dict[str, FloatArray], IntArray]:
    """Time from 0, values averaged over rows of one time, and the first row of each; of the rows with a time."""
    table, k = channels.table, channels.indices["time"]
    if len(rows) < 2:
        raise table.error(0, f"{len(rows)} rows have a time: at least two are needed", k)
    time = np.round(channels.time[rows] - channels.time[rows[0]], DIGITS)
    steps, most = np.diff(time), POSITIONS["time_s"][1]
    if steps.min() < 0.0:
        row = int((steps < 0.0).argmax()) + 1
        cell = table.columns[k][rows[row]].as_py()
        problem = f"the time {cell[:40]!r} is {-steps[row - 1]:.6g} s before the row above: sort or cut the file"
        raise table.error(rows[row], problem, k)
    if time[-1] == 0.0:
        raise table.error(rows[-1], "the time never changes: is this the column of time?", k)
    if time[-1] > most:
        problem = f"{time[-1]:.6g} s are more than the {most:g} s of a log: cut it, or is the unit of time right?"
        raise table.error(rows[-1], problem, k)
    first = np.flatnonzero(np.diff(time, prepend=-1.0) > 0.0)
    means = {n: portion_means(v[rows], first, QUANTITIES[n].rms) for n, v in channels.values.items()}
    return time[first], means, rows[first]


def portion_means(values: FloatArray, first: IntArray, rms: bool) -> FloatArray:
    """Means, or root mean squares, of portions that begin at the rows ``first``; NaN where all are missing."""
    if len(first) == len(values):
        return values
    known = ~np.isnan(values)
    powers = np.where(known, values**2 if rms else values, 0.0)
    with np.errstate(invalid="ignore"):
        means = np.add.reduceat(powers, first) / np.add.reduceat(known.astype(float), first)
    return np.asarray(np.sqrt(means) if rms else means)


def _check_gaps(table: Table, rows: IntArray, lasting: FloatArray, problem: str, gap: float) -> None:
    """Refuse what lasts longer than ``gap`` [s] between one of the rows (n,) and the next."""
    if lasting.max() > gap:
        k = int(lasting.argmax())
        problem = f"{problem} for {lasting[k]:.6g} s, more than the {gap:g} s that are bridged"
        raise table.error_between(rows[k], rows[k + 1], f"{problem} - cut the file there, or --gap")


def _bridged(
    channels: Channels, name: str, time: FloatArray, column: FloatArray, rows: IntArray, gap: float
) -> FloatArray:
    """A column (n,) with missing values on straight lines, or like the nearest at its ends."""
    known = np.flatnonzero(~np.isnan(column))
    if len(known) == len(column):
        return column
    table, k = channels.table, channels.indices[name]
    if not len(known):
        raise table.error(0, "no value in the whole column", k)
    edges = np.concatenate([[0], known, [len(column) - 1]])
    lasting = np.where(np.diff(edges) > 1, np.diff(time[edges]), 0.0)
    _check_gaps(table, rows[edges], lasting, f"column {table.heads[k]!r} has no values", gap)
    return np.asarray(np.interp(time, time[known], column[known]))


def held(time: FloatArray, length: FloatArray, band: Band, tolerance: float) -> tuple[FloatArray, IntArray]:
    """The length (n,) with standstills made constant, never falling, and the first and last rows of standstills.

    In a standstill the probe moves slower than ``STANDSTILL`` for ``DWELL``, and for at least half of that time its
    median position is possible within the band and the tolerance [m]; so slow creeping is no standstill.
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
    """How far straight lines between the ``rows`` of a length (n,) are outside a band [m], (n,); 0 inside."""
    line = np.interp(time, time[rows], length[rows])
    return np.asarray(np.maximum(0.0, np.maximum(line - band[1], band[0] - line)))


def kept_rows(
    time: FloatArray, length: FloatArray, band: Band, ends: IntArray, tolerance: float, every: float
) -> IntArray:
    """Rows (m,) whose straight lines stay within ``tolerance`` [m] of the band, at most ``every`` [s] apart.

    ``ends``, the first and last rows of standstills, are kept. Rows of the file that are further apart stay so.
    """
    regular, end = [0], len(time) - 1
    while regular[-1] < end:
        reached = int(np.searchsorted(time, time[regular[-1]] + every * (1.0 + 1e-9), side="right")) - 1
        regular.append(max(reached, regular[-1] + 1))
    rows = np.unique(np.concatenate([ends, regular]))
    for number in range(len(time)):
        error = outside(time, rows, length, band)
        worst = np.maximum.reduceat(error, rows)[:-1]
        bad = worst > tolerance
        if not bad.any():
            break
        places = np.flatnonzero(error > tolerance)
        places = places[error[places] == worst[np.searchsorted(rows, places, side="right") - 1]]
        more = [rows, places]
        if number >= ROUNDS:
            more.append((rows[:-1][bad] + rows[1:][bad]) // 2)
        rows = np.unique(np.concatenate(more))
    return rows
