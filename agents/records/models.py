"""What is stored as JSON, described by models."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Final, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, NonNegativeInt, ValidationError, model_validator
from pydantic_core import PydanticCustomError

from agents.records.columns import CARRIED, CORE, CORE_FAILURES
from agents.terminal.names import name_problem
from probe_env.design import RANGES
from probe_env.envs.contexts import Context
from probe_env.envs.episodes.starts import Probes
from probe_env.envs.task import TaskConfig
from probe_env.files import MEBI, FileError, read_text
from probe_env.settings import explain

MOST_JSON: Final = 16 * MEBI
TRIAL_KPIS: Final = (*CORE, *CORE_FAILURES)
RESTORE: Final = "restore the file or choose another folder"


class Stored(BaseModel):
    """Base of what is stored: fields that nobody reads may be there, as newer versions add some."""

    model_config = ConfigDict(frozen=True, extra="allow")


S = TypeVar("S", bound=Stored)
Key = Annotated[str, Field(pattern=r"^[0-9a-f]{16}$")]


class Episode(Stored):
    """A line of ``episodes.jsonl``. Profiles may hold NaN: of the period in which a probe diverged."""

    key: Key
    unit: tuple[str, int, int]
    kpis: dict[str, FiniteFloat]
    profile: dict[str, list[float]]
    probe: dict[str, FiniteFloat] | None = None

    @model_validator(mode="after")
    def _whole(self) -> Self:
        _named("kpis", self.kpis, (*CORE, "complete", *CORE_FAILURES))
        _named("profile", self.profile, CARRIED)
        if len({len(values) for values in self.profile.values()}) > 1:
            raise PydanticCustomError("profile", "profile: its columns are not of one length")
        if self.probe is not None:
            _named("probe", self.probe, tuple(RANGES))
        return self


class Trial(Stored):
    """A line of ``designs.jsonl``."""

    key: Key
    kpis: dict[str, FiniteFloat]

    @model_validator(mode="after")
    def _whole(self) -> Self:
        _named("kpis", self.kpis, TRIAL_KPIS)
        return self


class Setting(Stored):
    """``setting.json``: what all episodes of a folder share. Fields that are newer than it have their defaults."""

    task: TaskConfig
    fidelity: dict[str, Any]
    code: str = ""
    """Hash of the code that made them."""
    probes: Probes = "scene"


class Machine(Stored):
    """Where something was made."""

    processor: str
    cores: int
    kernels: str = ""
    """What linear algebra and numba chose code for; not known of older records."""


class Record(Stored):
    """``provenance.json`` and its like."""

    command: str
    commit: str
    packages: dict[str, str]
    machine: Machine


class Figures(Stored):
    """``summary.json`` of a study: figures by name, and what made them."""

    provenance: Record


class Evaluated(Record):
    """``provenance.json`` of an evaluation."""

    policies: dict[str, dict[str, Any]]


class Unfinished(Evaluated):
    """``unfinished.json``: what an evaluation is to hold. It is gone once the tables are there."""

    contexts: tuple[Context, ...]
    episodes: tuple[tuple[Key, str, NonNegativeInt, NonNegativeInt], ...]
    """Key, policy, number of the context and seed of each."""

    @model_validator(mode="after")
    def _whole(self) -> Self:
        for _, policy, context, _ in self.episodes:
            problem = name_problem(policy)
            if not problem and (context >= len(self.contexts) or policy not in self.policies):
                problem = f"in tube {context} is of no such policy or tube"
            if problem:
                raise PydanticCustomError("episodes", "{text}", {"text": f"episodes: {policy!r} {problem}"})
        return self


class Compared(Stored):
    """``report.json``."""

    against: str
    own: tuple[str, ...] = ()
    """Policies that were given as files of the user's own."""


class Quality(Record):
    """``vibration-map.json``: how the map was made and how well it tells."""

    episodes: int
    held_out_tubes: int
    explained_variance: FiniteFloat
    mean_absolute_error_decades: FiniteFloat


def _named(field: str, given: dict[str, Any], needed: tuple[str, ...]) -> None:
    missing = [name for name in needed if name not in given]
    if missing:
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
