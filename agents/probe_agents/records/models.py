"""Models of stored JSON files, and their reader."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Final, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from probe_env.files import MEBI, FileError, read_text
from probe_env.settings import explain

MAX_JSON: Final = 16 * MEBI
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
    """Raise ValueError if the mapping of a field lacks one of the names."""
    if missing := [name for name in names if name not in values]:
        raise ValueError(f"{field}: {', '.join(missing)} missing")


def read_json(path: Path, model: type[S]) -> S:
    """A JSON file as a model."""
    return validate(path, "", read_text(path, MAX_JSON), model)


def validate(path: Path, prefix: str, text: str, model: type[S]) -> S:
    """A JSON text as a model; raises a ``FileError`` that names the file, the line (``prefix``) and every field."""
    try:
        return model.model_validate_json(text)
    except ValidationError as error:
        hint = f"remove the line (its work is repeated), or {RESTORE}" if prefix else RESTORE
        raise FileError(path, f"{prefix}{explain(error)} - {hint}") from error
