"""Columns of a table as quantities in SI units: decimal signs, numbers, times, units and accepted ranges."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc

from agents.plant.quantities import DATE, QUANTITIES, ColumnOption, Quantity, known_as, plain, si_factor, split_head
from agents.plant.tables import Table, heads_shown
from probe_env.arrays import FloatArray
from probe_env.files import FileError

NOISE: Final[Mapping[str, float]] = {"air_supply": 1.0 / 3600.0, "inserted_length": 0.02}
"""How far below zero a meter may read [SI]; it is taken for zero."""
MISSING: Final = r"(?i)^(?:|-+|n/?a|#n/?a|nan|null|none|nil|\?|#nv|#value!|#wert!|#div/0!)$"
_SPACES: Final = "[ '’\u00a0\u2009\u202f]"
_POWER: Final = r"(?:[eE][+-]?\d+)"

DAY: Final = 86_400.0
_ISO: Final = r"^\d{4}-\d\d-\d\d[T ]\d\d:\d\d(?::\d\d(?:[.,]\d+)?)? ?(?:Z|[+-]\d\d(?::?\d\d)?)?$"
_GERMAN: Final = r"^(\d\d)\.(\d\d)\.(\d{4})[T ]"
_ZONE: Final = r"(?:Z|:\d\d(?:[.,]\d+)? ?[+-]\d\d(?::?\d\d)?)$"
_CLOCK: Final = r"^(?P<h>\d{1,2}):(?P<m>\d\d):(?P<s>\d\d(?:[.,]\d+)?)$"
_DATE: Final = r"^(?:\d{4}-\d\d-\d\d|\d\d\.\d\d\.\d{4})$"
_MIDNIGHT: Final = r"[T ]00:00(?::00(?:[.,]0+)?)?$"
"""What sheets write after a date."""
_MORE_THAN_NUMBER: Final = r"\d[:\-]\d|\d\.\d+\.\d{4}"


@dataclass(frozen=True)
class Channels:
    """A log as it was recorded, in SI units, NaN where values are missing."""

    table: Table
    time: FloatArray  # (rows,) seconds from any origin
    values: Mapping[str, FloatArray]  # quantity -> (rows,)
    places: Mapping[str, int]  # quantity -> index of its column


def channels_of(table: Table, options: Sequence[ColumnOption], decimal: str, air: float | None) -> Channels:
    """The quantities of a table; ``decimal`` is empty if found from the numbers, ``air`` for a log without it [m3/s].

    Raises:
        FileError: a column is missing, occurs twice or has no unit; a cell is not a number or time, or out of range.
    """
    places, units = _places(table, options)
    date = places.pop(DATE, None)
    for names in (("time",), ("feed_speed", "inserted_length"), ("air_supply",)):
        if not any(name in places for name in names) and (names != ("air_supply",) or air is None):
            hint = "; or give a constant, --air-supply M3_PER_H" if names == ("air_supply",) else ""
            problem = f"no column is known as {' or '.join(names)}; found: {heads_shown(table.heads)}"
            raise FileError(table.path, f"{problem} - name it: --columns 'HEAD={names[0]}'{hint}")
    cells = {k: _trimmed(table.columns[k]) for k in places.values()}
    time = places["time"]
    if date is not None:
        cells[time] = _dated(table, date, _trimmed(table.columns[date]), cells[time])
    first = cells[time].filter(pc.invert(_is_missing(cells[time])))[:1]
    written_out = any(pc.match_substring_regex(first, _MORE_THAN_NUMBER).to_pylist())
    scaled = {name: k for name, k in places.items() if not (written_out and name == "time")}
    factors = {name: _factor(table, QUANTITIES[name], k, units) for name, k in scaled.items()}
    sign = decimal or _decimal_sign(table, {k: cells[k] for k in scaled.values()})
    values = {}
    for name, k in places.items():
        known = name in factors
        column = _numbers(table, k, cells[k], sign) * factors[name] if known else _seconds(table, k, cells[k])
        values[name] = _in_range(table, k, QUANTITIES[name], column)
    if "air_supply" not in values and air is not None:
        values["air_supply"] = np.full(len(table.lines), air)
    return Channels(table, values.pop("time"), values, places)


def _places(table: Table, options: Sequence[ColumnOption]) -> tuple[dict[str, int], dict[str, str]]:
    """Index of the column of every quantity, and the units that ``--columns`` gives."""
    places: dict[str, int] = {}
    for option in options:
        matches = [k for k, head in enumerate(table.heads) if head.strip() == option.head]
        matches = matches or [k for k, head in enumerate(table.heads) if head and option.means(head)]
        name = f"column {option.head[:60]!r}"
        if len(matches) != 1:
            often = "is not there" if not matches else f"is there {len(matches)} times: rename one in the file"
            raise FileError(table.path, f"{name} of --columns {often}; found: {heads_shown(table.heads)}")
        if matches[0] in places.values():
            raise FileError(table.path, f"{name} is named twice in --columns: it is one quantity")
        places[option.quantity] = matches[0]
    named = dict(places)
    for k, head in enumerate(table.heads):
        name = known_as(head) or ""
        if k in named.values() or not name or name in named:
            continue
        if name in places:
            both = f"columns {table.heads[places[name]]!r} and {head!r} are both {name}"
            raise FileError(table.path, f"{both}: say which it is, --columns 'HEAD={name}'")
        places[name] = k
    return places, {option.quantity: option.unit for option in options if option.unit}


def _factor(table: Table, quantity: Quantity, k: int, units: Mapping[str, str]) -> float:
    head = table.heads[k]
    unit = units.get(quantity.name) or split_head(head)[1] or table.units[k]
    if not unit and quantity.name == "time":
        unit = quantity.unit
    if not unit:
        hint = f"give it, --columns '{plain(head)}={quantity.name}[UNIT]'"
        raise FileError(table.path, f"column {head!r} has no unit: {hint}")
    try:
        return si_factor(unit, quantity)
    except ValueError as error:
        raise FileError(table.path, f"column {head!r}: {error}") from error


def _in_range(table: Table, k: int, quantity: Quantity, values: FloatArray) -> FloatArray:
    low, high = quantity.low, quantity.high
    wrong = (values < low - NOISE.get(quantity.name, 0.0)) | (values > high)
    if wrong.any():
        row, unit = int(wrong.argmax()), quantity.unit
        value, least, most = (number / quantity.scale for number in (values[row], low, high))
        problem = f"{quantity.name} = {value:.6g} {unit} is outside the accepted range {least:g} to {most:g} {unit}"
        raise table.error(row, f"{problem} - is the unit right?", k)
    return np.asarray(np.where(values < low, low, values))


def _trimmed(cells: Any) -> Any:
    return pc.utf8_trim(cells, " \t\u00a0\u2009\u202f\ufeff")


def _is_missing(cells: Any) -> Any:
    return pc.match_substring_regex(cells, MISSING)


def _decimal_sign(table: Table, columns: Mapping[int, Any]) -> str:
    """The decimal sign of a file, by all its numbers: trimmed texts by the index of their column."""
    proofs = {sign: _first(columns, _proof(sign)) for sign in ".,"}
    if proofs["."] and proofs[","]:
        row, k = max(proofs["."], proofs[","])
        problem = f"{columns[k][row].as_py()[:40]!r} has another decimal sign than the numbers before it"
        raise table.error(row, f"{problem}: use one", k)
    for sign, proof in proofs.items():
        if proof:
            return sign
    points_only = not _first(columns, ",")
    if points_only and table.separator in ("", ","):  # a sheet; or commas separate: a point marks no thousands then
        return "."
    if unclear := _first(columns, r"[.,]"):
        row, k = unclear
        problem = f"{columns[k][row].as_py()[:40]!r} may have a decimal sign or thousands, and no other number tells"
        raise table.error(row, f"{problem}: --decimal point or comma", k)
    return "."


def _proof(sign: str) -> str:
    """What only a number with this decimal sign looks like."""
    g = re.escape("," if sign == "." else ".")
    d = re.escape(sign)
    return (
        rf"^[+-]?(?:\d{{1,3}}(?:{g}\d{{3}})+{d}\d*"  # thousands and a decimal sign
        rf"|\d{{1,3}}(?:{g}\d{{3}}){{2,}}"  # groups of thousands
        rf"|\d*{d}(?:\d{{0,2}}|\d{{4,}}){_POWER}?"  # not three digits behind it
        rf"|(?:0\d*|\d{{4,}}|){d}\d*{_POWER}?"  # nor one to three before it, as a group has
        rf"|\d+{d}\d*{_POWER})$"
    )


def _first(columns: Mapping[int, Any], shape: str) -> tuple[int, int] | None:
    """Row and column of the first text of a shape, row by row."""
    for begin, count in ((0, 1000), (1000, None)):  # most files show it at once
        found = []
        for k, cells in columns.items():
            match = np.asarray(pc.match_substring_regex(cells.slice(begin, count), shape))
            if match.any():
                found.append((begin + int(match.argmax()), k))
        if found:
            return min(found)
    return None


def _numbers(table: Table, column: int, cells: Any, sign: str) -> FloatArray:
    """Finite numbers (rows,) of trimmed texts, NaN where missing."""
    other = "," if sign == "." else "."
    if sign == "." or not _first({0: cells}, r"\."):
        try:  # most columns are written plainly, and read fast
            values = np.asarray(pc.replace_substring(cells, sign, ".").cast(pa.float64()), dtype=float)
        except pa.ArrowInvalid:
            values = np.array([np.nan])
        if np.isfinite(values).all():
            return values
    missing = np.asarray(_is_missing(cells))
    d, g = re.escape(sign), re.escape(other)
    shape = rf"^[+-]?(?:\d+|\d{{1,3}}(?:{g}\d{{3}})+|\d{{1,3}}(?:{_SPACES}\d{{3}})+)?(?:{d}\d*)?{_POWER}?$"
    good = pc.and_(pc.match_substring_regex(cells, shape), pc.match_substring_regex(cells, r"\d"))
    point = pc.replace_substring(pc.replace_substring_regex(cells, rf"^\+|{g}|{_SPACES}", ""), sign, ".")
    readable = np.asarray(good) & ~missing
    values = np.asarray(pc.if_else(pa.array(readable), point, pa.scalar("nan", pa.large_string())).cast(pa.float64()))
    wrong = ~(readable | missing) | np.isinf(values)
    if wrong.any():
        row = int(wrong.argmax())
        cell = cells[row].as_py()
        hint = f" with the decimal sign {sign!r}, which the other numbers have" if other in cell else ""
        raise table.error(row, f"{cell[:40]!r} is not a finite number{hint} - correct it, or leave it empty", column)
    return values


def _dated(table: Table, column: int, dates: Any, clocks: Any) -> Any:
    """Trimmed clocks with the day of another column, as timestamps.

    Timestamps, numbers and the clocks of a single day stay as they are: a clock shows when midnight is passed.
    """
    timed = pc.invert(_is_missing(clocks))
    days = pc.replace_substring_regex(dates, _MIDNIGHT, "")
    if not np.asarray(pc.match_substring_regex(clocks, _CLOCK)).any() or len(pc.unique(days.filter(timed))) < 2:
        return clocks
    good = np.asarray(pc.or_(pc.match_substring_regex(days, _DATE), pc.invert(timed)))
    _check(table, column, dates, good, "is not a date like 2024-05-31 or 31.05.2024")
    padded = pc.replace_substring_regex(clocks, r"^(\d):", r"0\1:")
    return pc.if_else(timed, pc.binary_join_element_wise(days, padded, pa.scalar("T", pa.large_string())), clocks)


def _seconds(table: Table, column: int, cells: Any) -> FloatArray:
    """Seconds (rows,) of trimmed timestamps or clocks, from any origin; NaN where missing."""
    wanted = "is not a time like the first: 2024-05-31T14:05:09.25, 14:05:09.25 or a number"
    missing = np.asarray(_is_missing(cells))
    clocks = np.asarray(pc.match_substring_regex(cells, _CLOCK))
    if clocks.any():
        _check(table, column, cells, missing | clocks, wanted)
        parts = pc.extract_regex(pc.replace_substring(cells, ",", "."), _CLOCK)
        hours, minutes, seconds = (
            np.asarray(pc.struct_field(parts, k).cast(pa.float64()).fill_null(np.nan), dtype=float) for k in range(3)
        )
        _check(table, column, cells, missing | ((hours < 24) & (minutes < 60) & (seconds < 60)), wanted)
        values = 3600.0 * hours + 60.0 * minutes + seconds
        known = values[~missing]
        values[~missing] += DAY * np.cumsum(np.diff(known, prepend=known[0]) < -0.5 * DAY)  # midnights
        return np.asarray(values)
    iso = pc.replace_substring_regex(cells, _GERMAN, r"\3-\2-\1T")
    _check(table, column, cells, missing | np.asarray(pc.match_substring_regex(iso, _ISO)), wanted)
    zoned = np.asarray(pc.match_substring_regex(iso, _ZONE))
    if (mixed := ~missing & (zoned != zoned[~missing][0])).any():
        raise table.error(int(mixed.argmax()), "times with a zone and times without one: use one or the other", column)
    texts = pc.replace_substring(iso, ",", ".").to_pandas()
    stamps = pd.to_datetime(texts, format="ISO8601", utc=True, errors="coerce")
    _check(table, column, cells, missing | stamps.notna().to_numpy(), wanted)
    times = stamps.to_numpy(dtype="datetime64[ns]")
    return np.where(missing, np.nan, (times - times[~missing][0]) / np.timedelta64(1, "s"))


def _check(table: Table, column: int, cells: Any, good: Any, problem: str) -> None:
    if not good.all():
        row = int((~good).argmax())
        raise table.error(row, f"{cells[row].as_py()[:40]!r} {problem}", column)
