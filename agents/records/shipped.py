"""Files that come with the package, by their names: agents, scenes, schedules, logs, tubes, designs, training files.

An installed package holds them in ``agents/shipped``; a checkout has them where they are made and edited. There is no
second copy: the wheel is built from the checkout's.
"""

from __future__ import annotations

import errno
from pathlib import Path
from typing import Final, Literal

Kind = Literal["agents", "scenes", "schedules", "logs", "tubes", "design", "train", "studies"]
PACKAGE: Final = Path(__file__).parents[1]
AGENT_FILE: Final = "agent.safetensors"
DEFAULT_SEED: Final = 0
"""Training seed of an agent that is named without one: the first, not the luckiest. What is published under the name of
an agent alone is this one's."""
_CALLED: Final[dict[Kind, str]] = {
    "agents": "agents", "scenes": "scenes", "schedules": "schedules", "logs": "logs", "tubes": "tubes",
    "design": "designs", "train": "training files", "studies": "studies",
}  # fmt: skip


class NoSuchFileError(FileNotFoundError):
    """Neither a file of this path nor a shipped one of this name.

    Attributes:
        hint: the names that there are.
    """

    def __init__(self, given: str | Path, kind: Kind) -> None:
        super().__init__(errno.ENOENT, "no such file", str(given))
        self.hint = f"{_CALLED[kind]} that ship, by name: {', '.join(shipped_names(kind))}"


def shipped_folder(kind: Kind) -> Path:
    """Where the files of a kind are: in the installed package ``agents``, else in the checkout that it stands in."""
    installed = PACKAGE / "shipped" / kind
    if installed.is_dir():
        return installed
    return PACKAGE.parent / ("results" if kind == "agents" else "configs") / kind


def ships(kind: Kind, path: str | Path) -> bool:
    """Whether a path is in the folder of the shipped files of a kind, however it is written."""
    return Path(path).resolve().is_relative_to(shipped_folder(kind).resolve())


def shipped_names(kind: Kind) -> tuple[str, ...]:
    """Names of the shipped files of a kind, without their endings."""
    return tuple(shipped_agents()) if kind == "agents" else tuple(path.stem for path in _files(kind))


def file_or_shipped(kind: Kind, given: str | Path) -> Path:
    """A file by its path, or a shipped one by its name, with or without its ending. A path that exists wins.

    Raises:
        NoSuchFileError: neither.
    """
    path = Path(given)
    if path.exists() and not path.is_dir():  # a folder of the same name is no such file
        return path
    for file in _files(kind):
        if str(given) in (file.stem, file.name):
            return file
    raise NoSuchFileError(given, kind)


def shipped_agents() -> dict[str, tuple[int, ...]]:
    """Names of the trained agents and the training seeds of each."""
    by_name: dict[str, list[int]] = {}
    for path in shipped_folder("agents").glob(f"*/seed-*/{AGENT_FILE}"):
        by_name.setdefault(path.parts[-3], []).append(int(path.parts[-2].removeprefix("seed-")))
    return {name: tuple(sorted(by_name[name])) for name in sorted(by_name)}


def agent_file(spec: str) -> Path | None:
    """The bundle of a trained agent, NAME or NAME@SEED; None if there is none of this name.

    Raises:
        ValueError: there is one, but not of this training seed.
    """
    name, at, seed = spec.partition("@")
    seeds = shipped_agents().get(name)
    if seeds is None:
        return None
    if at and seed not in map(str, seeds):
        raise ValueError(f"policy = {spec!r}: the training seeds of {name} are {', '.join(map(str, seeds))}")
    return shipped_folder("agents") / name / f"seed-{seed or DEFAULT_SEED}" / AGENT_FILE


def policy_file(spec: str) -> str:
    """The path of the trained agent or the schedule that ships under a name; what is no such name stays as it is.

    Raises:
        ValueError: an agent of this name has no such training seed.
    """
    if Path(spec).suffix and Path(spec).exists():
        return spec
    agent = agent_file(spec)
    if agent is not None:
        return str(agent)
    return next((str(path) for path in _files("schedules") if spec in (path.stem, path.name)), spec)


def _files(kind: Kind) -> list[Path]:
    files = (path for path in shipped_folder(kind).glob("*") if path.suffix in (".toml", ".csv"))
    return sorted(files, key=lambda path: path.stem)
