"""Locks the folder of a run against a second process."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from probe_env.files import FileError


@contextmanager
def run_lock(folder: Path) -> Iterator[None]:
    """Lock a folder against a second process; the system releases the lock when the process ends.

    Raises:
        FileError: another process works there.
    """
    folder.mkdir(parents=True, exist_ok=True)
    lock = FileLock(folder / "lock", timeout=0)
    try:
        lock.acquire()
    except Timeout as error:
        raise FileError(folder, "another process is working there: wait for it, or choose another folder") from error
    try:
        yield
    finally:
        lock.release()
        (folder / "lock").unlink(missing_ok=True)
