"""Cells of a column as seconds: timestamps, clock times across midnight, clock times with a date column."""

import re
from collections.abc import Callable
from datetime import datetime
from itertools import product
from typing import Any, ClassVar, Final

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
from dateutil.parser import parse, parserinfo

from probe_env.arrays import BoolArray, FloatArray

MISSING: Final = (
    r"(?i)^(?:|[-+*]+|n/?a|#n/?a|[+-]?nan(?:\(\w*\))?|[+-]?1[.,]#(?:[qs]nan|ind)0*|null|none|nil|\?"
    r"|#nv|#value!|#wert!|#div/0!)$"
)
MORE_THAN_NUMBER: Final = r"\d[:/-]\d|^\d{1,2}\.\d{1,2}\.(?:\d\d|\d{4})\b|[A-DF-Za-df-z]|^\d{8}[T_ ]?\d{6}"
"""Pattern in a timestamp or a clock time."""
DAY: Final = 86_400.0
HOUR: Final = 3600.0
_COMPACT: Final = r"^(\d{4})(\d\d)(\d\d)[T_ ]?(\d\d)(\d\d)(\d\d)", r"\1-\2-\3 \4:\5:\6"
_YEAR_LAST: Final = r"^(.*?\d)\s+(\d\d?:\d\d:\d\d)\s+(\d{4})$", r"\1 \3 \2"
"""Mon Mar 4 09:59:56 2025, as C writes it."""
_TIME: Final = (
    r"(?i)^(?:(?P<date>\S.*?)[\s,T_:-]\s*)??(?P<first>\d{1,4}):(?P<second>\d\d)(?::(?P<third>\d\d))?"
    r"(?P<fraction>[.,]\d+|:\d{3})?[\s\x{a0}\x{202f}]*(?:(?P<half>[ap])\.?\s?m\.?)?\s*"
    r"(?P<zone>[a-z]{1,5}|(?:GMT|UTC)?[+-]\d\d(?::?\d\d)?)?$"
)
"""Date, clock time (first is the hour, or the minute of mm:ss), fraction of a second, AM or PM, time zone."""
_ZONES: Final = {
    "BST": 1, "CET": 1, "MEZ": 1, "CEST": 2, "MESZ": 2, "EET": 2, "EEST": 3, "EST": -5, "EDT": -4, "CST": -6, "CDT": -5,
    "MST": -7, "MDT": -6, "PST": -8, "PDT": -7,
}  # fmt: skip
"""Hours from UTC of the names of zones; others have none."""
_PREFIX: Final = r"(?i)^L?(?:DT|DATE_AND_TIME|TOD|TIME_OF_DAY)#"
_DURATION: Final = r"(?i)^L?T(?:IME)?#"
"""Before the times and durations of a PLC (IEC 61131-3): DT#2025-03-04-09:59:40, T#12s500ms."""
_ZONE_NAME: Final = r"\s*(?:\[[^\[\]]*\]|\([^()]*\))$"
"""Name of a zone behind its offset: [Europe/Berlin], (Central European Standard Time)."""
MINUTES: Final = r"^\d{1,4}:\d\d(?:[.,]\d+)?$"
"""mm:ss."""
_CLOCK: Final = r"^\d{1,4}:\d\d"
_DATED: Final = r"%[cdjsx]"
"""Pattern in a form with a date."""
_MIDNIGHT: Final = r"(?i)[T ](?:0?0:00(?::00(?:[.,]0+)?)?|12:00:00 AM)$"
"""Time of day that sheets add to a date."""
_EXAMPLES: Final = "2024-05-31T14:05:09.25, 31.05.2024 14:05:09, 5/31/2024 2:05:09 PM, 14:05:09.25 or a number"
_FORM: Final = "if all are like that, name their form, --time-format '%d.%m.%y %H:%M:%S'"
_LIKE: Final = f"is not a time like {_EXAMPLES} - correct it, or {_FORM}"
_UNLIKE: Final = "is another form of time than {!r} above: correct it"
_CHANGE: Final = 60.0
"""Longest step of a log, besides the hour, at a change to or from summer time [s]."""
_MAX_DATES: Final = 100
"""Different dates in a log; it lasts at most 1e5 s."""


class _Names(parserinfo):  # type: ignore[misc]
    """Names of months in English and German; German weekdays are skipped."""

    JUMP: ClassVar[list[str]] = [
        *parserinfo.JUMP, "mo", "di", "mi", "do", "fr", "sa", "so",
        "montag", "dienstag", "mittwoch", "donnerstag", "freitag", "samstag", "sonntag",
    ]  # fmt: skip
    MONTHS: ClassVar[list[tuple[str, ...]]] = [
        (*names, *more.split())
        for names, more in zip(
            parserinfo.MONTHS,
            ("januar", "februar", "mär mrz märz", "", "mai", "juni", "juli", "", "", "okt oktober", "", "dez dezember"),
            strict=True,
        )
    ]


def are_serial_days(times: FloatArray) -> bool:
    """Whether times (n,) are days of Excel or catman (1982 to 2064) or of MATLAB.

    Read as seconds they would last less than 1 s.
    """
    first, last = times.min(initial=np.inf), times.max(initial=-np.inf)
    return bool(last - first < 1.0 and (30_000.0 < first < 60_000.0 or 724_000.0 < first < 754_000.0))


class CellError(ValueError):
    """A cell that cannot be read; the reader adds file, line and column (if it is another than expected, by index)."""

    def __init__(self, row: int, problem: str, column: int | None = None) -> None:
        super().__init__(problem)
        self.row, self.problem, self.column = row, problem, column


def check(cells: Any, good: BoolArray, problem: str) -> None:
    """Raise CellError at the first cell (rows,) that is not ``good``."""
    if not good.all():
        row = int((~good).argmax())
        raise CellError(row, f"{cells[row].as_py()[:40]!r} {problem}")


def matches(cells: Any, pattern: str) -> BoolArray:
    """(rows,) whether a text matches a pattern."""
    return np.asarray(pc.match_substring_regex(cells, pattern))


def days_of(dates: Any, clocks: Any, form: str = "") -> FloatArray | None:
    """Days (rows,) from any origin of trimmed dates beside clock times; None if those tell the time without them.

    This holds for timestamps, numbers, and clock times of a single day: midnight is detected from the clock.
    """
    timed = ~matches(clocks, MISSING)
    days = pc.replace_substring_regex(dates, _MIDNIGHT, "")
    clock_only = not re.search(_DATED, form) if form else matches(clocks, _CLOCK).any()
    if not clock_only or len(pc.unique(days.filter(pa.array(timed)))) < 2:
        return None
    numbers = np.full(len(dates), np.nan)
    numbers[timed] = _days(days.filter(pa.array(timed)))
    check(dates, ~(timed & np.isnan(numbers)), "is not a date like 2024-05-31, 31.05.2024 or 5/31/24")
    return numbers


def seconds(cells: Any, form: str = "", days: FloatArray | None = None) -> tuple[FloatArray, list[str]]:
    """Seconds (rows,) of trimmed timestamps or clock times, from any origin, and notes; NaN if missing.

    Without days, clock times continue after midnight, and mm:ss after the full hour. Whether the day or the month is
    first in dates follows from the dates: a log lasts hours, so the order with the shortest duration is right.

    Args:
        cells: texts.
        form: their form for ``strptime``; empty: detected.
        days: (rows,) days of clock times, of ``days_of``.
    """
    missing = matches(cells, MISSING)
    rows = np.flatnonzero(~missing)
    times = np.full(len(cells), np.nan)
    if not len(rows):
        return times, []
    present = cells.filter(pa.array(~missing))
    try:
        clock, period = _by_form(present, form) if form else _detected(present)
    except CellError as error:
        raise CellError(int(rows[error.row]), error.problem) from None
    if days is not None and period == DAY:
        clock, period = clock + DAY * (days[rows] - days[rows[0]]), np.inf
    falls = np.diff(clock, prepend=clock[:1]) < -0.5 * period
    begins_again = (clock <= period).all()  # else elapsed times
    times[rows] = clock + period * np.cumsum(falls) if falls.any() and begins_again else clock
    if not form and period == HOUR:
        return times, ["is read as mm:ss; for hh:mm, --time-format %H:%M"]
    return times, _without_summer_time(times, rows) if np.isinf(period) and days is None else []


def _without_summer_time(times: FloatArray, rows: Any) -> list[str]:
    """Take a clock that is put back, or forward, by an hour in the night to a Sunday as continued, in place; notes."""
    notes = []
    clock = times[rows]
    steps = np.diff(clock)
    for shift, change in ((HOUR, "put back"), (-HOUR, "put forward")):
        changes = np.abs(steps + shift) < _CHANGE if shift < 0.0 else (steps < 0.0) & (steps + shift < _CHANGE)
        for k in np.flatnonzero(changes & (steps + shift > 0.0)):
            day, second = divmod(clock[k + 1], DAY)
            if day % 7 == 0 and second < 4 * HOUR:
                times[rows[k + 1 :]] += shift
                notes.append(f"is {change} by an hour, to or from summer time, and is continued")
    return notes


def _detected(cells: Any) -> tuple[FloatArray, float]:
    """Seconds (rows,) of texts, none of which is missing, and the period after which they begin again [s]."""
    if matches(cells[:1], _DURATION).any():
        bare = pc.replace_substring_regex(pc.replace_substring_regex(cells, _DURATION, ""), "_", "")
        check(cells, matches(bare, r"(?i)^-?(?:[\d.]+(?:d|h|m|s|ms|us|ns))+$"), _LIKE)
        elapsed = pd.to_timedelta(bare.to_pandas(), errors="coerce")
        check(cells, elapsed.notna().to_numpy(), _LIKE)
        return np.asarray(elapsed.dt.total_seconds()), np.inf
    texts = cells
    for pattern, text in ((_PREFIX, ""), (_ZONE_NAME, ""), _COMPACT, _YEAR_LAST):
        texts = pc.replace_substring_regex(texts, pattern, text)
    parts = pc.extract_regex(texts, _TIME)
    check(cells, np.asarray(parts.is_valid()), _LIKE)
    field = {part.name: parts.field(k) for k, part in enumerate(parts.type)}
    dated, whole, halved = (bool(field[name][0].as_py()) for name in ("date", "third", "half"))
    for name in ("date", "half", "zone", "third")[: 4 - dated]:
        filled = matches(field[name], ".")
        check(cells, filled == filled[0], _UNLIKE.format(cells[0].as_py()[:40]))
    if field["zone"][0].as_py().isalpha() and not pc.all(pc.is_in(field["zone"], _KNOWN)).as_py():  # have no offset
        check(cells, np.asarray(pc.equal(field["zone"], field["zone"][0])), _UNLIKE.format(cells[0].as_py()[:40]))
    first, second, third = (_floats(field[name]) for name in ("first", "second", "third"))
    if halved:
        check(cells, (first >= 1) & (first <= 12), _LIKE)
        first = first % 12 + np.where(matches(field["half"], "(?i)p"), 12.0, 0.0)
    good, hours = (second < 60) & (third < 60), dated or whole or halved  # else mm:ss
    if hours:
        good &= (first < 24) | ((first == 24) & (second == 0) & (third == 0))
    check(cells, good, _LIKE)
    clock = HOUR * first + 60.0 * second + third if hours else 60.0 * first + second
    clock += _floats(pc.replace_substring_regex(field["fraction"], "^.", "0.")) - _of_unique(field["zone"], _offset)
    if not dated:
        return clock, DAY if hours else HOUR
    days = _days(field["date"])
    check(cells, ~np.isnan(days), _LIKE)
    origin = days[0] // 7 * 7  # a Sunday
    return np.asarray(DAY * (days - origin) + clock), np.inf


def _by_form(cells: Any, form: str) -> tuple[FloatArray, float]:
    """As ``_detected``, of texts of a form for ``strptime``."""
    try:
        stamps = pd.to_datetime(cells.to_pandas(), format=form, errors="coerce", utc=True)
    except ValueError as error:
        raise ValueError(f"time_format = {form!r} is not a form of time: {error}") from error
    check(cells, stamps.notna().to_numpy(), f"is not a time of the form {form!r}")
    dated = re.search(_DATED, form)
    first = stamps.iloc[0] if dated else pd.Timestamp("1900-01-01", tz="UTC")
    period = np.inf if dated else DAY if re.search("%[HIX]", form) else HOUR
    return np.asarray((stamps - first).dt.total_seconds()), period


def _floats(texts: Any) -> FloatArray:
    """Numbers (rows,) of texts of digits; 0 if empty."""
    zero = pa.scalar("0", pa.large_string())
    return np.asarray(pc.if_else(pc.equal(texts, ""), zero, texts).cast(pa.float64()), dtype=float)


def _of_unique(texts: Any, number: Callable[[str], float]) -> FloatArray:
    """A number (rows,) of each text, by a function that is called once for equal texts."""
    coded = pc.dictionary_encode(texts)
    numbers = np.array([number(text) for text in coded.dictionary.to_pylist()])
    return np.asarray(numbers[np.asarray(coded.indices)])


def _offset(zone: str) -> float:
    """Seconds from UTC of "+02:00", "GMT-0530" or "CEST"; 0 for an unknown name."""
    zone = zone.upper()
    if zone.isalpha():
        return HOUR * _ZONES.get(zone, 0)
    zone = zone.removeprefix("GMT").removeprefix("UTC")
    digits = re.sub(r"\D", "", zone).ljust(4, "0")
    return float(f"{zone[:1]}1") * (HOUR * int(digits[:2]) + 60.0 * int(digits[2:])) if digits.strip("0") else 0.0


def _days(dates: Any) -> FloatArray:
    """Days (rows,) of dates from any origin; NaN where a text is no date."""
    coded = pc.dictionary_encode(dates)
    texts = coded.dictionary.to_pylist()[:_MAX_DATES]
    orders = (
        np.array([_day(text, day_first, year_first) for text in texts])
        for day_first, year_first in product((False, True), repeat=2)
    )

    def duration(days: FloatArray) -> tuple[float, ...]:
        good = days[~np.isnan(days)]
        return float(len(days) - len(good)), float((np.diff(good) < 0).any()), float(np.ptp(good)) if len(good) else 0.0

    days = min(orders, key=duration)
    days = np.append(days, np.full(len(coded.dictionary) - len(days), np.nan))
    return np.asarray(days[np.asarray(coded.indices)])


def _day(text: str, day_first: bool, year_first: bool) -> float:
    """Number of a day; NaN if the text is not a whole date."""
    if number := re.fullmatch(r"(\d+) days?,?|([3-5]\d{4})", text):  # elapsed, or serial days of Excel
        return float(number[1] or number[2])
    try:
        days = {
            parse(text, _GERMAN, dayfirst=day_first, yearfirst=year_first, default=default).date()
            for default in (datetime(2000, 1, 1), datetime(2001, 2, 2))  # day, month and year must be in the text
        }
    except (ValueError, OverflowError):
        return np.nan
    return float(days.pop().toordinal()) if len(days) == 1 else np.nan


_GERMAN: Final = _Names()
_KNOWN: Final = pa.array(["Z", "GMT", "UTC", *_ZONES], pa.large_string())
