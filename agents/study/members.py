"""The members of an ensemble, run some at a time and stored as they finish."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np
import pandas as pd
from joblib import Parallel, delayed
from tqdm import tqdm

from agents.records.store import Store, stored_rows
from agents.terminal.work import Work, announce

KEYS = ("case", "member", "duration_s")


class Named(Protocol):
    """A case of an ensemble."""

    @property
    def name(self) -> str:
        """Its rows are stored under."""


C = TypeVar("C", bound=Named)


def run_members(
    wanted: Sequence[tuple[C, int]],
    run: Callable[[C, int], dict[str, Any]],
    store: Store,
    duration: float,
    jobs: int,
) -> pd.DataFrame:
    """The wanted members of cases, of this duration [s]; those that the store has are not run again.

    Args:
        wanted: cases and numbers of their members, in the order in which they are run.
        run: one member of a case, as a row with the ``KEYS``.
        store: where rows go as they finish.
        duration: of a run [s].
        jobs: runs at the same time, as threads.
    """

    def stored() -> int:
        return sum(store.has(case.name, member, duration) for case, member in wanted)

    missing = [(case, member) for case, member in wanted if not store.has(case.name, member, duration)]
    announce(Work("run", len(wanted), stored, store.path))
    parallel = Parallel(n_jobs=jobs, prefer="threads", return_as="generator_unordered")
    work = parallel(delayed(run)(case, member) for case, member in missing)
    for row in tqdm(work, total=len(missing), desc="study", unit="run", disable=not missing):
        store.add(row)
    table = store.table
    keys = {(case.name, member) for case, member in wanted}
    asked = [key in keys for key in zip(table["case"], table["member"], strict=True)]
    return _in_order(table[np.array(asked, dtype=bool) & (table["duration_s"] == duration)])


def load_members(path: Path, duration: float) -> pd.DataFrame:
    """Stored rows of a duration [s]; none if there is no file."""
    if not path.exists():
        return pd.DataFrame()
    table = stored_rows(path)
    return _in_order(table[table["duration_s"] == duration])


def _in_order(table: pd.DataFrame) -> pd.DataFrame:
    return table.sort_values(["case", "member"]).reset_index(drop=True)
