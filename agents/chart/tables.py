"""The chart's tables, as Markdown for the README and docs, and the one that ``fidelity="auto"`` reads."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import linregress

from agents.chart.ensembles import CHOICES, MODEL_STEP, STIFFNESSES, Setting
from agents.chart.errors import OUTPUTS, bound, insertion_cost, pitch_seconds
from agents.chart.figures import resolved
from agents.chart.insertions import Insertion
from agents.chart.smooth import METHODS, REFERENCES, cases
from probe_env.fidelity import PRESETS, lapse_in_words
from probe_env.physics.closed_forms.bare_chains import LAPACK
from probe_env.physics.methods import METHODS as KNOWN

Row = Mapping[Any, Any]


def smooth(table: pd.DataFrame) -> str:
    """Fitted slopes by scene and method, and what the references differ by."""
    names = list(cases())
    lines = ["| method | " + " | ".join(cases()[name].title for name in names) + " |", "|---" * (len(names) + 1) + "|"]
    for method in METHODS:
        if method != LAPACK:
            lines.append(f"| {method} | " + " | ".join(_slope(resolved(table, name), method) for name in names) + " |")
    difference = float(table.loc[table["method"] == "references", "error"].iloc[0])
    pair = " and ".join(f"{method} at {dt:g} s" for method, dt in REFERENCES)
    return "\n".join(lines) + f"\n\nThe references of the last column, {pair}, differ by {100.0 * difference:.2g} %."


def _slope(rows: pd.DataFrame, method: str) -> str:
    part = rows[(rows["method"] == method) & rows["error"].notna()].sort_values("time_step_s")
    if (
        method in KNOWN and KNOWN[method].least_step > 0.0
    ):  # rounding grows as the step shrinks: there is a best step, no order
        least = part.nsmallest(1, "error").iloc[0]
        return f"least error {least['error']:.1e} at {least['time_step_s']:g} s"
    part = part[part["error"] > 1e-8].head(4)  # the finest steps that rounding does not reach
    if len(part) < 3:
        return "rounding" if part.empty else f"error {part['error'].iloc[0]:.1e} at {part['time_step_s'].iloc[0]:g} s"
    fit = linregress(np.log(part["time_step_s"]), np.log(part["error"]))
    return f"{fit.slope:.1f}, error {part['error'].iloc[0]:.1e} at {part['time_step_s'].iloc[0]:g} s"


def choices(constant: pd.DataFrame, inserted: pd.DataFrame) -> pd.DataFrame:
    """What each mesh and model choice changes in the radial rms at 30 and 50 m; cost relative to table 2's mesh."""
    rows = []
    for length in (30.0, 50.0):
        plain = Setting(time_step=MODEL_STEP, length=length)
        cost = float(_rows(constant, plain.key)["cpu_s"].iloc[0])
        changes = CHOICES | {"step 2e-4 s": {"time_step": 2e-4}, "step 2.5e-4 s": {"time_step": 2.5e-4}}
        for choice, change in changes.items():
            for row in _rows(constant, replace(plain, **change).key).to_dict("records"):
                rows.append(_choice(choice, length, row, row["cpu_s"] / cost))
        band = inserted[(inserted["from_m"] <= length) & (length < inserted["to_m"])]
        band = band[(band["method"] == "imex32") & (band["time_step_s"] == 2e-4)]
        whole = float(band[band["time_lapse"] == 1.0]["cpu_s"].iloc[0])
        for row in band[band["time_lapse"] > 1.0].to_dict("records"):
            name = f"time-lapse {row['time_lapse']:g} (insertion)"
            rows.append(_choice(name, length, row, row["cpu_s"] / whole))
    return pd.DataFrame(rows)


def _choice(choice: str, length: float, row: Row, cost: float) -> dict[str, object]:
    return {"choice": choice, "carrier_length_m": length, "cost": cost} | {
        part: row[f"radial_rms_m:{part}"] for part in ("ratio", "low", "high")
    }


def _rows(table: pd.DataFrame, key: Row) -> pd.DataFrame:
    return table[(table[list(key)] == list(key.values())).all(axis=1)]


def choices_markdown(rows: pd.DataFrame) -> str:
    """The same as a table."""
    lines = ["| choice | radial rms at 30 m | at 50 m | cost |", "|---|---|---|---|"]
    for choice, part in rows.groupby("choice", sort=False):
        by_length = {row["carrier_length_m"]: row for row in part.to_dict("records")}
        cells = [_interval(by_length[length]) if length in by_length else "-" for length in (30.0, 50.0)]
        lines.append(f"| {choice} | {cells[0]} | {cells[1]} | {part['cost'].mean():.2g} |")
    return "\n".join(lines)


def _interval(row: Row) -> str:
    if np.isnan(row["ratio"]):
        return "diverges"
    return f"{row['ratio']:.2f} [{row['low']:.2f}, {row['high']:.2f}]"


def measured_errors(constant: pd.DataFrame, inserted: pd.DataFrame) -> pd.DataFrame:
    """What ``probe_env.fidelity`` reads: error bound of every setting and output, and its cost.

    Errors are those of mesh and step together. Length NaN stands for a whole insertion (stiffness of table 2); cost is
    processor time for a simulated second of a pitch [s], error the largest relative one that the 95 % interval leaves
    room for.
    """
    plain = (constant["walls"] == "both") & (constant["friction"] == 0.15)
    rows = []
    for row in constant[plain].to_dict("records"):
        length, stiffness = row["carrier_length_m"], row["contact_stiffness_n_per_m"]
        if stiffness in STIFFNESSES and row["diverged"] == 0.0:
            rows += _errors(row, 1.0, length, stiffness, row["cpu_s"] / ((length + 2.5) / 0.1))
    for row in inserted.to_dict("records"):
        cost = row["cpu_s"] / pitch_seconds()
        rows += _errors(row, row["time_lapse"], float("nan"), 1e5, cost)
    table = pd.DataFrame(rows)
    keys = [
        "method", "time_step_s", "nodes_per_pitch", "time_lapse", "carrier_length_m", "contact_stiffness_n_per_m",
        "output",
    ]  # fmt: skip
    return table.groupby(keys, dropna=False, as_index=False).agg({"error": "max", "cost_s": "mean"})


def _errors(row: Row, time_lapse: float, length: float, stiffness: float, cost: float) -> list[dict[str, object]]:
    setting = {key: row[key] for key in ("method", "time_step_s", "nodes_per_pitch")} | {"time_lapse": time_lapse}
    place = {"carrier_length_m": length, "contact_stiffness_n_per_m": stiffness, "cost_s": cost}
    return [
        setting | place | {"output": output, "error": bound(row, output)}
        for output in OUTPUTS
        if np.isfinite(row[f"{output}:ratio"])
    ]


def presets(constant: pd.DataFrame, inserted: pd.DataFrame, costs: pd.DataFrame) -> str:
    """Measured ratio of every preset to the converged mesh at 30 and 50 m and over the insertion, and its cost."""
    lines = [
        "| preset | what it is | radial rms at 30 m | at 50 m | insertion, 20-40 m | 40-60 m | cost of an insertion |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, preset in PRESETS.items():
        method, step, nodes = preset.method, preset.time_step, preset.nodes_per_pitch
        cells = [
            _interval(_plain(row))
            for length in (30.0, 50.0)
            for row in _rows(constant, Setting(method, step, nodes, length).key).to_dict("records")
        ]
        lapses = _rows(inserted, {"method": method, "time_step_s": step, "nodes_per_pitch": nodes})
        nearest = (lapses["time_lapse"] - preset.time_lapse).abs()
        rows = lapses[nearest == nearest.min()].sort_values("from_m").to_dict("records")
        note = "" if nearest.min() == 0.0 else f" (time-lapse {rows[0]['time_lapse']:g})"
        cells += [_interval(_plain(row)) + note for row in rows]
        cost = insertion_cost(Insertion(method, step, preset.time_lapse, nodes).key, costs)
        what = ", ".join(filter(None, (preset.method, f"{preset.time_step:g} s", lapse_in_words(preset))))
        label = f"`{name}` | {what}"
        lines.append(f"| {label} | " + " | ".join(cells) + f" | {cost:.2g} s |")
    return "\n".join(lines) + f"\n\n{_against_newmark(constant)}"


def _against_newmark(constant: pd.DataFrame) -> str:
    """What a simulated second at 50 m costs beside the study's scheme, with the error that goes with it."""
    plain = Setting(length=50.0)
    ((newmark,),) = _rows(constant, replace(plain, method="newmark", time_step=1e-4).key)[["cpu_s"]].to_numpy()
    parts = []
    for method, time_step in (("superelement32", 2.5e-4), ("superelement32", 2e-4), ("imex32", 2e-4), ("imex32", 1e-4)):
        (row,) = _rows(constant, replace(plain, method=method, time_step=time_step).key).to_dict("records")
        times = f"{newmark / row['cpu_s']:.0f} times less"
        parts.append(f"`{method}` at {time_step:.3g} s {times} (radial rms {_interval(_plain(row))})")
    return (
        "A simulated second at l = 50 m costs, beside the study's scheme at 1e-4 s with four nodes, with"
        f" {', '.join(parts)}. Ratios are to sixteen nodes at 5e-5 s."
    )


def _plain(row: Row) -> Row:
    return {part: row[f"radial_rms_m:{part}"] for part in ("ratio", "low", "high")}


def outputs(constant: pd.DataFrame, lengths: Sequence[float]) -> str:
    """Every output of every method, step and mesh on table 2's scene over the reference's."""
    names = [name.removesuffix("_m").removesuffix("_m_per_s2").replace("_", " ") for name in OUTPUTS]
    head = ["method", "nodes a pitch", "step", *names, "CPU s/s"]
    plain = Setting().key
    scene = {name: plain[name] for name in ("contact_stiffness_n_per_m", "friction", "walls")}
    lines: list[str] = []
    for length in lengths:
        lines += [""] if lines else []
        lines += [f"| l = {length:g} m: " + " | ".join(head) + " |", "|---" * len(head) + "|"]
        rows = _rows(constant, scene | {"carrier_length_m": length})
        for row in rows.sort_values(["method", "nodes_per_pitch", "time_step_s"]).to_dict("records"):
            cells = [_interval({part: row[f"{name}:{part}"] for part in ("ratio", "low", "high")}) for name in OUTPUTS]
            setting = f"| {row['method']} | {row['nodes_per_pitch']} | {row['time_step_s']:.3g} s | "
            lines.append(f"{setting}{' | '.join(cells)} | {row['cpu_s']:.2g} |")
    return "\n".join(lines)


def energy(table: pd.DataFrame) -> str:
    """Energy after 100,000 steps by method and step."""
    columns = [(damping, walls) for damping in sorted(table["damping_time_s"].unique()) for walls in (False, True)]
    head = [f"{'damped' if damping else 'undamped'}{', between walls' if walls else ''}" for damping, walls in columns]
    lines = ["| method | step | " + " | ".join(head) + " |", "|---" * (len(head) + 2) + "|"]
    for (method, step), part in table.groupby(["method", "time_step_s"], sort=False):
        ratios = {(row["damping_time_s"], row["walls"]): row["ratio"] for row in part.to_dict("records")}
        cells = [f"{ratios[c]:.2g}" if np.isfinite(ratios[c]) else "diverges" for c in columns]
        lines.append(f"| {method} | {step:.2g} s | " + " | ".join(cells) + " |")
    return "\n".join(lines)
