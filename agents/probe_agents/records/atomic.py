"""Atomic writes: a file is either the old or the new one."""

import os
import platform
import re
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from probe_agents.terminal.work import note_file

STANDARD_OUTPUT: Final = frozenset({Path("-"), Path("/dev/stdout")})
"""Output files of ``write_text`` that mean: print it."""


def write_text(path: Path, text: str) -> None:
    """Print a text if the path is standard output, otherwise write it atomically."""
    if path in STANDARD_OUTPUT:
        print(text, end="")
    else:
        write_atomically(path, text)


def write_atomically(path: Path, content: str | bytes) -> None:
    """Write a file atomically: it is either the old or the new one.

    The new one is a hidden file, ``.NAME.PROCESS@MACHINE.*.tmp``, until it is complete. Hidden files of the same name
    that a killed process of this machine did not complete are removed. A symbolic link stays; its target is written.
    The mode is that of the old file; the umask gives that of a new one.

    Raises:
        ValueError: the path is a folder, device, pipe or socket.
    """
    if path.is_dir():
        raise ValueError(f"{path} is a folder: give the name of a file to write")
    target = Path(os.path.realpath(path))
    old = path.stat() if path.is_file() else None
    if not old and (path.exists() or os.path.lexists(target)):  # the latter: a link to itself
        raise ValueError(f"{path} is not a regular file: give the name of a file to write")
    target.parent.mkdir(parents=True, exist_ok=True)
    _clean(target)
    temporary = target.with_name(f".{target.name}.{os.getpid()}@{platform.node()}.{secrets.token_hex(4)}.tmp")
    try:
        with named(path), temporary.open("xb") as file:
            if old:
                temporary.chmod(old.st_mode & 0o777)
            file.write(content.encode() if isinstance(content, str) else content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, target)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    note_file(path)


@contextmanager
def named(path: str | Path) -> Iterator[None]:
    """Context in which an OSError names this file; that of a full disk names none."""
    try:
        yield
    except OSError as error:
        error.filename = str(path)
        raise


def _clean(path: Path) -> None:
    pattern = re.compile(rf"\.{re.escape(path.name)}\.(\d+)@{re.escape(platform.node())}\.\w+\.tmp")
    for name in os.listdir(path.parent):
        match = pattern.fullmatch(name)
        if match and not _running(int(match[1])):
            (path.parent / name).unlink(missing_ok=True)


def _running(process: int) -> bool:
    if os.name == "nt":  # signal 0 is Ctrl-C there
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (PermissionError, OverflowError):  # of another user, or not a process id
        pass
    return True
