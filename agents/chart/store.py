"""A table on disk that grows row by row, so that an interrupted chart goes on where it stopped."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from agents.provenance import kernel_hash, provenance, write_atomically, write_json

COLUMN = "kernels"
BASES = {"newmark (LAPACK)": "newmark", "references": "newmark"}


def as_csv(table: pd.DataFrame, digits: int) -> str:
    """The table with so many digits, but time steps in full: settings are told apart by them."""
    exact = {name: table[name].map(repr) for name in ("time_step",) if name in table}
    return table.assign(**exact).to_csv(index=False, float_format=f"%.{digits}g")


class Store:
    """Rows of a CSV file with unique keys; rows that other kernels made are dropped when it is opened.

    Args:
        path: of the file; ``NAME-provenance.json`` goes beside it.
        keys: columns that tell rows apart; "method" must be one.
    """

    def __init__(self, path: Path, keys: tuple[str, ...]) -> None:
        self.path, self.keys = path, keys
        self.table = pd.read_csv(path) if path.exists() else pd.DataFrame(columns=[*keys, COLUMN])
        present = self.table["method"].map(_hash)
        self.table = self.table[self.table[COLUMN] == present].reset_index(drop=True)
        self._done = set(self.table[list(keys)].itertuples(index=False, name=None))

    def has(self, *key: object) -> bool:
        """Whether a row with this key is there."""
        return key in self._done

    def add(self, *rows: Mapping[str, Any]) -> None:
        """Add rows, in place of those with the same keys, and write the file."""
        new = pd.DataFrame([dict(row) | {COLUMN: _hash(str(row["method"]))} for row in rows])
        table = new if self.table.empty else pd.concat([self.table, new], ignore_index=True)
        self.table = table.drop_duplicates(list(self.keys), keep="last").reset_index(drop=True)
        write_atomically(self.path, as_csv(self.table, 6))
        self._done.update(new[list(self.keys)].itertuples(index=False, name=None))
        write_json(self.path.with_name(f"{self.path.stem}-provenance.json"), provenance())


def _hash(method: str) -> str:
    return kernel_hash(BASES.get(method, method))
