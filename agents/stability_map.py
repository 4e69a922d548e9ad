"""Where each method holds: method, step, contact stiffness and length, run and not assumed.

Steps are given as multiples of the step that ``Simulator.stable_time_step`` names for the method; those of
``implicit``, which has no limit, as multiples of Newmark's.
"""

from __future__ import annotations

import io
import warnings
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from joblib import Parallel, delayed
from tqdm import tqdm

from agents import errors_of_step, figures
from agents.provenance import provenance, write_atomically, write_json
from probe_env import Scene, SimulationError, Simulator, StabilityWarning
from probe_env.stability import stable_time_step

METHODS = ("newmark", "wilson", "imex", "explicit", "implicit")
RATIOS = (0.5, 1.0, 1.33, 1.67, 2.2, 4.4)
STIFFNESSES = (1e4, 1e5, 1e6)  # [N/m]
LENGTHS = (10.0, 50.0)  # [m]
DURATION = {"explicit": 0.1}  # [s], else 0.5


def run_cell(method: str, stiffness: float, length: float, ratio: float) -> dict[str, Any]:
    """One run from rest: the step, omega dt of a float on its contact spring, and when it diverged (NaN: it held)."""
    scene = Scene.model_validate({"carrier_length": length, "contact": {"stiffness": stiffness}})
    limit = stable_time_step(scene, 4, "newmark" if method == "implicit" else method)
    time_step = ratio * limit
    steps = int(np.ceil(DURATION.get(method, 0.5) / time_step))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StabilityWarning)  # steps beyond the limit are the point
        simulator = Simulator(scene, method, time_step)
    diverged = float("nan")
    try:
        simulator.run(steps * time_step, time_step * steps)
    except SimulationError as error:
        diverged = error.time
    mass = scene.probe.line_density * scene.probe.float_pitch / 4
    return {
        "method": method,
        "stiffness_n_per_m": stiffness,
        "length_m": length,
        "ratio": ratio,
        "time_step_s": time_step,
        "omega_dt": time_step * np.sqrt(stiffness / mass),
        "diverged_at_s": diverged,
    }


def run_map(output: Path) -> pd.DataFrame:
    """All cells, two at a time, and the errors of every step; stores map.csv, map.png, errors.csv, provenance.json."""
    cells = list(product(METHODS, STIFFNESSES, LENGTHS, RATIOS))
    work = Parallel(n_jobs=2, prefer="threads", return_as="generator")(delayed(run_cell)(*cell) for cell in cells)
    table = pd.DataFrame(tqdm(work, total=len(cells), desc="stability", unit="run"))
    buffer = io.StringIO()
    table.to_csv(buffer, index=False, float_format="%.5g")
    write_atomically(output / "map.csv", buffer.getvalue())
    write_json(output / "provenance.json", provenance())
    figures.stability_map(table, output / "map.png")
    print(markdown(table))
    print(errors_of_step.markdown(errors_of_step.run_errors(output)))
    print(f"written: {output}/ (map.csv, map.png, errors.csv)")
    return table


def markdown(table: pd.DataFrame) -> str:
    """For every method the steps that held everywhere, somewhere and nowhere, as a Markdown table."""
    lines = ["| method | limit named | held in all runs | held in some | held in none |", "|---|---|---|---|---|"]
    named = {"explicit": "computed, damping included", "implicit": "none; multiples of Newmark's"}
    for method in METHODS:
        held = table[table["method"] == method].groupby("ratio")["diverged_at_s"].apply(lambda at: at.isna().mean())
        cells = (held[held == 1.0], held[(held > 0.0) & (held < 1.0)], held[held == 0.0])
        ratios = (", ".join(f"{ratio:g}" for ratio in cell.index) or "-" for cell in cells)
        lines.append(f"| {method} | {named.get(method, 'dt √(k/m) = 1.8')} | " + " | ".join(ratios) + " |")
    return "\n".join(lines)
