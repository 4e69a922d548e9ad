"""Chart of accuracy against cost: methods before and in the chaotic regime, mesh and model choices, time-lapse."""

from __future__ import annotations

import warnings
from itertools import cycle
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from probe_agents.evaluation.workers import HERE, Workers
from probe_agents.records.atomic import write_atomically
from probe_agents.records.drawing import GREY, GRID, save
from probe_agents.records.manifest import CHECKOUT, write_manifest
from probe_agents.records.store import COLUMNS, Store, as_csv
from probe_agents.records.tables import Columns, read_csv
from probe_agents.studies.builtin import print_frame
from probe_agents.studies.chart import errors
from probe_agents.studies.chart.ensembles import CONVERGED, INSERTIONS, SETTINGS, Insertion, Setting
from probe_agents.studies.chart.smooth import cases, orders, resolved, run_smooth
from probe_agents.studies.claims.cases import load_rows
from probe_agents.terminal.tables import print_line
from probe_env.physics.closed_forms.bare_chains import LAPACK
from probe_env.physics.methods import METHODS, ON_NODES

STUDY = CHECKOUT / "results" / "study"
"""Stored runs of the slow methods by the study ``claims``."""
TABLES: dict[str, Columns] = {
    **dict.fromkeys(("ensembles", "insertions", "smooth"), COLUMNS),
    "costs": {**dict.fromkeys(errors.COST_COLUMNS, "number"), "method": "text", "nodes_per_pitch": "count"},
}
PALETTE = ("#1f5fa8", "#7d3c98", "#c0392b", "#ec7aa5", "#d68910", "#1e8449", "#5dade2", "#7e5109", "#283747", "#a6acaf")
COLOURS = dict(zip((*ON_NODES, LAPACK, *(m for m in METHODS if m not in ON_NODES)), cycle(PALETTE), strict=False))
MARKERS = {4: "o", 8: "s", 16: "^"}
"""Nodes per pitch -> marker."""
PANELS = {"radial_rms_m": "radial rms", "radial_p99_m": "radial p99", "lift_off_share": "lift-off share"}
PANELS["axial_peak_hz"] = "axial peak frequency"


def run(output: Path, workers: Workers = HERE) -> None:
    """Run what is not stored in the output folder, then the timing; writes tables and figures.

    Raises:
        FileError: a stored file is damaged or of another commit; nothing was run.
    """
    for name, columns in TABLES.items():
        path = output / f"{name}.csv"
        if path.exists():
            read_csv(path, columns)
    ensembles = Store(output / "ensembles.csv", (*Setting().key, "member"))
    ensembles.fill({setting.last: setting for setting in SETTINGS}, Setting.rows, "setting")
    insertions = Store(output / "insertions.csv", (*CONVERGED.key, "member", "from_m"))
    insertions.fill({insertion.last: insertion for insertion in INSERTIONS}, Insertion.rows, "insertion")
    run_smooth(output)
    errors.run_costs(output)
    draw_chart(output)


def draw_chart(output: Path) -> None:
    """Write tables and figures of the stored runs of a folder, and print the tables.

    measured_errors.csv is the table of ``fidelity="auto"``.
    """
    ensembles, insertions, smooth, costs = (read_csv(output / f"{name}.csv", TABLES[name]) for name in TABLES)
    slow = load_rows(STUDY)
    if slow.empty:
        warnings.warn(f"{STUDY} has no runs of the slow methods: the chart lacks them", stacklevel=2)
    else:
        ensembles = pd.concat([ensembles, errors.study_members(slow)], ignore_index=True)
    constant, inserted = errors.constant_length(ensembles, costs), errors.insertion(insertions, costs)
    tables = {
        "errors": constant,
        "insertion-errors": inserted,
        "time-lapse-errors": errors.time_lapse(insertions, costs),
        "orders": orders(smooth),
        "choices": errors.choices(ensembles, costs),
        "presets": errors.presets(constant, costs),
    }
    for name, table in (tables | {"measured_errors": errors.measured_errors(constant, inserted)}).items():
        write_atomically(output / f"{name}.csv", as_csv(table, 4))
    commits = pd.concat([table["commit"].dropna() for table in (smooth, ensembles, insertions)])
    write_manifest(output, [f"{name}.csv" for name in (*TABLES, *tables)], commits=commits)
    draw_smooth(smooth, output / "smooth.png")
    draw_chaos(constant, inserted, output / "chaos.png")
    print_frame("Order and error before chaos", tables["orders"], texts=2)
    print_frame("Radial rms by choice", tables["choices"])
    print_frame("Radial rms by preset", tables["presets"], texts=2)
    print_line(f"written: {output}/ ({', '.join(tables)} as .csv, smooth.png, chaos.png)")


def draw_smooth(table: pd.DataFrame, path: Path) -> None:
    """Error over processor time (above) and over sweeps (below), one column per scene; crosses: diverged."""
    names = ("linear", "step-load", "impact", "contact")
    figure, axes = plt.subplots(2, len(names), figsize=(15, 7.5), layout="constrained", sharey="col")
    for column, name in enumerate(names):
        rows = resolved(table, name)
        top = 3.0 * float(rows["error"].max())
        for axis, cost in zip(axes[:, column], ("cpu_s", "sweeps"), strict=True):
            for method, part in rows.groupby("method"):
                _curve(axis, part.sort_values("time_step_s"), cost, top, str(method))
            axis.set(xscale="log", yscale="log")
            axis.grid(**GRID)
        axes[0, column].set_title(cases()[name].title, fontsize=10)
        axes[0, column].set_xlabel("processor time for a simulated second [s]")
        axes[1, column].set_xlabel("sweeps over the chain for a simulated second")
    for axis in axes[:, 0]:
        axis.set_ylabel("largest error over largest value")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)
    save(figure, path, dpi=100)


def _curve(axis: Axes, part: pd.DataFrame, cost: str, top: float, method: str) -> None:
    style: dict[str, Any] = {"color": COLOURS[method]}
    stable = part[part["error"].notna()]
    axis.plot(stable[cost], stable["error"], "o-", ms=4, linewidth=1.2, label=method, **style)
    failed = part[part["error"].isna()]
    if failed.empty:
        return
    # cost of a diverged run, extrapolated from the cost of a step
    rate = float((stable[cost] * stable["time_step_s"]).median()) if len(stable) else float("nan")
    axis.plot(rate / failed["time_step_s"], [top] * len(failed), "x", ms=6, clip_on=False, **style)


def draw_chaos(constant: pd.DataFrame, inserted: pd.DataFrame, path: Path) -> None:
    """Ratio of ensemble means to those of the converged mesh over cost: 30 m, 50 m, two bands of the insertion."""
    table2 = constant[(constant["contact_stiffness_n_per_m"] == 1e5) & constant["nodes_per_pitch"].isin(MARKERS)]
    table2 = table2[(table2["walls"] == "both") & (table2["friction"] == 0.15)]
    panels = {f"l = {length:g} m": table2[table2["carrier_length_m"] == length] for length in (30.0, 50.0)}
    bands = inserted.groupby(["from_m", "to_m"])
    panels |= {f"insertion, {low:g} to {high:g} m": part for (low, high), part in bands}
    shape = len(PANELS), len(panels)
    figure, axes = plt.subplots(*shape, figsize=(15, 11), layout="constrained", sharey="row", sharex="col")
    for column, (title, part) in enumerate(panels.items()):
        stable = part[part["radial_rms_m:ratio"].notna()]
        for axis, (output, label) in zip(axes[:, column], PANELS.items(), strict=True):
            axis.axhline(1.0, color=GREY, linewidth=0.8)
            for (name, mesh), rows in stable.groupby(["method", "nodes_per_pitch"]):
                nodes, ratio = int(str(mesh)), rows[f"{output}:ratio"]
                spread = np.abs([ratio - rows[f"{output}:low"], rows[f"{output}:high"] - ratio])
                style = {"fmt": MARKERS[nodes], "ms": 4, "capsize": 2, "linewidth": 1, "color": COLOURS[str(name)]}
                style["label"] = str(name) if nodes == 4 else f"{name}, {nodes} nodes per pitch"
                axis.errorbar(rows["cpu_s"], ratio, yerr=spread, **style)
            axis.set_xscale("log")
            axis.grid(**GRID)
            if column == 0:
                axis.set_ylabel(f"{label}\nover converged mesh")
        for method, rows in part[part["radial_rms_m:ratio"].isna()].groupby("method"):
            style = {"ms": 7, "color": COLOURS[str(method)], "label": f"{method}, diverged"}
            axes[0, column].plot(rows["cpu_s"], [1.0] * len(rows), "x", **style)
        axes[0, column].set_title(title, fontsize=10)
        unit = "an insertion" if "insertion" in title else "a simulated second"
        axes[-1, column].set_xlabel(f"processor time for {unit} [s]")
    handles: dict[str, Any] = {}
    for axis in axes.ravel():
        handles |= dict(zip(*reversed(axis.get_legend_handles_labels()), strict=True))
    figure.legend(list(handles.values()), list(handles), loc="outside lower center", ncols=6, frameon=False)
    save(figure, path, dpi=90)
