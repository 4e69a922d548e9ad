"""Where stored results are, and what made them, in words."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from agents.records.models import Made
from agents.records.reading import read_json

RESULTS = Path("results")


def command(made: dict[str, Any]) -> str:
    """What to type to make it again."""
    return f"probe-env results {made['stage']}" if "stage" in made else str(made["command"])


def source(path: Path) -> str:
    """Command, commit and machine of stored results."""
    made = read_json(path, Made).model_dump()
    machine = made["machine"]
    return (
        f"Made by `{command(made)}` at commit {made['commit']}, {machine['cores']} cores"
        f" ({machine['processor']}), numba {made['packages']['numba']}; stored in `{path.parent}/`."
    )
