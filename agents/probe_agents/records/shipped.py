"""Shipped files by name: agents, scenes, schedules, logs, tubes, designs, training files.

An installed package has them in ``probe_agents/shipped``, a checkout in ``configs`` and ``results``.
"""

import errno
from pathlib import Path
from typing import Final, Literal

from probe_agents.records.sources import file_and_sheet

Kind = Literal["agents", "scenes", "schedules", "logs", "tubes", "design", "train", "studies"]
PACKAGE: Final = Path(__file__).parents[1]
AGENT_FILE: Final = "agent.safetensors"
DEFAULT_SEED: Final = 0
"""Training seed of an agent whose name has none: the first, not the best. Published results use it."""
_PLURALS: Final[dict[Kind, str]] = {
    "agents": "agents", "scenes": "scenes", "schedules": "schedules", "logs": "logs", "tubes": "tubes",
    "design": "designs", "train": "training files", "studies": "studies",
}  # fmt: skip


class NoSuchFileError(FileNotFoundError):
    """Neither a file of this path nor a shipped one of this name.

    Attributes:
        hint: the names of the shipped files.
    """

    def __init__(self, name: str | Path, kind: Kind) -> None:
        super().__init__(errno.ENOENT, "no such file", str(name))
        self.hint = f"shipped {_PLURALS[kind]}: {', '.join(shipped_names(kind))}"


def shipped_folder(kind: Kind) -> Path:
    """Folder of the shipped files of a kind, in the installed package or in the checkout."""
    installed = PACKAGE / "shipped" / kind
    if installed.is_dir():
        return installed
    return PACKAGE.parents[1] / ("results" if kind == "agents" else "configs") / kind


def ships(kind: Kind, path: str | Path) -> bool:
    """Whether a path is in the folder of the shipped files of a kind."""
    return Path(path).resolve().is_relative_to(shipped_folder(kind).resolve())


def shipped_names(kind: Kind) -> tuple[str, ...]:
    """Names of the shipped files of a kind, without their endings."""
    return tuple(shipped_agents()) if kind == "agents" else tuple(path.stem for path in _files(kind))


def file_or_shipped(kind: Kind, name: str | Path) -> Path:
    """An existing file, also FILE#SHEET, else the shipped file of this name, with or without its ending."""
    file, _ = file_and_sheet(name)
    if file.exists() and not file.is_dir():
        return Path(name)
    for file in _files(kind):
        if str(name) in (file.stem, file.name):
            return file
    raise NoSuchFileError(name, kind)


def shipped_agents() -> dict[str, tuple[int, ...]]:
    """Names of the trained agents and the training seeds of each."""
    by_name: dict[str, list[int]] = {}
    for path in shipped_folder("agents").glob(f"*/seed-*/{AGENT_FILE}"):
        by_name.setdefault(path.parts[-3], []).append(int(path.parts[-2].removeprefix("seed-")))
    return {name: tuple(sorted(by_name[name])) for name in sorted(by_name)}


def policy_file(spec: str) -> str:
    """The path of a shipped agent, NAME or NAME@SEED, or schedule; any other spec is returned unchanged."""
    if Path(spec).suffix and Path(spec).exists():
        return spec
    name, at, seed = spec.partition("@")
    seeds = shipped_agents().get(name)
    if seeds is not None:
        if at and seed not in map(str, seeds):
            raise ValueError(f"policy = {spec!r}: the training seeds of {name} are {', '.join(map(str, seeds))}")
        return str(shipped_folder("agents") / name / f"seed-{seed or DEFAULT_SEED}" / AGENT_FILE)
    return next((str(path) for path in _files("schedules") if spec in (path.stem, path.name)), spec)


def _files(kind: Kind) -> list[Path]:
    files = (path for path in shipped_folder(kind).glob("*") if path.suffix in (".toml", ".csv"))
    return sorted(files, key=lambda path: path.stem)
