"""Optuna's databases: opened only if they are whole, free and of this search; passwords are never told."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Final

import optuna
from optuna.study import StudyDirection
from optuna.trial import TrialState
from sqlalchemy.engine import make_url
from sqlalchemy.exc import SQLAlchemyError

from agents.terminal.masking import masked
from probe_env.files import MEBI, FileError, one_line, open_regular

MAGIC: Final = b"SQLite format 3\0"
MOST_DATABASE: Final = 16384 * MEBI
PATIENCE: Final = 2.0
"""Seconds that another process may hold the database."""
_RESTORE: Final = "restore the file, or choose another folder"
_TABLES: Final = {"studies", "study_directions", "trials", "trial_params", "trial_values", "trial_user_attributes"}
"""Of Optuna's schema, without which there is nothing to go on with."""
_UNUSABLE: Final = (
    SQLAlchemyError, optuna.exceptions.OptunaError, ImportError, ValueError, RuntimeError, LookupError, TypeError,
    AttributeError,
)  # fmt: skip
"""What Optuna and SQLAlchemy end in where a database or its URL is not what they expect, or a cell of it is damaged."""


def open_study(
    storage: str,
    name: str,
    directions: Sequence[str],
    parameters: Iterable[str],
    sampler: optuna.samplers.BaseSampler | None = None,
) -> optuna.Study:
    """Optuna's study of a name, made if it is not there.

    Args:
        storage: URL of any storage that Optuna knows.
        name: of the study.
        directions: of its objectives, "minimize" or "maximize".
        parameters: names of what is searched.
        sampler: of new trials.

    Raises:
        FileError: a SQLite file that is damaged, locked, or something else's; nothing in it is changed.
        ValueError: no such database, or a study of that name with other objectives or parameters.
    """
    path = _sqlite_file(storage)
    if path is not None and path.exists():
        _check_sqlite(path)
    place, wanted = str(path or masked(storage)), [StudyDirection[direction.upper()] for direction in directions]
    try:
        study = optuna.create_study(
            storage=storage, study_name=name, directions=wanted, load_if_exists=True, sampler=sampler
        )
        _check_study(place, study, wanted, set(parameters))
    except FileError:
        raise
    except _UNUSABLE as error:
        reason = _without_password(str(getattr(error, "orig", None) or error), storage)
        if path is not None:
            raise FileError(path, f"cannot be used as a database: {reason}") from None
        message = one_line(f"storage = {place!r} is not the URL of a database that can be used: {reason}")
        raise ValueError(message) from None
    return study


def _sqlite_file(storage: str) -> Path | None:
    try:
        url = make_url(storage)
        return Path(url.database) if url.get_backend_name() == "sqlite" and url.database else None
    except (SQLAlchemyError, ValueError):
        return None


def _check_sqlite(path: Path) -> None:
    """Raise unless SQLite finds the file whole and nobody writes to it; an empty one is new to SQLite."""
    with open_regular(path, MOST_DATABASE) as file:
        begin = file.read(len(MAGIC))
    if begin and begin != MAGIC:
        raise FileError(path, f"not a database of SQLite - {_RESTORE}")
    connection = sqlite3.connect(path, timeout=PATIENCE, isolation_level=None)
    try:
        connection.execute("BEGIN IMMEDIATE")
        tables = {str(row[0]) for row in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
        faults = [str(row[0]) for row in connection.execute("PRAGMA quick_check(1)")]
        connection.execute("ROLLBACK")
    except (sqlite3.Error, UnicodeDecodeError) as error:
        if "locked" in str(error):
            hint = "another search is writing to it: wait for its end, or choose another folder"
            raise FileError(path, f"locked by another process - {hint}") from None
        raise FileError(path, f"a damaged database: {error} - {_RESTORE}") from None
    finally:
        connection.close()
    if faults != ["ok"]:
        raise FileError(path, f"a damaged database: {faults[0] if faults else 'empty'} - {_RESTORE}")
    missing = _TABLES - tables if "studies" in tables else set()
    if missing:
        raise FileError(path, f"a damaged database: without the table {', '.join(sorted(missing))} - {_RESTORE}")
    if tables and "studies" not in tables:
        raise FileError(path, f"a database of something else (tables {', '.join(sorted(tables)[:5])}) - {_RESTORE}")


def _check_study(place: str, study: optuna.Study, wanted: list[StudyDirection], parameters: set[str]) -> None:
    other = f"study {study.study_name!r} is of another search"
    if study.directions != wanted:
        raise FileError(place, f"{other}: it has other objectives - choose another folder or storage")
    for trial in study.get_trials(deepcopy=False):
        if not isinstance(trial.user_attrs.get("commit", ""), str):
            raise FileError(place, f"trial {trial.number}: its commit is no text - {_RESTORE}")
        if trial.state is not TrialState.COMPLETE:
            continue
        if set(trial.params) != parameters or not _finite(trial.values, len(wanted)):
            raise FileError(place, f"{other}: trial {trial.number} has other parameters or figures - {_RESTORE}")
        for name, value in trial.params.items():
            if not _within(trial.distributions[name], value):
                raise FileError(place, f"trial {trial.number}: {name} = {value!r} is outside its range - {_RESTORE}")


def _finite(values: Any, count: int) -> bool:
    return isinstance(values, list) and len(values) == count and all(abs(value) < float("inf") for value in values)


def _within(distribution: Any, value: Any) -> bool:
    """Whether a value may have been drawn from one of Optuna's distributions."""
    if isinstance(distribution, optuna.distributions.CategoricalDistribution):
        return value in distribution.choices
    return isinstance(value, int | float) and bool(distribution.low <= value <= distribution.high)


def _without_password(text: str, storage: str) -> str:
    """The first line of an error, without the password, which some drivers repeat in other forms than the URL's."""
    first = masked(text.strip().splitlines()[0] if text.strip() else "no reason given").replace(
        storage, masked(storage)
    )
    try:
        password = make_url(storage).password
    except (SQLAlchemyError, ValueError):
        password = None
    return first.replace(str(password), "***") if password else first
