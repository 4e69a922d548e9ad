"""Error against step of every method before chaos: l = 10 m, the first 0.1 s, against two references that agree."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pandas as pd
from joblib import Parallel, delayed
from scipy.stats import linregress
from tqdm import tqdm

from agents.provenance import write_atomically
from probe_env import Scene, SimulationError, Simulator, StabilityWarning

SCENE, DURATION, SAMPLE_PERIOD = Scene(carrier_length=10.0), 0.1, 1e-3
REFERENCES = (("newmark", 3.125e-6), ("explicit", 2.5e-6))
TIME_STEPS = (5e-4, 2e-4, 1e-4, 5e-5, 2.5e-5, 1.25e-5, 5e-6)
METHODS = ("newmark", "wilson", "imex", "implicit", "explicit")


def sensor(method: str, time_step: float) -> np.ndarray | None:
    """Axial displacement of the sensor [m], sampled at 1 kHz; None where the method diverges."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StabilityWarning)
        simulator = Simulator(SCENE, method, time_step)
    try:
        run = simulator.run(DURATION, SAMPLE_PERIOD, ("sensor",))
    except SimulationError:
        return None
    return np.asarray(run.axial[:, 0])


def run_errors(output: Path) -> pd.DataFrame:
    """Largest error over the largest displacement, NaN where diverged; the references' own difference comes first."""
    first, second = (sensor(*reference) for reference in REFERENCES)
    assert first is not None
    assert second is not None
    scale = np.abs(first).max()
    rows = [("references", 0.0, float(np.abs(first - second).max() / scale))]
    cells = [(method, dt) for method in METHODS for dt in TIME_STEPS]
    work = Parallel(n_jobs=2, prefer="threads", return_as="generator")(delayed(sensor)(*cell) for cell in cells)
    for (method, dt), signal in zip(cells, tqdm(work, total=len(cells), desc="errors", unit="run"), strict=True):
        rows.append((method, dt, float("nan") if signal is None else float(np.abs(signal - first).max() / scale)))
    table = pd.DataFrame(rows, columns=["method", "time_step_s", "error"])
    write_atomically(output / "errors.csv", table.to_csv(index=False, float_format="%.5g"))
    return table


def markdown(table: pd.DataFrame) -> str:
    """Error in per cent of the largest displacement by method and step, with the slope fitted below 1e-4 s."""
    lines = ["| method | " + " | ".join(f"{dt:g} s" for dt in TIME_STEPS) + " | slope |"]
    lines.append("|---" * (len(TIME_STEPS) + 2) + "|")
    for method in METHODS:
        part = table[table["method"] == method].set_index("time_step_s")["error"]
        cells = ["diverges" if np.isnan(part[dt]) else f"{100.0 * part[dt]:.2g}" for dt in TIME_STEPS]
        fine = part[(part.index <= 1e-4) & part.notna()]
        fit = f"{linregress(np.log(fine.index), np.log(fine)).slope:.2f}" if len(fine) > 2 else "-"
        lines.append(f"| {method} | " + " | ".join(cells) + f" | {fit} |")
    agree = 100.0 * float(table.loc[table["method"] == "references", "error"].iloc[0])
    names = " and ".join(f"{method} at {dt:g} s" for method, dt in REFERENCES)
    return "\n".join(lines) + f"\n\nThe references, {names}, differ by {agree:.2g} %."
