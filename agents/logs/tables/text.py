"""Text of anyone's as a table of texts: its separator and head found, its rows checked for length."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from agents.logs.quantities import Given
from agents.logs.tables.heads import HEAD_WITHIN, head_score, is_units_row, no_head
from agents.logs.tables.table import MOST_COLUMNS, MOST_ROWS, IntArray, Table
from probe_env.files import FileError
from probe_env.schedule import CSV_COMMENT

SEPARATORS: Final = (";", "\t", "|", ",", " ")
COMMENT: Final = r"^\s*[#%!]|^[\s|:+=-]*$"
"""Comments, empty lines, rules between head and rows."""
_SPACED_TIME: Final = r"(\d{4}-\d\d-\d\d|\d\d\.\d\d\.\d{4})[ \t]+(\d\d:\d\d)"


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


def _head(path: Path, lines: Sequence[str], given: Sequence[Given]) -> tuple[int, str]:
    """Line number from 0 and separator of the line that names most quantities, the first of them."""
    begin = [k for k, line in enumerate(lines[: 10 * HEAD_WITHIN]) if line.strip()][:HEAD_WITHIN]
    best, place, first = 1, None, (1, list[str]())
    for k in begin:
        line = re.sub(r"^\s*[#%!]", "", lines[k][: 100 * MOST_COLUMNS])
        for separator in SEPARATORS:
            cells = _split(line, separator)
            score = head_score(cells, given)
            if score > best:
                best, place = score, (k, separator)
            if len(cells) > 1 and not first[1]:
                first = (k + 1, cells)
    if place is None:
        raise no_head(path, first[1], f"line {first[0]}")
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
