"""What the machine grants: cores, and a folder for compiled kernels where there is no home or nothing can be written.

numba keeps them beside the sources, else in the user's cache folder; without either ``njit(cache=True)`` raises when a
kernel is imported. This must therefore run before the first kernel is.
"""

from __future__ import annotations

import atexit
import os
import shutil
import stat
import tempfile
import warnings
from pathlib import Path

import numba


def ensure_kernel_cache() -> None:
    """Choose a temporary folder for compiled kernels if numba has none, and warn of it.

    Worker processes inherit the choice.

    Raises:
        RuntimeError: there is no folder that can be written at all.
    """
    if _numba_has_one():
        return
    try:
        folder = _folder()
    except OSError as error:
        raise RuntimeError(
            "no folder can be written to keep compiled kernels in: set NUMBA_CACHE_DIR to one that can"
        ) from error
    given = os.environ.get("NUMBA_CACHE_DIR", "")
    given = given and f"NUMBA_CACHE_DIR = {given} nor "
    os.environ["NUMBA_CACHE_DIR"] = str(folder)
    numba.config.reload_config()  # type: ignore[no-untyped-call]
    warnings.warn(
        f"compiled kernels are kept in {folder}, because neither {given}the package's folder nor the user's cache"
        " can be written; set NUMBA_CACHE_DIR to choose another",
        stacklevel=3,
    )


def _numba_has_one() -> bool:
    """Whether a function of this package can be cached; nothing is compiled."""
    try:
        numba.njit(cache=True)(_numba_has_one)
    except RuntimeError as error:
        if "locator" not in str(error):
            raise
        return False
    return True


def _folder() -> Path:
    """The user's own folder among the temporary ones, or a new one if somebody else made that.

    Compiled code is loaded from it: nobody else may write there.
    """
    user = os.getuid() if hasattr(os, "getuid") else "user"  # where there is none, temporary folders are one's own
    folder = Path(tempfile.gettempdir()) / f"probe_env-kernels-{user}"
    try:
        folder.mkdir(mode=0o700)
    except FileExistsError:
        if not _is_private(folder):
            folder = Path(tempfile.mkdtemp(prefix="probe_env-kernels-"))
            atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


def _is_private(folder: Path) -> bool:
    """Whether a folder, not a link to one, is the user's and closed to others."""
    entry = folder.lstat()
    if not stat.S_ISDIR(entry.st_mode):
        return False
    return not hasattr(os, "getuid") or (entry.st_uid == os.getuid() and not entry.st_mode & 0o077)


def available_cores() -> int:
    """Cores that this process may run on: its affinity on Linux, elsewhere all there are; at least 1."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    count = getattr(os, "process_cpu_count", os.cpu_count)  # the former from Python 3.13 on
    return count() or 1
