"""Stability and accuracy of each method over time step, contact stiffness, length and friction.

Steps are multiples of the step that ``Simulator.stable_time_step`` names for the method; those of ``implicit``, which
has no limit, are multiples of Newmark's. A stable step is wrong if bounces off a contact spring of that stiffness lose
or gain as much as 5 % of critical damping would take; that is tried on one mass, which superelements do not have.
Steps that a method refuses, because its rounding would show, are not run.
"""

from __future__ import annotations

import warnings
from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
from joblib import Parallel, delayed
from tqdm import tqdm

from agents.studies.chart.ensembles import STIFFNESSES
from agents.studies.stability.one_mass import bounce
from probe_env import Scene, SimulationError, Simulator, StabilityWarning
from probe_env.physics.methods import METHODS, ON_NODES

Cell = tuple[str, float, float, float, float]
RATIOS = (0.25, 0.5, 1.0, 1.33, 1.67, 2.2, 4.4)
LENGTHS = (10.0, 50.0)  # [m]
FRICTIONS = (0.05, 0.15, 0.3)
WRONG = 0.05
"""Numerical damping ratio of the contact, lost or gained."""
DURATION = {"explicit": 0.1}  # [s], else 0.5


def cells() -> list[Cell]:
    """Method, contact stiffness [N/m], length [m], friction and step over the named limit, of all runs."""
    every = product(METHODS, STIFFNESSES, LENGTHS, FRICTIONS, RATIOS)
    return [cell for cell in every if _scene_and_step(*cell)[1] >= METHODS[cell[0]].least_step]


def _scene_and_step(method: str, stiffness: float, length: float, friction: float, ratio: float) -> tuple[Scene, float]:
    contact = {"stiffness": stiffness, "friction": friction}
    scene = Scene.model_validate({"carrier_length": length, "contact": contact})
    step = METHODS[method].stable_step(scene, 4)
    named = step if 0.0 < step < np.inf else METHODS["newmark"].stable_step(scene, 4)
    return scene, ratio * named


def run_cell(method: str, stiffness: float, length: float, friction: float, ratio: float) -> dict[str, Any]:
    """One run from rest: the step, omega dt of a float on its contact spring, and when it diverged (NaN: stable)."""
    scene, time_step = _scene_and_step(method, stiffness, length, friction, ratio)
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
        "friction": friction,
        "ratio": ratio,
        "time_step_s": time_step,
        "omega_dt": time_step * np.sqrt(stiffness / mass),
        "diverged_at_s": diverged,
    }


def run_map(runs: list[Cell], jobs: int) -> pd.DataFrame:
    """A row a cell, as ``run_cell`` gives it, with bounce_damping of one mass (NaN: superelement, or diverged)."""
    work = Parallel(n_jobs=jobs, prefer="threads", return_as="generator")(delayed(run_cell)(*cell) for cell in runs)
    table = pd.DataFrame(tqdm(work, total=len(runs), desc="stability", unit="run"))
    table["bounce_damping"] = [_bounce_damping(*row) for row in table[["method", "omega_dt"]].itertuples(index=False)]
    return table


@lru_cache(maxsize=1024)
def _bounce_damping(method: str, omega_dt: float) -> float:
    return bounce(method, omega_dt)[1] if method in ON_NODES else float("nan")


def verdicts(table: pd.DataFrame) -> pd.DataFrame:
    """With a column ``verdict``: unstable, wrong (stable, but the contact's damping is off by 5 %) or stable."""
    wrong = ~(table["bounce_damping"].abs() <= WRONG) & table["method"].isin(list(ON_NODES))
    verdict = np.where(table["diverged_at_s"].notna(), "unstable", np.where(wrong, "wrong", "stable"))
    return table.assign(verdict=verdict)


def by_step(table: pd.DataFrame) -> pd.DataFrame:
    """Shares of the cells of a method and step that were stable, and that were stable but wrong.

    Columns method, ratio (step over the named limit), cells, stable, wrong.
    """
    marked = verdicts(table)
    marked = marked.assign(stable=marked["verdict"] != "unstable", wrong=marked["verdict"] == "wrong")
    groups = marked.groupby(["method", "ratio"], sort=False)
    return groups.agg(cells=("stable", "size"), stable=("stable", "mean"), wrong=("wrong", "mean")).reset_index()
