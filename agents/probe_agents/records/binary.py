"""Sheets of workbooks and tables of pandas as lines of text, in a process of its own with bounded memory.

``sources.py`` starts it as a program; it imports nothing that is slow, but pandas for its tables.
"""

import io
import json
import re
import sys
from collections.abc import Iterable
from contextlib import suppress
from datetime import date, datetime, time, timedelta
from typing import Any, Final

MAX_MEMORY: Final = 4 << 30
"""[bytes]."""


def _answer(reader: str, sheet: str | None) -> dict[str, list[str]] | str:
    """Sheets of the file at standard input, or the problem with it."""
    content = io.BytesIO(sys.stdin.buffer.read())
    if reader != "workbook":
        import pandas as pd

        lines = not content.getvalue().lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"[")
        arguments = {"convert_dates": False, "lines": lines} if reader == "read_json" else {}
        frame = getattr(pd, reader)(content, **arguments)
        if not isinstance(frame.index, pd.RangeIndex):
            frame = frame.reset_index()
        return {"": _lines([list(frame.columns), *frame.itertuples(index=False)])}
    from python_calamine import CalamineWorkbook, SheetTypeEnum

    book = CalamineWorkbook.from_filelike(content)
    names = [page.name for page in book.sheets_metadata if page.typ == SheetTypeEnum.WorkSheet]
    if sheet is not None and sheet not in names:
        return f"no sheet {sheet[:80]!r}; there are {', '.join(map(repr, names[:20]))}"
    chosen = names if sheet is None else [sheet]
    return {name: _lines(book.get_sheet_by_name(name).to_python(skip_empty_area=False)) for name in chosen}


def _lines(rows: Iterable[Iterable[Any]]) -> list[str]:
    return ["\t".join(map(_text, row)).rstrip() for row in rows]


def _text(value: Any) -> str:
    if value is None or value != value:
        return ""
    if isinstance(value, timedelta):
        clock = datetime.min + timedelta(seconds=value.seconds, microseconds=value.microseconds)
        return f"{value.days} days {clock:%H:%M:%S.%f}"
    if isinstance(value, date | time):
        day = isinstance(value, date) and not isinstance(value, datetime)
        return value.isoformat() + "T00:00:00" * day  # a library may give midnight as a date
    text = str(value)
    return re.sub(r"[\x00-\x1f\x7f-\x9f]", " ", text).replace("\u2212", "-")


def main() -> None:
    """Write the sheets of standard input, or the problem with it, as JSON; arguments: reader and, if any, the sheet."""
    with suppress(ImportError):
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (MAX_MEMORY, MAX_MEMORY))
    reader, *sheet = sys.argv[1:]
    answer: dict[str, list[str]] | str
    try:
        answer = _answer(reader, sheet[0] if sheet else None)
    except Exception as error:  # a damaged file can raise any error
        answer = f"a file that cannot be read ({type(error).__name__}): save it again, or export it as CSV"
    json.dump(answer, sys.stdout)


if __name__ == "__main__":
    main()
