"""Progress of a command: the remaining work, and what is stored after an interrupt.

Standard library only: an interrupt can come before packages are loaded.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

FILES_NAMED = 6


@dataclass(frozen=True)
class Work:
    """Equal units of work that are stored one by one.

    Attributes:
        unit: name of a unit, singular.
        total: number of units, including stored ones.
        stored: function for the number of stored units.
        folder: where they are stored.
        advice: how to continue.
        seconds: estimated time of a unit [s]; 0: not known.
    """

    unit: str
    total: int
    stored: Callable[[], int]
    folder: Path | str
    advice: str = "the same command continues"
    seconds: float = 0.0

    def remaining_text(self) -> str:
        """Number of units to do, and their time if it is more than a minute; empty if none."""
        left = self.total - self.stored()
        fraction = _count(left, self.unit) if left == self.total else f"{left} of {_count(self.total, self.unit)}"
        minutes = left * self.seconds / 60.0
        about = f"about {minutes:.0f} min" if minutes < 100.0 else f"about {minutes / 60.0:.0f} h"
        time = f", {about}" if minutes > 1.0 else ""
        return f"{fraction} to do{time}, stored in {_escaped(self.folder)} one by one" if left > 0 else ""

    def stored_text(self) -> str:
        """Number of stored units, and how to continue."""
        stored = self.stored()
        verb = "is" if stored == 1 else "are"
        return f"{stored} of {_count(self.total, self.unit)} {verb} stored in {_escaped(self.folder)}; {self.advice}"


_current: list[Work] = []
_files: list[Path] = []


def reset() -> None:
    """Start a new command: nothing is stored yet."""
    _current.clear()
    _files.clear()


def announce(work: Work, quiet: bool = False) -> None:
    """Log the remaining work; from now on an interrupt reports what is stored of it."""
    _current[:] = [work]
    text = "" if quiet else work.remaining_text()
    if text:
        import logging

        logging.getLogger("probe_env").info(text)


def note_file(path: Path) -> None:
    """Record that a file was written."""
    if path not in _files:
        _files.append(path)


def stored_text() -> str:
    """What the command has stored so far."""
    if _current:
        return _current[0].stored_text()
    files = [path for path in _files if path.exists()]
    if not files:
        return "nothing was stored"
    folders = list(dict.fromkeys(path.parent for path in files))
    names = [_escaped(path.name) for path in files[:FILES_NAMED]] + ["..."] * (len(files) > FILES_NAMED)
    verb = "is" if len(files) == 1 else "are"
    return f"{', '.join(names)} {verb} stored in {', '.join(map(_escaped, folders))}; nothing else is"


def _escaped(path: Path | str) -> str:
    from probe_env.files import escaped  # loaded where there is work

    return escaped(str(path))


def _count(number: int, unit: str) -> str:
    return f"{number} {unit}" + ("s" if number != 1 else "")
