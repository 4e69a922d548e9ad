"""Names of policies and designs in tables, spreadsheets, reports and on the terminal.

A name has one to ``MAX_LENGTH`` printable characters and does not start like a formula, which a spreadsheet would
execute. Names such as ``1e5`` or ``NA`` are valid: tables are read with names as text.
"""

from pathlib import Path
from typing import Final

MAX_LENGTH: Final = 80
FORMULA: Final = "=+-@"
"""First characters of a formula in a spreadsheet."""


def name_problem(name: str) -> str:
    """Error text of a name; empty if it is valid."""
    if not name.strip() or len(name) > MAX_LENGTH:
        return f"is not a name of 1 to {MAX_LENGTH} characters"
    if not name.isprintable() or name != name.strip():
        return "is not a name: it has invisible characters"
    if name[0] in FORMULA:
        return f"is not a name: {name[0]} starts a formula in spreadsheets"
    return ""


def checked_name(name: str, what: str, hint: str = "") -> str:
    """Check a name; returns it. ``what`` (kind of object) and ``hint`` (advice) are for the error."""
    problem = name_problem(name)
    if problem:
        raise ValueError(f"{what} {name[: 2 * MAX_LENGTH]!r} {problem}{hint and f' - {hint}'}")
    return name


def name_of(path: Path) -> str:
    """Name from a file name: without its ending and without first characters of a formula."""
    return path.stem.lstrip(FORMULA)
