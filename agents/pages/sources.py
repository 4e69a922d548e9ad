"""Where stored results are, and what made them, in words."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from agents.records.columns import sentence_of
from agents.records.models import Record
from agents.records.reading import FileError, read_csv, read_json
from probe_env.envs.task import FAILURES

RESULTS = Path("results")


def command(record: dict[str, Any]) -> str:
    """What to type to make it again."""
    return f"probe-env results {record['stage']}" if "stage" in record else str(record["command"])


def stored_table(path: Path, *needed: str) -> pd.DataFrame:
    """A stored table of a study.

    Raises:
        FileNotFoundError: no such file.
        FileError: not CSV, or without a needed column.
    """
    stored = read_csv(path)
    for name in needed:
        if name not in stored:
            raise FileError(path, f"column {name} is missing - restore the file, or make it again")
    return stored


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
