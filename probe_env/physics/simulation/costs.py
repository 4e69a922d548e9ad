"""What a run will cost, by the processor times that ``probe-env chart`` measured."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from functools import lru_cache
from importlib.resources import files
from statistics import median

from probe_env.physics.methods import ON_NODES


def check_measured(method: str, costs: Sequence[float]) -> None:
    """Raise ValueError if no cost of a method was measured."""
    if not costs:
        raise ValueError(f"method = {method!r}: its cost is not known until `probe-env chart` has measured it")


@lru_cache
def pitch_step_seconds(method: str, nodes_per_pitch: int) -> float:
    """Processor time of a step of one pitch [s], lanes full, on the machine that measured it.

    A superelement has the same mesh whatever the number of places where it is seen.

    Raises:
        ValueError: no cost of the method was measured.
    """
    text = files("probe_env").joinpath("data/measured_errors.csv").read_text()
    of_node, per_pitch = [], []
    for row in csv.DictReader(text.splitlines()):
        if row["method"] == method and float(row["time_lapse"]) == 1.0:
            per_pitch.append(float(row["cost_s"]) * float(row["time_step_s"]))
            of_node.append(per_pitch[-1] / int(row["nodes_per_pitch"]))
    check_measured(method, per_pitch)
    return median(of_node) * nodes_per_pitch if method in ON_NODES else median(per_pitch)
