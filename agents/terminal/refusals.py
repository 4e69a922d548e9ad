"""What was refused or failed as the one line that the terminal and the app tell."""

from __future__ import annotations

from pydantic import ValidationError

from probe_env.files import one_line
from probe_env.settings import explain


def refusal(error: Exception) -> str:
    """An error as one line."""
    if isinstance(error, ValidationError):
        return one_line(explain(error))
    if isinstance(error, FileNotFoundError):
        hint = getattr(error, "hint", "")
        return one_line(f"no such file: {error.filename}" + (f" - {hint}" if hint else ""))
    return one_line(str(error))
