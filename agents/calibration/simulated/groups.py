"""Groups of simulated tubes, a file each, so that interrupted work goes on: of one fidelity, and whole."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, Final

import pandas as pd
from tqdm import tqdm

from agents.processes.workers import Workers
from agents.records.provenance import commit, write_atomically
from agents.records.reading import FileError, read_csv
from agents.records.store import COMMIT
from agents.records.tables import Columns
from agents.terminal.work import Work, announce

FIDELITY: Final = "fidelity"
Rows = list[dict[str, Any]]


def run_groups(
    make: Callable[[int], Iterable[Rows]],
    count: int,
    fidelity: str,
    folder: Path,
    columns: Columns,
    workers: Workers,
    words: str,
) -> pd.DataFrame:
    """Rows of the first groups, each with the commit that made it; those that are stored are not made again.

    Args:
        make: rows of a group by its number, as the one item of a task.
        count: how many groups.
        fidelity: preset that they are simulated with.
        folder: of the files, group-0.csv and so on.
        columns: that rows must have.
        workers: that make them.
        words: what the bar says.

    Raises:
        FileError: a stored group is damaged, or of another fidelity; nothing was run.
    """
    files = [folder / f"group-{group}.csv" for group in range(count)]
    missing = [group for group, file in enumerate(files) if not file.exists()]
    for file in files:
        if file.exists():
            _stored(file, fidelity, columns)
    announce(Work("group", count, lambda: sum(file.exists() for file in files), folder))
    stream = workers.stream(make, missing)
    for group, rows in tqdm(stream, total=len(missing), desc=words, unit="group"):
        table = pd.DataFrame(rows).assign(**{FIDELITY: fidelity, COMMIT: commit()})
        write_atomically(files[group], table.to_csv(index=False, float_format="%.6g"))
    return pd.concat([_stored(file, fidelity, columns) for file in files], ignore_index=True)


def _stored(file: Path, fidelity: str, columns: Columns) -> pd.DataFrame:
    table = read_csv(file, {FIDELITY: "text", **columns}, newer={COMMIT: "text"})
    if COMMIT not in table:  # begun when rows did not know theirs
        table[COMMIT] = ""
    others = sorted(set(table[FIDELITY]) - {fidelity})
    if others:
        raise FileError(file, f"is of fidelity = {', '.join(others)!r}, not {fidelity!r}: choose another folder")
    return table
