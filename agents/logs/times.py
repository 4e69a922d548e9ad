"""Times as rigs write them: timestamps, clocks and numbers, as seconds from the first."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc

from agents.logs.decimals import is_missing
from agents.logs.tables.table import Table
from probe_env.arrays import FloatArray

DIGITS: Final = 6
"""Of seconds: all that is written."""
DAY: Final = 86_400.0
_ISO: Final = r"^\d{4}-\d\d-\d\d[T ]\d\d:\d\d(?::\d\d(?:[.,]\d+)?)? ?(?:Z|[+-]\d\d(?::?\d\d)?)?$"
_GERMAN: Final = r"^(\d\d)\.(\d\d)\.(\d{4})[T ]"
_CLOCK: Final = r"^(?P<h>\d{1,2}):(?P<m>\d\d):(?P<s>\d\d(?:[.,]\d+)?)$"
_DATE: Final = r"^(?:\d{4}-\d\d-\d\d|\d\d\.\d\d\.\d{4})$"
_MIDNIGHT: Final = r"[T ]00:00(?::00(?:[.,]0+)?)?$"
"""What sheets write behind a date."""
_MORE_THAN_NUMBER: Final = r"\d[:\-]\d|\d\.\d+\.\d{4}"


def is_written_out(cells: Any) -> bool:
    """Whether trimmed texts are timestamps or clocks, by the first that is there."""
    there = cells.filter(pc.invert(is_missing(cells)))
    return bool(len(there)) and bool(pc.any(pc.match_substring_regex(there[:1], _MORE_THAN_NUMBER)).as_py())


def dated(table: Table, column: int, dates: Any, clocks: Any) -> Any:
    """Trimmed clocks with the day that stands in a column of its own, as timestamps.

    Timestamps, numbers and the clocks of a single day stay as they are: a clock tells when midnight is passed.

    Raises:
        FileError: days that differ and are not all dates that can be read.
    """
    timed = pc.invert(is_missing(clocks))
    days = pc.replace_substring_regex(dates, _MIDNIGHT, "")
    if not np.asarray(pc.match_substring_regex(clocks, _CLOCK)).any() or len(pc.unique(days.filter(timed))) < 2:
        return clocks
    good = np.asarray(pc.or_(pc.match_substring_regex(days, _DATE), pc.invert(timed)))
    if not good.all():
        row = int((~good).argmax())
        raise table.error(row, f"{dates[row].as_py()[:40]!r} is not a date like 2024-05-31 or 31.05.2024", column)
    padded = pc.replace_substring_regex(clocks, r"^(\d):", r"0\1:")
    return pc.if_else(timed, pc.binary_join_element_wise(days, padded, pa.scalar("T", pa.large_string())), clocks)


def seconds_of(table: Table, column: int, cells: Any) -> FloatArray:
    """Seconds (rows,) of trimmed timestamps or clocks, of any origin; NaN where there is none.

    Raises:
        FileError: neither, or some of both.
    """
    missing = np.asarray(is_missing(cells))
    if np.asarray(pc.match_substring_regex(cells, _CLOCK)).any():
        return _of_clocks(table, column, cells, missing)
    iso = pc.replace_substring_regex(cells, _GERMAN, r"\3-\2-\1T")
    _check(table, column, cells, missing | np.asarray(pc.match_substring_regex(iso, _ISO)))
    zoned = np.asarray(pc.match_substring_regex(iso, r"(?:Z|:\d\d(?:[.,]\d+)? ?[+-]\d\d(?::?\d\d)?)$"))
    if (zoned != zoned[~missing][:1])[~missing].any():
        row = int(np.flatnonzero(~missing & (zoned != zoned[~missing][0]))[0])
        raise table.error(row, "times with a zone and times without one: use one or the other", column)
    texts = pc.replace_substring(iso, ",", ".").to_pandas()
    stamps = pd.to_datetime(texts, format="ISO8601", utc=True, errors="coerce")
    _check(table, column, cells, missing | stamps.notna().to_numpy())
    values = stamps.to_numpy(dtype="datetime64[ns]")
    origin = values[~missing][0]
    return np.where(missing, np.nan, (values - origin) / np.timedelta64(1, "s"))


def _of_clocks(table: Table, column: int, cells: Any, missing: Any) -> FloatArray:
    _check(table, column, cells, missing | np.asarray(pc.match_substring_regex(cells, _CLOCK)))
    parts = pc.extract_regex(pc.replace_substring(cells, ",", "."), _CLOCK)
    hours, minutes, seconds = (
        np.asarray(pc.struct_field(parts, k).cast(pa.float64()).fill_null(np.nan), dtype=float) for k in range(3)
    )
    _check(table, column, cells, missing | ((hours < 24) & (minutes < 60) & (seconds < 60)))
    values = 3600.0 * hours + 60.0 * minutes + seconds
    there = np.flatnonzero(~missing)
    midnights = np.cumsum(np.diff(values[there], prepend=values[there[0]]) < -0.5 * DAY)
    values[there] += DAY * midnights
    return np.asarray(values)


def _check(table: Table, column: int, cells: Any, good: Any) -> None:
    if not good.all():
        row = int((~good).argmax())
        cell = cells[row].as_py()
        raise table.error(
            row, f"{cell[:40]!r} is not a time like the first: 2024-05-31T14:05:09.25, 14:05:09.25 or a number", column
        )
