"""Published results come from clean commits: what other code makes goes to a folder of its own."""

from __future__ import annotations

import dataclasses
import warnings
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, Final

from agents.records.provenance import CHECKOUT, DATA, changed_code, commit

PUBLISHED: Final = ("results", *DATA)
"""Folders of the checkout, and patterns of its files, that hold what README and docs say."""
ELSEWHERE: Final = Path("output") / "unpublished"


def check_checkout(command: str) -> None:
    """Raise ValueError if this is no checkout of the project, which alone holds what a command reads and writes."""
    if not (CHECKOUT / "configs" / "results.toml").exists():
        raise ValueError(f"{command} works in a checkout of the project, and this is an installed package")


def in_its_place(command: Any) -> Any:
    """A command (a dataclass) with its output paths led elsewhere if this code must not publish there."""
    paths = {f.name: value for f in dataclasses.fields(command) if isinstance(value := getattr(command, f.name), Path)}
    moved = {name: place(path) for name, path in paths.items() if name in ("output", "target", "work")}
    return dataclasses.replace(command, **moved)


def is_published(path: Path) -> bool:
    """Whether a path is one of ``PUBLISHED``, or lies in one."""
    whole = path.absolute()
    inner = [p.relative_to(CHECKOUT).as_posix() for p in (whole, *whole.parents) if p.is_relative_to(CHECKOUT)]
    return any(fnmatchcase(name, pattern) for name in inner for pattern in PUBLISHED)


def check_may_publish(folder: Path) -> None:
    """Raise ValueError if what is written there would publish something of changed code."""
    reason = _reason_against(folder)
    if reason:
        raise ValueError(f"{reason}: commit first, or give a copy of the folder")


def _reason_against(path: Path) -> str:
    """Why nothing may be written there; empty if it may."""
    if not is_published(path) or not commit().endswith("+changes"):
        return ""
    files = changed_code()
    shown = ", ".join(files[:3]) + (f" and {len(files) - 3} more" if len(files) > 3 else "")
    return f"{path} is published from clean commits only, and {shown} differ from the commit"


def place(path: Path) -> Path:
    """Where what was meant for ``path`` goes: below ``ELSEWHERE`` if it would publish results of changed code."""
    reason = _reason_against(path)
    if not reason:
        return path
    elsewhere = ELSEWHERE / path.absolute().relative_to(CHECKOUT)
    warnings.warn(f"{reason}: writing to {elsewhere}", stacklevel=2)
    return elsewhere
