"""Cells as they are written, and how many a log may have."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from probe_env.files import FileError

IntArray = npt.NDArray[np.integer]
MOST_ROWS: Final = 5_000_000
MOST_COLUMNS: Final = 256


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
