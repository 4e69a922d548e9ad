"""Models of stored JSON files, and their reader."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Final, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic_core import PydanticCustomError

from probe_env.files import MEBI, FileError, read_text
from probe_env.settings import explain

MOST_JSON: Final = 16 * MEBI
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
    kernels: str = ""
    """What linear algebra and numba chose code for; not known of older records."""


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
