"""Text of anyone's as a table of texts: its encoding, separator and head found, its rows checked for length."""

from __future__ import annotations

import codecs
import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc

from agents.logs.quantities import NAMED, Given, known_as
from agents.logs.units import looks_like_unit
from probe_env.files import MEBI, FileError
from probe_env.schedule import CSV_COMMENT

IntArray = npt.NDArray[np.integer]
MOST_BYTES: Final = 256 * MEBI
MOST_ROWS: Final = 5_000_000
MOST_COLUMNS: Final = 256
HEAD_WITHIN: Final = 200
"""Lines, empty ones apart, within which the head must stand."""
HEADS_SHOWN: Final = 12
SEPARATORS: Final = (";", "\t", "|", ",", " ")
COMMENT: Final = r"^\s*[#%!]|^[\s|:+=-]*$"
"""Comments, empty lines, rules between head and rows."""
_CONTROL: Final = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f]")
_SPACED_TIME: Final = r"(\d{4}-\d\d-\d\d|\d\d\.\d\d\.\d{4})[ \t]+(\d\d:\d\d)"
_NUMBER_OR_TIME: Final = re.compile(r"[+-]?[\d.,'  ]*\d[\d.,'  ]*(?:[eE][+-]?\d+)?|\d[\d:.,TZ +-]*:[\d:.,TZ +-]*")


@dataclass(frozen=True)
class Table:
    """Cells as they are written.

    Attributes:
        path: of the file.
        heads: one a column.
        units: the row of units below the heads, empty texts where there is none.
        columns: texts of every column, arrow arrays of one length.
        lines: number of the line, or the row of a sheet, of every row.
        row_word: what a row is called in errors, "line" or "row".
        separator: of the columns; empty for a sheet.
        decimal: the decimal sign where it is beyond doubt, else empty.
        steps: whether it says of itself that values hold until the next row.
    """

    path: Path
    heads: tuple[str, ...]
    units: tuple[str, ...]
    columns: tuple[Any, ...]
    lines: IntArray
    row_word: str = "line"
    separator: str = ""
    decimal: str = ""
    steps: bool = False

    def error(self, row: int, problem: str, column: int | None = None) -> FileError:
        """What is wrong at a row, for a line of text."""
        place = f"{self.row_word} {self.lines[row]}" + (
            f", column {self.heads[column]!r}" if column is not None else ""
        )
        return FileError(self.path, f"{place}: {problem}")


def decoded(path: Path, content: bytes) -> str:
    """The text of a file: UTF-8, UTF-16, or else what Windows writes in Western Europe.

    Raises:
        FileError: not a text.
    """
    utf16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
    begin = content[:1000]
    if content.startswith(utf16):
        names = ["utf-16"]
    elif len(begin) > 3 and begin[1::2].count(0) > 0.4 * len(begin):
        names = ["utf-16-le"]
    elif len(begin) > 3 and begin[::2].count(0) > 0.4 * len(begin):
        names = ["utf-16-be"]
    else:
        names = ["utf-8-sig", "cp1252"]
    text = None
    for name in names:
        try:
            text = content.decode(name)
            break
        except UnicodeDecodeError as error:
            place, byte = content.count(b"\n", 0, error.start) + 1, content[error.start]
    if text is None:
        raise FileError(path, f"line {place}: not a text file (byte 0x{byte:02x}): export it as text in UTF-8")
    text = text.rstrip("\x1a").replace("\r\n", "\n").replace("\r", "\n")  # DOS ended files with Ctrl-Z
    control = _CONTROL.search(text)
    if control:
        line = text.count("\n", 0, control.start()) + 1
        raise FileError(
            path, f"line {line}: not a text file: a control character (0x{ord(control[0]):02x}) - export it as text"
        )
    return text


def table_of_text(path: Path, text: str, given: Sequence[Given]) -> Table:
    """The table in a text.

    Raises:
        FileError: no head, no rows, rows of another length than the head, too many of anything.
    """
    lines = text.split("\n")
    if not text.strip():
        raise FileError(path, "empty: a head and rows of numbers are needed")
    if len(lines) > MOST_ROWS:
        raise FileError(path, f"{len(lines)} lines are more than the {MOST_ROWS} that a log may have: cut it")
    head, separator = _head(path, lines, given)
    heads = _split(re.sub(r"^\s*[#%!]", "", lines[head]), separator)
    if len(heads) > MOST_COLUMNS:
        raise FileError(path, f"line {head + 1}: {len(heads)} columns are more than {MOST_COLUMNS}")
    steps = any(line.startswith(CSV_COMMENT) and line.partition(":")[2].strip() == "steps" for line in lines[:head])
    body = pa.array(lines[head + 1 :], pa.large_string())
    used = np.flatnonzero(~np.asarray(pc.match_substring_regex(body, COMMENT)))
    first = _split(lines[head + 1 + used[0]], separator) if len(used) else []
    units: tuple[str, ...] = ("",) * len(heads)
    if is_units_row(first):
        units, used = tuple(cell.strip().strip("[]()").strip() for cell in first), used[1:]
        units += ("",) * (len(heads) - len(units))
    if not len(used):
        raise FileError(path, f"line {head + 1}: a head, but no rows below it: at least two are needed")
    numbers = used + head + 2
    columns = _columns(path, body.take(pa.array(used)), numbers, separator, len(heads))
    return Table(path, tuple(heads), units, columns, numbers, separator=separator, steps=steps)


def head_score(cells: Sequence[str], given: Sequence[Given]) -> int:
    """How many quantities the cells of a line name."""
    named = {other.quantity for cell in cells for other in given if cell and other.means(cell)}
    return len(named | {name for cell in cells if cell and (name := known_as(cell))})


def is_units_row(cells: Sequence[str]) -> bool:
    """Whether the row below a head has units, and no number or time."""
    filled = [cell.strip() for cell in cells if cell.strip()]
    return bool(filled) and not any(map(_NUMBER_OR_TIME.fullmatch, filled)) and all(map(looks_like_unit, filled))


def no_head(path: Path, cells: Sequence[str], line: str) -> FileError:
    """Nobody knows the heads."""
    shown = ", ".join(repr(cell[:60]) for cell in cells[:HEADS_SHOWN]) + (" ..." if len(cells) > HEADS_SHOWN else "")
    return FileError(
        path,
        f"{line}: no head that names two quantities; found: {shown or 'none'} - say what they are:"
        f" --columns 'HEAD=QUANTITY', with QUANTITY one of {', '.join(NAMED)}",
    )


def _head(path: Path, lines: Sequence[str], given: Sequence[Given]) -> tuple[int, str]:
    """Line number from 0 and separator of the line that names most quantities, the first of them."""
    begin = [k for k, line in enumerate(lines[: 10 * HEAD_WITHIN]) if line.strip()][:HEAD_WITHIN]
    best, place, found = 1, None, (1, list[str]())
    for k in begin:
        line = re.sub(r"^\s*[#%!]", "", lines[k][: 100 * MOST_COLUMNS])
        for separator in SEPARATORS:
            cells = _split(line, separator)
            score = head_score(cells, given)
            if score > best:
                best, place = score, (k, separator)
            if len(cells) > 1 and not found[1]:
                found = (k + 1, cells)
    if place is None:
        raise no_head(path, found[1], f"line {found[0]}")
    return place


def _split(line: str, separator: str) -> list[str]:
    if separator == " ":
        line = re.sub(_SPACED_TIME, r"\1T\2", line)
        return re.split(r"\s+(?![\[(])", line.strip())  # a unit belongs to the word before it
    if separator == "|":
        line = re.sub(r"^\s*\||\|\s*$", "", line)
    if '"' in line:
        try:
            return [cell.strip() for cell in next(csv.reader([line], delimiter=separator, skipinitialspace=True))]
        except csv.Error:
            pass
    return [cell.strip() for cell in line.split(separator)]


def _columns(path: Path, lines: Any, numbers: IntArray, separator: str, count: int) -> tuple[Any, ...]:
    """Texts (rows,) of every column."""
    if pc.any(pc.match_substring(lines, '"')).as_py():
        return _quoted_columns(path, lines.to_pylist(), numbers, separator, count)
    if separator == " ":
        joined = pc.replace_substring_regex(lines, _SPACED_TIME, r"\1T\2")
        cells = pc.utf8_split_whitespace(pc.utf8_trim_whitespace(joined))
    else:
        if separator == "|":
            lines = pc.replace_substring_regex(lines, r"^\s*\||\|\s*$", "")
        open_end = np.asarray(pc.count_substring(lines, separator)) == count  # a separator behind the last cell
        ended = np.asarray(pc.match_substring_regex(lines, re.escape(separator) + r"[ ]*$"))
        if (open_end & ended).any():
            cut = pc.replace_substring_regex(lines, re.escape(separator) + r"[ ]*$", "")
            lines = pc.if_else(pa.array(open_end & ended), cut, lines)
        cells = pc.split_pattern(lines, separator)
    _check_lengths(path, np.asarray(pc.list_value_length(cells)), numbers, separator, count)
    flat = pc.list_flatten(cells)
    return tuple(flat.take(pa.array(np.arange(k, len(flat), count))) for k in range(count))


def _quoted_columns(path: Path, lines: list[str], numbers: IntArray, separator: str, count: int) -> tuple[Any, ...]:
    reader = csv.reader(lines, delimiter=separator, strict=True, skipinitialspace=True)
    rows: list[list[str]] = []
    try:
        for row in reader:
            rows.append(row[:-1] if len(row) == count + 1 and not row[-1].strip() else row)
            if reader.line_num != len(rows):
                raise FileError(path, f"line {numbers[len(rows) - 1]}: a quote that this line does not close")
    except csv.Error as error:
        raise FileError(path, f"line {numbers[len(rows)]}: not CSV: {error}") from error
    _check_lengths(path, np.array([len(row) for row in rows]), numbers, separator, count)
    return tuple(pa.array(cells, pa.large_string()) for cells in zip(*rows, strict=True))


def _check_lengths(path: Path, lengths: IntArray, numbers: IntArray, separator: str, count: int) -> None:
    wrong = np.flatnonzero(lengths != count)
    if not len(wrong):
        return
    row = int(wrong[0])
    hint = "correct that line or delete it"
    if row == len(lengths) - 1 and lengths[row] < count:
        hint = "the file ends within it: delete that line"
    elif separator == "," and len(wrong) == len(lengths) and lengths[row] > count:
        hint = "decimal commas and separating commas cannot be told apart: export it with semicolons"
    name = {"\t": "tabs", " ": "spaces"}.get(separator, repr(separator))
    raise FileError(
        path, f"line {numbers[row]}: {lengths[row]} values for {count} columns, separated by {name} - {hint}"
    )
