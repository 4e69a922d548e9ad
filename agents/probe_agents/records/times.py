"""Cells of a column as seconds: timestamps, clock times across midnight, clock times with a date column."""

import re
from datetime import datetime
from itertools import product
from typing import Any, Final

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
from dateutil.parser import parse

from probe_env.arrays import BoolArray, FloatArray

MISSING: Final = (
    r"(?i)^(?:|[-+*]+|n/?a|#n/?a|[+-]?nan(?:\(\w*\))?|[+-]?1[.,]#(?:[qs]nan|ind)0*|null|none|nil|\?"
    r"|#nv|#value!|#wert!|#div/0!)$"
)
MORE_THAN_NUMBER: Final = r"\d[:/-]\d|^\d{1,2}\.\d{1,2}\.(?:\d\d|\d{4})\b|[A-DF-Za-df-z]|^\d{8}[T_ ]?\d{6}"
"""Pattern in a timestamp or a clock time."""
MINUTES: Final = r"^\d{1,4}:\d\d(?:[.,]\d+)?$"
"""mm:ss."""
HOUR, DAY = 3600.0, 86_400.0
_DURATION: Final = (
    r"(?i)^(?:L?T(?:IME)?#-?(?:[\d.]+(?:d|h|m|s|ms|us|ns)_?)+|\d+ days?,?\s+\d\d?:[0-5]\d:[0-5]\d(?:[.,]\d+)?)$"
)
"""T#12s500ms of a PLC (IEC 61131-3); 1 day, 0:00:01."""
_REPLACED: Final = (
    (r"(?i)^L?(?:T|TIME|DT|DATE_AND_TIME|TOD|TIME_OF_DAY)#", ""),
    (r"\s*(?:\[[^\[\]]*\]|\([^()]*\))$", ""),  # name of a zone behind its offset: [Europe/Berlin]
    (r"(?:GMT|UTC)([+-])", r"\1"),
    (r"(:\d\d),(\d)", r"\1.\2"),
    (r"(?i)^(\d+ days?),", r"\1"),
    (r"^(\d{4})(\d\d)(\d\d)[T_ ]?(\d\d)(\d\d)(\d\d)", r"\1-\2-\3 \4:\5:\6"),
    (r"^(.*?\d)\s+(\d\d?:\d\d:\d\d)\s+(\d{4})$", r"\1 \3 \2"),  # Mon Mar 4 09:59:56 2025, as C writes it
)
_TIME: Final = (
    r"(?i)^(?:(?P<date>\S.*?)[\s,T_:-]\s*)??(?P<minute>\d{1,4}:[0-5]\d)(?P<second>:[0-5]\d)?"
    r"(?P<fraction>\.\d+|:\d{3})?[\s\x{a0}\x{202f}]*(?:(?P<half>[ap])\.?\s?m\.?)?\s*"
    r"(?P<zone>[a-z]{1,5}|[+-]\d\d(?::?\d\d)?)?$"
)
"""Date, hh:mm or the mm:ss of a duration, second, fraction of a second, AM or PM, time zone."""
_ZONES: Final = {
    "": 0, "Z": 0, "GMT": 0, "UTC": 0, "BST": 1, "CET": 1, "MEZ": 1, "CEST": 2, "MESZ": 2, "EET": 2, "EEST": 3,
    "EST": -5, "EDT": -4, "CST": -6, "CDT": -5, "MST": -7, "MDT": -6, "PST": -8, "PDT": -7,
}  # fmt: skip
"""Hours from UTC."""
_GERMAN: Final = (
    (r"\b(?:mo|di|mi|do|fr|sa|so)(?:[a-z]*tag|ttwoch)?(?![a-z])", ""), (r"\b(jan|feb)uar\b", r"\1"), ("mai", "may"),
    (r"\b(?:märz?|mrz)\b", "mar"), (r"\bju([nl])i\b", r"ju\1"), ("okt", "oct"), ("dez", "dec"),
)  # fmt: skip
"""Weekdays, which are left out, and months -> English."""
_LIKE: Final = (
    "is not a time like 2024-05-31T14:05:09.25, 31.05.2024 14:05:09, 5/31/2024 2:05:09 PM, 14:05:09.25 or a number"
    " - correct it, or if all are like that, name their form, --time-format '%d.%m.%y %H:%M:%S'"
)
_CHANGE: Final = 60.0
"""Longest step of a log, besides the hour, at a change to or from summer time [s]."""
_MAX_DATES: Final = 100
"""Different dates in a log; it lasts at most 1e5 s."""


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


def are_serial_days(times: FloatArray) -> bool:
    """Whether times (n,) are days of Excel (1982 to 2064) or MATLAB; as seconds they would last less than 1 s."""
    first, last = times.min(initial=np.inf), times.max(initial=-np.inf)
    return bool(last - first < 1.0 and (30_000.0 < first < 60_000.0 or 724_000.0 < first < 754_000.0))


def seconds(cells: Any, form: str = "", dates: Any = None) -> tuple[FloatArray, list[str]]:
    """Seconds (rows,) of trimmed timestamps or clock times, from any origin, and notes; NaN if missing.

    Clock times continue after midnight, and mm:ss after the full hour.

    Args:
        cells: texts.
        form: their form for ``strptime``; empty: detected.
        dates: texts (rows,) of another column, the dates of clock times unless all are equal.
    """
    missing = matches(cells, MISSING)
    times, rows = np.full(len(cells), np.nan), np.flatnonzero(~missing)
    if not len(rows):
        return times, []
    present = cells.take(pa.array(rows))
    try:
        clock, period = _by_form(present, form) if form else _detected(present)
        beside = None if dates is None else dates.take(pa.array(rows))
        if period == DAY and beside is not None and len(pc.unique(beside)) > 1:
            days = _days(beside.to_pandas())
            check(beside, ~np.isnan(days), "beside it is not a date like 2024-05-31, 31.05.2024 or 5/31/24")
            clock, period = clock + DAY * (days - days[0] // 7 * 7), np.inf
    except CellError as error:
        raise CellError(int(rows[error.row]), error.problem) from None
    notes = ["is read as mm:ss; for hh:mm, --time-format %H:%M"] if period == HOUR and not form else []
    if np.isinf(period):
        notes = _continue_summer_time(clock)
    elif (clock <= period).all():  # else elapsed times
        clock += period * np.cumsum(np.diff(clock, prepend=clock[:1]) < -0.5 * period)
    times[rows] = clock
    return times, notes


def _continue_summer_time(clock: FloatArray) -> list[str]:
    """Continue seconds (n,) from a Sunday, put back or forward by an hour in the night to a Sunday, in place; notes."""
    steps, notes = np.diff(clock, prepend=clock[:1]), []
    night = clock % (7 * DAY) < 4 * HOUR
    for shift, change in ((HOUR, "back"), (-HOUR, "forward")):
        changed = night & (steps + shift > 0.0) & (steps + shift < _CHANGE)
        if changed.any():
            clock += shift * np.cumsum(changed)
            notes.append(f"is put {change} by an hour, to or from summer time, and is continued")
    return notes


def _detected(cells: Any) -> tuple[FloatArray, float]:
    """Seconds (rows,) of texts, none of which is missing, and the period after which they begin again [s].

    The period is infinite for dates, and 0 for durations.
    """
    texts = cells
    for pattern, text in _REPLACED:
        texts = pc.replace_substring_regex(texts, pattern, text)
    if matches(cells[:1], _DURATION).any():
        elapsed = pd.to_timedelta(pc.replace_substring(texts, "_", "").to_pandas(), errors="coerce")
        check(cells, matches(cells, _DURATION) & elapsed.notna().to_numpy(), _LIKE)
        return np.array(elapsed.dt.total_seconds()), 0.0
    parts = pc.extract_regex(texts, _TIME)
    check(cells, np.asarray(parts.is_valid()), _LIKE)
    part = {field.name: parts.field(k).to_pandas() for k, field in enumerate(parts.type)}
    dated, hours = part["date"][0] != "", bool(part["date"][0] + part["second"][0] + part["half"][0])
    offsets = part["zone"].map({zone: _offset(zone) for zone in part["zone"].unique()})
    alike = offsets.notna() if pd.notna(offsets[0]) else part["zone"] == part["zone"][0]
    for name in ("date", "half", "zone", "second")[: 4 - dated]:
        alike &= (part[name] == "") == (part[name][0] == "")
    check(cells, alike.to_numpy(), f"is another form of time than {cells[0].as_py()[:40]!r} above: correct it")
    whole = part["minute"] + part["second"].replace("", ":00") if hours else "0:" + part["minute"]
    clock = np.array(pd.to_timedelta(whole + "." + part["fraction"].str[1:] + "0").dt.total_seconds())
    if part["half"][0]:
        check(cells, (clock >= HOUR) & (clock < 13 * HOUR), _LIKE)
        clock = clock % (0.5 * DAY) + 0.5 * DAY * part["half"].isin(["p", "P"]).to_numpy()
    check(cells, (clock <= DAY) | (not hours), _LIKE)
    clock = clock - offsets.fillna(0.0).to_numpy()
    if not dated:
        return clock, DAY if hours else HOUR
    days = _days(part["date"])
    check(cells, ~np.isnan(days), _LIKE)
    return clock + DAY * (days - days[0] // 7 * 7), np.inf


def _by_form(cells: Any, form: str) -> tuple[FloatArray, float]:
    """As ``_detected``, of texts of a form for ``strptime``."""
    try:
        stamps = pd.to_datetime(cells.to_pandas(), format=form, errors="coerce", utc=True)
    except ValueError as error:
        raise ValueError(f"time_format = {form!r} is not a form of time: {error}") from error
    check(cells, stamps.notna().to_numpy(), f"is not a time of the form {form!r}")
    origin, period = stamps[0].normalize(), DAY if re.search("%[HIX]", form) else HOUR
    if re.search(r"%[cdjsx]", form):  # a date
        origin, period = origin - pd.Timedelta(days=origin.isoweekday() % 7), np.inf
    return np.array((stamps - origin).dt.total_seconds()), period


def _offset(zone: str) -> float:
    """Seconds from UTC of a time zone like +02:00, -0530 or CEST; NaN if its name is unknown."""
    if zone[:1] not in ("+", "-"):
        return HOUR * _ZONES.get(zone.upper(), np.nan)
    return pd.Timedelta(f"{zone[:3]}:{zone[3:].strip(':') or '00'}:00").total_seconds()


def _days(dates: "pd.Series[str]") -> FloatArray:
    """Days (rows,) of dates from a Sunday; NaN where a text is no date.

    Whether day, month or year is first follows from the dates: a log lasts hours, so the order with the shortest
    duration is right.
    """
    codes, texts = pd.factorize(dates)
    orders = [
        pd.Series([*(_day(text, *first) for text in texts[:_MAX_DATES]), np.nan])
        for first in product((False, True), repeat=2)
    ]
    best = min(orders, key=lambda days: (days.isna().sum(), days.max() - days.min()))
    return best.to_numpy()[np.minimum(codes, _MAX_DATES)]


def _day(text: str, day_first: bool, year_first: bool) -> float:
    """Days from a Sunday to a date; NaN if the text is not a whole date."""
    if re.fullmatch(r"[3-5]\d{4}", text):  # serial day of Excel; 1 is a Sunday
        return float(text) - 1.0
    for german, english in _GERMAN:
        text = re.sub(german, english, text, flags=re.IGNORECASE)
    try:
        day, other = (
            parse(text, dayfirst=day_first, yearfirst=year_first, default=default).toordinal()
            for default in (datetime(2000, 1, 1), datetime(2001, 2, 2))  # day, month and year must be in the text
        )
    except (ValueError, OverflowError):
        return np.nan
    return float(day) if day == other else np.nan
