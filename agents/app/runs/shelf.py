"""The runs of a folder as they are on the disk: what was finished, what was interrupted and how it goes on."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Final

from agents.app.runs.wanted import Wanted
from agents.evaluation.folder import UNFINISHED, Evaluation, Unfinished, episodes_of, read_evaluation
from agents.evaluation.report import ended
from agents.evaluation.statistics import endings
from agents.records.models import read_json
from agents.terminal.refusals import refusal

WHOLE: Final = "provenance.json"


@dataclass(frozen=True)
class Stored:
    """A folder of an evaluation.

    Attributes:
        folder: where.
        whole: whether everything that was wanted is there.
        outcome: how its insertions ended, or what is wrong with it, in words.
    """

    folder: Path
    whole: bool
    outcome: str


def stored_runs(folder: Path) -> list[Stored]:
    """The evaluations in the folders of a folder, the oldest first."""
    folders = [path for path in folder.glob("*") if (path / WHOLE).exists() or (path / UNFINISHED).exists()]
    return [described(path) for path in sorted(folders, key=lambda path: path.name)]


def described(folder: Path) -> Stored:
    """A stored evaluation, in words."""
    files = (folder / WHOLE, folder / UNFINISHED, episodes_of(folder).path)
    return _described(folder, tuple(path.stat().st_mtime_ns if path.exists() else 0 for path in files))


@lru_cache(maxsize=4096)
def _described(folder: Path, changed: tuple[int, ...]) -> Stored:
    """As it was when its files had last changed: a page lists all folders again and again."""
    whole = not (folder / UNFINISHED).exists()
    try:
        if not whole:
            plan = read_json(folder / UNFINISHED, Unfinished)
            done = len({key for key, *_ in plan.episodes} & episodes_of(folder).read().keys())
            return Stored(folder, False, f"interrupted: {done} of {len(plan.episodes)} insertions are stored")
        return Stored(folder, True, _outcomes(read_evaluation(folder)))
    except (ValueError, OSError) as error:
        return Stored(folder, whole, refusal(error))


def _outcomes(done: Evaluation) -> str:
    """How the insertions of each policy ended."""
    ends = endings(done.table)
    return "; ".join(f"{name}: {ended({str(k): int(v) for k, v in row.items()})}" for name, row in ends.iterrows())


def unfinished(folder: Path) -> Wanted:
    """What goes on with an interrupted evaluation.

    Raises:
        FileNotFoundError: there is none.
        ValueError: it is damaged, or was not begun by a command that goes on here.
    """
    return Wanted.of_command(read_json(folder / UNFINISHED, Unfinished).command, folder)


def free_folder(folder: Path, name: str) -> Path:
    """A folder for a new run, numbered: no run is written into that of another."""
    used = (re.match(r"(\d{3,})-", path.name) for path in folder.glob("*"))
    number = 1 + max((int(match[1]) for match in used if match), default=0)
    return folder / f"{number:03d}-{re.sub(r'[^a-z0-9.-]+', '-', name.lower()).strip('.-')[:40] or 'run'}"
