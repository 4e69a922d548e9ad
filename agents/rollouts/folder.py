"""The folder of an evaluation: a journal of episodes, tables made of it, and until then what it is to hold."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from agents.records.journal import Journal
from agents.records.models import Episode
from agents.records.provenance import write_atomically
from probe_env import Context

UNFINISHED: Final = "unfinished.json"
"""Says what an evaluation is to hold, from its beginning until its tables are written: ``models.Unfinished``."""
TABLES: Final = ("episodes", "profile")


def episodes_of(output: Path) -> Journal[Episode]:
    """The stored episodes of an evaluation."""
    return Journal(output / "episodes.jsonl", Episode)


def gathered(
    planned: Sequence[tuple[str, str, int, int]], contexts: Sequence[Context], done: Mapping[str, dict[str, Any]]
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """KPIs a row an episode, and profiles a row a metre.

    Args:
        planned: key, policy name, context number and seed of every episode; all of them are done.
        contexts: the tubes.
        done: records of episodes by their keys.
    """
    rows, profiles = [], []
    for key, name, k, seed in planned:
        record = done[key]
        place: dict[str, Any] = {"policy": name, "context": k, "seed": seed}
        origin = {"commit": record.get("commit", "unknown")}
        rows.append(place | contexts[k].model_dump() | record.get("probe", {}) | record["kpis"] | origin)
        profiles.append(pd.DataFrame(record["profile"]).astype(np.float32).assign(**place))
    return pd.DataFrame(rows), pd.concat(profiles, ignore_index=True)


def write_tables(table: pd.DataFrame, profile: pd.DataFrame, output: Path) -> None:
    """Write ``episodes.csv``, ``episodes.parquet`` and ``profile.parquet``."""
    write_atomically(output / "episodes.csv", table.to_csv(index=False, float_format="%.8g"))
    for name, frame in zip(TABLES, (table, profile), strict=True):
        buffer = io.BytesIO()
        frame.to_parquet(buffer, index=False)
        write_atomically(output / f"{name}.parquet", buffer.getvalue())
