"""Reads logs and schedules: columns of texts become quantities in SI units.

``read_table`` gives the cells of a file, ``_Conversion`` finds the column of each quantity and converts it.
"""

import math
import re
import shlex
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from probe_agents.records.cells import ReadOptions, Table, listed, read_table
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
    days_of,
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
"""Share of the rows which may be messages of the logger."""
_DIGITS: Final = r"^[+-]?\d+(?:[.,]\d+)?$"
_WITH_UNIT: Final = re.compile(
    r"[+-]?\d[\d.,' ]*(?:[eE][+-]?\d+)?\s*([A-Za-zµμ%°][A-Za-zµμ]*[23²³]?(?:/[A-Za-z]+[23²³]?)?)"
)
"""A number and its unit in one cell."""
_SPACES: Final = "[ '’\u00a0\u2009\u202f]"
_POWER: Final = r"(?:[eE][+-]?\d+)"
_FROM, _TO = ("from", "from length", "begin", "start", "von"), ("to", "to length", "end", "bis")
"""Headings of the ends of a section of a schedule."""
T = TypeVar("T")


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
    if options.rate is not None and "time" in log.indices:
        head = table.heads[log.indices["time"]]
        raise FileError(
            path, f"the column {head!r} is the time: leave --rate out, or {table.option(log.indices['time'], IGNORED)}"
        )
    log.require(*[("time",)][: options.rate is None], ("feed_speed", "inserted_length"))
    if options.air_supply is None:
        log.require(("air_supply",))
    for name in RETURN:
        log.indices.pop(name, None)
    values = log.values()
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
        sections = [next((k for k, word in enumerate(words) if word in heads), -1) for heads in (_FROM, _TO)]
        is_sections = min(sections) >= 0 and not {"time", "inserted_length"} & set(plan.indices)
        if is_sections:
            plan.indices["inserted_length"] = sections[0]
        plan.require(("inserted_length", "time"), ("feed_speed",), ("air_supply",))
        used = ("time", DATE, FRACTION, "inserted_length", "feed_speed", "air_supply", *RETURN)
        plan.indices = {name: plan.indices[name] for name in used if name in plan.indices}
        values = plan.values()
        if is_sections:
            _check_sections(table, values["inserted_length"], sections[1])
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
            raise table.error(int(empty.argmax()), problem, plan.indices[name])
        values[name] = (column - (column[0] if name == "time" else 0.0)) / QUANTITIES[name].scale
    columns = {QUANTITIES[name].column: [float(f"{v:.12g}") for v in column] for name, column in values.items()}
    rows = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
    places = (f"{table.row_word} {line}" for line in table.lines)
    return "steps" if table.steps or is_sections else "linear", list(zip(places, rows, strict=True))


def _check_sections(table: Table, begin: FloatArray, column: int) -> None:
    """Raise FileError unless each section ends where the next one begins."""
    ends = _Conversion(table, None)
    ends.indices = {"inserted_length": column}
    apart = np.abs(ends.values()["inserted_length"][:-1] - begin[1:]) > 1e-6
    if apart.any():
        problem = "the section does not end where the next one begins: a schedule has no gaps and no overlaps"
        raise table.error(int(apart.argmax()), problem, column)


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
        marked = (*table.null, *self.options.missing)
        declared = {text: number for text in marked if (number := _plain_number(text)) is not None}
        self.markers, self.words = list(declared.values()), [text for text in marked if text not in declared]

    def _indices(self) -> dict[str, int]:
        """Index of the column of every quantity."""
        table, indices, ignored = self.table, dict[str, int](), list[int]()
        for option in self.options.named:
            found = [k for k, head in enumerate(table.heads) if head == option.head]
            found = found or [k for k, head in enumerate(table.heads) if head and option.means(head)]
            name = f"column {option.head[:60]!r}"
            if len(found) != 1:
                often = "does not exist" if not found else f"exists {len(found)} times: rename one in the file"
                raise FileError(table.path, f"{name} of --columns {often}; found: {listed(table.heads)}")
            if found[0] in {*indices.values(), *ignored}:
                raise FileError(table.path, f"{name} is named twice in --columns: a column is one quantity")
            if option.quantity == IGNORED:
                ignored.append(found[0])
            else:
                indices[option.quantity] = found[0]
        by_option = dict(indices)
        for k, head in enumerate(table.heads):
            quantity = quantity_of(head)
            if k in {*by_option.values(), *ignored} or quantity is None:
                continue
            first = indices.get(quantity, k)
            if first == k:
                indices[quantity] = k
            elif table.columns[k].equals(table.columns[first]):
                continue
            elif quantity not in by_option:
                hint = f"choose one, --columns 'HEAD={quantity}'".replace("HEAD", table.heads[first].replace("'", ""))
                hint = hint if head != table.heads[first] else "rename one in the file"
                both = f"columns {table.heads[first]!r} and {head!r} are both {quantity}"
                raise FileError(table.path, f"{both}: {hint}")
            elif quantity == "time":
                self.notes.append(
                    f"The column {head!r} is another time and is left out: if columns have this time, read them apart."
                )
        if "time" not in indices and not table.heads[0] and matches(table.columns[0][:1], MORE_THAN_NUMBER).all():
            indices["time"] = 0  # the index of a table of pandas
        return indices

    def require(self, *groups: Sequence[str]) -> None:
        """Raise FileError unless there is a column for one name of each group."""
        for names in groups:
            if not any(name in self.indices for name in names):
                heads = self.table.heads
                unknown = next((head for head in heads if head and quantity_of(head) is None), "HEAD").replace("'", "")
                hint = {
                    "time": "give the rows per second, --rate HZ, or ",
                    "air_supply": "give a constant, --air-supply M3_PER_H, or ",
                }.get(names[0], "")
                problem = f"no column for {' or '.join(names)}; found: {listed(heads)}"
                raise FileError(self.table.path, f"{problem} - {hint}name it: --columns '{unknown[:60]}={names[0]}'")

    def values(self) -> dict[str, FloatArray]:
        """Values in SI units (rows,) of the quantities; missing ones are NaN."""
        table, values = self.table, dict[str, FloatArray]()
        date, fraction = self.indices.pop(DATE, None), self.indices.pop(FRACTION, None)
        cells = {name: _without(table.columns[k], self.words) for name, k in self.indices.items()}
        self._leave_messages_out(cells)
        units = {name: self._unit(name, cells) for name in cells}
        form = self.options.time_format
        if "time" in cells:
            first = cells["time"].filter(pa.array(~matches(cells["time"], MISSING)))[:1]
            number = bool(units["time"] not in ("", "s") and matches(first, _DIGITS).any())
            self.written_out = bool(form) or (not number and bool(matches(first, MORE_THAN_NUMBER).any()))
            if not form and _HOURS.fullmatch(units["time"]) and matches(cells["time"], MINUTES).any():
                self.written_out, form = True, "%H:%M"
        numbers = [name for name in cells if not (name == "time" and self.written_out)]
        factors = dict[str, float]()
        for name in numbers:
            if (factor := self._unless_spare(name, partial(self._factor, name, units[name]))) is not None:
                factors[name] = factor
                cells[name] = pc.replace_substring_regex(cells[name], r"^([+-])\s+", r"\1")  # a sign apart
        decimal = {"auto": "", "point": ".", "comma": ","}[self.options.decimal]
        sign = decimal or _decimal_sign(table, {self.indices[name]: cells[name] for name in factors})
        for name in [name for name in cells if name in self.indices]:
            if name in factors:
                convert = partial(self._numbers, name, cells[name], sign, factors)
                if (read := self._unless_spare(name, partial(self._at, self.indices[name], convert))) is not None:
                    values[name] = read
            else:
                values[name] = self._at(self.indices["time"], partial(self._times, cells["time"], date, form))
        if fraction is not None and "time" in values:
            values["time"] = values["time"] + self._fractions(fraction, values["time"], sign)
        return values

    def _leave_messages_out(self, cells: dict[str, Any]) -> None:
        """Empty the rows whose columns of numbers hold words and no digit, unless they are many, with a note."""
        columns = [column for name, column in cells.items() if name != "time"]
        digits = np.any([matches(column, r"\d") for column in columns], axis=0)
        words = np.any([matches(column, r"\pL") & ~matches(column, MISSING) for column in columns], axis=0)
        rows = np.flatnonzero(words & ~digits)
        if 0 < len(rows) < MESSAGES * len(digits):
            where, more = f"{self.table.row_word} {self.table.lines[rows[0]]}", len(rows) - 1
            text = next(text for column in columns if (text := column[int(rows[0])].as_py()))
            self.notes.append(f"Left out: {where}, {text[:40]!r}" + f", and {more} more" * bool(more) + ".")
            for name, column in cells.items():
                cells[name] = pc.if_else(pa.array(words & ~digits), pa.scalar("", pa.large_string()), column)

    def _at(self, column: int, read: Callable[[], T]) -> T:
        """The result of a function, whose CellError gets file, row and column."""
        try:
            return read()
        except CellError as error:
            raise self.table.error(
                error.row, error.problem, column if error.column is None else error.column
            ) from error

    def _unless_spare(self, name: str, read: Callable[[], T]) -> T | None:
        """The result of a function; None, and a note, if it fails for a feed speed beside an encoder."""
        try:
            return read()
        except FileError as error:
            if name != "feed_speed" or "inserted_length" not in self.indices or name in self.named or not self.is_log:
                raise
            problem = re.split(" - |: declare", error.problem)[0]
            self.notes.append(f"Left out, as there is an encoder: {problem}.")
            del self.indices[name]
            return None

    def _unit(self, name: str, cells: dict[str, Any]) -> str:
        """Unit of a quantity by ``--columns``, its heading, or all its cells, from which it is removed."""
        option, written = self.named.get(name), self.table.written_unit(self.indices[name])
        first = next((text for text in cells[name][:1000].to_pylist() if not re.match(MISSING, text)), "")
        if (match := _WITH_UNIT.fullmatch(first)) and match[1] != "":
            unit = match[1]
            bare = pc.replace_substring_regex(cells[name], rf"\s*{re.escape(unit)}$", "")
            good = matches(cells[name], rf"\d\s*{re.escape(unit)}$") | matches(cells[name], MISSING)
            with suppress(ValueError):
                if good.all() and (
                    not written or si_factor(written, QUANTITIES[name]) == si_factor(unit, QUANTITIES[name])
                ):
                    cells[name], written = bare, unit
        return (option.unit if option else "") or written

    def _factor(self, name: str, unit: str) -> float:
        """Factor of a quantity to SI units."""
        table, quantity, k = self.table, QUANTITIES[name], self.indices[name]
        head, written, option = table.heads[k], table.written_unit(k), self.named.get(name)
        declared = f"column {head!r} has no unit: declare it, {table.option(k, name, 'UNIT')}"
        if not unit and (name != "time" or not self.is_log):
            raise FileError(table.path, declared)
        try:
            factor = si_factor(unit or quantity.unit, quantity)
            if written != unit and not (option and option.factor):  # a declaration does not make newtons of volts
                with suppress(UnknownUnitError):
                    si_factor(written or unit, quantity)
        except ValueError as error:
            problem = str(error).replace("'HEAD=", f"'{table.name(k)}=")
            raise FileError(table.path, f"column {head!r}: {problem}") from error
        if option and option.factor:
            return factor * option.factor
        if name == "air_supply" and (gas := gas_amount(unit)):
            self.notes.append(
                f"The column {head!r} is an amount of gas, a volume at {gas[0]:g} °C and 1013 mbar, and read as m3/h;"
                f" at 20 °C it is {gas[1]:g} times as large: {table.option(k, name, f'{gas[1]:g}*{unit}')}."
            )
        return factor

    def _numbers(self, name: str, cells: Any, sign: str, factors: dict[str, float]) -> FloatArray:
        """Values of a column of numbers in SI units (rows,)."""
        table, k, quantity = self.table, self.indices[name], QUANTITIES[name]
        read = np.array(_numbers(cells, sign, name == "time"))
        if self.is_log:
            known, suspect = (), name in SUSPECT and not self.options.missing
            markers = _blank_markers(read, known if name == "time" else self.markers, suspect)
            if markers:
                self.notes.append(f"The column {table.heads[k]!r} has missing values, marked by {', '.join(markers)}.")
            self._blank_bad(read, k)
        if name == "time" and not table.written_unit(k) and name not in self.named:
            self._check_time(read, k, factors)
        return self._in_range(quantity, read * factors[name], k)

    def _check_time(self, read: FloatArray, k: int, factors: dict[str, float]) -> None:
        """Take numbers of time without a unit as days or seconds, with a note, or raise CellError."""
        present, head = read[~np.isnan(read)], self.table.heads[k]
        if are_serial_days(present):
            self.notes.append(f"The column {head!r} has no unit and is read as serial days.")
            factors["time"] = DAY
        elif len(present) and 0.0 < np.ptp(present) < SHORTEST_STEP * (len(present) - 1):
            problem = f"without a unit, rows are less than {SHORTEST_STEP:g} s apart"
            raise CellError(0, f"{problem}: declare it, {self.table.option(k, 'time', 'UNIT')} (s, min, h or d)")
        else:
            self.notes.append(f"The column {head!r} has no unit and is read as seconds.")

    def _blank_bad(self, values: FloatArray, k: int) -> None:
        """Set values (rows,) of bad or uncertain quality to NaN, in place, by the column of quality of a column."""
        table, name = self.table, normalized(split_head(self.table.heads[k])[0])
        for column, head in enumerate(table.heads):
            match = _QUALITY.fullmatch(normalized(head))
            if column == k or not match or match[1] != name:
                continue
            cells, codes = table.columns[column], np.full(len(values), np.nan)
            digits = matches(cells, r"^\d+$")
            codes[digits] = np.asarray(cells.filter(pa.array(digits)).cast(pa.float64()))
            bad = matches(cells, _BAD)
            if (codes >= UNCERTAIN).any():
                bad |= codes < GOOD
            elif digits.any():
                self.notes.append(f"The column {head!r} is not used: which of its codes are bad is not known.")
            if bad.any():
                values[bad] = np.nan
                self.notes.append(f"{int(bad.sum())} values of {table.heads[k]!r} are missing: bad by {head!r}.")

    def _times(self, cells: Any, date: int | None, form: str) -> FloatArray:
        """Seconds (rows,) of timestamps or clock times."""
        try:
            days = None if date is None else days_of(self.table.columns[date], cells, form)
        except CellError as error:
            raise CellError(error.row, error.problem, date) from None
        read, notes = seconds(cells, form, days)
        head = self.table.heads[self.indices["time"]]
        self.notes += [f"The column {head!r} {note}." for note in notes]
        return read

    def _fractions(self, k: int, time: FloatArray, sign: str) -> FloatArray:
        """Fractions of a second (rows,) from column ``k``; 0 if the times have their own or are no seconds."""
        table, head, option = self.table, self.table.heads[k], self.named.get(FRACTION)
        if (time[~np.isnan(time)] % 1.0).any():
            return np.zeros(len(time))
        unit = (option.unit if option else "") or table.written_unit(k) or FRACTION_UNITS.get(normalized(head), "")
        if not unit:
            raise FileError(table.path, f"column {head!r} has no unit: declare it, {table.option(k, FRACTION, 'ms')}")

        def read() -> FloatArray:
            fractions = _numbers(table.columns[k], sign) * si_factor(unit, QUANTITIES["time"])
            problem = f"is not a fraction of a second, 0 to less than 1 s: leave it out, {table.option(k, IGNORED)}"
            check(table.columns[k], ~((fractions < 0.0) | (fractions >= 1.0)), problem)
            return fractions

        return self._at(k, read)

    def _in_range(self, quantity: Quantity, values: FloatArray, k: int) -> FloatArray:
        low, high, unit = quantity.low, quantity.high, quantity.unit
        wrong = (values < low - quantity.noise) | (values > high)
        if wrong.any():
            present = values[~np.isnan(values)]
            row = int(wrong.argmax())
            value, minimum, maximum = (number / quantity.scale for number in (values[row], low, high))
            problem = (
                f"{quantity.name} = {value:.6g} {unit} is outside the accepted range {minimum:g} to {maximum:g} {unit}"
            )
            hint = "is the unit right?"
            if (present <= 0.0).all() and (-present <= high).all():
                written = self.table.written_unit(k) or unit
                hint = f"the sign is reversed throughout: {self.table.option(k, quantity.name, f'-{written}')}"
            raise CellError(row, f"{problem} - {hint}")
        return np.asarray(np.where(values < low, low, values))


def _without(cells: Any, words: Sequence[str]) -> Any:
    """Texts (rows,), empty where they are one of ``words``."""
    empty = pa.scalar("", pa.large_string())
    return pc.if_else(pc.is_in(cells, pa.array(words, pa.large_string())), empty, cells) if words else cells


def _blank_markers(values: FloatArray, declared: Sequence[float], suspect: bool) -> list[str]:
    """Set numbers (rows,) that mark missing values to NaN, in place.

    These are the declared ones, and -999.25, 9999, 32767 and the like if they lie apart: no other number reaches half
    of them, or the distance to the others is more than their range.

    Args:
        values: numbers of a column.
        declared: markers.
        suspect: refuse a number that repeats and is more than ``FAR`` times as large as all others.

    Returns:
        the markers that were found.
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
    """Decimal sign of a file from all its numbers: texts by the index of their column."""
    proofs = {sign: _first(columns, _proof(sign)) for sign in ".,"}
    if proofs["."] and proofs[","]:
        row, k = max(proofs["."], proofs[","])
        problem = f"{columns[k][row].as_py()[:40]!r} has another decimal sign than the numbers before it"
        raise table.error(row, f"{problem}: use only one", k)
    for sign, proof in proofs.items():
        if proof:
            return sign
    if table.separator in ("", ",") and not _first(columns, ","):  # then a point is no thousands separator
        return "."
    if unclear := _first(columns, r"[.,]\d"):
        row, k = unclear
        problem = f"{columns[k][row].as_py()[:40]!r} is ambiguous: decimal sign or thousands separator"
        raise table.error(row, f"{problem}: give --decimal point or comma", k)
    return "."


def _proof(sign: str) -> str:
    """Pattern of numbers that are only possible with this decimal sign."""
    g = re.escape("," if sign == "." else ".")
    d = re.escape(sign)
    return (
        rf"^[+-]?(?:\d{{1,3}}(?:{g}\d{{3}})+{d}\d*"  # thousands and a decimal sign
        rf"|\d{{1,3}}(?:{g}\d{{3}}){{2,}}"  # groups of thousands
        rf"|\d*{d}(?:\d{{0,2}}|\d{{4,}}){_POWER}?"  # not three digits after it
        rf"|(?:0\d*|\d{{4,}}|){d}\d*{_POWER}?"  # nor one to three before it, as a group has
        rf"|\d+{d}\d*{_POWER})$"
    )


def _first(columns: Mapping[int, Any], pattern: str) -> tuple[int, int] | None:
    """Row and column of the first text with a pattern, row by row."""
    for begin, count in ((0, 1000), (1000, None)):  # in most files one of the first rows matches
        found = [
            (begin + int(m.argmax()), k)
            for k, c in columns.items()
            if (m := matches(c.slice(begin, count), pattern)).any()
        ]
        if found:
            return min(found)
    return None


def _plain_number(text: str) -> float | None:
    with suppress(ValueError):
        return number if math.isfinite(number := float(text.replace(",", "."))) else None
    return None


def _numbers(cells: Any, sign: str, is_time: bool = False) -> FloatArray:
    """Finite numbers (rows,) of trimmed texts, NaN where missing."""
    other = "," if sign == "." else "."
    if sign == "." or not matches(cells, r"\.").any():
        with suppress(pa.ArrowInvalid):  # fast path for plain numbers
            values = np.asarray(pc.replace_substring(cells, sign, ".").cast(pa.float64()), dtype=float)
            if np.isfinite(values).all():
                return values
    missing = matches(cells, MISSING)
    d, g = re.escape(sign), re.escape(other)
    whole = rf"\d+|\d{{1,3}}(?:{g}\d{{3}})+|\d{{1,3}}(?:{_SPACES}\d{{3}})+"
    shape = rf"^[+-]?(?:(?:{whole})(?:{d}\d*)?|{d}\d+){_POWER}?$"
    readable = matches(cells, shape) & ~missing
    if (signed := matches(cells, d) & readable).any():  # then a number with groups of thousands has it, too
        unlike = f"has {other!r}, and other numbers of the column have the decimal sign {sign!r} - correct it"
        check(cells, ~(matches(cells, g) & readable & ~signed), unlike)
    point = pc.replace_substring(pc.replace_substring_regex(cells, rf"^\+|{g}|{_SPACES}", ""), sign, ".")
    values = np.asarray(pc.if_else(pa.array(readable), point, pa.scalar("nan", pa.large_string())).cast(pa.float64()))
    hint = " - correct it, or leave it empty"
    good = (readable | missing) & ~np.isinf(values)
    if not good.all() and other in cells[int((~good).argmax())].as_py():
        hint = f" with the decimal sign {sign!r} of the other numbers{hint}"
    word = next((text for text in cells.filter(pa.array(~good))[:1].to_pylist() if re.search("[A-Za-z]", text)), "")
    if re.fullmatch(r"[+-]?\d[\d.,]*\s*[A-Za-z/]+", word):
        hint = " - a unit belongs in the heading: correct it"
    elif word and word.isprintable() and not is_time:
        hint += f", or if it marks a missing value, --missing={shlex.quote(word[:40])}"
    check(cells, good, f"is not a finite number{hint}")
    return values
