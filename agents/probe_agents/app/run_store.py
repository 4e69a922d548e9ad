"""Stored runs of the app's folder: finished, interrupted, and how to resume them."""

import re
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Final

from probe_agents.app.runs import RunRequest
from probe_agents.evaluation.folder import UNFINISHED, Unfinished, episodes_of, read_evaluation
from probe_agents.evaluation.report import ended
from probe_agents.evaluation.statistics import endings
from probe_agents.records.models import read_json
from probe_agents.terminal.messages import format_error

REQUEST: Final = "request.json"


@dataclass(frozen=True)
class StoredRun:
    """An evaluation folder."""

    folder: Path
    complete: bool  # whether all insertions are stored
    outcome: str  # how the insertions ended, or the error of the folder


def stored_runs(folder: Path) -> list[StoredRun]:
    """The evaluations in the subfolders of a folder, oldest first."""
    folders = {path.parent for name in ("episodes.parquet", UNFINISHED) for path in folder.glob(f"*/{name}")}
    return [stored_run(path) for path in sorted(folders)]


def stored_run(folder: Path) -> StoredRun:
    """One stored evaluation."""
    files = (folder / "episodes.parquet", folder / UNFINISHED, episodes_of(folder).path)
    return _read_run(folder, tuple(_modified(path) for path in files))


def _modified(path: Path) -> int:
    """Modification time [ns]; 0: no such file, perhaps since a moment ago, when a run ended."""
    try:
        return path.stat().st_mtime_ns
    except FileNotFoundError:
        return 0


@lru_cache(maxsize=4096)
def _read_run(folder: Path, changed: tuple[int, ...]) -> StoredRun:
    """Cached by the modification times of the files, since a page lists all folders repeatedly."""
    complete = not (folder / UNFINISHED).exists()
    try:
        if not complete:
            plan = read_json(folder / UNFINISHED, Unfinished)
            done = len({key for key, *_ in plan.episodes} & episodes_of(folder).read().keys())
            return StoredRun(folder, False, f"interrupted: {done} of {len(plan.episodes)} insertions are stored")
        ends = endings(read_evaluation(folder).table)
        outcomes = (f"{name}: {ended({str(k): int(v) for k, v in row.items()})}" for name, row in ends.iterrows())
        return StoredRun(folder, True, "; ".join(outcomes))
    except (ValueError, OSError) as error:
        return StoredRun(folder, complete, format_error(error))


def read_request(folder: Path) -> RunRequest:
    """The request of a stored run."""
    request = read_json(folder / REQUEST, RunRequest).model_copy(update={"output": folder})
    if request.manual:
        raise ValueError(f"{folder}: a manual drive cannot be resumed: start a new one under Manual")
    return request


def new_folder(parent: Path, name: str) -> Path:
    """Create a new numbered folder for a run."""
    while True:
        used = (re.match(r"(\d{3,})-", path.name) for path in parent.glob("*"))
        number = 1 + max((int(match[1]) for match in used if match), default=0)
        safe = re.sub(r"[^a-z0-9.-]+", "-", name.lower()).strip(".-")[:40] or "run"
        folder = parent / f"{number:03d}-{safe}"
        try:
            folder.mkdir(parents=True)
        except FileExistsError:  # another page was faster
            continue
        return folder
