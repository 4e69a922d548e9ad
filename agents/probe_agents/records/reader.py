"""Reads logs and schedules: columns of texts become quantities in SI units.

``read_table`` gives the cells of a file, ``_Conversion`` finds the column of each quantity and converts it.
"""

import math
import re
import shlex
import warnings
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc

from probe_agents.records.cells import HEADS_SHOWN, ReadOptions, Table, listed, read_table, unknown_head
from probe_agents.records.quantities import (
    DATE,
    FRACTION,
    FRACTION_UNITS,
    HOUR,
    IGNORED,
    MEASURED,
    QUANTITIES,
    RETURN,
    Quantity,
    UnknownUnitError,
    gas_amount,
    normalized,
    quantity_of,
    si_factor,
    split_head,
)
from probe_agents.records.sources import MAX_BYTES, file_and_sheet
from probe_agents.records.times import (
    DAY,
    MINUTES,
    MISSING,
    MORE_THAN_NUMBER,
    CellError,
    are_serial_days,
    check,
    matches,
    seconds,
)
from probe_env.arrays import FloatArray
from probe_env.files import FileError, open_regular
from probe_env.schedule import AIR, FEED, POSITIONS, Row, Schedule, schedule_of_rows, schedule_rows, withdrawal_of_rows

_MARKER: Final = re.compile(
    r"-?(?:9{4,}(?:\.(?:25|9+))?|999\.25|[67]999|32767|65535|2147483647)"
    r"|-(?:999(?:\.9+)?|99\.9+|8888|888\.88|32768|2147483648)"
)
"""Numbers that loggers write for a missing value; 2147483647 is that of 32 bits."""
MAX_NUMBER: Final = 1e30
"""Numbers from here on mark a missing value or an overload."""
SHORTEST_STEP: Final = 5e-3
"""Mean step of a time without a unit [s]; a shorter one may be of hours."""
SUSPECT: Final = ("air_supply", *MEASURED)
"""Quantities whose accepted range is wide enough for overload codes."""
FAR: Final = 10.0
"""Ratio of an overload code to the largest other value."""
_HOURS: Final = re.compile(r"(?:h{1,2}|std):m(?:m|in)", re.IGNORECASE)
"""Units of a clock time without seconds: hh:mm."""
_QUALITY: Final = re.compile(r"(.+) (?:quality|status|state|qualität|q)")
"""Heading of the quality of another column."""
_BAD: Final = r"(?i)^(?:bad|uncertain|invalid|fail|fault|error|false|schlecht|unsicher|ungültig|fehler)"
GOOD: Final = 192.0
"""Codes of OPC from here on are of good values; below, and from ``UNCERTAIN`` on, of uncertain ones."""
UNCERTAIN: Final = 64.0
MESSAGES: Final = 0.05
"""Fraction of the rows which may be messages of the logger."""
_DIGITS: Final = r"^[+-]?\d+(?:[.,]\d+)?$"
_WITH_UNIT: Final = re.compile(
    r"[+-]?\d(?:[\d.,' ]*[\d.,'])?(?:[eE][+-]?\d+)?\s*([A-Za-zµμ%°][A-Za-zµμ]*[23²³]?(?:/[A-Za-z]+[23²³]?)?)"
)
"""A number and its unit in one cell."""
_SPACES: Final = "[ '’\u00a0\u2009\u202f]"
_QUANTITIES: Final = dict(QUANTITIES) | {FRACTION: Quantity(FRACTION, "s", "s", 0.0, math.nextafter(1.0, 0.0))}
_EMPTY: Final = pa.scalar("", pa.large_string())
_FROM, _TO = ("from", "from length", "begin", "start", "von"), ("to", "to length", "end", "bis")
"""Headings of the ends of a section of a schedule."""


@dataclass(frozen=True)
class Channels:
    """A recorded log in SI units; missing values are NaN."""

    table: Table
    time: FloatArray  # (rows,) seconds from any origin
    values: Mapping[str, FloatArray]  # quantity -> (rows,)
    indices: Mapping[str, int]  # quantity -> index of its column
    notes: tuple[str, ...] = ()  # what was taken as missing or as days, or left out
    written_out: bool = False  # whether times are clock times or timestamps, not numbers


def read_channels(path: Path, options: ReadOptions) -> Channels:
    """Read the quantities of a log from a text file or from a sheet of a workbook.

    Raises:
        FileNotFoundError: no such file.
        FileError: not a text or workbook; no such sheet; no header or rows; a column that is missing, occurs twice or
            has no unit; a cell that is not a number or time, or out of range; too large.
        ValueError: ``time_format`` is not a form, or ``encoding`` is unknown.
        ModuleNotFoundError: python-calamine or pint is not installed.
    """
    table = read_table(path, options)
    log = _Conversion(table, options)
    if options.rate is not None and (k := log.indices.get("time")) is not None:
        problem = f"the column {table.heads[k]!r} is the time: leave --rate out, or {table.option(k, IGNORED)}"
        raise FileError(path, problem)
    log.require(*[("time",)][: options.rate is None], ("feed_speed", "inserted_length"))
    if options.air_supply is None:
        log.require(("air_supply",))
    for name in RETURN:
        log.indices.pop(name, None)
    values = log.values()
    log.note_unread()
    if options.rate is not None:
        values["time"], log.indices["time"] = np.arange(len(table.lines)) / options.rate, 0
    if options.air_supply is not None:
        values.setdefault("air_supply", np.full(len(table.lines), options.air_supply / HOUR))
    return Channels(table, values.pop("time"), values, log.indices, tuple(log.notes), log.written_out)


def read_schedule(path: str | Path) -> Schedule:
    """Read a schedule; it may have the headings, units, separators and the workbook that a log may have.

    Sections may be given by the columns "from" and "to". "FILE#SHEET" names a sheet of a workbook; by default it is the
    first one with known headings.

    Raises:
        ModuleNotFoundError: python-calamine or pint is not installed.
    """
    return schedule_of_rows(Path(path), *_schedule_rows(*file_and_sheet(path)))


def read_withdrawal(path: str | Path) -> Schedule | None:
    """Read the withdrawal of a schedule; None if the file has none. Raises as ``read_schedule``."""
    return withdrawal_of_rows(Path(path), *_schedule_rows(*file_and_sheet(path)))


def _schedule_rows(path: Path, sheet: str | None) -> tuple[str, Sequence[Row]]:
    """Interpolation and rows of a schedule; heads, separators and units may differ from those of ``Schedule.read``."""
    if path.suffix == ".toml" or _has_schedule_columns(path):
        return schedule_rows(path)
    try:
        table = read_table(path, ReadOptions(sheet=sheet))
        plan = _Conversion(table, None)
        words = [normalized(split_head(head)[0]) for head in table.heads]
        begin, end = (next((k for k, word in enumerate(words) if word in heads), -1) for heads in (_FROM, _TO))
        is_sections = min(begin, end) >= 0 and not {"time", "inserted_length"} & set(plan.indices)
        if is_sections:
            plan.indices["inserted_length"] = begin
        plan.require(("inserted_length", "time"), ("feed_speed",), ("air_supply",))
        used = ("time", DATE, FRACTION, "inserted_length", "feed_speed", "air_supply", *RETURN)
        indices = plan.indices = {name: plan.indices[name] for name in used if name in plan.indices}
        values = plan.values()
        if is_sections:
            plan.indices = {"inserted_length": end}
            apart = np.abs(plan.values()["inserted_length"][:-1] - values["inserted_length"][1:]) > 1e-6
            if apart.any():
                problem = "the section does not end where the next one begins: a schedule has no gaps and no overlaps"
                raise table.error(int(apart.argmax()), problem, end)
    except FileError as error:
        if "--" not in error.problem:  # an option of other commands
            raise
        problem = re.sub(r"(?:,|:|;| -) (?:or )?[^,:;-]*?[,:]? ?--(?!sheet).*", "", error.problem)
        hint = " - correct the file: a schedule has heads like 'length [m]', 'feed [m/s]' and 'air [m3/h]'"
        raise FileError(path, problem + hint * (" - " not in problem)) from error
    for note in plan.notes:
        warnings.warn(f"{path}: {note}", stacklevel=3)
    for name, column in values.items():
        if (empty := np.isnan(column)).any():
            problem = "no value"
            if table.row_word == "row":
                problem = "no value, or a formula without a stored value: open the workbook in Excel and save it"
            raise table.error(int(empty.argmax()), problem, indices[name])
        values[name] = (column - (column[0] if name == "time" else 0.0)) / QUANTITIES[name].scale
    columns = {QUANTITIES[name].column: [float(f"{v:.12g}") for v in column] for name, column in values.items()}
    rows = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
    places = (f"{table.row_word} {line}" for line in table.lines)
    return "steps" if table.steps or is_sections else "linear", list(zip(places, rows, strict=True))


def _has_schedule_columns(path: Path) -> bool:
    """Whether the header of a file has the columns of ``Schedule.read``, separated by commas."""
    with open_regular(path, MAX_BYTES) as file:
        lines = file.read(1 << 16).decode("utf-8-sig", "replace").splitlines()
    header = next((line for line in lines if line.strip(" ,") and not line.startswith("#")), "")
    names = {name.strip() for name in header.split(",")}
    return {FEED, AIR} <= names and not names.isdisjoint(POSITIONS)


class _Conversion:
    """The columns of a table that are quantities, and their values in SI units.

    Args:
        table: cells of the file.
        options: of a log; None: a schedule, whose numbers mark no missing values and whose times need a unit.
    """

    def __init__(self, table: Table, options: ReadOptions | None) -> None:
        self.table, self.is_log, self.notes, self.written_out = table, options is not None, [*table.notes], False
        self.options = options or ReadOptions()
        self.named = {option.quantity: option for option in self.options.named}
        self.indices = self._indices()
        marked = np.array([*table.null, *self.options.missing], dtype=object)
        numbers = pd.to_numeric([text.replace(",", ".") for text in marked], errors="coerce")
        self.markers, self.words = numbers[np.isfinite(numbers)], marked[~np.isfinite(numbers)]

    def _indices(self) -> dict[str, int]:
        """Index of the column of every quantity."""
        table, by_option = self.table, dict[str, int]()
        for option in self.options.named:
            found = [k for k, head in enumerate(table.heads) if head == option.head]
            found = found or [k for k, head in enumerate(table.heads) if head and option.means(head)]
            name = f"column {option.head[:60]!r}"
            if len(found) != 1:
                often = "does not exist" if not found else f"exists {len(found)} times: rename one in the file"
                raise FileError(table.path, f"{name} of --columns {often}; found: {listed(table.heads)}")
            if found[0] in by_option.values():
                raise FileError(table.path, f"{name} is named twice in --columns: a column is one quantity")
            by_option[option.quantity if option.quantity != IGNORED else f"{IGNORED} {found[0]}"] = found[0]
        indices = {name: k for name, k in by_option.items() if not name.startswith(IGNORED)}
        for k, head in enumerate(table.heads):
            quantity = quantity_of(head)
            if quantity is None or k in by_option.values():
                continue
            first = indices.setdefault(quantity, k)
            if first == k or table.columns[k].equals(table.columns[first]):
                continue
            if quantity not in by_option:
                hint = "rename one in the file"
                if head != (other := table.heads[first].replace("'", "")):
                    hint = f"choose one, --columns '{other}={quantity}'"
                both = f"columns {table.heads[first]!r} and {head!r} are both {quantity}"
                raise FileError(table.path, f"{both}: {hint}")
            if quantity == "time":
                note = "is another time and is left out: if columns have this time, read them apart"
                self.notes.append(f"The column {head!r} {note}.")
        if "time" not in indices and not table.heads[0] and matches(table.columns[0][:1], MORE_THAN_NUMBER).all():
            indices["time"] = 0  # the index of a table of pandas
        return indices

    def require(self, *groups: Sequence[str]) -> None:
        """Raise FileError unless there is a column for one name of each group."""
        hints = {"time": "give the rows per second, --rate HZ", "air_supply": "give a constant, --air-supply M3_PER_H"}
        for names in groups:
            if self.indices.keys().isdisjoint(names):
                heads, name = self.table.heads, names[0]
                problem = f"no column for {' or '.join(names)}; found: {listed(heads)}"
                hint = f"name it: --columns '{unknown_head(heads)}={name}'"
                hint = f"{hints[name]}, or {hint}" if name in hints else hint
                raise FileError(self.table.path, f"{problem} - {hint}")

    def note_unread(self) -> None:
        """Note the columns that are not read, with the missing measurements that each may be, by its unit."""
        table, heads, options = self.table, list[str](), list[str]()
        for k, head in enumerate(table.heads):
            named = any(option.means(head) for option in self.options.named)
            if not head or named or quantity_of(head) or _QUALITY.fullmatch(normalized(head)):
                continue
            heads.append(head)
            if unit := table.written_unit(k):
                for name in (name for name in MEASURED if name not in self.indices):
                    with suppress(ValueError, ModuleNotFoundError):
                        si_factor(unit, QUANTITIES[name])
                        options.append(table.option(k, name))
        if heads:
            hint = f" If they are measurements: {', '.join(options[:HEADS_SHOWN])}." if options else ""
            self.notes.append(f"Not read: {listed(heads)}.{hint}")

    def values(self) -> dict[str, FloatArray]:
        """Values in SI units (rows,) of the quantities; missing ones are NaN."""
        table, values, form = self.table, dict[str, FloatArray](), self.options.time_format
        words = pa.array(self.words, pa.large_string())
        cells = {
            name: pc.if_else(pc.is_in(table.columns[k], words), _EMPTY, table.columns[k])
            for name, k in self.indices.items()
            if name != DATE
        }
        self._leave_messages_out(cells)
        units = {name: self._unit(name, cells) for name in cells}
        if "time" in cells:
            first = cells["time"].filter(pa.array(~matches(cells["time"], MISSING)))[:1]
            number = bool(units["time"] not in ("", "s") and matches(first, _DIGITS).any())
            self.written_out = bool(form) or (not number and bool(matches(first, MORE_THAN_NUMBER).any()))
            if not form and _HOURS.fullmatch(units["time"]) and matches(cells["time"], MINUTES).any():
                self.written_out, form = True, "%H:%M"
        numbers = {
            name: pc.replace_substring_regex(column, r"^([+-])\s+", r"\1")  # a sign apart
            for name, column in cells.items()
            if name != "time" or not self.written_out
        }
        sign = {"auto": "", "point": ".", "comma": ","}[self.options.decimal]
        sign = sign or _decimal_sign(table, {self.indices[n]: column for n, column in numbers.items() if n != FRACTION})
        for name in sorted(cells, key=lambda name: name == FRACTION):  # last, as a time with fractions needs no others
            if name == FRACTION and ("time" not in values or (values["time"] % 1.0 > 0.0).any()):
                continue
            try:
                if name in numbers:
                    values[name] = self._numbers(name, numbers[name], units[name], sign)
                else:
                    values[name] = self._times(cells[name], form)
                continue
            except CellError as error:
                refusal = table.error(error.row, error.problem, self.indices[name])
            except FileError as error:
                refusal = error
            if name != "feed_speed" or "inserted_length" not in self.indices or name in self.named or not self.is_log:
                raise refusal
            problem = re.split(" - |: declare", refusal.problem)[0]
            self.notes.append(f"Left out, as there is an encoder: {problem}.")
        if FRACTION in values:
            values["time"] = values["time"] + values.pop(FRACTION)
        return values

    def _leave_messages_out(self, cells: dict[str, Any]) -> None:
        """Empty the rows whose columns of numbers hold words and no digit, unless they are many, with a note."""
        columns = [column for name, column in cells.items() if name not in ("time", FRACTION)]
        digits = np.any([matches(column, r"\d") for column in columns], axis=0)
        words = np.any([matches(column, r"\pL") & ~matches(column, MISSING) for column in columns], axis=0)
        rows = np.flatnonzero(words & ~digits)
        if 0 < len(rows) < MESSAGES * len(digits):
            where, more = f"{self.table.row_word} {self.table.lines[rows[0]]}", len(rows) - 1
            text = next(text for column in columns if (text := column[int(rows[0])].as_py()))
            self.notes.append(f"Left out: {where}, {text[:40]!r}" + f", and {more} more" * bool(more) + ".")
            for name, column in cells.items():
                cells[name] = pc.if_else(pa.array(words & ~digits), _EMPTY, column)

    def _unit(self, name: str, cells: dict[str, Any]) -> str:
        """Unit of a quantity by ``--columns``, its heading, or all its cells, from which it is removed."""
        k, option, column, quantity = self.indices[name], self.named.get(name), cells[name], _QUANTITIES[name]
        written = self.table.written_unit(k)
        first = next((text for text in column[:1000].to_pylist() if not re.match(MISSING, text)), "")
        if match := _WITH_UNIT.fullmatch(first):
            pattern = rf"(\d)\s*{re.escape(match[1])}$"
            with suppress(ValueError):
                same = not written or si_factor(written, quantity) == si_factor(match[1], quantity)
                if same and (matches(column, pattern) | matches(column, MISSING)).all():
                    cells[name], written = pc.replace_substring_regex(column, pattern, r"\1"), match[1]
        usual = FRACTION_UNITS.get(normalized(self.table.heads[k]), "") if name == FRACTION else ""
        return (option.unit if option else "") or written or usual

    def _factor(self, name: str, unit: str) -> float:
        """Factor of a quantity to SI units."""
        table, quantity, k, option = self.table, _QUANTITIES[name], self.indices[name], self.named.get(name)
        column, written = f"column {table.heads[k]!r}", table.written_unit(k)
        if not unit and (name != "time" or not self.is_log):
            raise FileError(table.path, f"{column} has no unit: declare it, {table.option(k, name, 'UNIT')}")
        try:
            factor = si_factor(unit or quantity.unit, quantity)
            if option and option.factor:
                return factor * option.factor
            if written:  # a declaration does not make newtons of volts
                with suppress(UnknownUnitError):
                    si_factor(written, quantity)
        except ValueError as error:
            problem = str(error).replace("'HEAD=", f"'{table.name(k)}=")
            raise FileError(table.path, f"{column}: {problem}") from error
        if name == "air_supply" and (gas := gas_amount(unit)):
            self.notes.append(
                f"The {column} is an amount of gas, a volume at {gas[0]:g} °C and 1013 mbar, and read as m3/h;"
                f" at 20 °C it is {gas[1]:g} times as large: {table.option(k, name, f'{gas[1]:g}*{unit}')}."
            )
        return factor

    def _numbers(self, name: str, cells: Any, unit: str, sign: str) -> FloatArray:
        """Values of a column of numbers in SI units (rows,)."""
        table, k, quantity = self.table, self.indices[name], _QUANTITIES[name]
        factor, read = self._factor(name, unit), _numbers(cells, sign, name == "time")
        if self.is_log:
            suspect = name in SUSPECT and not self.options.missing
            markers = _blank_markers(read, () if name in ("time", FRACTION) else self.markers, suspect)
            if markers:
                self.notes.append(f"The column {table.heads[k]!r} has missing values, marked by {', '.join(markers)}.")
            self._blank_bad(read, k)
        if name == "time" and not table.written_unit(k) and name not in self.named:
            factor = self._factor_of_bare_time(read)
        values, (low, high, scale, unit) = read * factor, (quantity.low, quantity.high, quantity.scale, quantity.unit)
        wrong = (values < low - quantity.noise) | (values > high)
        if wrong.any():
            row, present = int(wrong.argmax()), values[~np.isnan(values)]
            limits = f"the accepted range {low / scale:g} to {high / scale:g} {unit}"
            hint = "is the unit right?"
            if name == FRACTION:
                hint = f"leave it out, {table.option(k, IGNORED)}"
            elif (present <= 0.0).all() and (-present <= high).all():
                turned = table.option(k, name, f"-{table.written_unit(k) or unit}")
                hint = f"the sign is reversed throughout: {turned}"
            raise CellError(row, f"{name} = {values[row] / scale:.6g} {unit} is outside {limits} - {hint}")
        return np.asarray(np.where(values < low, low, values))

    def _factor_of_bare_time(self, read: FloatArray) -> float:
        """Factor of numbers of time (rows,) without a unit, which are days or seconds."""
        present, head = read[~np.isnan(read)], self.table.heads[self.indices["time"]]
        days = are_serial_days(present)
        if not days and len(present) and 0.0 < np.ptp(present) < SHORTEST_STEP * (len(present) - 1):
            problem = f"without a unit, rows are less than {SHORTEST_STEP:g} s apart"
            declared = self.table.option(self.indices["time"], "time", "UNIT")
            raise CellError(0, f"{problem}: declare it, {declared} (s, min, h or d)")
        self.notes.append(f"The column {head!r} has no unit and is read as {'serial days' if days else 'seconds'}.")
        return DAY if days else 1.0

    def _blank_bad(self, values: FloatArray, k: int) -> None:
        """Set values (rows,) of bad or uncertain quality to NaN, in place, by the column of quality of a column."""
        heads, name = self.table.heads, normalized(split_head(self.table.heads[k])[0])
        for head, cells in zip(heads, self.table.columns, strict=True):
            match = _QUALITY.fullmatch(normalized(head))
            if head == heads[k] or not match or match[1] != name:
                continue
            codes = pd.to_numeric(cells.to_pandas(), errors="coerce").to_numpy(float)
            bad = matches(cells, _BAD)
            if (codes >= UNCERTAIN).any():
                bad |= codes < GOOD
            elif np.isfinite(codes).any():
                self.notes.append(f"The column {head!r} is not used: which of its codes are bad is not known.")
            if bad.any():
                values[bad] = np.nan
                self.notes.append(f"{int(bad.sum())} values of {heads[k]!r} are missing: bad by {head!r}.")

    def _times(self, cells: Any, form: str) -> FloatArray:
        """Seconds (rows,) of timestamps or clock times."""
        date = self.indices.get(DATE)
        read, notes = seconds(cells, form, None if date is None else self.table.columns[date])
        self.notes += [f"The column {self.table.heads[self.indices['time']]!r} {note}." for note in notes]
        return read


def _blank_markers(values: FloatArray, declared: Iterable[float], suspect: bool) -> list[str]:
    """Set numbers (rows,) that mark missing values to NaN, in place; the markers that were found.

    These are the declared ones, and -999.25, 9999, 32767 and the like if they lie apart: no other number reaches half
    of them, or the distance to the others is more than their range. If ``suspect``, a number that repeats and is more
    than ``FAR`` times as large as all others is a CellError.
    """
    found = [number for number in declared if (values == number).any()]
    values[np.isin(values, found)] = np.nan
    while np.isfinite(values).any():
        for number in (np.nanmin(values), np.nanmax(values)):
            at, size = values == number, np.abs(number)
            rest = values[~at & ~np.isnan(values)]
            known = (len(rest) or number < 0.0) and (_MARKER.fullmatch(f"{number:.12g}") or size >= MAX_NUMBER)
            low = (rest * np.sign(number)).max(initial=0.0) < 0.5 * size
            if known and (low or np.abs(rest - number).min() > np.ptp(rest)):
                break
            minimum = np.abs(rest[np.abs(rest) < 0.999 * size])  # without an overload of the other sign
            if suspect and 1 < at.sum() <= len(minimum) and size > FAR * minimum.max(initial=0.0) > 0.0:
                problem = f"{number:g} repeats, and no other value is larger than {minimum.max():g}"
                hint = f"if it marks an overload or a missing value, --missing={number:.9g}; else --missing=nan"
                raise CellError(int(at.argmax()), f"{problem} - {hint}")
        else:
            break
        found.append(float(number))
        values[at] = np.nan
    return [f"{number:.9g}" for number in found]


def _decimal_sign(table: Table, columns: Mapping[int, Any]) -> str:
    """Decimal sign of a file, by the first number that needs it: texts by the index of their column."""
    texts = pa.concat_arrays(columns.values())
    point, comma = (matches(texts, _number(sign)) for sign in ".,")
    if (proof := point != comma).any():
        return "." if point[proof.argmax()] else ","
    unclear = matches(texts, r"[.,]\d") & point
    if not unclear.any() or (table.separator in ("", ",") and not matches(texts, ",").any()):
        return "."  # between commas, a point is no thousands separator
    at = int(unclear.argmax())
    problem = f"{texts[at].as_py()[:40]!r} is ambiguous: decimal sign or thousands separator"
    column, row = divmod(at, len(table.lines))
    raise table.error(row, f"{problem}: give --decimal point or comma", list(columns)[column])


def _number(sign: str) -> str:
    """Pattern of numbers with a decimal sign; before it may be groups of thousands."""
    d, g, power = re.escape(sign), re.escape("," if sign == "." else "."), "(?:[eE][+-]?\\d+)?"
    groups = rf"[1-9]\d{{0,2}}(?:(?:{g}\d{{3}})+|(?:{_SPACES}\d{{3}})+)(?:{d}\d*)?"
    return rf"^[+-]?(?:{groups}|(?:\d+(?:{d}\d*)?|{d}\d+){power})$"


def _numbers(cells: Any, sign: str, is_time: bool) -> FloatArray:
    """Finite numbers (rows,) of trimmed texts, NaN where missing."""
    other = "," if sign == "." else "."
    readable, missing = matches(cells, _number(sign)), matches(cells, MISSING)
    signed = readable & matches(cells, re.escape(sign))
    if signed.any():  # then a number with groups of thousands has the sign, too
        readable &= signed | ~matches(cells, re.escape(other))
    plain = pc.replace_substring(pc.replace_substring_regex(cells, rf"^\+|{re.escape(other)}|{_SPACES}", ""), sign, ".")
    values = np.array(pc.if_else(pa.array(readable), plain, pa.scalar("nan", plain.type)).cast(pa.float64()))
    good = (readable | missing) & ~np.isinf(values)
    hint = " - correct it, or leave it empty"
    for text in cells.filter(pa.array(~good))[:1].to_pylist():
        if other in text:
            hint = f" with the decimal sign {sign!r} of the other numbers{hint}"
        if re.fullmatch(r"[+-]?\d[\d.,]*\s*[A-Za-z/]+", text):
            hint = " - a unit belongs in the heading: correct it"
        elif re.search("[A-Za-z]", text) and text.isprintable() and not is_time:
            hint += f", or if it marks a missing value, --missing={shlex.quote(text[:40])}"
    check(cells, good, f"is not a finite number{hint}")
    return values
