"""Models of stored JSON files and their reader; journals, so that work can be continued.

A journal has a line of JSON for each record, on the disk before the next one begins.
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

from probe_env.files import MEBI, FileError, as_text, open_regular, read_text
from probe_env.settings import explain

MOST_JSON: Final = 16 * MEBI
MOST_JOURNAL: Final = 4096 * MEBI
MOST_LINE: Final = 4 * MEBI
RESTORE: Final = "restore the file or choose another folder"


class Stored(BaseModel):
    """Base of stored records; further fields are allowed, as newer versions add some."""

    model_config = ConfigDict(frozen=True, extra="allow")


S = TypeVar("S", bound=Stored)
Key = Annotated[str, Field(pattern=r"^[0-9a-f]{16}$")]


class Machine(Stored):
    """Where something was made."""

    processor: str
    cores: int


class Record(Stored):
    """``manifest.json``, and records that embed ``manifest.origin``."""

    command: str
    commit: str
    packages: dict[str, str]
    machine: Machine


def require(field: str, values: Mapping[str, Any], names: Iterable[str]) -> None:
    """Raise PydanticCustomError if a mapping, the value of a field, lacks some names."""
    if missing := [name for name in names if name not in values]:
        raise PydanticCustomError("missing", "{text}", {"text": f"{field}: without {', '.join(missing)}"})


def read_json(path: Path, model: type[S]) -> S:
    """A JSON file as a model.

    Raises:
        FileNotFoundError: no such file.
        FileError: not JSON, or not what the model says.
    """
    return valid(path, "", read_text(path, MOST_JSON), model)


def valid(path: Path, place: str, text: str, model: type[S]) -> S:
    """What a text says, or a ``FileError`` that names the file, the place in it and every field."""
    try:
        return model.model_validate_json(text)
    except ValidationError as error:
        hint = RESTORE if not place else f"take the line out (what it held is run again), or {RESTORE}"
        raise FileError(path, f"{place}{explain(error)} - {hint}") from error


class Journal(Generic[S]):
    """Records by their keys in a file of lines.

    Args:
        path: of the file, which need not exist.
        model: of a record, with a field ``key``.
    """

    def __init__(self, path: Path, model: type[S]) -> None:
        self.path, self.model = path, model

    def read(self) -> dict[str, dict[str, Any]]:
        """Records by their keys; the later one of two with the same key, without a last line that was cut off.

        Raises:
            FileError: any other line is not a record: names file and line.
        """
        records: dict[str, dict[str, Any]] = {}
        if not os.path.lexists(self.path):
            return records
        for number, line, _ in _lines(self.path):
            if line.endswith(b"\n") or not _cut_off(line):
                text = as_text(self.path, line, number)
                record = valid(self.path, f"line {number}: ", text, self.model).model_dump(exclude_none=True)
                records[record["key"]] = record
        return records

    @contextmanager
    def appending(self) -> Iterator[Callable[[str], None]]:
        """A function that appends lines, while it is entered; they are on the disk when it returns."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        complete(self.path)
        with self.path.open("ab") as file:

            def append(lines: str) -> None:
                file.write(lines.encode())
                file.flush()
                os.fsync(file.fileno())

            yield append


def complete(path: Path) -> None:
    """Make a journal ready to be appended to: a last line that was cut off is removed, a whole one gets its end."""
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
    with open_regular(path, MOST_JOURNAL) as file:
        begin, number = 0, 0
        while line := file.readline(MOST_LINE + 1):
            number += 1
            if len(line) > MOST_LINE:
                raise FileError(path, f"line {number}: longer than the {MOST_LINE} bytes of any record - {RESTORE}")
            yield number, line, begin
            begin += len(line)


def _cut_off(line: bytes) -> bool:
    """Whether a line without an end is the beginning of a record, and not a whole one."""
    begin = b'{"key": "'
    if not (line.startswith(begin) or begin.startswith(line)) or b"\0" in line:
        return False
    try:
        json.loads(line)
    except (ValueError, RecursionError):
        return True
    return False
