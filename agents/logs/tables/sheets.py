"""Sheets of Excel workbooks as tables of texts: bounded before they are unpacked, formulas by their stored values."""

from __future__ import annotations

import io
import re
import warnings
import zipfile
from collections.abc import Sequence
from datetime import datetime, time
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa

from agents.logs.quantities import Given
from agents.logs.tables.heads import HEAD_WITHIN, head_score, is_units_row, no_head
from agents.logs.tables.table import MOST_COLUMNS, MOST_ROWS, Table
from probe_env.files import MEBI, FileError

ZIP: Final = b"PK\x03\x04"
OLD_EXCEL: Final = b"\xd0\xcf\x11\xe0"
MOST_UNPACKED: Final = 512 * MEBI
MOST_TEXT: Final = 256 * MEBI
MOST_PARTS: Final = 10_000
LONGEST_CELL: Final = 32_767
"""Characters, as Excel has it."""
LAST_ROW: Final = min(1_048_576, MOST_ROWS)
"""As Excel has it."""
MOST_EMPTY: Final = 10_000
"""Rows without a cell, which a small file can have by the million."""
_CONTROL: Final = re.compile(r"[\x00-\x1f\x7f-\x9f]")


def table_of_sheet(path: Path, content: bytes, sheet: str | None, given: Sequence[Given]) -> Table:
    """The table in a sheet of a workbook, by default the first.

    Raises:
        FileError: no workbook, no such sheet, no head, no rows, too large when unpacked.
        ModuleNotFoundError: openpyxl is not installed.
    """
    import openpyxl

    _check_parts(path, content)
    try:
        with warnings.catch_warnings(action="ignore"):  # of styles and extensions, which are of no interest here
            book = openpyxl.load_workbook(io.BytesIO(content), read_only=True, data_only=True, keep_links=False)
            names = [str(name) for name in book.sheetnames]
            if sheet is not None and sheet not in names:
                raise FileError(path, f"no sheet {sheet[:80]!r}; there are {', '.join(map(repr, names[:20]))}")
            page = book[sheet if sheet is not None else names[0]]
            rows = _rows(path, page)
    except FileError:
        raise
    except Exception as error:  # a damaged workbook raises whatever its parts run into
        raise FileError(path, f"not an Excel workbook that can be read ({type(error).__name__}): save it again") from (
            error
        )
    return _table(path, rows, given)


def _check_parts(path: Path, content: bytes) -> None:
    """A small file may unpack to more than any memory; what it declares is all that is unpacked."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            parts = archive.infolist()
    except (zipfile.BadZipFile, ValueError, OSError, NotImplementedError) as error:
        raise FileError(path, f"not an Excel workbook that can be read ({error}): save it again") from error
    unpacked = sum(part.file_size for part in parts)
    if unpacked > MOST_UNPACKED or len(parts) > MOST_PARTS:
        raise FileError(
            path, f"{len(parts)} parts of {unpacked} bytes unpacked are more than a log may have: export it as CSV"
        )


def _rows(path: Path, page: Any) -> list[tuple[int, list[str]]]:
    """Number and cells of every row that has any."""
    if not hasattr(page, "reset_dimensions"):
        raise FileError(path, f"{page.title!r} is a chart, not a sheet: --sheet names another")
    page.reset_dimensions()  # a sheet may claim any size
    rows: list[tuple[int, list[str]]] = []
    size = 0
    for number, row in enumerate(page.iter_rows(max_col=MOST_COLUMNS + 1, values_only=True), start=1):
        cells = [_text(value) for value in row]
        while cells and not cells[-1].strip():
            cells.pop()
        if number > LAST_ROW or number - len(rows) > MOST_EMPTY:
            raise FileError(path, f"row {number}: more rows than a sheet has, or more empty ones than a log: cut it")
        if not cells:
            continue
        if len(cells) > MOST_COLUMNS:
            raise FileError(path, f"row {number}: more than {MOST_COLUMNS} columns")
        size += sum(map(len, cells))
        if size > MOST_TEXT:
            raise FileError(path, f"row {number}: the sheet is larger than a log may be: cut it")
        for cell in cells:
            if len(cell) > LONGEST_CELL or _CONTROL.search(cell):
                raise FileError(path, f"row {number}: {cell[:60]!r} is not a head, number or time")
        rows.append((number, cells))
    return rows


def _text(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, datetime | time):
        return value.isoformat()
    return repr(value) if isinstance(value, float) else str(value).replace("\n", " ").replace("\r", " ")


def _table(path: Path, rows: list[tuple[int, list[str]]], given: Sequence[Given]) -> Table:
    if not rows:
        raise FileError(path, "the sheet is empty: --sheet names another")
    scores = [head_score(cells, given) for _, cells in rows[:HEAD_WITHIN]]
    k = scores.index(max(scores))
    if scores[k] < 2:
        raise no_head(path, rows[0][1], f"row {rows[0][0]}")
    (head, heads), rows = rows[k], rows[k + 1 :]
    count = len(heads)
    units: tuple[str, ...] = ("",) * count
    if rows and is_units_row(rows[0][1]):
        units = tuple(cell.strip().strip("[]()").strip() for cell in rows[0][1][:count])
        units, rows = units + ("",) * (count - len(units)), rows[1:]
    if not rows:
        raise FileError(path, f"row {head}: a head, but no rows below it: at least two are needed")
    for number, cells in rows:
        if len(cells) > count:
            raise FileError(path, f"row {number}: {len(cells)} values for {count} columns - correct that row")
        cells += [""] * (count - len(cells))
    columns = zip(*(cells for _, cells in rows), strict=True)
    return Table(
        path, tuple(cell.strip() for cell in heads), units, tuple(pa.array(c, pa.large_string()) for c in columns),
        np.array([number for number, _ in rows]), row_word="row", decimal=".",
    )  # fmt: skip
