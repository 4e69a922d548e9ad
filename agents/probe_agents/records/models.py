"""Models of stored JSON files, their reader, and journals of finished work.

A journal has one line of JSON per record; each is on the disk before the next one starts.
"""

from __future__ import annotations

import json
import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Final, Generic, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic_core import PydanticCustomError

from probe_agents.records.atomic import named
from probe_agents.records.locks import run_lock
from probe_env.files import MEBI, FileError, as_text, open_regular, read_text
from probe_env.settings import explain

MAX_JSON: Final = 16 * MEBI
MAX_JOURNAL: Final = 4096 * MEBI
MAX_LINE: Final = 4 * MEBI
RESTORE: Final = "restore the file or choose another folder"


class Stored(BaseModel):
    """Base of stored records; unknown fields of newer versions are accepted."""

    model_config = ConfigDict(frozen=True, extra="allow")


S = TypeVar("S", bound=Stored)
Key = Annotated[str, Field(pattern=r"^[0-9a-f]{16}$")]


class Machine(Stored):
    """Machine that made a result."""

    processor: str
    cores: int


class Record(Stored):
    """``manifest.json`` and other records with the fields of ``manifest.origin``."""

    command: str
    commit: str
    packages: dict[str, str]
    machine: Machine


def require(field: str, values: Mapping[str, Any], names: Iterable[str]) -> None:
    """Raise PydanticCustomError if the mapping of a field lacks one of the names."""
    if missing := [name for name in names if name not in values]:
        raise PydanticCustomError("missing", "{text}", {"text": f"{field}: {', '.join(missing)} missing"})


def read_json(path: Path, model: type[S]) -> S:
    """A JSON file as a model.

    Raises:
        FileNotFoundError: no such file.
        FileError: not JSON, or invalid for the model.
    """
    return validate(path, "", read_text(path, MAX_JSON), model)


def validate(path: Path, prefix: str, text: str, model: type[S]) -> S:
    """A JSON text as a model; raises a ``FileError`` that names the file, the line (``prefix``) and every field."""
    try:
        return model.model_validate_json(text)
    except ValidationError as error:
        hint = f"remove the line (its work is repeated), or {RESTORE}" if prefix else RESTORE
        raise FileError(path, f"{prefix}{explain(error)} - {hint}") from error


class Journal(Generic[S]):
    """Records by key in a file of lines.

    Args:
        path: the file, which need not exist.
        model: model of a record, with a field ``key``.
    """

    def __init__(self, path: Path, model: type[S]) -> None:
        self.path, self.model = path, model

    def read(self) -> dict[str, dict[str, Any]]:
        """Records by key, the last one of each key; an incomplete last line is ignored.

        Raises:
            FileError: another line is not a record; names file and line.
        """
        records: dict[str, dict[str, Any]] = {}
        if not os.path.lexists(self.path):
            return records
        for number, line, _ in _lines(self.path):
            if line.endswith(b"\n") or not _cut_off(line):
                text = as_text(self.path, line, number)
                record = validate(self.path, f"line {number}: ", text, self.model).model_dump(exclude_none=True)
                records[record["key"]] = record
        return records

    @contextmanager
    def appending(self) -> Iterator[Callable[[str], None]]:
        """Context of a function that appends lines; they are on the disk when it returns.

        Raises:
            FileError: another process works in the folder.
        """
        with run_lock(self.path.parent):
            complete(self.path)
            with self.path.open("ab") as file:

                def append(lines: str) -> None:
                    with named(self.path):
                        file.write(lines.encode())
                        file.flush()
                        os.fsync(file.fileno())

                yield append


def complete(path: Path) -> None:
    """Prepare a journal for appending: remove an incomplete last line, end a complete one."""
    last = deque(_lines(path) if path.exists() else (), maxlen=1)
    _, line, begin = last[0] if last else (0, b"\n", 0)
    if line.endswith(b"\n"):
        return
    if _cut_off(line):
        os.truncate(path, begin)
    else:
        with path.open("ab") as file:
            file.write(b"\n")


def _lines(path: Path) -> Iterator[tuple[int, bytes, int]]:
    with open_regular(path, MAX_JOURNAL) as file:
        begin, number = 0, 0
        while line := file.readline(MAX_LINE + 1):
            number += 1
            if len(line) > MAX_LINE:
                raise FileError(path, f"line {number}: longer than the limit of {MAX_LINE} bytes - {RESTORE}")
            yield number, line, begin
            begin += len(line)


def _cut_off(line: bytes) -> bool:
    """Whether a line without an end is an incomplete record."""
    begin = b'{"key": "'
    if not (line.startswith(begin) or begin.startswith(line)) or b"\0" in line:
        return False
    try:
        json.loads(line)
    except (ValueError, RecursionError):
        return True
    return False
