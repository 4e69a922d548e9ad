"""Chooses a writable folder for compiled kernels and deletes kernels that are older than their sources.

numba stores kernels beside the sources, else in the user's cache folder; if it can write neither, importing a kernel
fails. It checks a kernel's own file only, not the functions of other files that are compiled into it. Call
``ensure_kernel_cache`` before the first kernel is imported.
"""

import atexit
import hashlib
import os
import shutil
import stat
import tempfile
import warnings
from contextlib import suppress
from pathlib import Path
from typing import Final

import numba

SOURCES: Final = Path(__file__).absolute().parent / "physics"
STAMP: Final = "sources.sha256"
"""Hash of the kernel sources, stored next to the compiled kernels."""


def ensure_kernel_cache() -> None:
    """Choose a temporary folder for compiled kernels if numba has none, and warn of it; delete those of other sources.

    Worker processes inherit the choice.

    Raises:
        RuntimeError: there is no folder that can be written at all.
    """
    if numba.config.DISABLE_JIT:  # type: ignore[attr-defined]  # for debuggers: nothing is compiled
        return
    cache_folder = _numbas_folder()
    if cache_folder is None:
        try:
            folder = _folder()
        except OSError as error:
            raise RuntimeError(
                "no folder can be written to keep compiled kernels in: set NUMBA_CACHE_DIR to one that can"
            ) from error
        variable = os.environ.get("NUMBA_CACHE_DIR", "")
        variable = variable and f"NUMBA_CACHE_DIR = {variable} nor "
        os.environ["NUMBA_CACHE_DIR"] = str(folder)
        numba.config.reload_config()  # type: ignore[no-untyped-call]
        warnings.warn(
            f"compiled kernels are kept in {folder}, because neither {variable}the package's folder nor the user's"
            " cache can be written; set NUMBA_CACHE_DIR to choose another",
            stacklevel=3,
        )
        cache_folder = _numbas_folder()
    if cache_folder is not None:
        delete_outdated(cache_folder)


def delete_outdated(cache_folder: Path) -> None:
    """Delete compiled kernels, unless their stamp is that of these sources; ``cache_folder`` is this file's."""
    beside_sources = cache_folder.name == "__pycache__"

    def folder_of(sources: Path) -> Path:
        if beside_sources:
            return sources / "__pycache__"
        return (
            cache_folder.parent / f"{sources.name}_{hashlib.sha1(str(sources).encode()).hexdigest()}"
        )  # as numba has it

    files = [path for pattern in ("*.py", "model/*.py", "methods/**/*.py") for path in SOURCES.glob(pattern)]
    hashed = hashlib.sha256()
    for path in sorted(files):
        hashed.update(f"{path.relative_to(SOURCES).as_posix()}\n".encode() + path.read_bytes())
    stamp, now = folder_of(SOURCES) / STAMP, hashed.hexdigest()
    with suppress(OSError):  # somebody else's, or another process does the same
        if stamp.exists() and stamp.read_text() == now:
            return
        for sources in {path.parent for path in files}:
            for path in folder_of(sources).glob("*.nb[ic]"):
                path.unlink(missing_ok=True)
        stamp.parent.mkdir(exist_ok=True)
        stamp.write_text(now)


def _numbas_folder() -> Path | None:
    """Where numba keeps the compiled functions of this file, if anywhere; nothing is compiled."""
    try:
        return Path(str(numba.njit(cache=True)(_numbas_folder).stats.cache_path))
    except RuntimeError as error:
        if "locator" not in str(error):
            raise
        return None


def _folder() -> Path:
    """The user's own folder among the temporary ones, or a new one if somebody else made that.

    Compiled code is loaded from it: nobody else may write there.
    """
    user = os.getuid() if hasattr(os, "getuid") else "user"  # where there is none, temporary folders are one's own
    folder = Path(tempfile.gettempdir()) / f"probe_env-kernels-{user}"
    try:
        folder.mkdir(mode=0o700)
    except FileExistsError:
        entry = folder.lstat()  # a folder, not a link to one, that is the user's and closed to others?
        private = not hasattr(os, "getuid") or (entry.st_uid == os.getuid() and not entry.st_mode & 0o077)
        if not stat.S_ISDIR(entry.st_mode) or not private:
            folder = Path(tempfile.mkdtemp(prefix="probe_env-kernels-"))
            atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder
