"""One training a folder: two in one would write over each other's checkpoints and logs."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Hold a folder as long as it is entered; the system lets go of it when the process ends, however it does.

    Raises:
        ValueError: another process trains there.
    """
    folder.mkdir(parents=True, exist_ok=True)
    lock = FileLock(folder / "lock", timeout=0)
    try:
        lock.acquire()
    except Timeout as error:
        raise ValueError(f"{folder}: another process trains there: wait for it, or choose another folder") from error
    try:
        yield
    finally:
        lock.release()
        (folder / "lock").unlink(missing_ok=True)
