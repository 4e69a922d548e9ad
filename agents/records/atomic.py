"""Files that are either the old or the new one, never half of it."""

from __future__ import annotations

import os
import platform
import re
import tempfile
from pathlib import Path

from agents.terminal.work import note_file


def write_atomically(path: Path, content: str | bytes) -> None:
    """Write a file so that it is either the old or the new one, never half of it.

    The new one is a hidden file, ``.NAME.PROCESS@MACHINE.*.tmp``, until it is whole. What a process of this machine
    that was killed has left of the same file is removed; that of a running one, or of another machine, is not.

    Raises:
        ValueError: there is a folder of this name.
    """
    if path.is_dir():
        raise ValueError(f"{path} is a folder: give the name of a file to write")
    path.parent.mkdir(parents=True, exist_ok=True)
    _clean(path)
    begin = f".{path.name}.{os.getpid()}@{platform.node()}."
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=begin, suffix=".tmp")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content.encode() if isinstance(content, str) else content)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
    note_file(path)


def _clean(path: Path) -> None:
    left = re.compile(rf"\.{re.escape(path.name)}\.(\d+)@{re.escape(platform.node())}\.\w+\.tmp")
    for name in os.listdir(path.parent):
        match = left.fullmatch(name)
        if match and not _running(int(match[1])):
            (path.parent / name).unlink(missing_ok=True)


def _running(process: int) -> bool:
    if os.name == "nt":  # where signal 0 is Ctrl-C
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (PermissionError, OverflowError):  # another user's, or no process' number at all
        pass
    return True
