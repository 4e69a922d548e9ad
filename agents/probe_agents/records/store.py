"""A CSV table that grows row by row; interrupted work continues from it."""

from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final, TypeVar

import pandas as pd
from joblib import Parallel, delayed
from tqdm import tqdm

from probe_agents.records.atomic import write_atomically
from probe_agents.records.manifest import commit
from probe_agents.records.result_folder import code_changed, run_lock
from probe_agents.records.tables import Columns, read_csv
from probe_agents.terminal.work import Work, announce
from probe_env.files import FileError

T = TypeVar("T")
Row = Mapping[str, Any]
COMMIT: Final = "commit"
COLUMNS: Final[Columns] = {COMMIT: "text"}


def as_csv(table: pd.DataFrame, digits: int) -> str:
    """The table with ``digits`` digits; time steps, which identify settings, with all digits."""
    exact = {name: table[name].map(repr) for name in ("time_step_s",) if name in table}
    return table.assign(**exact).to_csv(index=False, float_format=f"%.{digits}g")


def write_tables(folder: Path, tables: Mapping[str, pd.DataFrame], digits: int = 6) -> list[str]:
    """Write tables as NAME.csv, see ``as_csv``; returns the names of the files."""
    for name, table in tables.items():
        write_atomically(folder / f"{name}.csv", as_csv(table, digits))
    return [f"{name}.csv" for name in tables]


def stored_rows(path: Path) -> pd.DataFrame:
    """The rows of a stored table, of any commit."""
    return read_csv(path, COLUMNS)


def present_commit() -> str:
    """Commit of the checkout (``+changes`` if it was not clean), or the version of an installed package."""
    name = commit()
    return f"version {version('probe-env')}" if name == "unknown" else name


class Store:
    """Rows of a CSV file with unique keys, each with its commit.

    Args:
        path: the file.
        keys: columns that identify a row.

    Raises:
        FileError: the file is not such a table, or has rows of another commit.
    """

    def __init__(self, path: Path, keys: tuple[str, ...]) -> None:
        self.path, self.keys = path, keys
        self.table = stored_rows(path) if path.exists() else pd.DataFrame(columns=[*keys, COMMIT])
        if missing := [name for name in keys if name not in self.table]:
            raise FileError(path, f"no column {', '.join(missing)}: not a table of this study; choose another folder")
        if others := sorted(set(self.table[COMMIT]) - {present_commit()}):
            made = "these rows were simulated"
            raise FileError(path.parent, code_changed(made, "commit", ", ".join(others), present_commit()))
        self._done = set(self.table[list(keys)].itertuples(index=False, name=None))

    def has(self, *key: object) -> bool:
        """Whether a row with this key is stored."""
        return key in self._done

    def add(self, *rows: Row) -> None:
        """Add rows, replacing those with the same keys, and write the file."""
        new = pd.DataFrame([dict(row) | {COMMIT: present_commit()} for row in rows])
        table = new if self.table.empty else pd.concat([self.table, new], ignore_index=True)
        self.table = table.drop_duplicates(list(self.keys), keep="last", ignore_index=True)
        write_atomically(self.path, as_csv(self.table, 6))
        self._done.update(new[list(self.keys)].itertuples(index=False, name=None))

    def fill(
        self, runs: Mapping[tuple[Any, ...], T], rows_of: Callable[[T], Sequence[Row]], unit: str = "run", jobs: int = 1
    ) -> pd.DataFrame:
        """Run what is not stored yet and add the rows of each run when it ends; returns the whole table.

        Runs have the key of their last row; ``rows_of`` executes one, in ``jobs`` threads. The progress bar names the
        ``unit``.
        """
        missing = [run for key, run in runs.items() if not self.has(*key)]
        announce(Work(unit, len(runs), lambda: sum(self.has(*key) for key in runs), self.path))
        parallel = Parallel(n_jobs=jobs, prefer="threads", return_as="generator_unordered")
        work = parallel(delayed(rows_of)(run) for run in missing)
        with run_lock(self.path.parent):
            for rows in tqdm(work, total=len(missing), desc=self.path.stem, unit=unit, disable=not missing):
                self.add(*rows)
        return self.table
