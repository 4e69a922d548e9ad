"""Cells of a column as seconds: timestamps, clock times across midnight, clock times with a date column."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc

from probe_env.arrays import BoolArray, FloatArray

MISSING: Final = (
    r"(?i)^(?:|-+|n/?a|#n/?a|[+-]?nan(?:\(\w*\))?|[+-]?1[.,]#(?:[qs]nan|ind)0*|null|none|nil|\?"
    r"|#nv|#value!|#wert!|#div/0!)$"
)
MORE_THAN_NUMBER: Final = r"\d[:\-]\d|\d\.\d+\.\d{4}"
"""Pattern in a timestamp or a clock time."""
DAY: Final = 86_400.0
_FRACTION: Final = r"(?:[.,]\d+)?"
_ISO: Final = rf"^\d{{4}}-\d\d-\d\d[T ]\d\d:\d\d(?::\d\d{_FRACTION})? ?(?:Z|[+-]\d\d(?::?\d\d)?)?$"
_GERMAN: Final = r"^(\d\d)\.(\d\d)\.(\d{4})[T ]"
_ZONE: Final = rf"(?:Z|:\d\d{_FRACTION} ?[+-]\d\d(?::?\d\d)?)$"
_CLOCK: Final = rf"^\d{{1,2}}:\d\d:\d\d{_FRACTION}$"
_OF_A_DAY: Final = rf"^(?:[01]?\d|2[0-3]):[0-5]\d:[0-5]\d{_FRACTION}$"
_DATE: Final = r"^(?:\d{4}-\d\d-\d\d|\d\d\.\d\d\.\d{4})$"
_MIDNIGHT: Final = r"[T ]00:00(?::00(?:[.,]0+)?)?$"
"""Time of day that sheets add to a date."""
_LIKE: Final = "is not a time like the first: 2024-05-31T14:05:09.25, 14:05:09.25 or a number"


def are_serial_days(times: FloatArray) -> bool:
    """Whether times (n,) are days of Excel or catman (1982 to 2064) or of MATLAB.

    Read as seconds they would last less than 1 s.
    """
    first, last = times.min(initial=np.inf), times.max(initial=-np.inf)
    return bool(last - first < 1.0 and (30_000.0 < first < 60_000.0 or 724_000.0 < first < 754_000.0))


class CellError(ValueError):
    """A cell that cannot be read; the reader adds file, line and column."""

    def __init__(self, row: int, problem: str) -> None:
        super().__init__(problem)
        self.row, self.problem = row, problem


def check(cells: Any, good: BoolArray, problem: str) -> None:
    """Raise CellError at the first cell (rows,) that is not ``good``."""
    if not good.all():
        row = int((~good).argmax())
        raise CellError(row, f"{cells[row].as_py()[:40]!r} {problem}")


def matches(cells: Any, pattern: str) -> BoolArray:
    """(rows,) whether a text matches a pattern."""
    return np.asarray(pc.match_substring_regex(cells, pattern))


def with_dates(dates: Any, clocks: Any) -> Any:
    """Combine trimmed clock times and dates of another column to timestamps.

    Timestamps, numbers and clock times of a single day are not changed: midnight is detected from the clock.

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
    """Seconds (rows,) of trimmed timestamps or clock times, from any origin; NaN if missing.

    Raises:
        CellError: not a time, or not like the first.
    """
    missing = matches(cells, MISSING)
    texts = pc.replace_substring(cells, ",", ".").to_pandas()
    if matches(cells, _CLOCK).any():
        check(cells, missing | matches(cells, _OF_A_DAY), _LIKE)
        clocks = np.where(missing, np.nan, pd.to_timedelta(texts.mask(missing)).dt.total_seconds())
        present = clocks[~missing]
        clocks[~missing] += DAY * np.cumsum(np.diff(present, prepend=present[0]) < -0.5 * DAY)  # midnights
        return clocks
    iso = pc.replace_substring_regex(cells, _GERMAN, r"\3-\2-\1T")
    check(cells, missing | matches(iso, _ISO), _LIKE)
    zoned = matches(iso, _ZONE)
    mixed = "is mixed with the others: use times with a zone or times without"
    check(cells, missing | (zoned == zoned[~missing][0]), mixed)
    stamps = pd.to_datetime(
        pc.replace_substring(iso, ",", ".").to_pandas(), format="ISO8601", utc=True, errors="coerce"
    )
    check(cells, missing | stamps.notna().to_numpy(), _LIKE)
    times = stamps.to_numpy(dtype="datetime64[ns]")
    return np.where(missing, np.nan, (times - times[~missing][0]) / np.timedelta64(1, "s"))
