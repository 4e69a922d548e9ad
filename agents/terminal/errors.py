"""Formats errors for the terminal and the app."""

from __future__ import annotations

from pathlib import Path

from pydantic import ValidationError

from probe_env.files import one_line
from probe_env.settings import explain


def format_error(error: Exception) -> str:
    """An error as one line."""
    if isinstance(error, ValidationError):
        return one_line(explain(error))
    if isinstance(error, FileNotFoundError):
        hint = getattr(error, "hint", "")
        missing = error.filename
        if missing is not None and Path(missing).is_dir():
            return one_line(f"{missing}: a folder, not a file" + (f" - {hint}" if hint else ""))
        if missing is not None and not hint and not Path(missing).parent.is_dir():
            hint = f"there is no folder {Path(missing).parent}"
        return one_line(f"no such file: {missing}" + (f" - {hint}" if hint else ""))
    if isinstance(error, FileExistsError | NotADirectoryError) and error.filename is not None:
        return one_line(f"{error.filename}: a file, where a folder is needed")
    return one_line(str(error))
