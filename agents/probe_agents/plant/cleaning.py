"""Repairs of a recorded log, which are bounded and counted, and thinning to fewer rows."""

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from probe_agents.records.cells import IntArray, Table
from probe_agents.records.quantities import MEASURED, QUANTITIES
from probe_agents.records.reader import Channels
from probe_agents.records.times import DAY
from probe_env.arrays import FloatArray
from probe_env.files import FileError
from probe_env.schedule import POSITIONS
from probe_env.settings import within

Band = tuple[FloatArray, FloatArray]
NOISE: Final = "rf_noise_rms"
DIGITS: Final = 6
"""Decimals of seconds and metres in the clean file."""
USUAL_SPACING: Final = 2.5
"""Shortest gap in time, in units of the median time step."""
AGREEMENT: Final = 0.05, 0.02
"""Accepted difference of the integrated speed from the encoder [m], and as a fraction of the length."""
STANDSTILL: Final = 2e-3
"""Speed below which the probe is at a standstill [m/s]: a tenth of the slowest feed of the task."""
DWELL: Final = 1.0
"""Duration of the shortest standstill [s]."""
WRONG_UNIT: Final = 10.0
"""Ratio of the encoder's motion and the integrated speed from which a unit is wrong."""
TURN: Final = 1.0
"""Motion back from which another pass begins [m]; ``Bounds.backward`` is at most this."""
COARSE: Final = 10
"""Steps of a coarse encoder over which the feed is averaged."""
STANDS: Final = 5.0
"""Time between two steps, in units of the usual one, from which the probe stands in between."""
STUCK: Final = 0.1
"""Fraction of a log in which a measured channel must not change by a digit to be reported as a fault."""
STUCK_ROWS: Final = 20
"""Minimum number of rows of such a time."""
SHORTEST: Final = 1.0
"""Duration of the shortest log [s]; less has another unit of time."""
ROUNDS: Final = 12
"""Rounds of the search for the worst rows; later rounds also halve the intervals, so that the search ends."""


@dataclass(frozen=True)
class Bounds:
    """Limits of the repairs; a log beyond them is refused."""

    gap: float = 5.0  # in time, interpolated [s]
    backward: float = 0.02  # backward motion of the encoder that counts as noise [m]
    start_length: float = 5.0  # inserted length at the start of a log without an encoder [m]
    tolerance: float = 1e-3  # error of the inserted length after thinning [m]
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
    untimed: int = 0  # rows without a time, dropped
    duplicates: int = 0  # rows at the time of the row before, averaged with it
    gaps: int = 0  # in time, interpolated
    max_gap: float = 0.0  # [s]
    missing: int = 0  # values, interpolated
    backward: int = 0  # rows with a smaller encoder length than an earlier row
    max_backward: float = 0.0  # [m]


class Fault(NamedTuple):
    """What is wrong with a measured channel; with a ``fatal`` one nothing can be estimated from it."""

    channel: str
    text: str
    fatal: bool


@dataclass(frozen=True)
class CleanLog:
    """A repaired log at its original rows.

    ``band`` has the smallest length from each row on and the largest up to it, the range of the encoder's noise. Both
    equal the length where it increases.
    """

    time: FloatArray  # (n,) seconds from the first, strictly rising
    length: FloatArray  # (n,) inserted length [m], never falling
    band: Band  # (n,) each [m]
    values: dict[str, FloatArray]  # measured quantities and the air supply, (n,) [SI]
    repairs: Repairs
    notes: tuple[str, ...]  # messages about contradictions in the log
    rows: IntArray  # (n,) index of the row of the table
    gaps: FloatArray  # (g, 2) begin and end of gaps in time and of missing eddy-current noise [s]
    faults: tuple[Fault, ...]


def clean(channels: Channels, bounds: Bounds, passage: str = "") -> CleanLog:
    """Repair a log, or one of its passes; a repair outside the bounds is a FileError with lines, column and value."""
    table = channels.table
    timed = np.flatnonzero(~np.isnan(channels.time))
    time, values, rows = _merged(channels, timed, bounds)
    merged, notes = len(timed) - len(rows), list(channels.notes)
    time, values, rows = _one_pass(channels, time, values, rows, passage, notes)
    steps = np.diff(time)
    _check_gaps(table, rows, steps, "no rows", bounds.gap)
    usual = max(float(np.median(steps)), bounds.every if table.steps else 0.0)
    gap = steps > USUAL_SPACING * usual
    long = steps[gap]
    if NOISE in values:  # a row is valid until the next one
        gap |= np.isnan(values[NOISE][:-1])
    gaps = np.column_stack([time[:-1], time[1:]])[gap]
    count = len(table.lines)
    repairs = Repairs(count, count - len(timed), merged, len(long), float(long.max(initial=0.0)))
    stuck = {name: _stuck(time, values[name]) for name in MEASURED if name in values}
    for name, column in list(values.items()):
        repairs.missing += int(np.isnan(column).sum())
        try:
            values[name] = _bridged(channels, name, time, column, rows, bounds.gap)
        except FileError as error:
            if name != "feed_speed" or "inserted_length" not in values:
                raise
            notes.append(f"Left out, as there is an encoder: the feed speed, {error.problem}.")
            values.pop(name)
    length, is_encoder = _length(channels, time, values, bounds, notes)
    high = np.maximum.accumulate(length)
    backward, maximum = high - length, POSITIONS["inserted_length_m"][1]
    if (moving_back := backward > bounds.backward).any():
        row = int(moving_back.argmax())
        problem = (
            f"the probe moves back to {length[row]:.6g} m from {high[row]:.6g} m, more than the {bounds.backward:g} m"
        )
        hint = f"that count as noise: cut the file there, or --backward {backward.max() + 5e-3:.2f}"
        name = "inserted_length" if is_encoder else "feed_speed"
        raise table.error(rows[row], f"{problem} {hint}", channels.indices[name])
    if length.max() > maximum:
        raise table.error(rows[int(length.argmax())], f"a length of {length.max():.6g} m is more than {maximum:g} m")
    low = np.minimum.accumulate(length[::-1])[::-1]
    repairs.backward, repairs.max_backward = int((backward > 0.0).sum()), float(backward.max())
    rising = np.where(low == high, length, 0.5 * (low + high))  # the middle of the band
    faults = tuple(_faults(channels, time, rising, values, stuck))
    return CleanLog(time, rising, (low, high), values, repairs, tuple(notes), rows, gaps, faults)


def _length(
    channels: Channels, time: FloatArray, values: dict[str, FloatArray], bounds: Bounds, notes: list[str]
) -> tuple[FloatArray, bool]:
    """Inserted length (n,) [m] of the encoder, or of the integrated speed, and whether it is of the encoder."""
    table, steps = channels.table, np.diff(time)
    speed, encoder = values.pop("feed_speed", None), values.pop("inserted_length", None)
    fed = None
    if speed is not None:
        means = speed[:-1] if table.steps else 0.5 * (speed[1:] + speed[:-1])
        fed = np.concatenate([[0.0], np.cumsum(means * steps)])
    if encoder is None:
        assert fed is not None  # the log has one of both
        return bounds.start_length + fed, False
    moves = np.flatnonzero(np.diff(encoder))
    coarse = len(moves) > COARSE and np.median(np.diff(moves)) > 1.0  # most moves are alone
    step = float(np.median(np.abs(np.diff(encoder)[moves]))) if coarse else 0.0
    if speed is not None and fed is not None:
        by_encoder, absolute, relative = encoder - encoder[0], AGREEMENT[0] + step, AGREEMENT[1]
        small, large = sorted((abs(by_encoder[-1]), abs(fed[-1])))
        if large > max(WRONG_UNIT * small, 2.0 * absolute) and small > 0.0:
            problem = f"the encoder moves {by_encoder[-1]:.4g} m, and speed times time is {fed[-1]:.4g} m"
            k = channels.indices["feed_speed"]
            declared = table.option(channels.indices["time"], "time", "UNIT")
            hint = f"is the unit of time, length or speed right? Declare it, {declared}"
            raise table.error(0, f"{problem}: {hint}", k)
        excess = np.abs(fed - by_encoder) - (absolute + relative * np.abs(by_encoder))
        if excess[k := int(excess.argmax())] > 0.0:
            why = " (the sign of the speed is reversed)" if speed.max() <= 0.0 and fed[-1] < 0.0 else ""
            notes.append(
                f"The speed column and the encoder disagree{why}: {fed[k]:.4g} m and {by_encoder[k]:.4g} m up to"
                f" {time[k]:.4g} s differ by more than {absolute:g} m and {100 * relative:g} %; the encoder is used."
            )
            fed = None
    if table.steps or step <= 2.0 * bounds.tolerance:
        return encoder, True
    # the encoder tells the length where it moves; between, speed or average
    if fed is not None:
        nodes, how = moves + 1, "that of the speed column"
        length = fed + np.interp(time, time[nodes], (encoder - fed)[nodes])
    else:
        how, times = f"the mean over {COARSE} steps", time[moves + 1]
        usual = float(np.median(np.diff(times)))
        rests = np.flatnonzero(np.diff(times) > max(DWELL, STANDS * usual))  # ends a usual step before the next move
        ends = np.searchsorted(time, times[rests + 1] - usual)
        nodes = np.unique(np.concatenate([[0], moves[::COARSE] + 1, moves[rests] + 1, ends, moves[-1:] + 1]))
        last = nodes[-1]
        slope = (encoder[last] - encoder[nodes[-2]]) / (time[last] - time[nodes[-2]])
        end = encoder[last] + min(step, slope * (time[-1] - time[last]))
        length = np.interp(time, [*time[nodes], time[-1]], [*encoder[nodes], end])
    notes.append(
        f"The encoder's steps of {step:.3g} m are coarse for rows {np.median(steps):.3g} s apart: the feed is {how}."
    )
    return np.maximum.accumulate(length), True


def _one_pass(
    channels: Channels,
    time: FloatArray,
    values: dict[str, FloatArray],
    rows: IntArray,
    passage: str,
    notes: list[str],
) -> tuple[FloatArray, dict[str, FloatArray], IntArray]:
    """The rows of one pass: time (n,), values (n,) and rows (n,) as of ``_merged``; a withdrawal from its end."""
    table, motion = channels.table, values.get("inserted_length")
    if motion is None or np.isnan(motion).all():
        speed = np.nan_to_num(values["feed_speed"]) if "feed_speed" in values else np.zeros(len(time))
        motion = np.concatenate([[0.0], np.cumsum(speed[:-1] * np.diff(time))])
        if not passage and speed.max() <= 0.0 and motion[-1] < -TURN:
            k = channels.indices["feed_speed"]
            turned = table.option(k, "feed_speed", f"-{table.written_unit(k) or 'm/s'}")
            hint = f"is its sign reversed ({turned}), or is it a withdrawal (--pass out)?"
            raise table.error(rows[0], f"the feed is negative throughout: {hint}", k)
    valid = ~np.isnan(motion)
    motion = np.interp(time, time[valid], motion[valid])
    passes = _passes(motion)
    texts = [
        f"{k}: {'insertion' if inward else 'withdrawal'}, {table.row_word}s {table.lines[rows[a]]} to"
        f" {table.lines[rows[b - 1]]}, {motion[a]:.4g} to {motion[b - 1]:.4g} m"
        for k, (a, b, inward) in enumerate(passes, start=1)
    ]
    wanted = passage or "in"
    found = [k for k, one in enumerate(passes, start=1) if wanted in (str(k), "in" if one[2] else "out")]
    if len(found) != 1:
        problem = f"{len(passes)} passes ({'; '.join(texts)})" if len(passes) > 1 else f"one pass ({texts[0][3:]})"
        hint = "choose one, --pass NUMBER" if len(passes) > 1 else "a log is of an insertion"
        hint += "; --pass out reads a withdrawal from its end, as if time ran backwards" * (len(passes) == 1)
        raise FileError(table.path, f"{problem}: {hint}")
    begin, end, inward = passes[found[0] - 1]
    if len(passes) > 1 or not inward:
        how = ", from its end" * (not inward)
        notes.append(f"Pass {found[0]} of {len(passes)} is read{how}: {'; '.join(texts)}.")
    part = slice(begin, end)
    time, values, rows = time[part] - time[begin], {name: v[part] for name, v in values.items()}, rows[part]
    if inward:
        return time, values, rows
    values = {name: v[::-1] * (-1.0 if name == "feed_speed" else 1.0) for name, v in values.items()}
    return time[-1] - time[::-1], values, rows[::-1]


def _passes(length: FloatArray) -> list[tuple[int, int, bool]]:
    """Begin, end and whether it is inward of the motions (n,) [m] that turn back by ``TURN``."""
    turned_back = np.maximum.accumulate(length) - length
    if turned_back.max() < TURN:
        return [(0, len(length), True)]
    turns, begin, low, high, inward = list[tuple[int, int, bool]](), 0, 0, 0, True
    for k, x in enumerate(length.tolist()):
        low, high = (k if x <= length[low] else low), (k if x >= length[high] else high)
        back = length[high] - x if inward else x - length[low]
        if back >= TURN:
            extreme = high if inward else low
            if abs(length[extreme] - length[begin]) >= TURN:  # else the log begins with the other direction
                turns.append((begin, extreme + 1, inward))
                begin = extreme
            inward, low, high = not inward, k, k
    return [*turns, (begin, len(length), inward)]


def _stuck(time: FloatArray, values: FloatArray) -> tuple[int, int] | None:
    """First and last row of the longest time in which values (n,) do not change; None if it is short."""
    edges = np.concatenate([[0], np.flatnonzero(np.diff(values) != 0.0) + 1, [len(values)]])
    k = int((time[edges[1:] - 1] - time[edges[:-1]]).argmax())
    first, last = int(edges[k]), int(edges[k + 1]) - 1
    long = time[last] - time[first] >= STUCK * time[-1] and last - first + 1 >= STUCK_ROWS
    return (first, last) if long else None


def _faults(
    channels: Channels,
    time: FloatArray,
    length: FloatArray,
    values: dict[str, FloatArray],
    stuck: dict[str, tuple[int, int] | None],
) -> list[Fault]:
    """What is wrong with the measured channels."""
    table, faults = channels.table, list[Fault]()
    for name, rows in stuck.items():
        k, unit = channels.indices[name], QUANTITIES[name].unit
        if rows:
            (begin, end), (first, last) = time[[*rows]], length[[*rows]]
            text = f"{table.heads[k]!r} does not change by a digit from {begin:.4g} to {end:.4g} s"
            faults.append(Fault(name, f"{text} ({first:.4g} to {last:.4g} m)", False))
        if (values[name] < 0.0).all():
            turned = table.option(k, name, f"-{table.written_unit(k) or unit}")
            faults.append(
                Fault(name, f"{table.heads[k]!r} is negative throughout: is its sign reversed? {turned}", True)
            )
    return faults


def _merged(channels: Channels, rows: IntArray, bounds: Bounds) -> tuple[FloatArray, dict[str, FloatArray], IntArray]:
    """Time from 0, values averaged over rows of equal time, and the first row of each, for the rows with a time."""
    table, k = channels.table, channels.indices["time"]
    if len(rows) < 2:
        problem = f"{len(rows)} rows have a time" if len(rows) else "the whole column is empty"
        raise table.error(0, f"{problem}: at least two rows with a time are needed", k)
    number = not channels.written_out
    unit = f"is the unit of time right? - declare it, {table.option(k, 'time', 'UNIT')}"
    time = np.round(channels.time[rows] - channels.time[rows[0]], DIGITS)
    steps, maximum = np.diff(time), POSITIONS["time_s"][1]
    if steps.min() < 0.0:
        row = int((steps < 0.0).argmax()) + 1
        cell = table.columns[k][rows[row]].as_py()
        problem = f"the time {cell[:40]!r} is {-steps[row - 1]:.6g} s before the row above"
        half_day = channels.written_out and abs(steps[row - 1] + 0.5 * DAY) < 60.0
        hint = "was the clock set back, or are rows out of order? Correct the times from there on"
        if half_day:
            hint = "a 12-hour clock without AM or PM? Export it with 24 hours"
        raise table.error(rows[row], f"{problem}: {hint}", k)
    if time[-1] == 0.0:
        raise table.error(rows[-1], "the time never changes: is this the column of time?", k)
    if time[-1] > maximum:
        problem = f"{time[-1]:.6g} s are more than {maximum:g} s: cut the log, or check the unit of time"
        raise table.error(rows[-1], problem, k)
    if time[-1] < SHORTEST:
        problem = f"the whole log lasts {time[-1]:.6g} s, less than {SHORTEST:g} s"
        raise table.error(rows[-1], problem + f": {unit} (d, h or min)" * number, k)
    if number and np.median(steps) > bounds.gap:
        problem = f"most rows are {np.median(steps):.6g} s apart or more, and {bounds.gap:g} s are interpolated: {unit}"
        raise table.error(rows[1], f"{problem}, or raise --gap", k)
    first = np.flatnonzero(np.diff(time, prepend=-1.0) > 0.0)
    means = {n: group_means(v[rows], first, QUANTITIES[n].rms) for n, v in channels.values.items()}
    return time[first], means, rows[first]


def group_means(values: FloatArray, first: IntArray, rms: bool) -> FloatArray:
    """Means, or root mean squares, of groups that begin at the rows ``first``; NaN if all values are missing."""
    if len(first) == len(values):
        return values
    valid = ~np.isnan(values)
    powers = np.where(valid, values**2 if rms else values, 0.0)
    with np.errstate(invalid="ignore"):
        means = np.add.reduceat(powers, first) / np.add.reduceat(valid.astype(float), first)
    return np.asarray(np.sqrt(means) if rms else means)


def _check_gaps(table: Table, rows: IntArray, duration: FloatArray, problem: str, gap: float) -> None:
    """Raise FileError for a duration (n - 1,) longer than ``gap`` [s] between rows (n,)."""
    if duration.max() > gap:
        k = int(duration.argmax())
        problem = f"{problem} for {duration[k]:.6g} s, more than the {gap:g} s that are interpolated"
        raise table.error_between(rows[k], rows[k + 1], f"{problem} - cut the file there, or raise --gap")


def _bridged(
    channels: Channels, name: str, time: FloatArray, column: FloatArray, rows: IntArray, gap: float
) -> FloatArray:
    """A column (n,) with missing values interpolated, at its ends by the nearest value."""
    valid = np.flatnonzero(~np.isnan(column))
    if len(valid) == len(column):
        return column
    table, k = channels.table, channels.indices[name]
    if not len(valid):
        raise table.error(0, "no value in the whole column", k)
    edges = np.concatenate([[0], valid, [len(column) - 1]])
    duration = np.where(np.diff(edges) > 1, np.diff(time[edges]), 0.0)
    _check_gaps(table, rows[edges], duration, f"column {table.heads[k]!r} has no values", gap)
    return np.asarray(np.interp(time, time[valid], column[valid]))


def standstills_of(time: FloatArray, length: FloatArray, band: Band, tolerance: float) -> tuple[FloatArray, IntArray]:
    """The non-decreasing length (n,) with constant standstills, and the first and last rows of the standstills.

    In a standstill the probe moves slower than ``STANDSTILL`` for ``DWELL``, and for at least half of that time its
    median position is within the band and the tolerance [m]; so slow creep is no standstill.
    """
    low, high = band
    slow = (np.interp(time + DWELL, time, length) - length < STANDSTILL * DWELL) & (time + DWELL <= time[-1])
    edges = np.flatnonzero(np.diff(slow.astype(np.int8), prepend=0, append=0))
    still, ends = length.copy(), [0]
    for first, end in zip(edges[::2], edges[1::2], strict=True):
        last = int(np.searchsorted(time, time[end - 1] + DWELL, side="right")) - 1
        median = np.median(length[first : last + 1])
        begin = first + int(np.searchsorted(high[first : last + 1], median - tolerance, side="left"))
        until = first + int(np.searchsorted(low[first : last + 1], median + tolerance, side="right")) - 1
        begin = max(begin, ends[-1])  # a standstill may begin within a second of the previous one
        if time[until] - time[begin] >= max(DWELL, 0.5 * (time[last] - time[first])):
            still[begin : until + 1] = max(median, still[begin - 1] if begin else median)
            ends += [begin, until]
    return np.maximum.accumulate(still), np.array(ends[1:], dtype=np.int64)


def outside(time: FloatArray, rows: IntArray, length: FloatArray, band: Band) -> FloatArray:
    """Distance (n,) of the linear interpolation between ``rows`` of a length (n,) from a band [m]; 0 inside."""
    line = np.interp(time, time[rows], length[rows])
    return np.asarray(np.maximum(0.0, np.maximum(line - band[1], band[0] - line)))


def thin_rows(
    time: FloatArray, length: FloatArray, band: Band, ends: IntArray, tolerance: float, every: float
) -> IntArray:
    """Rows (m,) whose linear interpolation is within ``tolerance`` [m] of the band, at most ``every`` [s] apart.

    ``ends``, the first and last rows of standstills, are always included; rows of the file may be further apart.
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
        worst_rows = np.flatnonzero(error > tolerance)
        worst_rows = worst_rows[error[worst_rows] == worst[np.searchsorted(rows, worst_rows, side="right") - 1]]
        more = [rows, worst_rows]
        if number >= ROUNDS:
            more.append((rows[:-1][bad] + rows[1:][bad]) // 2)
        rows = np.unique(np.concatenate(more))
    return rows
