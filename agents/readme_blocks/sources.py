"""Where stored results are, and what made them, in words."""

from __future__ import annotations

from pathlib import Path

from agents.stored import read_json
from agents.stored.records import Made

RESULTS = Path("results")


def source(path: Path) -> str:
    """Command, commit and machine of stored results."""
    made = read_json(path, Made).model_dump()
    machine = made["machine"]
    return (
        f"Made by `{made['command']}` at commit {made['commit']}, {machine['cores']} cores"
        f" ({machine['processor']}), numba {made['packages']['numba']}; stored in `{path.parent}/`."
    )
