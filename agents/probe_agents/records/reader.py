"""Reads logs and schedules: text with any separator and encoding, or an Excel sheet, as columns in SI units.

``_decoded`` or ``sheet_lines`` give lines, ``_table_of`` splits them, ``_convert`` converts the columns.
"""

import codecs
import csv
import math
import re
import shlex
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from probe_agents.records.quantities import (
    DATE,
    FRACTION,
    FRACTION_UNITS,
    IGNORED,
    MEASURED,
    NAMES,
    QUANTITIES,
    RETURN,
    ColumnOption,
    Quantity,
    UnknownUnitError,
    looks_like_unit,
    normalized,
    quantity_of,
    si_factor,
    split_head,
)
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
from probe_agents.records.workbook import MAX_COLUMNS, OLD_EXCEL, ZIP, sheet_lines
from probe_env.arrays import FloatArray
from probe_env.files import MEBI, FileError, open_regular, read_bytes
from probe_env.schedule import (
    AIR,
    CSV_COMMENT,
    FEED,
    POSITIONS,
    Row,
    Schedule,
    schedule_of_rows,
    schedule_rows,
    withdrawal_of_rows,
)

IntArray = npt.NDArray[np.integer]
MAX_BYTES: Final = 256 * MEBI
MAX_ROWS: Final = 5_000_000
HEAD_WITHIN: Final = 200
"""Number of non-empty lines within which the header must be."""
HEADS_SHOWN: Final = 12
_OPEN_QUOTE: Final = re.compile(r'(?:^|[;,\t|])\s*"[^"]*$')
MAX_WRAPPED: Final = 5
"""Line breaks within the quotes of a cell."""

SEPARATORS: Final = {";": "';'", "\t": "tabs", "|": "'|'", ",": "','", " ": "spaces"}
_CONTROL: Final = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f]")
_COMMENT: Final = r"^\s*[#%!]|^[\s|:;,+=-]*$"
"""Comments, empty lines, also of separators, and lines of dashes between header and rows."""
_TOO_NARROW: Final = r"^\s*#{2,}\s*[;,\t|]"
"""A cell of ####, as Excel writes a time in a narrow column."""
_SPACED_TIME: Final = (
    r"(\d{1,4}[-/.]\w{1,3}[-/.]\d{1,4})[ \t]+(\d{1,2}:\d\d)", r"\1T\2"
), (r"(?i)(:\d\d(?:[.,]\d+)?)[ \t]+([ap]\.?m)\b", r"\1\2")  # fmt: skip
"""Date and clock, and clock and AM, which belong together in a file of spaces."""
_END_PIPES: Final = r"^\s*\||\|\s*$"
_NUMBER_OR_TIME: Final = re.compile(r"[+-]?[\d.,'  ]*\d[\d.,'  ]*(?:[eE][+-]?\d+)?|\d[\d:.,TZ +-]*:[\d:.,TZ +-]*")
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
_SPACES: Final = "[ '’\u00a0\u2009\u202f]"
_POWER: Final = r"(?:[eE][+-]?\d+)"


@dataclass(frozen=True)
class Table:
    """Cells of a file as texts."""

    path: Path
    heads: tuple[str, ...]
    units: tuple[str, ...]  # from the row below the headings; empty texts without such a row
    columns: tuple[Any, ...]  # arrow arrays of trimmed texts (rows,)
    lines: IntArray  # (rows,) line number, or row number of a sheet
    row_word: str  # word for a row in errors: line or row
    separator: str
    steps: bool  # whether values are constant until the next row
    null: tuple[str, ...] = ()  # what marks missing values by a LAS header
    notes: tuple[str, ...] = ()  # repairs of the file

    def error(self, row: int, problem: str, column: int | None = None) -> FileError:
        """An error at a row and column."""
        position = f", column {self.heads[column]!r}" if column is not None else ""
        return FileError(self.path, f"{self.row_word} {self.lines[row]}{position}: {problem}")

    def error_between(self, first: int, last: int, problem: str) -> FileError:
        """An error from one row to another."""
        return FileError(self.path, f"{self.row_word}s {self.lines[first]} to {self.lines[last]}: {problem}")


@dataclass(frozen=True)
class Channels:
    """A recorded log in SI units; missing values are NaN."""

    table: Table
    time: FloatArray  # (rows,) seconds from any origin
    values: Mapping[str, FloatArray]  # quantity -> (rows,)
    indices: Mapping[str, int]  # quantity -> index of its column
    notes: tuple[str, ...] = ()  # what was taken as missing or as days, or left out
    written_out: bool = False  # whether times are clock times or timestamps, not numbers


class Converted(NamedTuple):
    """Columns in SI units."""

    values: dict[str, FloatArray]  # quantity -> (rows,)
    notes: tuple[str, ...]
    written_out: bool


def read_channels(
    path: Path,
    sheet: str | None,
    options: Sequence[ColumnOption],
    decimal: str,
    air: float | None,
    missing: Sequence[str] = (),
    time_format: str = "",
) -> Channels:
    """Read the quantities of a log from a text file or from a sheet of a workbook.

    Args:
        path: file.
        sheet: sheet of a workbook; None: the first.
        options: quantities of unknown headings.
        decimal: "." or ","; empty: detected.
        air: air of a log without that column [m3/s].
        missing: texts and numbers that mark missing values, in addition to NaN, -999.25 and the like.
        time_format: form of the times for ``strptime``, with the date of another column and a space before it; empty:
            detected.

    Raises:
        FileNotFoundError: no such file.
        FileError: not a text or workbook; no such sheet; no header or rows; a column that is missing, occurs twice or
            has no unit; a cell that is not a number or time, or out of range; too large.
        ValueError: ``time_format`` is not a form.
        ModuleNotFoundError: openpyxl or pint is not installed.
    """
    table = _read_table(path, sheet, options)
    indices, units = _indices(table, options)
    _require(table, indices, (("time",), ("feed_speed", "inserted_length"), ("air_supply",)[: air is None]))
    for name in RETURN:
        indices.pop(name, None)
    values, notes, written_out = _convert(table, indices, units, decimal, missing, time_format)
    if "air_supply" not in values and air is not None:
        values["air_supply"] = np.full(len(table.lines), air)
    return Channels(table, values.pop("time"), values, indices, notes, written_out)


def read_schedule(path: str | Path) -> Schedule:
    """Read a schedule; it may have the headings, units, separators and the workbook that a log may have.

    Raises:
        ModuleNotFoundError: openpyxl or pint is not installed.
    """
    return schedule_of_rows(Path(path), *_schedule_rows(Path(path)))


def read_withdrawal(path: str | Path) -> Schedule | None:
    """Read the withdrawal of a schedule; None if the file has none. Raises as ``read_schedule``."""
    return withdrawal_of_rows(Path(path), *_schedule_rows(Path(path)))


def _schedule_rows(path: Path) -> tuple[str, Sequence[Row]]:
    """Interpolation and rows of a schedule; heads, separators and units may differ from those of ``Schedule.read``."""
    if path.suffix == ".toml" or _has_schedule_columns(path):
        return schedule_rows(path)
    try:
        table = _read_table(path, None, ())
        indices, _ = _indices(table, ())
        _require(table, indices, (("inserted_length", "time"), ("feed_speed",), ("air_supply",)))
        used = ("time", DATE, FRACTION, "inserted_length", "feed_speed", "air_supply", *RETURN)
        indices = {name: indices[name] for name in used if name in indices}
        values = _convert(table, indices, {}, "", None).values
    except FileError as error:
        if "--" not in error.problem:  # an option of other commands
            raise
        problem = re.sub(r"(?:,|:|;| -) (?:or )?[^,:;-]*?[,:]? ?--.*", "", error.problem)
        hint = " - correct the file: a schedule has heads like 'length [m]', 'feed [m/s]' and 'air [m3/h]'"
        raise FileError(path, problem + hint * (" - " not in problem)) from error
    for name, column in values.items():
        if (empty := np.isnan(column)).any():
            raise table.error(int(empty.argmax()), "no value", indices[name])
        values[name] = (column - (column[0] if name == "time" else 0.0)) / QUANTITIES[name].scale
    columns = {QUANTITIES[name].column: [float(f"{v:.12g}") for v in column] for name, column in values.items()}
    rows = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
    places = (f"{table.row_word} {line}" for line in table.lines)
    return "steps" if table.steps else "linear", list(zip(places, rows, strict=True))


def _has_schedule_columns(path: Path) -> bool:
    """Whether the header of a file has the columns of ``Schedule.read``, separated by commas."""
    with open_regular(path, MAX_BYTES) as file:
        lines = file.read(1 << 16).decode("utf-8-sig", "replace").splitlines()
    header = next((line for line in lines if line.strip(" ,") and not line.startswith("#")), "")
    names = {name.strip() for name in header.split(",")}
    return {FEED, AIR} <= names and not names.isdisjoint(POSITIONS)


def _require(table: Table, indices: Mapping[str, int], groups: Iterable[Sequence[str]]) -> None:
    """Raise FileError unless there is a column for one name of each group."""
    for names in groups:
        if names and not any(name in indices for name in names):
            hint = "; or give a constant, --air-supply M3_PER_H" if names == ("air_supply",) else ""
            problem = f"no column for {' or '.join(names)}; found: {_listed(table.heads)}"
            raise FileError(table.path, f"{problem} - name it: --columns 'HEAD={names[0]}'{hint}")


def _convert(
    table: Table,
    indices: dict[str, int],
    units: Mapping[str, str],
    decimal: str,
    missing: Sequence[str] | None,
    time_format: str = "",
) -> Converted:
    """Convert the columns at ``indices`` to SI units; arguments as ``read_channels``, ``missing`` None: no markers."""
    date, fraction = indices.pop(DATE, None), indices.pop(FRACTION, None)
    marked = (*table.null, *(missing or ()))
    declared = {text: number for text in marked if (number := _plain_number(text)) is not None}
    words = [text for text in marked if text not in declared]
    notes = list(table.notes)
    spare = missing is not None and {"feed_speed", "inserted_length"} <= set(indices) and "feed_speed" not in units
    if spare:
        try:
            _factor(table, QUANTITIES["feed_speed"], indices["feed_speed"], units)
        except FileError as error:
            notes.append(_left_out(error))
            del indices["feed_speed"]
    cells, column = {name: _without(table.columns[k], words) for name, k in indices.items()}, date
    values: dict[str, FloatArray] = {}
    days, written_out = None, False
    try:
        if "time" in indices:
            unit = units.get("time") or _written_unit(table, indices["time"])
            if not time_format and _HOURS.fullmatch(unit) and matches(cells["time"], MINUTES).any():
                time_format = "%H:%M"
            if date is not None:
                days = days_of(table.columns[date], cells["time"], time_format)
            first = cells["time"].filter(pa.array(~matches(cells["time"], MISSING)))[:1]
            written_out = bool(time_format) or bool(matches(first, MORE_THAN_NUMBER).any())
        numbers = {name: k for name, k in indices.items() if not (written_out and name == "time")}
        factors = {name: _factor(table, QUANTITIES[name], k, units) for name, k in numbers.items()}
        for name in numbers:
            cells[name] = pc.replace_substring_regex(cells[name], r"^([+-])\s+", r"\1")  # a sign apart
        sign = decimal or _decimal_sign(table, {k: cells[name] for name, k in numbers.items()})
        for name, column in list(indices.items()):
            head = table.heads[column]
            if name not in factors:
                values[name] = seconds(cells[name], time_format, days)
                if not time_format and matches(first, MINUTES).any():
                    notes.append(f"The column {head!r} is read as mm:ss; for hh:mm, --time-format %H:%M.")
                continue
            try:
                read = np.array(_numbers(cells[name], sign))
            except CellError as error:
                if not spare or name != "feed_speed":
                    raise
                notes.append(_left_out(table.error(error.row, error.problem, column)))
                del indices[name]
                continue
            known = () if name == "time" else [*declared.values()]
            markers = [] if missing is None else _blank_markers(read, known, name in SUSPECT and not missing)
            if markers:
                notes.append(f"The column {head!r} has missing values, marked by {', '.join(markers)}.")
            if name == "time" and not (units.get(name) or _written_unit(table, column)):
                present = read[~np.isnan(read)]
                if are_serial_days(present):
                    notes.append(f"The column {head!r} has no unit and is read as serial days.")
                    factors[name] = DAY
                elif len(present) and 0.0 < np.ptp(present) < SHORTEST_STEP * (len(present) - 1):
                    problem = f"without a unit, rows are less than {SHORTEST_STEP:g} s apart"
                    raise CellError(
                        0, f"{problem}: declare it, --columns '{normalized(head)}=time[UNIT]' (s, min, h or d)"
                    )
                elif missing is None:
                    hint = f"declare it, --columns '{normalized(head)}=time[UNIT]'"
                    raise FileError(table.path, f"column {head!r} has no unit: {hint}")
                else:
                    notes.append(f"The column {head!r} has no unit and is read as seconds.")
            values[name] = _in_range(QUANTITIES[name], read * factors[name])
        if fraction is not None and "time" in values:
            column = fraction
            values["time"] = values["time"] + _fractions(table, fraction, values["time"], units, sign)
    except CellError as error:
        raise table.error(error.row, error.problem, column) from None
    return Converted(values, tuple(notes), written_out)


def _left_out(error: FileError) -> str:
    """Note about a feed speed that is not needed."""
    return f"Left out, as there is an encoder: {re.split(' - |: declare', error.problem)[0]}."


def _fractions(table: Table, k: int, time: FloatArray, units: Mapping[str, str], sign: str) -> FloatArray:
    """Fractions of a second (rows,) from column ``k``; 0 if the times have their own or are no seconds."""
    if (time[~np.isnan(time)] % 1.0).any():
        return np.zeros(len(time))
    head = table.heads[k]
    unit = units.get(FRACTION) or _written_unit(table, k) or FRACTION_UNITS.get(normalized(head), "")
    if not unit:
        raise FileError(
            table.path, f"column {head!r} has no unit: declare it, --columns '{normalized(head)}=fraction[ms]'"
        )
    fractions = _numbers(table.columns[k], sign) * si_factor(unit, QUANTITIES["time"])
    problem = (
        f"is not a fraction of a second, 0 to less than 1 s: leave it out, --columns '{normalized(head)}={IGNORED}'"
    )
    check(table.columns[k], ~((fractions < 0.0) | (fractions >= 1.0)), problem)
    return fractions


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


def _read_table(path: Path, sheet: str | None, options: Sequence[ColumnOption]) -> Table:
    content = read_bytes(path, MAX_BYTES)
    if content.startswith(OLD_EXCEL):
        raise FileError(path, "a workbook of Excel before 2007: save it as .xlsx or as CSV")
    if content.startswith(ZIP):
        return _table_of(path, sheet_lines(path, content, sheet), options, "row")
    if sheet is not None:
        raise FileError(path, f"not a workbook, so it has no sheet {sheet[:80]!r}: leave --sheet out")
    filled = content.rstrip(b"\0")
    cut = len(content) - len(filled) if b"\0" not in filled else 0  # else UTF-16 or not a text
    lines, null = _unwrapped(_decoded(path, content[: len(content) - cut]).split("\n")), tuple[str, ...]()
    if lines[0].upper().startswith("~V"):
        lines, null = _las_lines(path, lines)
    table = _table_of(path, lines, options, "line")
    notes = (f"{cut} NUL bytes behind the last line, as of a power cut, were cut off.",) if cut else ()
    return replace(table, null=null, notes=notes)


def _unwrapped(lines: list[str]) -> list[str]:
    """Lines in which those of a quoted cell with line breaks are joined, and the others empty."""
    for k in [k for k, line in enumerate(lines) if '"' in line and _OPEN_QUOTE.search(line)]:
        ends = [j for j, line in enumerate(lines[k + 1 : k + 1 + MAX_WRAPPED], k + 1) if line.count('"') % 2]
        if ends and lines[k].count('"') % 2:
            lines[k : ends[0] + 1] = [" ".join(lines[k : ends[0] + 1]), *[""] * (ends[0] - k)]
    return lines


def _las_lines(path: Path, lines: Sequence[str]) -> tuple[list[str], tuple[str, ...]]:
    """Lines of a LAS 2.0 file (a log of a well) with its curves as heads and the other sections empty; its NULL."""
    section, heads, null = "", list[str](), tuple[str, ...]()
    for k, line in enumerate(lines):
        if line.startswith("~"):
            section = line[1:2].upper()
            if section == "A" and heads:
                rows = list(lines[k + 1 :])
                return [*[""] * k, ("," if rows and "," in rows[0] else " ").join(heads), *rows], null
        elif entry := re.match(r"\s*([^\s#.][^.]*?)\s*\.(\S*)\s*(.*?)\s*:", line):
            name, unit, value = entry.groups()
            if section == "C":
                heads.append(name.replace(" ", "_") + f"[{unit}]" * bool(unit))
            elif name.upper() == "NULL":
                null = (value,)
            elif name.upper() == "WRAP" and value.upper() == "YES":
                raise FileError(path, f"line {k + 1}: a LAS file with wrapped rows: export it without WRAP, or as CSV")
    raise FileError(path, "a LAS file without the sections ~Curve and ~ASCII: export it again, or as CSV")


def _decoded(path: Path, content: bytes) -> str:
    """Decode a file: UTF-8, UTF-16, else Windows Western European."""
    begin = content[:1000]
    names = ["utf-8-sig", "cp1252"]
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        names = ["utf-16"]
    elif len(begin) > 3:
        names = [f"utf-16-{e}" for e, k in (("le", 1), ("be", 0)) if begin[k::2].count(0) > 0.4 * len(begin)] or names
    for name in names:
        try:
            text = content.decode(name)
            break
        except UnicodeDecodeError as error:
            line, byte = content.count(b"\n", 0, error.start) + 1, content[error.start]
    else:
        raise FileError(path, f"line {line}: not a text file (byte 0x{byte:02x}): export it as text in UTF-8")
    text = text.rstrip("\x1a").replace("\r\n", "\n").replace("\r", "\n")  # end of file in DOS: Ctrl-Z
    text = text.replace("\u2212", "-").replace("\u2013", "-")
    if control := _CONTROL.search(text):
        line = text.count("\n", 0, control.start()) + 1
        problem = f"not a text file: a control character (0x{ord(control[0]):02x})"
        raise FileError(path, f"line {line}: {problem} - export it as text")
    return text


def _table_of(path: Path, lines: list[str], options: Sequence[ColumnOption], word: str) -> Table:
    """Make a table of lines of text, or of rows of a sheet with cells separated by tabs."""
    text = word == "line"
    if len(lines) > MAX_ROWS:
        raise FileError(path, f"{len(lines)} {word}s are more than the {MAX_ROWS} accepted in a log: cut it")
    filled = [k for k, line in enumerate(lines[: 10 * HEAD_WITHIN]) if line.strip()][:HEAD_WITHIN]
    if not any(map(str.strip, lines)):
        raise FileError(
            path, "empty: a header and rows of numbers are needed" + ("" if text else "; --sheet names another")
        )
    separators = tuple(SEPARATORS) if text else ("\t",)
    candidates = [
        (k + 1, separator, _split(_uncommented(lines[k])[: 100 * MAX_COLUMNS], separator))
        for k in filled
        for separator in separators
        if separator != " " or max(map(lines[k].count, ";|,")) < 2  # a file of commas is not one of spaces
    ]
    best = max(candidates, key=lambda candidate: _named(candidate[2], options), default=None)
    if best is None or _named(best[2], options) < 2:
        several = [(k, cells) for k, separator, cells in candidates if len(cells) > text and separator != " "]
        several = several or [(k, cells) for k, _, cells in candidates if len(cells) > text][:1] or [(1, [])]
        number, found = max(several, key=lambda row: sum(map(bool, row[1])))
        problem = f"no header with two known quantities; found: {_listed(found) or 'none'}"
        hint = f"declare them: --columns 'HEAD=QUANTITY', with QUANTITY one of {', '.join(NAMES)}"
        if found and all(not cell or _NUMBER_OR_TIME.fullmatch(cell) for cell in found):
            hint = "is the header missing? Write one above the rows, like 'time [s]', 'length [m]', 'air [m3/h]'"
        raise FileError(path, f"{word} {number}: {problem} - {hint}")
    head, separator, _ = best
    heads = _split(_uncommented(lines[head - 1]), separator)
    if len(heads) > MAX_COLUMNS:
        raise FileError(path, f"{word} {head}: {len(heads)} columns are more than {MAX_COLUMNS}")
    remarks = (line for line in lines[: head - 1] if line.startswith(CSV_COMMENT))
    steps = any(line.partition(":")[2].strip() == "steps" for line in remarks)
    body = lines[head:]
    if not text:  # cells at the end of a row may be empty
        body = [line + "\t" * (len(heads) - 1 - line.count("\t")) for line in body]
    rows = pa.array(body, pa.large_string())
    labels = next((line for line in lines[:head] if line.startswith("Y_Unit_Label")), "")  # of LabVIEW
    skipped = matches(rows, _COMMENT if text else r"^\s*$") & ~matches(rows, _TOO_NARROW)
    numbers = np.flatnonzero(~skipped) + head + 1
    below = _split(lines[numbers[0] - 1], separator) if len(numbers) else []
    filled_below = [cell for cell in below if cell]
    units = [*["", *_split(labels, separator)[1:]][: len(heads)], *[""] * len(heads)][: len(heads)]
    if filled_below and all(looks_like_unit(cell) and not _NUMBER_OR_TIME.fullmatch(cell) for cell in filled_below):
        units = [*(cell.strip("[]() ") for cell in below), *units][: len(heads)]
        numbers = numbers[1:]
        third = [cell for cell in _split(lines[numbers[0] - 1], separator) if cell] if len(numbers) else []
        if third and not any(re.search(r"^[\d+.,-]|\d:\d", cell) or re.match(MISSING, cell) for cell in third):
            numbers = numbers[1:]  # names of objects, or "Smp" and "Avg"
    if not len(numbers):
        raise FileError(path, f"{word} {head}: a header without rows below it: at least two are needed")
    columns = _columns(path, rows.take(pa.array(numbers - head - 1)), numbers, separator, heads, word)
    return Table(path, tuple(heads), tuple(units), columns, numbers, word, separator if text else "", steps)


def _named(cells: Sequence[str], options: Sequence[ColumnOption]) -> int:
    """Number of quantities that a row names."""
    named = {option.quantity for cell in cells if cell for option in options if option.means(cell)}
    return len(named | {name for cell in cells if (name := quantity_of(cell))})


def _listed(heads: Sequence[str]) -> str:
    """The first headings, for an error."""
    return ", ".join(repr(head[:60]) for head in heads[:HEADS_SHOWN]) + (" ..." if len(heads) > HEADS_SHOWN else "")


def _uncommented(line: str) -> str:
    return re.sub(r"^\s*[#%!]", "", line)


def _split(line: str, separator: str) -> list[str]:
    """Cells of a header or a row of units."""
    if separator == " ":
        for pattern, joined in _SPACED_TIME:
            line = re.sub(pattern, joined, line)
        return re.split(r"\s+(?![\[(])", line.strip())  # a unit belongs to its word
    if separator == "|":
        line = re.sub(_END_PIPES, "", line)
    cells = line.split(separator)
    if '"' in line:
        with suppress(csv.Error):
            cells = next(csv.reader([line], delimiter=separator, skipinitialspace=True))
    return [cell.strip() for cell in cells]


def _columns(
    path: Path, lines: Any, numbers: IntArray, separator: str, heads: Sequence[str], word: str
) -> tuple[Any, ...]:
    """Trimmed texts (rows,) of every column; empty below last heads that no row fills."""
    count = len(heads)
    if word == "line" and pc.any(pc.match_substring(lines, '"')).as_py():
        cells = pa.array(_quoted_rows(path, lines.to_pylist(), numbers, separator, count), pa.list_(pa.large_string()))
    elif separator == " ":
        for pattern, joined in _SPACED_TIME[any(quantity_of(head) == DATE for head in heads) :]:
            lines = pc.replace_substring_regex(lines, pattern, joined)
        cells = pc.utf8_split_whitespace(pc.utf8_trim_whitespace(lines))
    else:
        if separator == "|":
            lines = pc.replace_substring_regex(lines, _END_PIPES, "")
        end = re.escape(separator) + r"[ ]*$"
        counts = np.asarray(pc.count_substring(lines, separator))
        # LabVIEW writes a comment in some rows only; behind commas, decimal commas would look like one
        if heads[-1].casefold() == "comment" and separator != "," and (counts == count - 2).any():
            lines = pc.if_else(pa.array(counts == count - 2), pc.replace_substring_regex(lines, "$", separator), lines)
        closed = counts == count  # a separator after the last cell
        if (closed & matches(lines, end)).any():
            lines = pc.if_else(pa.array(closed), pc.replace_substring_regex(lines, end, ""), lines)
        cells = pc.split_pattern(lines, separator)
    lengths = np.asarray(pc.list_value_length(cells))
    filled = count
    if (lengths == lengths[0]).all() and not any(map(quantity_of, heads[lengths[0] :])):
        filled = min(count, int(lengths[0]))
    wrong = np.flatnonzero(lengths != filled)
    if len(wrong):
        k = int(wrong[0])
        hint = f"correct that {word} or delete it"
        if k == len(lengths) - 1 and lengths[k] < count:
            hint = "the file ends within it: delete that line"
        if len(wrong) == len(lengths) > 1 and lengths[k] < count:
            hint = "the header has more names than the rows have values: correct it"
        elif separator == "," and len(wrong) == len(lengths) and lengths[k] > count:
            hint = "decimal commas and separating commas are ambiguous: export it with semicolons"
        values = f"{lengths[k]} values for {count} columns" + f", separated by {SEPARATORS[separator]}" * (
            word == "line"
        )
        raise FileError(path, f"{word} {numbers[k]}: {values} - {hint}")
    flat = pc.utf8_trim(pc.list_flatten(cells), " \t\u00a0\u2009\u202f\ufeff")
    empty = pa.array([""], pa.large_string()).take(pa.array(np.zeros(len(lengths), dtype=int)))
    columns = (flat.take(pa.array(np.arange(k, len(flat), filled))) for k in range(filled))
    return (*columns, *[empty] * (count - filled))


def _quoted_rows(path: Path, lines: list[str], numbers: IntArray, separator: str, count: int) -> list[list[str]]:
    reader = csv.reader(lines, delimiter=separator, strict=True, skipinitialspace=True)
    rows: list[list[str]] = []
    try:
        for row in reader:
            rows.append(row[:-1] if len(row) == count + 1 and not row[-1].strip() else row)
            if reader.line_num != len(rows):
                raise FileError(path, f"line {numbers[len(rows) - 1]}: a quote is not closed")
    except csv.Error as error:
        raise FileError(path, f"line {numbers[len(rows)]}: not CSV: {error}") from error
    return rows


def _indices(table: Table, options: Sequence[ColumnOption]) -> tuple[dict[str, int], dict[str, str]]:
    """Index of the column of every quantity, and units from ``--columns``."""
    indices: dict[str, int] = {}
    ignored: list[int] = []
    for option in options:
        found = [k for k, head in enumerate(table.heads) if head == option.head]
        found = found or [k for k, head in enumerate(table.heads) if head and option.means(head)]
        name = f"column {option.head[:60]!r}"
        if len(found) != 1:
            often = "does not exist" if not found else f"exists {len(found)} times: rename one in the file"
            raise FileError(table.path, f"{name} of --columns {often}; found: {_listed(table.heads)}")
        if found[0] in {*indices.values(), *ignored}:
            raise FileError(table.path, f"{name} is named twice in --columns: a column is one quantity")
        if option.quantity == IGNORED:
            ignored.append(found[0])
        else:
            indices[option.quantity] = found[0]
    by_option = dict(indices)
    for k, head in enumerate(table.heads):
        quantity = quantity_of(head)
        if k in {*by_option.values(), *ignored} or quantity is None or quantity in by_option:
            continue
        if quantity in indices:
            first = indices[quantity]
            if table.columns[k].equals(table.columns[first]):
                continue
            hint = (
                f"choose one, --columns 'HEAD={quantity}'" if head != table.heads[first] else "rename one in the file"
            )
            both = f"columns {table.heads[first]!r} and {head!r} are both {quantity}"
            raise FileError(table.path, f"{both}: {hint}")
        indices[quantity] = k
    if "time" not in indices and not table.heads[0] and matches(table.columns[0][:1], MORE_THAN_NUMBER).all():
        indices["time"] = 0  # the index of a table of pandas
    return indices, {option.quantity: option.unit for option in options if option.unit}


def _written_unit(table: Table, k: int) -> str:
    """Unit of a column by its heading or the row below; empty without."""
    return split_head(table.heads[k])[1] or table.units[k]


def _factor(table: Table, quantity: Quantity, k: int, units: Mapping[str, str]) -> float:
    head, written = table.heads[k], _written_unit(table, k)
    unit = units.get(quantity.name) or written
    if not unit and quantity.name == "time":
        unit = quantity.unit
    if not unit:
        hint = f"declare it, --columns '{normalized(head)}={quantity.name}[UNIT]'"
        raise FileError(table.path, f"column {head!r} has no unit: {hint}")
    try:
        factor = si_factor(unit, quantity)
        if written != unit:  # a declaration does not make newtons of volts
            with suppress(UnknownUnitError):
                si_factor(written, quantity)
    except ValueError as error:
        problem = str(error).replace("'HEAD=", f"'{normalized(split_head(head)[0])}=")
        raise FileError(table.path, f"column {head!r}: {problem}") from error
    return factor


def _in_range(quantity: Quantity, values: FloatArray) -> FloatArray:
    low, high = quantity.low, quantity.high
    wrong = (values < low - quantity.noise) | (values > high)
    if wrong.any():
        row, unit = int(wrong.argmax()), quantity.unit
        value, minimum, maximum = (number / quantity.scale for number in (values[row], low, high))
        problem = (
            f"{quantity.name} = {value:.6g} {unit} is outside the accepted range {minimum:g} to {maximum:g} {unit}"
        )
        raise CellError(row, f"{problem} - is the unit right?")
    return np.asarray(np.where(values < low, low, values))


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


def _numbers(cells: Any, sign: str) -> FloatArray:
    """Finite numbers (rows,) of trimmed texts, NaN where missing."""
    other = "," if sign == "." else "."
    if sign == "." or not matches(cells, r"\.").any():
        with suppress(pa.ArrowInvalid):  # fast path for plain numbers
            values = np.asarray(pc.replace_substring(cells, sign, ".").cast(pa.float64()), dtype=float)
            if np.isfinite(values).all():
                return values
    missing = matches(cells, MISSING)
    d, g = re.escape(sign), re.escape(other)
    shape = rf"^[+-]?(?:\d+|\d{{1,3}}(?:{g}\d{{3}})+|\d{{1,3}}(?:{_SPACES}\d{{3}})+)?(?:{d}\d*)?{_POWER}?$"
    readable = matches(cells, shape) & matches(cells, r"\d") & ~missing
    point = pc.replace_substring(pc.replace_substring_regex(cells, rf"^\+|{g}|{_SPACES}", ""), sign, ".")
    values = np.asarray(pc.if_else(pa.array(readable), point, pa.scalar("nan", pa.large_string())).cast(pa.float64()))
    hint = " - correct it, or leave it empty"
    good = (readable | missing) & ~np.isinf(values)
    if not good.all() and other in cells[int((~good).argmax())].as_py():
        hint = f" with the decimal sign {sign!r} of the other numbers{hint}"
    word = next((text for text in cells.filter(pa.array(~good))[:1].to_pylist() if re.search("[A-Za-z]", text)), "")
    if re.fullmatch(r"[+-]?\d[\d.,]*\s*[A-Za-z/]+", word):
        hint = " - a unit belongs in the heading: correct it"
    elif word and word.isprintable():
        hint += f", or if it marks a missing value, --missing={shlex.quote(word[:40])}"
    check(cells, good, f"is not a finite number{hint}")
    return values
