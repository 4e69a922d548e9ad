"""Names of policies and designs: what may stand in tables, in spreadsheets, on the terminal and in reports.

A name is one to ``LONGEST`` printable characters, and does not begin as a formula does: a spreadsheet would run it.
Names that look like numbers or like nothing (``1e5``, ``NA``) are fine: tables are read with names as text.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

LONGEST: Final = 80
FORMULA: Final = "=+-@"
"""What a spreadsheet takes for the beginning of a formula."""


def name_problem(name: str) -> str:
    """What is wrong with a name, in words; empty if nothing."""
    if not name.strip() or len(name) > LONGEST:
        return f"is not a name of 1 to {LONGEST} characters"
    if not name.isprintable() or name != name.strip():
        return "is not a name: it has characters that cannot be seen"
    if name[0] in FORMULA:
        return f"is not a name: spreadsheets take for a formula what begins with one of {' '.join(FORMULA)}"
    return ""


def checked_name(name: str, what: str, hint: str = "") -> str:
    """The name itself.

    Args:
        name: of a policy or a design.
        what: it is the name of, for the error.
        hint: what to do about it, for the error.

    Raises:
        ValueError: it may not be one.
    """
    problem = name_problem(name)
    if problem:
        raise ValueError(f"{what} {name[: 2 * LONGEST]!r} {problem}{hint and f' - {hint}'}")
    return name


def name_of(path: Path) -> str:
    """The name that a file gives to what it holds: its own without the ending, and without what begins a formula."""
    return path.stem.lstrip(FORMULA)
