"""Messages in the terminal and the app: errors in one line, compilation."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from numba.core import event
from pydantic import ValidationError
from tqdm import tqdm

from probe_env.files import escaped, one_line
from probe_env.settings import explain


def format_error(error: Exception) -> str:
    """An error as one line."""
    if isinstance(error, ValidationError):
        return one_line(explain(error))
    if isinstance(error, MemoryError):
        return one_line(f"not enough memory: {error}" if str(error) else "not enough memory")
    if not isinstance(error, OSError):
        return one_line(str(error))
    path = Path(str(error.filename))
    if isinstance(error, FileNotFoundError) and not path.is_absolute() and _working_folder_deleted():
        return "the working folder was deleted: change to another one"
    if error.filename is None:
        return one_line(str(error))
    file = escaped(str(error.filename))
    if isinstance(error, FileNotFoundError):
        hint = getattr(error, "hint", "")
        if path.is_dir():
            return one_line(f"{file}: a folder, not a file" + (f" - {hint}" if hint else ""))
        if not hint and not path.parent.is_dir():
            hint = f"there is no folder {escaped(str(path.parent))}"
        return one_line(f"no such file: {file}" + (f" - {hint}" if hint else ""))
    if isinstance(error, FileExistsError | NotADirectoryError):
        return one_line(f"{file}: a file, where a folder is needed")
    return one_line(f"{file}: {error.strerror}")


def _working_folder_deleted() -> bool:
    try:
        os.getcwd()
    except FileNotFoundError:
        return True
    return False


class _Once(event.Listener):
    """Prints a message at the first kernel that is not in numba's cache."""

    announced = False

    def on_start(self, event: Any) -> None:
        if not self.announced:
            self.announced = True
            tqdm.write("compiling kernels; later runs use the cache", file=sys.stderr)

    def on_end(self, event: Any) -> None:
        pass


@contextmanager
def announce_compilation() -> Iterator[None]:
    """Context that prints a message when a kernel is compiled, which takes seconds to a minute."""
    with event.install_listener("numba:compile", _Once()):
        yield
