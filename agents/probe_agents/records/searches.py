"""Opens the Optuna study of a search in an append-only journal file."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Final, Literal

import optuna
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend
from optuna.trial import TrialState

from probe_agents.records.atomic import named
from probe_agents.records.result_folder import is_intact, sealed
from probe_env.files import MEBI, FileError, one_line, read_bytes

JOURNAL: Final = "study.jsonl"
MAX_JOURNAL: Final = 1024 * MEBI


class _Journal(JournalFileBackend):
    """Optuna's journal with a checksum a line; errors name the file."""

    def append_logs(self, logs: list[dict[str, Any]]) -> None:
        with named(self._file_path):
            super().append_logs([sealed(log, (",", ":")) for log in logs])


def open_study(
    path: Path, name: str, directions: Sequence[Literal["minimize", "maximize"]], parameters: Iterable[str]
) -> optuna.Study:
    """The study of this name, created if it does not exist; unfinished trials of a killed process are marked as failed.

    The caller has locked the folder, so a lock of Optuna's is one that a killed process has left.

    Args:
        path: the journal; an incomplete last line is removed.
        name: name of the study.
        directions: "minimize" or "maximize" for each objective.
        parameters: names of the search parameters.

    Raises:
        FileError: not a journal, a damaged one, or a study with other objectives or parameters.
    """
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    try:
        _check_lines(path)
        Path(f"{path}.lock").unlink(missing_ok=True)  # Optuna would wait half a minute for it
        storage = JournalStorage(_Journal(str(path)))
        if name in optuna.get_all_study_names(storage):
            study = optuna.load_study(study_name=name, storage=storage)
        else:
            study = optuna.create_study(study_name=name, storage=storage, directions=directions)
        if [direction.name.lower() for direction in study.directions] != list(directions):
            raise ValueError(f"study {name!r} has other objectives")
        for trial in study.get_trials(deepcopy=False):
            if trial.state is TrialState.COMPLETE and set(trial.params) != set(parameters):
                raise ValueError(f"trial {trial.number} of study {name!r} has other parameters")
            if trial.state is TrialState.COMPLETE and not all(map(math.isfinite, trial.values)):
                raise ValueError(f"the values of trial {trial.number} are not finite")
            if trial.state is TrialState.RUNNING:
                study.tell(trial.number, state=TrialState.FAIL)
    except (FileError, OSError):
        raise
    except Exception as error:  # any error of Optuna for a damaged journal
        reason = f"{type(error).__name__}: {one_line(str(error))}"
        raise FileError(path, f"not a journal of this search ({reason}): choose another folder") from error
    return study


def _check_lines(path: Path) -> None:
    """Raise unless every line is a record; remove an incomplete last line."""
    if not os.path.lexists(path):
        return
    *lines, rest = read_bytes(path, MAX_JOURNAL).split(b"\n")
    if not all(b'"op_code"' in line and isinstance(json.loads(line), dict) for line in lines):
        raise ValueError("a line is not the record of a trial")
    if damaged := [number for number, line in enumerate(lines, start=1) if not is_intact(line)]:
        raise ValueError(f"line {damaged[0]}: its checksum does not fit: it was changed after it was written")
    if lines and not lines[0].startswith(b'{"op_code":0,'):
        raise ValueError("the first line is not the record of a study")
    if rest and not b'{"op_code":'.startswith(rest[:11]):
        raise ValueError("the last line is not the record of a trial")
    if rest:
        os.truncate(path, sum(len(line) + 1 for line in lines))
