"""A rig's log, read, mended and thinned; and the clean file of it, which every command takes as a schedule."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np

from agents.logs.channels import channels_of
from agents.logs.cleaning import Bounds, Cleaned, Mended, cleaned
from agents.logs.quantities import HOUR, MEASURED, QUANTITIES, parse_columns
from agents.logs.repairs import portion_means
from agents.logs.tables.encodings import MOST_BYTES, decoded
from agents.logs.tables.sheets import OLD_EXCEL, ZIP, table_of_sheet
from agents.logs.tables.table import IntArray, Table
from agents.logs.tables.text import table_of_text
from agents.logs.thinning import DWELL, held, kept_rows, outside
from agents.logs.times import DIGITS
from probe_env.arrays import FloatArray
from probe_env.files import FileError, read_bytes
from probe_env.schedule import AIR, CSV_COMMENT, FEED, MOST_POINTS, RANGES

DECIMALS: Final[Mapping[str, str]] = {"auto": "", "point": ".", "comma": ","}
USUAL: Final = Bounds()


class Dwell(NamedTuple):
    """A standstill: when it begins [s], where [m] and how long it lasts [s]."""

    time: float
    inserted_length: float
    duration: float


@dataclass(frozen=True, eq=False)
class Log:
    """What a rig fed, blew and measured, SI units; every row holds until the next, and the last one from then on.

    Attributes:
        time: (n,) seconds from the beginning, strictly rising.
        inserted_length: (n,) at that time [m], never falling.
        feed_speed: (n,) mean until the next row [m/s], 0 in standstills; its integral is the inserted length.
        air_supply_rate: (n,) mean until the next row [m3/s].
        measured: name -> (n,) mean root tension [N], rms accelerations [m/s2], rms of the eddy-current noise [m] until
            the next row; names are those of ``agents.logs.quantities.MEASURED``, what the file lacks is not there.
        mended: what was wrong, counted.
        notes: sentences about what does not agree.
        deviation: how far the straight lines are at most from the length at the rows of the file, or from what its
            noise leaves open (``agents.logs.cleaning.Cleaned.band``) [m].
    """

    time: FloatArray
    inserted_length: FloatArray
    feed_speed: FloatArray
    air_supply_rate: FloatArray
    measured: Mapping[str, FloatArray] = field(default_factory=lambda: MappingProxyType({}))
    mended: Mended = field(default_factory=lambda: Mended(0))
    notes: tuple[str, ...] = ()
    deviation: float = 0.0

    @property
    def dwells(self) -> tuple[Dwell, ...]:
        """Standstills of a second and more."""
        edges = np.flatnonzero(np.diff((self.feed_speed[:-1] == 0.0).astype(np.int8), prepend=0, append=0))
        standstills = (
            Dwell(float(self.time[a]), float(self.inserted_length[a]), float(self.time[b] - self.time[a]))
            for a, b in zip(edges[::2], edges[1::2], strict=True)
        )
        return tuple(dwell for dwell in standstills if dwell.duration >= DWELL)

    def to_csv(self) -> str:
        """The log as CSV text, in the units that its columns name; ``Schedule.read`` and ``read_log`` take it."""
        names = [name for name in MEASURED if name in self.measured]
        lines = [
            f"{CSV_COMMENT} steps",
            ",".join(
                QUANTITIES[name].column for name in ("time", "inserted_length", "feed_speed", "air_supply", *names)
            ),
        ]
        columns = (self.time, self.inserted_length, self.feed_speed, self.air_supply_rate * HOUR)
        for time, length, speed, air, *others in zip(*columns, *(self.measured[name] for name in names), strict=True):
            cells = [f"{time:.12g}", f"{length:.10g}", f"{speed:.9g}", *(f"{value:.6g}" for value in (air, *others))]
            lines.append(",".join(cells))
        return "\n".join(lines) + "\n"


def read_log(
    path: str | Path,
    columns: Sequence[str] = (),
    *,
    bounds: Bounds = USUAL,
    sheet: str | None = None,
    decimal: str = "auto",
    air_supply_rate: float | None = None,
) -> Log:
    """Read what an inspection rig wrote: text with any separator, or an Excel sheet.

    Args:
        path: of the file.
        columns: "HEAD=QUANTITY" or "HEAD=QUANTITY[UNIT]" for heads that are not known by themselves.
        bounds: up to where the log is mended and thinned.
        sheet: of a workbook; None: the first.
        decimal: "point" or "comma", where the file leaves it open.
        air_supply_rate: of a log without that column [m3/s].

    Raises:
        FileNotFoundError: no such file.
        FileError: not a log that can be read or mended; names line, column, value and what to do.
        ValueError: an argument is not valid.
        ModuleNotFoundError: pint or openpyxl is not installed (``probe-env[agents]``).
    """
    path, given = Path(path), parse_columns(columns)
    if decimal not in DECIMALS:
        raise ValueError(f"decimal = {decimal!r} is not one of {', '.join(DECIMALS)}")
    highest = RANGES[AIR][1] / HOUR
    if air_supply_rate is not None and not 0.0 <= air_supply_rate <= highest:
        raise ValueError(f"air_supply_rate = {air_supply_rate!r} is outside the accepted range 0 to {highest:g} m3/s")
    content = read_bytes(path, MOST_BYTES)
    if content.startswith(OLD_EXCEL):
        raise FileError(path, "a workbook of Excel before 2007: save it as .xlsx or as CSV")
    if content.startswith(ZIP):
        table = table_of_sheet(path, content, sheet, given)
    elif sheet is not None:
        raise FileError(path, f"not a workbook, so it has no sheet {sheet[:80]!r}: leave --sheet out")
    else:
        table = table_of_text(path, decoded(path, content), given)
    del content
    channels = channels_of(table, given, DECIMALS[decimal], air_supply_rate)
    return _thinned(table, cleaned(channels, bounds), bounds)


def _thinned(table: Table, whole: Cleaned, bounds: Bounds) -> Log:
    """The log that a clean file holds; what is one already stays as it is."""
    share = 0.49 * bounds.tolerance  # for standing still, for straight lines, the rest for digits
    rows: IntArray
    if whole.steps:
        length, rows = whole.length.copy(), np.arange(len(whole.time))
    else:
        length, ends = held(whole.time, whole.length, whole.band, share)
        band = np.minimum(whole.band[0], length), np.maximum(whole.band[1], length)
        rows = kept_rows(whole.time, length, band, ends, share, bounds.every)
    if len(rows) > MOST_POINTS:
        raise FileError(table.path, f"{len(rows)} rows are left, more than {MOST_POINTS}: raise --every or --tolerance")
    time, kept = whole.time[rows], np.round(length[rows], DIGITS)
    speed = np.diff(kept) / np.diff(time)
    if speed.max() > RANGES[FEED][1]:
        k = int(speed.argmax())
        first, last = table.lines[whole.rows[rows[k : k + 2]]]
        raise FileError(
            table.path,
            f"{table.row_word}s {first} to {last}: the inserted length leaps from {kept[k]:.6g} to"
            f" {kept[k + 1]:.6g} m, at {speed[k]:.4g} m/s, and no feed does more than {RANGES[FEED][1]:g} m/s - correct"
            " the file, or raise --tolerance for a noisy encoder",
        )
    values = {name: portion_means(column, rows, QUANTITIES[name].rms) for name, column in whole.values.items()}
    length[rows] = kept
    deviation = float(outside(whole.time, rows, length, whole.band).max())
    air = values.pop("air_supply")
    return Log(
        time, kept, np.append(speed, speed[-1]), air, MappingProxyType(values), whole.mended, whole.notes, deviation
    )
