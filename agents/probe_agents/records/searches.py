"""Opens the Optuna study of a search in an append-only journal file."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, Literal

import optuna
from optuna.storages import JournalStorage
from optuna.storages.journal import JournalFileBackend
from optuna.trial import TrialState

from probe_agents.records.atomic import named
from probe_agents.records.result_folder import CHECKSUM, is_intact, sealed
from probe_env.files import MEBI, FileError, one_line, read_bytes

JOURNAL: Final = "study.jsonl"
MAX_JOURNAL: Final = 1024 * MEBI


class _Journal(JournalFileBackend):
    """Optuna's journal with a checksum a line; errors name the file."""

    def append_logs(self, logs: list[dict[str, Any]]) -> None:
        with named(self._file_path):
            super().append_logs([sealed(log, (",", ":")) for log in logs])


def open_study(path: Path, name: str, directions: Sequence[Literal["minimize", "maximize"]]) -> optuna.Study:
    """The study of this name, created if it does not exist; unfinished trials of a killed process are marked as failed.

    An incomplete last line of the journal is removed. The caller has locked the folder, so a lock of Optuna's is one
    that a killed process has left.

    Raises:
        FileError: a line is not what was written.
    """
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    _check_lines(path)
    Path(f"{path}.lock").unlink(missing_ok=True)  # Optuna would wait half a minute for it
    try:
        storage = JournalStorage(_Journal(str(path)))
        if name in optuna.get_all_study_names(storage):
            study = optuna.load_study(study_name=name, storage=storage)
        else:
            study = optuna.create_study(study_name=name, storage=storage, directions=directions)
    except (LookupError, ValueError) as error:  # a line is missing
        reason = f"{type(error).__name__}: {one_line(str(error))}"
        raise FileError(path, f"not a journal of this search ({reason}): choose another folder") from error
    for trial in study.get_trials(deepcopy=False, states=(TrialState.RUNNING,)):
        study.tell(trial.number, state=TrialState.FAIL)
    return study


def _check_lines(path: Path) -> None:
    """Raise unless every line has its checksum; remove an incomplete last line."""
    if not os.path.lexists(path):
        return
    *lines, rest = read_bytes(path, MAX_JOURNAL).split(b"\n")
    for number, line in enumerate(lines, start=1):
        if not CHECKSUM.search(line) or not is_intact(line):
            problem = "its checksum is missing or does not fit: it was changed after it was written"
            raise FileError(path, f"line {number}: {problem} - choose another folder")
    if lines and not lines[0].startswith(b'{"op_code":0,'):
        raise FileError(path, "line 1: not the record of a study: choose another folder")
    if rest:
        os.truncate(path, sum(len(line) + 1 for line in lines))
