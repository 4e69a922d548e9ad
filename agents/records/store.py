"""A table on disk that grows row by row, so that interrupted work goes on where it stopped. No row is ever dropped."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from agents.records.provenance import commit, provenance, write_atomically, write_json
from agents.records.reading import FileError, read_csv
from agents.records.tables import Columns

CODE: Final = "code"
COMMIT: Final = "commit"
SUPERSEDED: Final = "superseded"
COLUMNS: Final[Columns] = {CODE: "text", COMMIT: "text", SUPERSEDED: "truth"}


def as_csv(table: pd.DataFrame, digits: int) -> str:
    """The table with so many digits, but time steps in full: settings are told apart by them."""
    exact = {name: table[name].map(repr) for name in ("time_step_s",) if name in table}
    return table.assign(**exact).to_csv(index=False, float_format=f"%.{digits}g")


def stored_rows(path: Path) -> pd.DataFrame:
    """The rows of a stored table that count: all but those that newer ones with the same keys took the place of."""
    return _counting(read_csv(path, COLUMNS))


class Store:
    """Rows of a CSV file with unique keys, each with the code (its hash) and the commit that made it.

    Rows of other code do not count as done. They stay in the file, marked as superseded once the same keys have been
    run again.

    Args:
        path: of the file; ``NAME-provenance.json`` goes beside it.
        keys: columns that tell rows apart.
        code: hash of the present code that a row depends on.
    """

    def __init__(self, path: Path, keys: tuple[str, ...], code: Callable[[Mapping[str, Any]], str]) -> None:
        self.path, self.keys, self._code = path, keys, code
        empty = pd.DataFrame(columns=[*keys, CODE, COMMIT, SUPERSEDED])
        self._rows = read_csv(path, COLUMNS) if path.exists() else empty
        missing = [name for name in map(str, empty) if name not in self._rows]
        if missing:
            raise FileError(path, f"no column {', '.join(missing)}: not a table of this kind; choose another folder")
        self._done = set(self.table[list(keys)].itertuples(index=False, name=None))

    @property
    def table(self) -> pd.DataFrame:
        """Rows of the present code."""
        rows = _counting(self._rows)
        records: list[Any] = rows.to_dict("records")
        present = np.array([self._code(record) == record[CODE] for record in records], dtype=bool)
        return rows[present].reset_index(drop=True)

    def has(self, *key: object) -> bool:
        """Whether a row with this key is there."""
        return key in self._done

    def add(self, *rows: Mapping[str, Any]) -> None:
        """Add rows, which supersede those with the same keys, and write the file."""
        origin = {COMMIT: commit(), SUPERSEDED: False}
        new = pd.DataFrame([dict(row) | {CODE: self._code(row)} | origin for row in rows])
        table = new if self._rows.empty else pd.concat([self._rows, new], ignore_index=True)
        old = table.duplicated(list(self.keys), keep="last")
        self._rows = table.assign(**{SUPERSEDED: table[SUPERSEDED].astype(bool) | old})
        write_atomically(self.path, as_csv(self._rows, 6))
        self._done.update(new[list(self.keys)].itertuples(index=False, name=None))
        commits = _counting(self._rows)[COMMIT]
        write_json(self.path.with_name(f"{self.path.stem}-provenance.json"), provenance(commits=commits))


def _counting(rows: pd.DataFrame) -> pd.DataFrame:
    return rows[~rows[SUPERSEDED].astype(bool)].drop(columns=SUPERSEDED).reset_index(drop=True)
