"""Tables on disk, CSV and Parquet: the columns that are needed, of the kind that they should be.

Names stay text whatever they look like (``null``, ``1e5``, ``NA``), and numbers are read exactly.
"""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, Literal

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from agents.records.columns import CARRIED, CORE, CORE_FAILURES, COST_KPIS, HEARD, KPIS
from agents.terminal.names import name_problem
from probe_env.envs.contexts import Context
from probe_env.envs.task import ENDINGS
from probe_env.files import MEBI, FileError, read_bytes, read_text
from probe_env.inspection.tally import POD_NAMES

Kind = Literal["name", "text", "count", "number", "maybe", "truth"]
"""A name (``agents.terminal.names``); any text; a whole number of 0 or more; a finite number; a number or nothing; a
truth."""
Columns = Mapping[str, Kind]
MOST_CSV: Final = 64 * MEBI
MOST_PARQUET: Final = 1024 * MEBI
MOST_ROWS: Final = 20_000_000
MOST_COLUMNS: Final = 1000
PLACE: Final[dict[str, Kind]] = {"policy": "name", "context": "count", "seed": "count"}
EPISODES: Final[Columns] = {
    **PLACE, **dict.fromkeys((*Context.model_fields, *CORE, "complete", *CORE_FAILURES), "number")
}  # fmt: skip
"""``episodes.csv`` and ``episodes.parquet``: what every one has."""
EPISODES_NEWER: Final[Columns] = dict.fromkeys((*KPIS, *COST_KPIS, *POD_NAMES, *ENDINGS), "number")
PROFILE_HEARD: Final[Columns] = dict.fromkeys(HEARD, "maybe")
"""What both have that were stored since there is such a figure."""
PROFILE: Final[Columns] = {**dict.fromkeys(CARRIED, "maybe"), **PLACE}
"""``profile.parquet``: metres of episodes; NaN where a probe diverged."""
FRONT: Final[Columns] = {
    "family": "name", "value": "maybe",
    **dict.fromkeys(("time_s", "time_low", "time_high", "out_share", "out_low", "out_high"), "number"),
}  # fmt: skip
"""``tradeoff/front.csv``; a single policy has no value."""
CURVE: Final[Columns] = {
    **dict.fromkeys(("seed", "phase", "steps"), "count"),
    **dict.fromkeys(("reward", "inspection_time_s", "share_within_limit"), "number"),
    **dict.fromkeys(("validation_s", "wall_s", "kernel_s"), "number"),
}  # fmt: skip
"""``learning.csv``."""
COSTS: Final[Columns] = {
    "method": "text", "nodes_per_pitch": "count", "carrier_length_m": "number", "ns_per_node_step": "number"
}  # fmt: skip
"""``chart/costs.csv``."""
_NONE: Final[Columns] = MappingProxyType({})
_HINT: Final = "restore the file, or make it again"


def read_episodes(path: Path) -> pd.DataFrame:
    """A table of episodes, CSV or Parquet: what every one has, and the KPIs that this one has.

    Raises:
        FileNotFoundError: no such file.
        FileError: it is damaged.
    """
    return (read_csv if path.suffix == ".csv" else read_parquet)(path, EPISODES, EPISODES_NEWER)


HASHES: Final = ("code", "commit")
"""Columns that are text, though the digits of a hash may all be decimal, or one of them an e between decimal ones."""


def read_csv(path: Path, columns: Columns = _NONE, newer: Columns = _NONE) -> pd.DataFrame:
    """A CSV table with a header and the needed columns; those of ``newer`` are of their kind where there are any.

    Columns that are not named are numbers, truths or text, as all of their cells allow.

    Raises:
        FileNotFoundError: no such file.
        FileError: not CSV, or a needed column is missing or not of its kind.
    """
    table = csv.reader(re.split("\r\n|\r|\n", read_text(path, MOST_CSV)), strict=True)
    try:
        rows = [(table.line_num, row) for row in table if row]
    except csv.Error as error:
        raise FileError(path, f"line {table.line_num}: not CSV: {error} - {_HINT}") from error
    header = rows[0][1] if rows else []
    columns = _present(columns, newer, header)
    _check_header(path, header, columns)
    for line, row in rows[1:]:
        if len(row) != len(header):
            raise FileError(path, f"line {line}: {len(row)} values for {len(header)} columns - {_HINT}")
    lines = [line for line, _ in rows[1:]]
    cells = zip(*(row for _, row in rows[1:]), strict=True) if len(rows) > 1 else ([] for _ in header)
    converted = {
        name: _converted(path, name, list(values), lines, columns[name])
        if name in columns
        else _inferred(list(values), name in HASHES)
        for name, values in zip(header, cells, strict=True)
    }
    return check_table(path, pd.DataFrame(converted), columns)


def read_parquet(path: Path, columns: Columns, newer: Columns = _NONE) -> pd.DataFrame:
    """The needed columns of a Parquet table, and those of ``newer`` that it has, in the file's order.

    Raises:
        FileNotFoundError: no such file.
        FileError: not Parquet, more rows than any table has, or a needed column is missing or not of its kind.
    """
    content = read_bytes(path, MOST_PARQUET)
    texts = [name for name, kind in columns.items() if kind in ("name", "text")]
    try:
        file = pq.ParquetFile(io.BytesIO(content))
        names, rows = list(file.schema_arrow.names), file.metadata.num_rows
        columns = _present(columns, newer, names)
        _check_header(path, names, columns)
        if not 0 < rows <= MOST_ROWS:
            raise FileError(path, f"{rows} rows: a table has 1 to {MOST_ROWS} - {_HINT}")
        dictionaries = pq.ParquetFile(io.BytesIO(content), read_dictionary=texts)
        table = dictionaries.read(columns=[name for name in names if name in columns])
    except (pa.ArrowException, OSError, ValueError, MemoryError) as error:
        if isinstance(error, FileError):
            raise
        raise FileError(path, f"not a Parquet file that can be read: {error} - {_HINT}") from error
    for name in texts:  # a short dictionary may stand for millions of long texts
        kind = table.schema.field(name).type
        if not (pa.types.is_dictionary(kind) and pa.types.is_string(kind.value_type)):
            raise FileError(path, f"column {name!r}: {kind}, not text - {_HINT}")
        for chunk in table.column(name).chunks:
            _check_names(path, name, chunk.dictionary.to_pylist(), columns[name])
    frame = table.to_pandas(ignore_metadata=True)
    return check_table(path, frame.astype(dict.fromkeys(texts, str)), columns)


def _present(columns: Columns, newer: Columns, header: list[Any]) -> Columns:
    """The needed columns, and the newer ones that a table has."""
    return {**columns, **{name: kind for name, kind in newer.items() if name in header}}


def check_table(path: Path, table: pd.DataFrame, columns: Columns, newer: Columns = _NONE) -> pd.DataFrame:
    """The table itself, if it has rows and the columns that are needed, and these and newer ones are of their kinds.

    Raises:
        FileError: names file, column and row (the first is 1).
    """
    columns = _present(columns, newer, list(table.columns))
    _check_header(path, list(table.columns), columns)
    if table.empty:
        raise FileError(path, f"no rows - {_HINT}")
    for name, kind in columns.items():
        values = table[name]
        if kind in ("name", "text"):
            _check_names(path, name, list(values.unique()), kind)
        elif values.dtype.kind not in ("b" if kind == "truth" else "iuf"):
            raise FileError(
                path, f"column {name!r}: {values.dtype}, not {'truths' if kind == 'truth' else 'numbers'} - {_HINT}"
            )
        elif kind in ("count", "number"):
            numbers = values.to_numpy()
            bad = ~np.isfinite(numbers) if kind == "number" else ~((numbers >= 0) & (numbers == np.floor(numbers)))
            if bad.any():
                row, what = int(bad.argmax()), "finite" if kind == "number" else "a whole number of 0 or more"
                raise FileError(path, f"row {row + 1}: {name} = {numbers[row]} is not {what} - {_HINT}")
    return table


def _check_header(path: Path, header: list[Any], columns: Columns) -> None:
    if len(header) > MOST_COLUMNS:
        raise FileError(path, f"{len(header)} columns are more than {MOST_COLUMNS} - {_HINT}")
    present = ", ".join(map(str, header)) or "none"
    for name in columns:
        if header.count(name) != 1:
            often = "is missing" if name not in header else f"is there {header.count(name)} times"
            raise FileError(path, f"column {name!r} {often}; found: {present} - {_HINT}")
    if len(set(header)) < len(header):
        raise FileError(path, f"a column is there twice; found: {present} - {_HINT}")


def _check_names(path: Path, column: str, values: list[Any], kind: Kind) -> None:
    for value in values:
        problem = "not text" if not isinstance(value, str) else name_problem(value) if kind == "name" else ""
        if problem:
            raise FileError(path, f"column {column!r}: {str(value)[:100]!r} {problem} - {_HINT}")


def _converted(path: Path, name: str, cells: list[str], lines: list[int], kind: Kind) -> list[Any] | np.ndarray:
    if kind in ("name", "text", "truth"):
        return _inferred(cells) if kind == "truth" else cells
    numbers: list[float] = []
    for line, cell in zip(lines, cells, strict=True):
        number = _number(cell) if cell or kind != "maybe" else math.nan
        if number is None:
            raise FileError(path, f"line {line}: {name} = {cell[:100]!r} is not a number - {_HINT}")
        numbers.append(number)
    if kind == "count" and all(number.is_integer() and abs(number) < 2**53 for number in numbers):
        return np.array(numbers, dtype=np.int64)
    return np.array(numbers)


def _inferred(cells: list[str], text: bool = False) -> list[Any] | np.ndarray:
    """A column that nothing is said of: as pandas would take it, but numbers are exact."""
    if text:
        return [cell or math.nan for cell in cells]
    if any(cells) and all(cell in ("True", "False") for cell in cells):
        return np.array([cell == "True" for cell in cells])
    if any(cells) and all(re.fullmatch(r"[+-]?\d{1,18}", cell, re.ASCII) for cell in cells):
        return np.array([int(cell) for cell in cells], dtype=np.int64)
    numbers = [_number(cell) if cell else math.nan for cell in cells]
    if all(number is not None for number in numbers):
        return np.array(numbers, dtype=float)
    return [cell or math.nan for cell in cells]


def _number(cell: str) -> float | None:
    try:
        return float(cell)
    except ValueError:
        return None
