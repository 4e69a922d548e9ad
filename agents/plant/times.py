"""Cells of a column as seconds: timestamps, clocks across midnight, clocks with the day in another column."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc

from probe_env.arrays import BoolArray, FloatArray

MISSING: Final = r"(?i)^(?:|-+|n/?a|#n/?a|nan|null|none|nil|\?|#nv|#value!|#wert!|#div/0!)$"
MORE_THAN_NUMBER: Final = r"\d[:\-]\d|\d\.\d+\.\d{4}"
"""In a timestamp or a clock."""
DAY: Final = 86_400.0
_FRACTION: Final = r"(?:[.,]\d+)?"
_ISO: Final = rf"^\d{{4}}-\d\d-\d\d[T ]\d\d:\d\d(?::\d\d{_FRACTION})? ?(?:Z|[+-]\d\d(?::?\d\d)?)?$"
_GERMAN: Final = r"^(\d\d)\.(\d\d)\.(\d{4})[T ]"
_ZONE: Final = rf"(?:Z|:\d\d{_FRACTION} ?[+-]\d\d(?::?\d\d)?)$"
_CLOCK: Final = rf"^\d{{1,2}}:\d\d:\d\d{_FRACTION}$"
_OF_A_DAY: Final = rf"^(?:[01]?\d|2[0-3]):[0-5]\d:[0-5]\d{_FRACTION}$"
_DATE: Final = r"^(?:\d{4}-\d\d-\d\d|\d\d\.\d\d\.\d{4})$"
_MIDNIGHT: Final = r"[T ]00:00(?::00(?:[.,]0+)?)?$"
"""What sheets write after a date."""
_LIKE: Final = "is not a time like the first: 2024-05-31T14:05:09.25, 14:05:09.25 or a number"


class CellError(ValueError):
    """A cell that cannot be read; the reader adds file, line and column."""

    def __init__(self, row: int, problem: str) -> None:
        super().__init__(problem)
        self.row, self.problem = row, problem


def check(cells: Any, good: BoolArray, problem: str) -> None:
    """Raise CellError at the first of the cells (rows,) that is not good."""
    if not good.all():
        row = int((~good).argmax())
        raise CellError(row, f"{cells[row].as_py()[:40]!r} {problem}")


def matches(cells: Any, pattern: str) -> BoolArray:
    """(rows,) whether a text has a pattern."""
    return np.asarray(pc.match_substring_regex(cells, pattern))


def dated(dates: Any, clocks: Any) -> Any:
    """Trimmed clocks with the days of another column, as timestamps.

    Timestamps, numbers and the clocks of a single day stay as they are: a clock shows when midnight is passed.

    Raises:
        CellError: not a date.
    """
    timed = ~matches(clocks, MISSING)
    days = pc.replace_substring_regex(dates, _MIDNIGHT, "")
    if not matches(clocks, _CLOCK).any() or len(pc.unique(days.filter(pa.array(timed)))) < 2:
        return clocks
    check(dates, matches(days, _DATE) | ~timed, "is not a date like 2024-05-31 or 31.05.2024")
    padded = pc.replace_substring_regex(clocks, r"^(\d):", r"0\1:")
    stamps = pc.binary_join_element_wise(days, padded, pa.scalar("T", pa.large_string()))
    return pc.if_else(pa.array(timed), stamps, clocks)


def seconds(cells: Any) -> FloatArray:
    """Seconds (rows,) of trimmed timestamps or clocks, from any origin; NaN where missing.

    Raises:
        CellError: not a time, or not like the first.
    """
    missing = matches(cells, MISSING)
    texts = pc.replace_substring(cells, ",", ".").to_pandas()
    if matches(cells, _CLOCK).any():
        check(cells, missing | matches(cells, _OF_A_DAY), _LIKE)
        clocks = np.where(missing, np.nan, pd.to_timedelta(texts.mask(missing)).dt.total_seconds())
        known = clocks[~missing]
        clocks[~missing] += DAY * np.cumsum(np.diff(known, prepend=known[0]) < -0.5 * DAY)  # midnights
        return clocks
    iso = pc.replace_substring_regex(cells, _GERMAN, r"\3-\2-\1T")
    check(cells, missing | matches(iso, _ISO), _LIKE)
    zoned = matches(iso, _ZONE)
    mixed = "mixes times with a zone and times without: use one or the other"
    check(cells, missing | (zoned == zoned[~missing][0]), mixed)
    stamps = pd.to_datetime(
        pc.replace_substring(iso, ",", ".").to_pandas(), format="ISO8601", utc=True, errors="coerce"
    )
    check(cells, missing | stamps.notna().to_numpy(), _LIKE)
    times = stamps.to_numpy(dtype="datetime64[ns]")
    return np.where(missing, np.nan, (times - times[~missing][0]) / np.timedelta64(1, "s"))
