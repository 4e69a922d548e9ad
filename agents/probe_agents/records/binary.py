"""Sheets of workbooks and tables of pandas as lines of text, in a process of its own with bounded memory.

``sources.py`` starts it as a program, with the reader, its memory [bytes] and, if any, the sheet.
"""

import io
import json
import re
import sys
from collections.abc import Iterable
from contextlib import suppress
from datetime import date, datetime, timedelta
from typing import Any


def _answer(reader: str, sheets: list[str]) -> dict[str, list[str]] | str:
    """Sheets of the file at standard input, or the problem with it."""
    content = io.BytesIO(sys.stdin.buffer.read())
    if reader != "workbook":
        import pandas as pd  # takes longer than a workbook

        lines = not content.getvalue().lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"[")
        arguments = {"convert_dates": False, "lines": lines} if reader == "read_json" else {}
        frame = getattr(pd, reader)(content, **arguments)
        frame = frame if isinstance(frame.index, pd.RangeIndex) else frame.reset_index()
        frame = frame.astype(object).where(frame.notna(), None)
        return {"": _lines([list(frame.columns), *frame.itertuples(index=False)])}
    from python_calamine import CalamineWorkbook, SheetTypeEnum

    book = CalamineWorkbook.from_filelike(content)
    names = [page.name for page in book.sheets_metadata if page.typ == SheetTypeEnum.WorkSheet]
    if missing := [sheet for sheet in sheets if sheet not in names]:
        return f"no sheet {missing[0][:80]!r}; there are {', '.join(map(repr, names[:20]))}"
    return {name: _lines(book.get_sheet_by_name(name).to_python(skip_empty_area=False)) for name in sheets or names}


def _lines(rows: Iterable[Iterable[Any]]) -> list[str]:
    return ["\t".join(map(_text, row)).rstrip() for row in rows]


def _text(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, timedelta):
        value = f"{value.days} days {(datetime.min + value % timedelta(days=1)).time()}"
    elif isinstance(value, date) and not isinstance(value, datetime):
        value = f"{value} 00:00:00"  # a library may give midnight as a date
    return re.sub(r"[\x00-\x1f\x7f-\x9f]", " ", str(value)).replace("\u2212", "-")


def main() -> None:
    """Write the sheets of standard input, or the problem with it, as JSON."""
    reader, memory, *sheets = sys.argv[1:]
    with suppress(ImportError):
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (int(memory), int(memory)))
    answer: dict[str, list[str]] | str
    try:
        answer = _answer(reader, sheets)
    except Exception as error:  # a damaged file can raise any error
        answer = f"a file that cannot be read ({type(error).__name__}): save it again, or export it as CSV"
    json.dump(answer, sys.stdout)


if __name__ == "__main__":
    main()
