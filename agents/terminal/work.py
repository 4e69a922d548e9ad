"""What a command has to do and what of it is stored: said beforehand, and when it is interrupted.

Long work is announced once, with a way to count what is stored of it; files that are written one by one are noted as
they are. An interrupt asks for the account of both. Standard library only: interrupts are heard before packages load.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

FILES_NAMED = 6


@dataclass(frozen=True)
class Work:
    """Equal units of work that are stored one by one.

    Attributes:
        unit: what one is called, in the singular.
        total: how many there are, stored ones included.
        stored: counts those that are stored.
        place: where.
        go_on: what brings the rest.
    """

    unit: str
    total: int
    stored: Callable[[], int]
    place: Path | str
    go_on: str = "the same command goes on"

    def ahead(self) -> str:
        """What is to be done, in words; empty if nothing."""
        left = self.total - self.stored()
        share = _count(left, self.unit) if left == self.total else f"{left} of {_count(self.total, self.unit)}"
        return f"{share} to do, stored in {self.place} one by one" if left > 0 else ""

    def account(self) -> str:
        """What is stored, in words."""
        stored = self.stored()
        verb = "is" if stored == 1 else "are"
        return f"{stored} of {_count(self.total, self.unit)} {verb} stored in {self.place}; {self.go_on}"


_current: list[Work] = []
_files: list[Path] = []


def reset() -> None:
    """A new command begins: nothing is stored yet."""
    _current.clear()
    _files.clear()


def announce(work: Work, quiet: bool = False) -> None:
    """Say what is to be done, on the package's log; an interrupt tells what is stored of it from now on."""
    _current[:] = [work]
    ahead = "" if quiet else work.ahead()
    if ahead:
        import logging

        logging.getLogger("probe_env").info(ahead)


def note_file(path: Path) -> None:
    """A file was written as a whole."""
    if path not in _files:
        _files.append(path)


def account() -> str:
    """What the command has stored until now, in words."""
    if _current:
        return _current[0].account()
    files = [path for path in _files if path.exists()]
    if not files:
        return "nothing was stored"
    folders = list(dict.fromkeys(path.parent for path in files))
    names = [path.name for path in files[:FILES_NAMED]] + ["..."] * (len(files) > FILES_NAMED)
    verb = "is" if len(files) == 1 else "are"
    return f"{', '.join(names)} {verb} stored in {', '.join(map(str, folders))}, and nothing else"


def _count(number: int, unit: str) -> str:
    return f"{number} {unit}" + ("s" if number != 1 else "")
