"""What a run will cost, by the processor times that ``probe-env chart`` measured."""

from __future__ import annotations

import csv
from functools import lru_cache
from importlib.resources import files
from statistics import median


@lru_cache
def node_step_seconds() -> dict[str, float]:
    """Processor time of a step of one node [s] by method, lanes full, on the machine that measured it."""
    text = files("probe_env").joinpath("data/measured_errors.csv").read_text()
    times: dict[str, list[float]] = {}
    for row in csv.DictReader(text.splitlines()):
        if float(row["time_lapse"]) == 1.0:
            times.setdefault(row["method"], []).append(float(row["cost_s"]) * float(row["time_step_s"]))
    return {method: median(values) for method, values in times.items()}
