"""Errors and costs of ensembles: ratios of means to a reference with 95 % bootstrap intervals, processor times."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import astuple, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from tqdm import tqdm

from probe_agents.evaluation.statistics import ratio_interval
from probe_agents.records.atomic import write_atomically
from probe_agents.studies.chart import ensembles
from probe_agents.studies.chart.ensembles import CONVERGED, PEAK, STATISTICS, STIFFNESSES, Insertion, Setting, converged
from probe_agents.studies.claims.cases import CASES
from probe_env.fidelity import PRESETS
from probe_env.physics.methods import METHODS

FLOORS = {"radial_rms_m": 1e-5, "radial_p99_m": 5e-5, "lift_off_share": 0.01, PEAK: 1.0, "axial_rms_m": 1e-5}
FLOORS["radial_acceleration_rms_m_per_s2"] = 0.1
"""Output -> smallest reference of a relative error; for the radial rms a tenth of the vibration limit."""
OUTPUTS = tuple(FLOORS)
RADIAL = ("radial_rms_m:ratio", "radial_rms_m:low", "radial_rms_m:high")
KEYS = list(Setting().key)
Row = Mapping[Any, Any]
NO_TIME_LAPSE = Insertion("superelement32")
"""Reference of insertions with time-lapse: method and step of ``fast``."""
_SEGMENTS = np.arange(ensembles.START, ensembles.END, ensembles.SEGMENT) + 0.5 * ensembles.SEGMENT
PITCH_SECONDS = float((_SEGMENTS / 0.1).sum() * ensembles.SEGMENT / ensembles.FEED_SPEED)
"""Sum of inserted pitches over the seconds of an insertion."""
TIMED_NODES = {"imex": (1, 2, 4, 8, 16), "imex32": (4, 8, 16)}
"""Nodes per pitch that are timed; 4 for other methods."""
TIMED_LENGTHS = (10.0, 30.0, 40.0, 50.0)  # [m]
LONGEST_TIMED = 1e-4  # [s], time step
REPEATS = 5
COST_COLUMNS = ["method", "nodes_per_pitch", "carrier_length_m", "ns_per_node_step"]


def run_costs(output: Path) -> None:
    """Processor time of a node-step with full lanes on one thread, the minimum of ``REPEATS``; writes costs.csv.

    All costs are measured in one run: only ratios within a run are comparable.
    """
    cells = [(m, nodes, length) for m in METHODS for nodes in TIMED_NODES.get(m, (4,)) for length in TIMED_LENGTHS]
    rows = []
    for method, nodes, length in tqdm(cells, desc="costs", unit="setting"):
        kind = METHODS[method]
        setting = Setting(method, min(kind.usual_step, LONGEST_TIMED), nodes, length)
        batch, steps, seconds = setting.batch(kind.width, threads=1), 4000 if kind.width > 1 else 500, []
        for _ in range(1 + REPEATS):  # the first is a warm-up
            begin = time.process_time()
            batch.advance(None, None, steps * setting.time_step, steps * setting.time_step)
            seconds.append(time.process_time() - begin)
        node_steps = kind.width * steps * (length + 2.5) / 0.1 * nodes
        rows.append((method, nodes, length, min(seconds[1:]) / node_steps * 1e9))
    table = pd.DataFrame(rows, columns=COST_COLUMNS)
    write_atomically(output / "costs.csv", table.to_csv(index=False, float_format="%.5g"))


def cpu_seconds(costs: pd.DataFrame, settings: pd.DataFrame) -> pd.Series:
    """Processor time [s] per probe and simulated second, for rows with the columns of a ``Setting``."""
    keys = COST_COLUMNS[:3]
    node_step = settings[keys].merge(costs, how="left", on=keys)["ns_per_node_step"].to_numpy()
    nodes = (settings["carrier_length_m"] + 2.5) / 0.1 * settings["nodes_per_pitch"]
    seconds: pd.Series = nodes / settings["time_step_s"] * node_step * 1e-9
    return seconds


def insertion_cost(row: Row, costs: pd.DataFrame) -> float:
    """Processor time of an insertion of one probe [s], from the cost of a node-step."""
    same = (costs["method"] == row["method"]) & (costs["nodes_per_pitch"] == row["nodes_per_pitch"])
    node_step = costs[same]["ns_per_node_step"].mean()
    steps = PITCH_SECONDS / row["time_lapse"] / row["time_step_s"]
    return float(row["nodes_per_pitch"] * steps * node_step * 1e-9)


def study_members(ensemble: pd.DataFrame) -> pd.DataFrame:
    """The ensemble of ``claims`` at l = 10, 30 and 50 m, all methods, in the columns of ensembles.csv."""
    parts = []
    for case in CASES:
        length = float(case.scene.removeprefix("fig11_l")) if case.scene.startswith("fig11_l") else 0.0
        if length in ensembles.LENGTHS and case.is_plain and case.method not in ("imex", "imex32"):
            setting = Setting(case.method, case.time_step, length=length)
            rows = ensemble[ensemble["case"] == case.name]
            part = rows[["member", *STATISTICS, PEAK]].assign(diverged=rows["diverged_at_s"].notna(), **setting.key)
            parts.append(part)
    return pd.concat(parts, ignore_index=True)


def constant_length(members: pd.DataFrame, costs: pd.DataFrame) -> pd.DataFrame:
    """Errors of mesh and step together, of every setting whose length and stiffness have a converged reference.

    Columns: those of ``Setting``, members, diverged (share), cpu_s (for a simulated second), and for every output
    reference, ratio, low, high.
    """
    groups = dict(list(members.groupby(KEYS)))
    rows = []
    for key, part in groups.items():
        setting: dict[str, Any] = dict(zip(KEYS, key, strict=True))
        reference = converged(setting["carrier_length_m"], setting["contact_stiffness_n_per_m"])
        base = groups.get(tuple(reference.key.values()))
        row: dict[str, Any] = setting | {"members": len(part), "diverged": float(part["diverged"].astype(bool).mean())}
        if base is not None:
            rows.append(row | _compared(part, base))
    table = pd.DataFrame(rows)
    return table.assign(cpu_s=cpu_seconds(costs, table))


def insertion(
    members: pd.DataFrame,
    costs: pd.DataFrame,
    reference: Insertion = CONVERGED,
    bands: tuple[tuple[float, float], ...] = ((20.0, 40.0), (40.0, 60.0)),
) -> pd.DataFrame:
    """Errors of whole insertions in bands of length [m] beyond the silent 20 m, and ``cpu_s`` of one insertion.

    A member's value in a band is the root mean square (of an rms) or the mean over its stretches.
    """

    def pooled(values: pd.Series) -> float:
        return float(np.sqrt((values**2).mean())) if str(values.name).endswith("rms_m") else float(values.mean())

    rows, keys = [], list(reference.key)
    for low, high in bands:
        band = members[members["from_m"].between(low, high, inclusive="left")]
        of_member = band.groupby([*keys, "member"])[list(OUTPUTS)].agg(pooled).reset_index()
        chosen = _rows(of_member, reference.key)
        for key, part in of_member.groupby(keys):
            row = dict(zip(keys, key, strict=True)) | {"from_m": low, "to_m": high, "members": len(part)}
            rows.append(row | _compared(part, chosen))
    table = pd.DataFrame(rows)
    return table.assign(cpu_s=[insertion_cost(row, costs) for row in table.to_dict("records")])


def time_lapse(members: pd.DataFrame, costs: pd.DataFrame) -> pd.DataFrame:
    """Bias of time-lapse: ratios of insertions to ``NO_TIME_LAPSE``, in bands of 10 m.

    Columns as those of ``insertion``.
    """
    same = {name: value for name, value in NO_TIME_LAPSE.key.items() if name != "time_lapse"}
    bands = tuple((start, start + 10.0) for start in (20.0, 30.0, 40.0, 50.0))
    table = insertion(_rows(members, same), costs, NO_TIME_LAPSE, bands)
    return table[table["time_lapse"] > 1.0].reset_index(drop=True)


def _compared(part: pd.DataFrame, reference: pd.DataFrame) -> dict[str, float]:
    """For every output the mean of the reference, and ratio of means with interval."""
    row: dict[str, float] = {}
    for output in OUTPUTS:
        values, base = (frame[output].to_numpy(dtype=float) for frame in (part, reference))
        row[f"{output}:reference"] = float(np.nanmean(base)) if np.isfinite(base).any() else float("nan")
        interval = astuple(ratio_interval(values, base))
        row |= {f"{output}:{name}": value for name, value in zip(("ratio", "low", "high"), interval, strict=True)}
    return row


def _rows(table: pd.DataFrame, key: Row) -> pd.DataFrame:
    return table[(table[list(key)] == list(key.values())).all(axis=1)]


def bound(row: Row, output: str) -> float:
    """Largest error within the 95 % interval, relative to the mean of the reference, at least ``FLOORS``."""
    reference = abs(row[f"{output}:reference"])  # pressed on the wall, even a 99th percentile is negative
    relative = max(abs(row[f"{output}:low"] - 1.0), abs(row[f"{output}:high"] - 1.0))
    return float(relative * reference / max(reference, FLOORS[output]))


def measured_errors(constant: pd.DataFrame, inserted: pd.DataFrame) -> pd.DataFrame:
    """Table of ``probe_env.fidelity``: error ``bound`` of mesh and step, and cost, of every setting and output.

    Length NaN is an insertion (stiffness of table 2); cost is processor time per pitch and simulated second [s].
    """
    plain = (constant["walls"] == "both") & (constant["friction"] == 0.15)
    stable = constant["contact_stiffness_n_per_m"].isin(STIFFNESSES) & (constant["diverged"] == 0.0)
    at_length = constant[plain & stable].assign(time_lapse=1.0)
    at_length["cost_s"] = at_length["cpu_s"] / ((at_length["carrier_length_m"] + 2.5) / 0.1)
    whole = inserted.assign(carrier_length_m=np.nan, contact_stiffness_n_per_m=1e5)
    whole["cost_s"] = whole["cpu_s"] / PITCH_SECONDS
    keys = ["method", "time_step_s", "nodes_per_pitch", "time_lapse", "carrier_length_m", "contact_stiffness_n_per_m"]
    rows = [
        {name: row[name] for name in (*keys, "cost_s")} | {"output": output, "error": bound(row, output)}
        for row in (*at_length.to_dict("records"), *whole.to_dict("records"))
        for output in OUTPUTS
        if np.isfinite(row[f"{output}:ratio"])
    ]
    groups = pd.DataFrame(rows).groupby([*keys, "output"], dropna=False, as_index=False)
    return groups.agg({"error": "max", "cost_s": "mean"})


def choices(members: pd.DataFrame, costs: pd.DataFrame) -> pd.DataFrame:
    """Ratio of radial rms with each mesh and model choice to that of table 2, at 30 and 50 m.

    Columns choice, carrier_length_m, cost (relative to table 2's mesh), ratio, low, high.
    """
    rows = []
    for length in (30.0, 50.0):
        plain = Setting(time_step=ensembles.MODEL_STEP, length=length)
        settings = [plain, *(replace(plain, **change) for change in ensembles.CHOICES.values())]
        parts = [_rows(members, setting.key) for setting in settings]
        cpu = cpu_seconds(costs, pd.DataFrame([setting.key for setting in settings])).to_numpy()
        for choice, part, cost in zip(ensembles.CHOICES, parts[1:], cpu[1:] / cpu[0], strict=True):
            compared = _compared(part, parts[0])
            rows.append((choice, length, cost, *(compared[name] for name in RADIAL)))
    return pd.DataFrame(rows, columns=["choice", "carrier_length_m", "cost", "ratio", "low", "high"])


def presets(constant: pd.DataFrame, costs: pd.DataFrame) -> pd.DataFrame:
    """Ratio of radial rms of every preset to the converged mesh at 30 and 50 m, and cost of an insertion.

    Columns preset, method, time_step_s, time_lapse, carrier_length_m, ratio, low, high, insertion_cpu_s.
    """
    rows = []
    for name, preset in PRESETS.items():
        method, step, lapse, nodes = preset.method, preset.time_step, preset.time_lapse, preset.nodes_per_pitch
        cost = insertion_cost(Insertion(method, step, lapse, nodes).key, costs)
        for length in (30.0, 50.0):
            for row in _rows(constant, Setting(method, step, nodes, length).key).to_dict("records"):
                rows.append((name, method, step, lapse, length, *(row[column] for column in RADIAL), cost))
    columns = ["preset", "method", "time_step_s", "time_lapse", "carrier_length_m", "ratio", "low", "high"]
    return pd.DataFrame(rows, columns=[*columns, "insertion_cpu_s"])
