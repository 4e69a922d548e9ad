"""The reader of log files: text of any separator and encoding, or an Excel sheet, as columns of texts."""

from __future__ import annotations

import codecs
import csv
import io
import re
import warnings
import zipfile
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime, time
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from agents.plant.quantities import NAMES, ColumnOption, known_as, looks_like_unit
from probe_env.files import MEBI, FileError, read_bytes
from probe_env.schedule import CSV_COMMENT

IntArray = npt.NDArray[np.integer]
MOST_BYTES: Final = 256 * MEBI
MOST_ROWS: Final = 5_000_000
MOST_COLUMNS: Final = 256
HEAD_WITHIN: Final = 200
"""Lines, empty ones apart, within which the head must stand."""
HEADS_SHOWN: Final = 12

SEPARATORS: Final = {";": "';'", "\t": "tabs", "|": "'|'", ",": "','", " ": "spaces"}
_CONTROL: Final = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f]")
_COMMENT: Final = r"^\s*[#%!]|^[\s|:+=-]*$"
"""Comments, empty lines, rules between head and rows."""
_SPACED_TIME: Final = r"(\d{4}-\d\d-\d\d|\d\d\.\d\d\.\d{4})[ \t]+(\d\d:\d\d)"
_END_PIPES: Final = r"^\s*\||\|\s*$"
_NUMBER_OR_TIME: Final = re.compile(r"[+-]?[\d.,'  ]*\d[\d.,'  ]*(?:[eE][+-]?\d+)?|\d[\d:.,TZ +-]*:[\d:.,TZ +-]*")

ZIP: Final = b"PK\x03\x04"
OLD_EXCEL: Final = b"\xd0\xcf\x11\xe0"
MOST_UNPACKED: Final = 512 * MEBI
MOST_TEXT: Final = 256 * MEBI
MOST_EMPTY: Final = 10_000
"""Rows without a cell, of which a small file can hold millions."""


@dataclass(frozen=True)
class Table:
    """Cells as they are written."""

    path: Path
    heads: tuple[str, ...]
    units: tuple[str, ...]  # from the row below the heads; empty texts where there is none
    columns: tuple[Any, ...]  # arrow arrays of texts (rows,)
    lines: IntArray  # (rows,) line number, or row number of a sheet
    row_word: str = "line"  # what errors call a row
    separator: str = ""  # empty for a sheet
    steps: bool = False  # whether the file says that values hold until the next row

    def error(self, row: int, problem: str, column: int | None = None) -> FileError:
        """An error at a row, and column."""
        place = f", column {self.heads[column]!r}" if column is not None else ""
        return FileError(self.path, f"{self.row_word} {self.lines[row]}{place}: {problem}")

    def error_between(self, first: int, last: int, problem: str) -> FileError:
        """An error from one row to another."""
        return FileError(self.path, f"{self.row_word}s {self.lines[first]} to {self.lines[last]}: {problem}")


def read_table(path: Path, sheet: str | None, options: Sequence[ColumnOption]) -> Table:
    """The table of a text file, or of a sheet of a workbook (default: the first).

    Raises:
        FileNotFoundError: no such file.
        FileError: not a text or workbook; no such sheet; no head; no rows; rows longer or shorter than the head; too
            large.
        ModuleNotFoundError: openpyxl is not installed.
    """
    content = read_bytes(path, MOST_BYTES)
    if content.startswith(OLD_EXCEL):
        raise FileError(path, "a workbook of Excel before 2007: save it as .xlsx or as CSV")
    if content.startswith(ZIP):
        return _sheet_table(path, _sheet_rows(path, content, sheet), options)
    if sheet is not None:
        raise FileError(path, f"not a workbook, so it has no sheet {sheet[:80]!r}: leave --sheet out")
    return _text_table(path, _decoded(path, content), options)


def _decoded(path: Path, content: bytes) -> str:
    """The text of a file: UTF-8, UTF-16, or else what Windows writes in Western Europe."""
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
    text = text.rstrip("\x1a").replace("\r\n", "\n").replace("\r", "\n")  # DOS ended files with Ctrl-Z
    if control := _CONTROL.search(text):
        line = text.count("\n", 0, control.start()) + 1
        problem = f"not a text file: a control character (0x{ord(control[0]):02x})"
        raise FileError(path, f"line {line}: {problem} - export it as text")
    return text


def _text_table(path: Path, text: str, options: Sequence[ColumnOption]) -> Table:
    lines = text.split("\n")
    if not text.strip():
        raise FileError(path, "empty: a head and rows of numbers are needed")
    if len(lines) > MOST_ROWS:
        raise FileError(path, f"{len(lines)} lines are more than the {MOST_ROWS} that a log may have: cut it")
    filled = [k for k, line in enumerate(lines[: 10 * HEAD_WITHIN]) if line.strip()][:HEAD_WITHIN]
    begins = {k + 1: _uncommented(lines[k][: 100 * MOST_COLUMNS]) for k in filled}
    candidates = [(k, separator, _split(line, separator)) for k, line in begins.items() for separator in SEPARATORS]
    first = next(((number, cells) for number, _, cells in candidates if len(cells) > 1), (1, list[str]()))
    head, separator, _ = _find_head(path, "line", candidates, options, first)
    heads = _split(_uncommented(lines[head - 1]), separator)
    if len(heads) > MOST_COLUMNS:
        raise FileError(path, f"line {head}: {len(heads)} columns are more than {MOST_COLUMNS}")
    remarks = (line for line in lines[: head - 1] if line.startswith(CSV_COMMENT))
    steps = any(line.partition(":")[2].strip() == "steps" for line in remarks)
    body = pa.array(lines[head:], pa.large_string())
    numbers = np.flatnonzero(~np.asarray(pc.match_substring_regex(body, _COMMENT))) + head + 1
    below = _split(lines[numbers[0] - 1], separator) if len(numbers) else []
    units, numbers = _units(path, f"line {head}", below, heads, numbers)
    columns = _text_columns(path, body.take(pa.array(numbers - head - 1)), numbers, separator, len(heads))
    return Table(path, tuple(heads), units, columns, numbers, separator=separator, steps=steps)


def _find_head(
    path: Path,
    word: str,
    candidates: Iterable[tuple[int, str, list[str]]],
    options: Sequence[ColumnOption],
    shown: tuple[int, list[str]],
) -> tuple[int, str, list[str]]:
    """The first of the rows (number, separator, cells) that name the most quantities; two are needed."""

    def score(candidate: tuple[int, str, list[str]]) -> int:
        cells = [cell for cell in candidate[2] if cell]
        named = {option.quantity for cell in cells for option in options if option.means(cell)}
        return len(named | {name for cell in cells if (name := known_as(cell))})

    best = max(candidates, key=score, default=None)
    if best is None or score(best) < 2:
        problem = f"no head that names two quantities; found: {heads_shown(shown[1]) or 'none'} - say what they are"
        names = f"--columns 'HEAD=QUANTITY', with QUANTITY one of {', '.join(NAMES)}"
        raise FileError(path, f"{word} {shown[0]}: {problem}: {names}")
    return best


def heads_shown(heads: Sequence[str]) -> str:
    """The first heads, for an error."""
    return ", ".join(repr(head[:60]) for head in heads[:HEADS_SHOWN]) + (" ..." if len(heads) > HEADS_SHOWN else "")


def _units(path: Path, place: str, row: Sequence[str], heads: Sequence[str], rest: Any) -> tuple[tuple[str, ...], Any]:
    """Units of the columns if the row below the heads has them, and the rows that remain."""
    filled = [cell.strip() for cell in row if cell.strip()]
    units: tuple[str, ...] = ("",) * len(heads)
    if filled and not any(map(_NUMBER_OR_TIME.fullmatch, filled)) and all(map(looks_like_unit, filled)):
        units = (*(cell.strip().strip("[]()").strip() for cell in row), *units)[: len(heads)]
        rest = rest[1:]
    if not len(rest):
        raise FileError(path, f"{place}: a head, but no rows below it: at least two are needed")
    return units, rest


def _uncommented(line: str) -> str:
    return re.sub(r"^\s*[#%!]", "", line)


def _split(line: str, separator: str) -> list[str]:
    """Cells of a head or a row of units."""
    if separator == " ":
        return re.split(r"\s+(?![\[(])", re.sub(_SPACED_TIME, r"\1T\2", line).strip())  # a unit belongs to its word
    if separator == "|":
        line = re.sub(_END_PIPES, "", line)
    cells = line.split(separator)
    if '"' in line:
        with suppress(csv.Error):
            cells = next(csv.reader([line], delimiter=separator, skipinitialspace=True))
    return [cell.strip() for cell in cells]


def _text_columns(path: Path, lines: Any, numbers: IntArray, separator: str, count: int) -> tuple[Any, ...]:
    """Texts (rows,) of every column."""
    if pc.any(pc.match_substring(lines, '"')).as_py():
        rows = _quoted_rows(path, lines.to_pylist(), numbers, separator, count)
        cells = pa.array(rows, pa.list_(pa.large_string()))
    elif separator == " ":
        joined = pc.replace_substring_regex(lines, _SPACED_TIME, r"\1T\2")
        cells = pc.utf8_split_whitespace(pc.utf8_trim_whitespace(joined))
    else:
        if separator == "|":
            lines = pc.replace_substring_regex(lines, _END_PIPES, "")
        end = re.escape(separator) + r"[ ]*$"
        closed = np.asarray(pc.count_substring(lines, separator)) == count  # a separator behind the last cell
        if (closed & np.asarray(pc.match_substring_regex(lines, end))).any():
            lines = pc.if_else(pa.array(closed), pc.replace_substring_regex(lines, end, ""), lines)
        cells = pc.split_pattern(lines, separator)
    lengths = np.asarray(pc.list_value_length(cells))
    wrong = np.flatnonzero(lengths != count)
    if len(wrong):
        k = int(wrong[0])
        hint = "correct that line or delete it"
        if k == len(lengths) - 1 and lengths[k] < count:
            hint = "the file ends within it: delete that line"
        elif separator == "," and len(wrong) == len(lengths) and lengths[k] > count:
            hint = "decimal commas and separating commas cannot be told apart: export it with semicolons"
        values = f"{lengths[k]} values for {count} columns, separated by {SEPARATORS[separator]}"
        raise FileError(path, f"line {numbers[k]}: {values} - {hint}")
    flat = pc.list_flatten(cells)
    return tuple(flat.take(pa.array(np.arange(k, len(flat), count))) for k in range(count))


def _quoted_rows(path: Path, lines: list[str], numbers: IntArray, separator: str, count: int) -> list[list[str]]:
    reader = csv.reader(lines, delimiter=separator, strict=True, skipinitialspace=True)
    rows: list[list[str]] = []
    try:
        for row in reader:
            rows.append(row[:-1] if len(row) == count + 1 and not row[-1].strip() else row)
            if reader.line_num != len(rows):
                raise FileError(path, f"line {numbers[len(rows) - 1]}: a quote that this line does not close")
    except csv.Error as error:
        raise FileError(path, f"line {numbers[len(rows)]}: not CSV: {error}") from error
    return rows


def _sheet_rows(path: Path, content: bytes, sheet: str | None) -> list[tuple[int, list[str]]]:
    """Number and cells of every row of a sheet that has any; formulas by their stored values."""
    import openpyxl

    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            parts = archive.infolist()
        unpacked = sum(part.file_size for part in parts)  # what a part declares is all that is unpacked of it
        if unpacked > MOST_UNPACKED:
            size = f"{len(parts)} parts of {unpacked} bytes unpacked"
            raise FileError(path, f"{size} are more than a log may have: export it as CSV")
        with warnings.catch_warnings(action="ignore"):  # of styles and extensions
            book = openpyxl.load_workbook(io.BytesIO(content), read_only=True, data_only=True, keep_links=False)
            names = [str(name) for name in book.sheetnames]
            if sheet is not None and sheet not in names:
                raise FileError(path, f"no sheet {sheet[:80]!r}; there are {', '.join(map(repr, names[:20]))}")
            page = book[sheet if sheet is not None else names[0]]
            if not hasattr(page, "reset_dimensions"):
                raise FileError(path, f"{page.title!r} is a chart, not a sheet: --sheet names another")
            page.reset_dimensions()  # a sheet may claim any size
            return _checked_rows(path, page.iter_rows(max_col=MOST_COLUMNS + 1, values_only=True))
    except FileError:
        raise
    except Exception as error:  # a damaged workbook raises whatever its parts run into
        problem = f"not an Excel workbook that can be read ({type(error).__name__})"
        raise FileError(path, f"{problem}: save it again") from error


def _checked_rows(path: Path, values: Iterable[Sequence[Any]]) -> list[tuple[int, list[str]]]:
    rows: list[tuple[int, list[str]]] = []
    size = 0
    for number, row in enumerate(values, start=1):
        cells = [_cell_text(value) for value in row]
        while cells and not cells[-1].strip():
            cells.pop()
        if number - len(rows) > MOST_EMPTY:
            raise FileError(path, f"row {number}: more rows than a sheet has, or more empty ones than a log: cut it")
        if len(cells) > MOST_COLUMNS:
            raise FileError(path, f"row {number}: more than {MOST_COLUMNS} columns")
        size += sum(map(len, cells))
        if size > MOST_TEXT:
            raise FileError(path, f"row {number}: the sheet is larger than a log may be: cut it")
        for cell in cells:
            if _CONTROL.search(cell) or "\t" in cell:
                raise FileError(path, f"row {number}: {cell[:60]!r} is not a head, number or time")
        if cells:
            rows.append((number, cells))
    return rows


def _cell_text(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, datetime | time):
        return value.isoformat()
    return repr(value) if isinstance(value, float) else str(value).replace("\n", " ").replace("\r", " ")


def _sheet_table(path: Path, rows: list[tuple[int, list[str]]], options: Sequence[ColumnOption]) -> Table:
    if not rows:
        raise FileError(path, "the sheet is empty: --sheet names another")
    candidates = [(number, "", cells) for number, cells in rows[:HEAD_WITHIN]]
    head, _, heads = _find_head(path, "row", candidates, options, rows[0])
    rows = [(number, cells) for number, cells in rows if number > head]
    units, rows = _units(path, f"row {head}", rows[0][1] if rows else [], heads, rows)
    for number, cells in rows:
        if len(cells) > len(heads):
            raise FileError(path, f"row {number}: {len(cells)} values for {len(heads)} columns - correct that row")
        cells += [""] * (len(heads) - len(cells))
    columns = tuple(pa.array(cells, pa.large_string()) for cells in zip(*(cells for _, cells in rows), strict=True))
    lines = np.array([number for number, _ in rows])
    return Table(path, tuple(cell.strip() for cell in heads), units, columns, lines, row_word="row")
