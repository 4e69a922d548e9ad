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
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from joblib import Parallel, delayed
from matplotlib.colors import ListedColormap
from matplotlib.patches import Patch
from tqdm import tqdm

from agents.records.drawing import GREY, save
from agents.studies.chart.ensembles import STIFFNESSES
from agents.studies.stability.one_mass import bounce
from probe_env import Scene, SimulationError, Simulator, StabilityWarning
from probe_env.physics.methods import METHODS, ON_NODES

ROWS = ("stiffness_n_per_m", "length_m", "friction")
VERDICTS = {"stable": "#1f5fa8", "wrong": "#f5b041", "unstable": "#c0392b"}
Cell = tuple[str, float, float, float, float]
RATIOS = (0.25, 0.5, 1.0, 1.33, 1.67, 2.2, 4.4)
LENGTHS = (10.0, 50.0)  # [m]
FRICTIONS = (0.05, 0.15, 0.3)
COLUMNS = ("method", *ROWS, "ratio", "time_step_s", "omega_dt", "diverged_at_s")
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
    values = (method, stiffness, length, friction, ratio, time_step, time_step * np.sqrt(stiffness / mass), diverged)
    return dict(zip(COLUMNS, values, strict=True))


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


def draw_map(table: pd.DataFrame, path: Path) -> None:
    """Verdicts over step, a panel a method, a row a stiffness, length and friction."""
    methods, codes = list(dict.fromkeys(table["method"])), table["verdict"].map(list(VERDICTS).index)
    figure, axes = plt.subplots(1, len(methods), figsize=(14, 6), sharey=True, layout="constrained", squeeze=False)
    look: dict[str, Any] = {"cmap": ListedColormap(list(VERDICTS.values())), "vmin": 0, "vmax": 2}
    for axis, method in zip(axes[0], methods, strict=True):
        grid = table.assign(code=codes)[table["method"] == method].pivot_table("code", list(ROWS), "ratio")
        axis.imshow(grid.to_numpy(), aspect="auto", origin="lower", **look)
        axis.set_xticks(range(grid.shape[1]), [f"{ratio:g}" for ratio in grid.columns], fontsize=8, rotation=90)
        labels = [f"{k:.0e} N/m, {length:.0f} m, friction {mu:g}" for k, length, mu in grid.index]
        axis.set_yticks(range(grid.shape[0]), labels, fontsize=8)
        axis.set(xlabel="step / named limit", title=method)
    marks = [Patch(color=colour) for colour in VERDICTS.values()]
    labels = ["stable", "stable, but bounces are off by 5 % of critical damping or more", "diverged"]
    if len(table) < len(methods) * len(table.drop_duplicates([*ROWS, "ratio"])):
        marks.append(Patch(facecolor="white", edgecolor=GREY))
        labels.append("refused: its rounding would show")
    figure.legend(marks, labels, loc="outside lower center", ncols=len(marks), frameon=False)
    save(figure, path, dpi=90)
