"""Reads CSV and Parquet tables and checks the kind of each required column.

Names stay text, also ``null``, ``1e5`` and ``NA``; numbers are read exactly.
"""

import csv
import io
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, Literal

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq

from probe_agents.terminal.names import name_problem
from probe_env.files import MEBI, FileError, read_bytes, read_text

Kind = Literal["name", "text", "count", "number", "maybe", "truth", "number?", "maybe?"]
"""A name (``terminal.names``), any text, a whole number from 0, a finite number, a number or NaN, a boolean.

Columns with a question mark may be missing.
"""
Columns = Mapping[str, Kind]
MAX_CSV: Final = 64 * MEBI
MAX_PARQUET: Final = 1024 * MEBI
MAX_ROWS: Final = 20_000_000
MAX_COLUMNS: Final = 1000
CURVE: Final[Columns] = {
    **dict.fromkeys(("seed", "phase", "steps"), "count"),
    **dict.fromkeys(("reward", "inspection_time_s", "share_within_limit"), "number"),
    **dict.fromkeys(("validation_s", "wall_s", "kernel_s"), "number"),
}  # fmt: skip
"""``learning.csv``."""
HASHES: Final = ("code", "commit")
"""Columns of text: the digits of a hash may look like a number."""
_NONE: Final[Columns] = MappingProxyType({})
_HINT: Final = "restore the file, or create it again"
_ARROW: Final = {"name": pa.string(), "text": pa.string(), "truth": pa.bool_()}


def read_csv(path: Path, columns: Columns = _NONE) -> pd.DataFrame:
    """A CSV table with a header; the kinds of other columns are inferred."""
    text = read_text(path, MAX_CSV)
    header = next(filter(None, csv.reader(io.StringIO(text))), [])
    columns = _present(columns, header)
    _check_header(path, header, columns)
    types: dict[str, Any] = {name: _ARROW.get(kind, pa.float64()) for name, kind in columns.items()}
    types = dict.fromkeys((name for name in HASHES if name in header), pa.string()) | types
    table = _parse(path, text, header, types)
    dates = {field.name: pa.string() for field in table.schema if pa.types.is_temporal(field.type)}
    frame = (_parse(path, text, header, types | dates) if dates else table).to_pandas()
    for name, kind in columns.items():
        values = frame[name]
        if kind in ("name", "text"):
            frame[name] = values.fillna("")
        elif kind == "count" and (values % 1.0 == 0.0).all() and (values.abs() < 2**53).all():
            frame[name] = values.astype(np.int64)
    return check_table(path, frame, columns)


def _parse(path: Path, text: str, header: Sequence[str], types: Mapping[str, Any]) -> pa.Table:
    """A CSV text as a table, columns without a type inferred; errors name the column, the row and the value."""
    convert = pa.csv.ConvertOptions(
        column_types=types, null_values=[""], strings_can_be_null=True, true_values=["True"], false_values=["False"]
    )  # fmt: skip
    if text.count('"') % 2:
        raise FileError(path, f"not CSV: a quote is not closed - {_HINT}")
    try:
        return pa.csv.read_csv(
            io.BytesIO(text.encode()),
            read_options=pa.csv.ReadOptions(use_threads=False, block_size=2 * MAX_CSV),
            parse_options=pa.csv.ParseOptions(newlines_in_values=True),
            convert_options=convert,
        )
    except pa.ArrowException as error:
        raise FileError(path, f"{_csv_error(str(error), header)} - {_HINT}") from error


def _csv_error(error: str, header: Sequence[str]) -> str:
    """Arrow's error with the name of the column and the row number; row 1 is the first below the header."""
    if match := re.fullmatch(r"In CSV column #(\d+): Row #(\d+): .* invalid value '(.*)'", error, re.DOTALL):
        return f"row {int(match[2]) - 1}: {header[int(match[1])]} = {match[3][:100]!r} is not a number"
    if match := re.fullmatch(r"CSV parse error: Row #(\d+): Expected (\d+) columns, got (\d+).*", error, re.DOTALL):
        return f"row {int(match[1]) - 1}: {match[3]} values for {match[2]} columns"
    return f"not CSV: {error}"


def read_parquet(path: Path, columns: Columns) -> pd.DataFrame:
    """The columns of a Parquet table, in the order of the file."""
    stored = read_bytes(path, MAX_PARQUET)
    try:
        file = pq.ParquetFile(io.BytesIO(stored))
        names, rows = list(file.schema_arrow.names), file.metadata.num_rows
        columns = _present(columns, names)
        _check_header(path, names, columns)
        if not 0 < rows <= MAX_ROWS:
            raise FileError(path, f"{rows} rows; accepted: 1 to {MAX_ROWS} - {_HINT}")
        content = file.read(columns=[name for name in names if name in columns])
        content.validate(full=True)  # such as text that is not UTF-8
        table = content.to_pandas(ignore_metadata=True)
    except (pa.ArrowException, OSError, ValueError, MemoryError) as error:
        if isinstance(error, FileError):
            raise
        raise FileError(path, f"not a Parquet file that can be read: {error} - {_HINT}") from error
    return check_table(path, table, columns)


def _present(columns: Columns, header: list[Any]) -> Columns:
    """Columns without those that may be missing and are."""
    kinds: dict[str, Any] = {name: kind for name, kind in columns.items() if name in header or not kind.endswith("?")}
    return {name: kind.rstrip("?") for name, kind in kinds.items()}


def check_table(path: Path, table: pd.DataFrame, columns: Columns) -> pd.DataFrame:
    """Check that a table has rows and the required columns, all of their kinds; returns the table.

    Raises:
        FileError: names file, column and row (the first is 1).
    """
    columns = _present(columns, list(table.columns))
    _check_header(path, list(table.columns), columns)
    if table.empty:
        raise FileError(path, f"no rows - {_HINT}")
    for name, kind in columns.items():
        values = table[name]
        if kind in ("name", "text"):
            _check_names(path, name, list(values.unique()), kind)
        elif values.dtype.kind not in ("b" if kind == "truth" else "iuf"):
            raise FileError(
                path, f"column {name!r}: {values.dtype}, not {'booleans' if kind == 'truth' else 'numbers'} - {_HINT}"
            )
        elif kind in ("count", "number"):
            numbers = values.to_numpy()
            bad = ~np.isfinite(numbers) if kind == "number" else ~((numbers >= 0) & (numbers == np.floor(numbers)))
            if bad.any():
                row, what = int(bad.argmax()), "finite" if kind == "number" else "a whole number of 0 or more"
                raise FileError(path, f"row {row + 1}: {name} = {numbers[row]} is not {what} - {_HINT}")
    return table


def _check_header(path: Path, header: list[Any], columns: Columns) -> None:
    if len(header) > MAX_COLUMNS:
        raise FileError(path, f"{len(header)} columns are more than {MAX_COLUMNS} - {_HINT}")
    present = ", ".join(map(str, header)) or "none"
    for name in columns:
        if header.count(name) != 1:
            problem = "is missing" if name not in header else f"occurs {header.count(name)} times"
            raise FileError(path, f"column {name!r} {problem}; found: {present} - {_HINT}")
    if len(set(header)) < len(header):
        raise FileError(path, f"a column occurs twice; found: {present} - {_HINT}")


def _check_names(path: Path, column: str, values: list[Any], kind: Kind) -> None:
    for value in values:
        problem = "not text" if not isinstance(value, str) else name_problem(value) if kind == "name" else ""
        if problem:
            raise FileError(path, f"column {column!r}: {str(value)[:100]!r} {problem} - {_HINT}")
