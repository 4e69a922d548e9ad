"""Channels of a log without what went wrong in recording: every repair has a bound, and is counted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from agents.logs.channels import Channels
from agents.logs.quantities import QUANTITIES
from agents.logs.repairs import band, between, bridged, disagreement, integral, portion_means
from agents.logs.tables.table import IntArray
from agents.logs.times import DIGITS
from probe_env.arrays import FloatArray
from probe_env.schedule import POSITIONS

USUAL_SPACING: Final = 2.5
"""Rows further apart than so many times their usual distance have something missing between them."""


@dataclass(frozen=True)
class Bounds:
    """Up to where a log is mended; beyond, it is refused.

    Attributes:
        gap: in time, bridged by straight lines [s].
        backward: motion of the encoder, taken for its noise [m].
        start_length: inserted length at the beginning, where there is no encoder [m].
        tolerance: of the inserted length after thinning [m].
        every: rows of the clean log are no further apart [s].
    """

    gap: float = 5.0
    backward: float = 0.02
    start_length: float = 5.0
    tolerance: float = 1e-3
    every: float = 1.0

    def __post_init__(self) -> None:
        ranges = {"gap": (1e-3, 3600.0, "s"), "backward": (0.0, 1.0, "m"), "start_length": (0.0, 1e3, "m"),
                  "tolerance": (1e-5, 0.1, "m"), "every": (1e-3, 3600.0, "s")}  # fmt: skip
        for name, (low, high, unit) in ranges.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise ValueError(f"{name} = {value!r} is outside the accepted range {low:g} to {high:g} {unit}")
        if self.every > self.gap:
            raise ValueError(
                f"every = {self.every:g} s is more than gap = {self.gap:g} s, and the clean file could not be read"
            )


@dataclass(frozen=True)
class Mended:
    """What was mended.

    Attributes:
        rows: of the file.
        untimed: rows without a time, which were left out.
        duplicates: rows at the time of the row before, averaged with it.
        gaps: in time, that were bridged.
        longest_gap: of them [s].
        missing: cells without a value, which were interpolated.
        backward: rows at which the encoder was behind an earlier one.
        most_backward: by how much at most [m].
    """

    rows: int
    untimed: int = 0
    duplicates: int = 0
    gaps: int = 0
    longest_gap: float = 0.0
    missing: int = 0
    backward: int = 0
    most_backward: float = 0.0


@dataclass(frozen=True)
class Cleaned:
    """A log at its own rows.

    Attributes:
        time: (n,) seconds from the first, strictly rising.
        length: (n,) inserted length [m], never falling.
        band: least length behind and greatest length before each row, (n,) each [m]: the encoder's noise leaves open
            where the probe is between them; both are the length where it only rises.
        values: measured quantities and the air supply, (n,) [SI].
        mended: what was.
        notes: sentences about what does not agree.
        steps: whether values hold until the next row.
        rows: (n,) which row of the table each is.
    """

    time: FloatArray
    length: FloatArray
    band: tuple[FloatArray, FloatArray]
    values: Mapping[str, FloatArray]
    mended: Mended
    notes: tuple[str, ...]
    steps: bool
    rows: IntArray


def cleaned(channels: Channels, bounds: Bounds) -> Cleaned:
    """The log without what can be mended.

    Raises:
        FileError: what cannot; names lines, column and value.
    """
    table = channels.table
    rows: IntArray = np.flatnonzero(~np.isnan(channels.time))
    mended = Mended(rows=len(table.lines), untimed=len(table.lines) - len(rows))
    time, values, rows = _merged(channels, rows)
    mended = replace(mended, duplicates=mended.rows - mended.untimed - len(rows))
    steps = np.diff(time)
    if steps.max() > bounds.gap:
        k = int(steps.argmax())
        raise between(table, rows[k], rows[k + 1], f"no rows for {steps[k]:.6g} s", bounds.gap)
    gaps = steps > USUAL_SPACING * np.median(steps)
    mended = replace(mended, gaps=int(gaps.sum()), longest_gap=float(steps[gaps].max(initial=0.0)))
    for name, column in values.items():
        missing = np.isnan(column)
        values[name] = bridged(channels, name, time, column, rows, bounds.gap)
        mended = replace(mended, missing=mended.missing + int(missing.sum()))
    speed = values.pop("feed_speed", None)
    encoder = values.pop("inserted_length", None)
    length, notes = encoder, tuple[str, ...]()
    if speed is not None:
        fed = integral(time, speed, table.steps)
        if length is None:
            length = bounds.start_length + fed
        else:
            notes = disagreement(time, length - length[0], fed)
    assert length is not None  # one of both is there
    low, high = band(channels, length, rows, bounds.backward, encoder is not None)
    behind = high - length
    mended = replace(mended, backward=int((behind > 0.0).sum()), most_backward=float(behind.max()))
    rising = np.where(low == high, length, 0.5 * (low + high))  # neither early nor late
    return Cleaned(time, rising, (low, high), values, mended, notes, table.steps, rows)


def _merged(channels: Channels, rows: IntArray) -> tuple[FloatArray, dict[str, FloatArray], IntArray]:
    """Time from 0 and values of the rows that have a time, those of one time averaged, and the first row of each."""
    table, k = channels.table, channels.places["time"]
    if len(rows) < 2:
        raise table.error(0, f"{len(rows)} rows have a time: at least two are needed", k)
    time = np.round(channels.time[rows] - channels.time[rows[0]], DIGITS)
    steps = np.diff(time)
    if steps.min() < 0.0:
        row = int((steps < 0.0).argmax()) + 1
        cell = table.columns[k][rows[row]].as_py()
        raise table.error(
            rows[row],
            f"the time {cell[:40]!r} is {-steps[row - 1]:.6g} s before the row above: sort or cut the file",
            k,
        )
    if time[-1] == 0.0:
        raise table.error(rows[-1], "the time never changes: is this the column of time?", k)
    if time[-1] > POSITIONS["time_s"][1]:
        raise table.error(
            rows[-1], f"{time[-1]:.6g} s are more than the {POSITIONS['time_s'][1]:g} s of a log: cut it, or is the"
            " unit of time right?", k,
        )  # fmt: skip
    first = np.flatnonzero(np.diff(time, prepend=-1.0) > 0.0)
    return (
        time[first],
        {n: portion_means(v[rows], first, QUANTITIES[n].rms) for n, v in channels.values.items()},
        rows[first],
    )
