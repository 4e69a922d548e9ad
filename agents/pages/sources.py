"""Where stored results are, and what made them, in words."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from agents.records.columns import sentence_of
from agents.records.models import Record
from agents.records.reading import read_json
from probe_env.envs.task import FAILURES

RESULTS = Path("results")


def command(record: dict[str, Any]) -> str:
    """What to type to make it again."""
    return f"probe-env results {record['stage']}" if "stage" in record else str(record["command"])


def source(path: Path) -> str:
    """Command, commit and machine of stored results."""
    record = read_json(path, Record).model_dump()
    machine = record["machine"]
    processor = "; ".join(filter(None, (machine["processor"], machine.get("kernels", ""))))
    return (
        f"Made by `{command(record)}` at commit {record['commit']}, {machine['cores']} cores"
        f" ({processor}), numba {record['packages']['numba']}; stored in `{path.parent}/`."
    )


def ways_to_fail() -> str:
    """How insertions may fail, for a sentence that counts them."""
    return " or ".join(map(sentence_of, FAILURES))


def markdown(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    """A table as a page has it."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(map(str, line))} |" for line in lines)
