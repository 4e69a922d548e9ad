"""From ensembles to errors: ratios of means to a reference's, with 95 % bootstrap intervals."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import astuple
from typing import Any

import numpy as np
import pandas as pd

from agents.chart.costs import cpu_seconds
from agents.chart.ensembles import (
    LENGTHS,
    MODEL_STEP,
    PEAK,
    REFERENCE_STEP,
    STATISTICS,
    STIFFNESSES,
    Setting,
    converged,
)
from agents.chart.insertions import END, FEED_SPEED, REFERENCE, START, STRETCH, Insertion
from agents.rollouts.statistics import ratio_interval
from agents.study.cases import CASES

FLOORS = {
    "radial_rms_m": 1e-5, "radial_p99_m": 5e-5, "lift_off_share": 0.01, PEAK: 1.0, "axial_rms_m": 1e-5,
    "radial_acceleration_rms_m_per_s2": 0.1,
}  # fmt: skip
"""Outputs, with what is too little to matter: an error of something smaller is relative to this.

Radially a tenth of the vibration limit, and a p99 five times that, as where it rings. At 10 m it is 3.5 micrometres.
"""
OUTPUTS = tuple(FLOORS)
KEYS = list(Setting().key)
Reference = Callable[[Mapping[Any, Any]], dict[str, Any]]
BANDS = ((20.0, 40.0), (40.0, 60.0))
"""[m] stretches of the insertion over which runs are compared; before 20 m it is all but silent."""


def study_members(ensemble: pd.DataFrame) -> pd.DataFrame:
    """The study's stored ensemble at l = 10, 30 and 50 m, all methods, in the columns of ensembles.csv."""
    parts = []
    for case in CASES:
        length = float(case.scene.removeprefix("fig11_l")) if case.scene.startswith("fig11_l") else 0.0
        plain = case.walls == "both" and not case.settles and not case.root_offset
        if length in LENGTHS and plain and case.method not in ("imex", "imex32"):
            setting = Setting(case.method, case.time_step, length=length)
            rows = ensemble[ensemble["case"] == case.name]
            part = rows[["member", *STATISTICS, PEAK]].assign(diverged=rows["diverged_at_s"].notna(), **setting.key)
            parts.append(part)
    return pd.concat(parts, ignore_index=True)


def fine_step(setting: Mapping[Any, Any]) -> dict[str, Any]:
    """What shows the error of the step alone: imex at the reference step, on table 2's mesh.

    For a changed model it shows the model's: table 2's mesh at ``MODEL_STEP``.
    """
    plain = Setting(time_step=MODEL_STEP, length=setting["carrier_length_m"]).key
    changed = [name for name in ("nodes_per_pitch", "walls", "friction") if setting[name] != plain[name]]
    stiffness = setting["contact_stiffness_n_per_m"]
    if changed or stiffness not in STIFFNESSES:
        return plain
    return Setting(time_step=REFERENCE_STEP, length=setting["carrier_length_m"], stiffness=stiffness).key


def converged_mesh(setting: Mapping[Any, Any]) -> dict[str, Any]:
    """What shows the error of mesh and step together."""
    key = converged(setting["carrier_length_m"], setting["contact_stiffness_n_per_m"]).key
    return key | {name: Setting().key[name] for name in ("friction", "walls")}


def constant_length(members: pd.DataFrame, costs: pd.DataFrame, reference: Reference = fine_step) -> pd.DataFrame:
    """Errors of every setting at a constant length that has a reference.

    Columns: those of ``Setting``, members, diverged (share), cpu_s (for a simulated second), and for every output
    ratio, low, high.
    """
    groups = dict(list(members.groupby(KEYS)))
    rows = []
    for key, part in groups.items():
        setting = dict(zip(KEYS, key, strict=True))
        base = groups.get(tuple(reference(setting).values()))
        row: dict[str, Any] = setting | {"members": len(part), "diverged": float(part["diverged"].astype(bool).mean())}
        if base is not None:
            rows.append(row | _compared(part, base))
    table = pd.DataFrame(rows)
    return table.assign(cpu_s=cpu_seconds(costs, table))


def insertion(members: pd.DataFrame, costs: pd.DataFrame, reference: Insertion = REFERENCE) -> pd.DataFrame:
    """Errors of whole insertions in two bands of length, and ``cpu_s``, processor time of one insertion.

    A member's value in a band is the root mean square (of an rms) or the mean over its stretches.
    """
    rows = []
    keys = list(reference.key)
    for low, high in BANDS:
        band = members[members["from_m"].between(low, high, inclusive="left")]
        of_member = band.groupby([*keys, "member"])[list(OUTPUTS)].agg(_pooled).reset_index()
        chosen = (of_member[keys] == list(reference.key.values())).all(axis=1)
        for key, part in of_member.groupby(keys):
            row: dict[str, Any] = dict(zip(keys, key, strict=True)) | {
                "from_m": low,
                "to_m": high,
                "members": len(part),
            }
            rows.append(row | _compared(part, of_member[chosen]))
    table = pd.DataFrame(rows)
    return table.assign(cpu_s=[insertion_cost(row, costs) for row in table.to_dict("records")])


def _pooled(values: pd.Series) -> float:
    return float(np.sqrt((values**2).mean())) if str(values.name).endswith("rms_m") else float(values.mean())


def insertion_cost(row: Mapping[Any, Any], costs: pd.DataFrame) -> float:
    """Processor time of a whole insertion of one probe [s], from the cost of a node-step."""
    same = (costs["method"] == row["method"]) & (costs["nodes_per_pitch"] == row["nodes_per_pitch"])
    node_step = costs[same]["ns_per_node_step"].mean()
    steps = pitch_seconds() / row["time_lapse"] / row["time_step_s"]
    return float(row["nodes_per_pitch"] * steps * node_step * 1e-9)


def pitch_seconds() -> float:
    """Pitches inserted, summed over the seconds of a whole insertion."""
    pitches = (np.arange(START, END, STRETCH) + 0.5 * STRETCH) / 0.1
    return float(pitches.sum() * STRETCH / FEED_SPEED)


def _compared(part: pd.DataFrame, reference: pd.DataFrame) -> dict[str, float]:
    """For every output the reference's mean, and ratio, low and high of the means' ratio."""
    row: dict[str, float] = {}
    for output in OUTPUTS:
        values, base = (frame[output].to_numpy(dtype=float) for frame in (part, reference))
        row[f"{output}:reference"] = float(np.nanmean(base)) if np.isfinite(base).any() else float("nan")
        interval = astuple(ratio_interval(values, base))
        row |= {f"{output}:{name}": value for name, value in zip(("ratio", "low", "high"), interval, strict=True)}
    return row


def bound(row: Mapping[Any, Any], output: str) -> float:
    """Largest error that the 95 % interval leaves room for, relative to the reference's mean or its ``FLOORS``."""
    reference = abs(row[f"{output}:reference"])  # pressed on the wall, even a 99th percentile is negative
    relative = max(abs(row[f"{output}:low"] - 1.0), abs(row[f"{output}:high"] - 1.0))
    return float(relative * reference / max(reference, FLOORS[output]))
