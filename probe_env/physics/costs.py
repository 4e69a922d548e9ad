"""What a run will cost, by the processor times that ``probe-env chart`` measured."""

from __future__ import annotations

import csv
from functools import lru_cache
from importlib.resources import files
from statistics import median
from typing import Final

AT_MOST: Final = {"superelement": "imex", "superelement32": "imex32"}
"""Methods that the chart has not measured yet: a step of them takes less than one of these with four nodes a pitch."""


@lru_cache
def node_step_seconds() -> dict[str, float]:
    """Processor time of a step of one node [s] by method, lanes full, on the machine that measured it."""
    text = files("probe_env").joinpath("data/measured_errors.csv").read_text()
    times: dict[str, list[float]] = {}
    for row in csv.DictReader(text.splitlines()):
        if float(row["time_lapse"]) == 1.0:
            times.setdefault(row["method"], []).append(float(row["cost_s"]) * float(row["time_step_s"]))
    measured = {method: median(values) for method, values in times.items()}
    return {method: measured[other] for method, other in AT_MOST.items()} | measured
