"""Sheets of Excel workbooks (.xlsx) as lines of text, bounded in memory and time before they are parsed."""

import io
import re
import warnings
import zipfile
from collections.abc import Iterable, Sequence
from datetime import datetime, time, timedelta
from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree

import numpy as np
import pandas as pd

from probe_env.files import MEBI, FileError

MAX_COLUMNS: Final = 256
ZIP: Final = b"PK\x03\x04"
OLD_EXCEL: Final = b"\xd0\xcf\x11\xe0"
MAX_UNPACKED: Final = 512 * MEBI
MAX_STRINGS: Final = 64 * MEBI
MAX_PART: Final = 4 * MEBI
"""Limit of parts that are parsed as a whole and of a row of a sheet; the parser needs 100 times as much memory."""
MAX_SHEET_ROWS: Final = 1 << 20
_SHEETS: Final = "xl/worksheets/"
_STRINGS: Final = "xl/sharedStrings.xml"
_LARGE: Final = re.compile(rf"{_SHEETS}[^/]+$|{_STRINGS}$|xl/media/")
_LARGE_KIND: Final = re.compile(r"\.(?:worksheet|sharedStrings)\+xml$|^image/")
"""Names and content types of parts that are not parsed as a whole."""
_MAX_TAG: Final = 64
_ROW: Final = re.compile(rb"<(?:!|(?:\w{1,32}:)?(?:row|si)\b)")
"""Begin of a row or shared text, or of a comment, in which they do not count."""
MAX_TEXT: Final = 256 * MEBI
MAX_EMPTY: Final = 10_000
"""Limit of empty rows; a small file can hold millions."""


def sheet_lines(path: Path, content: bytes, sheet: str | None) -> list[str]:
    """Rows of a sheet as lines of cells, separated by tabs; formulas are replaced by their stored values."""
    import openpyxl

    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            _check_parts(path, archive)
        with warnings.catch_warnings(action="ignore"):  # of styles and extensions
            book = openpyxl.load_workbook(io.BytesIO(content), read_only=True, data_only=True, keep_links=False)
            names = [str(name) for name in book.sheetnames]
            if sheet is not None and sheet not in names:
                raise FileError(path, f"no sheet {sheet[:80]!r}; there are {', '.join(map(repr, names[:20]))}")
            page = book[sheet if sheet is not None else names[0]]
            if not hasattr(page, "reset_dimensions"):
                raise FileError(path, f"{page.title!r} is a chart, not a sheet: --sheet names another")
            page.reset_dimensions()  # a sheet may declare any size
            return _joined(path, page.iter_rows(values_only=True))
    except FileError:
        raise
    except Exception as error:  # a damaged workbook can raise any error
        problem = f"not an Excel workbook that can be read ({type(error).__name__})"
        raise FileError(path, f"{problem}: save it again") from error


def _check_parts(path: Path, archive: zipfile.ZipFile) -> None:
    """Raise FileError for a workbook that would need a lot of memory or time; parts are not parsed for this."""
    parts = archive.infolist()
    unpacked = sum(part.file_size for part in parts)  # no more than the declared size is unpacked
    if unpacked > MAX_UNPACKED:
        size = f"{len(parts)} parts of {unpacked} bytes unpacked"
        raise FileError(path, f"{size} are too large for a log: export it as CSV")
    for part in parts:
        name = part.filename
        maximum = MAX_STRINGS if name == _STRINGS else MAX_UNPACKED if _LARGE.match(name) else MAX_PART
        if part.file_size > maximum:
            size = f"its part {name[:80]!r} has {part.file_size} bytes, more than the {maximum} accepted"
            raise FileError(path, f"{size}: copy the sheet to a new workbook, or export it as CSV")
    for entry in ElementTree.fromstring(archive.read("[Content_Types].xml")):
        name, kind = entry.get("PartName", "")[1:], entry.get("ContentType", "")
        if _LARGE.match(name) and not _LARGE_KIND.search(kind):  # would be parsed as a whole
            raise FileError(path, f"not an Excel workbook that can be read: {name[:80]!r} is {kind[:80]!r}")
    for part in parts:
        if part.filename.startswith(_SHEETS) or part.filename == _STRINGS:
            _check_rows(path, part.filename, archive)


def _check_rows(path: Path, name: str, archive: zipfile.ZipFile) -> None:
    """Raise FileError for more rows, or shared texts, than sheets have rows, or for one of over ``MAX_PART`` bytes."""
    rows = offset = last = 0
    text = b""
    with archive.open(name) as file:
        while chunk := file.read(MEBI):
            offset, text = offset + max(len(text) - _MAX_TAG, 0), text[-_MAX_TAG:] + chunk
            found = [m for m in _ROW.finditer(text) if m.start() < len(text) - _MAX_TAG]  # others come again
            starts = [last, *(offset + m.start() for m in found), offset + len(text)]
            rows, last = rows + len(found), starts[-2]
            if rows > MAX_SHEET_ROWS:
                raise FileError(path, f"{name} has more than {MAX_SHEET_ROWS} rows or texts: cut it")
            if any(m[0] == b"<!" for m in found):
                raise FileError(path, f"not an Excel workbook that can be read: {name} has comments: save it again")
            if np.diff(starts).max() > MAX_PART:
                raise FileError(path, f"{name} has a row of more than {MAX_PART} bytes: export the sheet as CSV")


def _sheet_text(value: Any) -> str:
    if isinstance(value, datetime | time):
        return value.isoformat()
    return "" if value is None else str(pd.Timedelta(value) if isinstance(value, timedelta) else value)


def _joined(path: Path, rows: Iterable[Sequence[Any]]) -> list[str]:
    lines: list[str] = []
    size = empty = 0
    for number, row in enumerate(rows, start=1):
        cells = [re.sub(r"[\x00-\x1f\x7f-\x9f]", " ", _sheet_text(v)).replace("\u2212", "-") for v in row]
        while cells and not cells[-1].strip():
            cells.pop()
        empty += not cells
        size += sum(map(len, cells))
        if empty > MAX_EMPTY:
            raise FileError(path, f"row {number}: more empty rows than accepted ({MAX_EMPTY}): cut the sheet")
        if len(cells) > MAX_COLUMNS:
            raise FileError(path, f"row {number}: more than {MAX_COLUMNS} columns")
        if size > MAX_TEXT:
            raise FileError(path, f"row {number}: the sheet is too large for a log: cut it")
        lines.append("\t".join(cells))
    return lines
