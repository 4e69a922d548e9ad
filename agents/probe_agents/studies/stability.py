"""Stability of time steps: simulated map, and bounces of one mass.

Map: steps are multiples of ``Simulator.stable_time_step``; for ``implicit``, which has no limit, of Newmark's. A stable
step is wrong if the bounces of one mass off a contact spring gain or lose more than 5 % of critical damping (not for
superelements). Steps below a method's ``min_step`` are not run.
"""

import math
import warnings
from itertools import product
from pathlib import Path
from typing import Any, Final

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.colors import ListedColormap
from matplotlib.patches import Patch

from probe_agents.evaluation.workers import HERE, Workers
from probe_agents.records.drawing import GREY, save
from probe_agents.records.manifest import write_manifest
from probe_agents.records.store import Store, write_tables
from probe_agents.studies.builtin import print_frame
from probe_agents.studies.chart import STIFFNESSES
from probe_agents.terminal.tables import print_line
from probe_env import Scene, SimulationError, Simulator, StabilityWarning
from probe_env.physics.closed_forms import bare_chains
from probe_env.physics.methods import METHODS, ON_NODES
from probe_env.physics.model.state import at_rest

ROWS = ("stiffness_n_per_m", "length_m", "friction")
COLOURS = {"stable": "#1f5fa8", "wrong": "#f5b041", "unstable": "#c0392b"}
Cell = tuple[str, float, float, float, float]
RATIOS = (0.25, 0.5, 1.0, 1.33, 1.67, 2.2, 4.4)
LENGTHS = (10.0, 50.0)  # [m]
FRICTIONS = (0.05, 0.15, 0.3)
KEYS = ("method", *ROWS, "ratio")
WRONG = 0.05
"""Numerical damping ratio of the contact, lost or gained."""
DURATION = {"explicit": 0.1}  # [s], else 0.5

BOUNCES: Final = 60
GAP, SPEED, STIFFNESS = 1e-3, 0.5, 1e5  # [m], [m/s], [N/m]


def run(output: Path, assumptions: str = "study", workers: Workers = HERE) -> pd.DataFrame:
    """Run what is not stored of the map; writes map.csv, steps.csv and map.png.

    With ``assumptions="whole"`` it is of the whole model at friction 0.15.
    """
    whole = assumptions == "whole"
    chosen = [cell for cell in cells() if not whole or (METHODS[cell[0]].simulates_terms and cell[3] == FRICTIONS[1])]
    runs = {cell: cell for cell in chosen}
    table = Store(output / "map.csv", KEYS).fill(runs, lambda cell: [run_cell(*cell, whole=whole)], jobs=workers.jobs)
    table = table.set_index(list(KEYS)).loc[list(runs)].reset_index()
    steps = by_step(table)
    write_manifest(output, ["map.csv", *write_tables(output, {"steps": steps}, 5)], commits=table["commit"])
    draw_map(classify(table), output / "map.png")
    print_frame("Shares of the cells of a step (ratio to the stability limit)", steps)
    print_line(f"written: {output}/ (map.csv, steps.csv, map.png)")
    return table


def cells() -> list[Cell]:
    """Method, contact stiffness [N/m], length [m], friction and step over the stability limit of all runs."""
    every = product(METHODS, STIFFNESSES, LENGTHS, FRICTIONS, RATIOS)
    return [cell for cell in every if _scene_and_step(*cell)[1] >= METHODS[cell[0]].min_step]


def _scene_and_step(method: str, stiffness: float, length: float, friction: float, ratio: float) -> tuple[Scene, float]:
    contact = {"stiffness": stiffness, "friction": friction}
    scene = Scene.model_validate({"carrier_length": length, "contact": contact})
    step = METHODS[method].stable_step(scene, 4)
    limit = step if 0.0 < step < np.inf else METHODS["newmark"].stable_step(scene, 4)
    return scene, ratio * limit


def run_cell(
    method: str, stiffness: float, length: float, friction: float, ratio: float, whole: bool = False
) -> dict[str, Any]:
    """One run from rest: step, omega dt of a float on its contact spring, time of divergence (NaN: stable).

    bounce_damping is that of one mass; NaN for a superelement, or if it diverged.
    """
    scene, time_step = _scene_and_step(method, stiffness, length, friction, ratio)
    steps = int(np.ceil(DURATION.get(method, 0.5) / time_step))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StabilityWarning)  # steps beyond the limit are tested on purpose
        simulator = Simulator(scene.whole() if whole else scene, method, time_step)
    diverged = float("nan")
    try:
        simulator.run(steps * time_step, time_step * steps)
    except SimulationError as error:
        diverged = error.time
    mass = scene.probe.line_density * scene.probe.float_pitch / 4
    omega_dt = time_step * float(np.sqrt(stiffness / mass))
    return dict(zip(KEYS, (method, stiffness, length, friction, ratio), strict=True)) | {
        "time_step_s": time_step, "omega_dt": omega_dt, "diverged_at_s": diverged,
        "bounce_damping": bounce(method, omega_dt)[1] if method in ON_NODES else math.nan,
    }  # fmt: skip


def classify(table: pd.DataFrame) -> pd.DataFrame:
    """Add the column ``verdict``: unstable, wrong (stable, contact damping off by 5 %) or stable."""
    wrong = ~(table["bounce_damping"].abs() <= WRONG) & table["method"].isin(list(ON_NODES))
    verdict = np.where(table["diverged_at_s"].notna(), "unstable", np.where(wrong, "wrong", "stable"))
    return table.assign(verdict=verdict)


def by_step(table: pd.DataFrame) -> pd.DataFrame:
    """Shares of the cells of a method and step that were stable, and stable but wrong.

    Columns method, ratio (step over the stability limit), cells, stable, wrong.
    """
    marked = classify(table)
    marked = marked.assign(stable=marked["verdict"] != "unstable", wrong=marked["verdict"] == "wrong")
    groups = marked.groupby(["method", "ratio"], sort=False)
    return groups.agg(cells=("stable", "size"), stable=("stable", "mean"), wrong=("wrong", "mean")).reset_index()


def draw_map(table: pd.DataFrame, path: Path) -> None:
    """Verdicts over step: one panel per method, one row per stiffness, length and friction."""
    methods, codes = list(dict.fromkeys(table["method"])), table["verdict"].map(list(COLOURS).index)
    figure, axes = plt.subplots(1, len(methods), figsize=(14, 6), sharey=True, layout="constrained", squeeze=False)
    look: dict[str, Any] = {"cmap": ListedColormap(list(COLOURS.values())), "vmin": 0, "vmax": 2}
    for axis, method in zip(axes[0], methods, strict=True):
        grid = table.assign(code=codes)[table["method"] == method].pivot_table("code", list(ROWS), "ratio")
        axis.imshow(grid.to_numpy(), aspect="auto", origin="lower", **look)
        axis.set_xticks(range(grid.shape[1]), [f"{ratio:g}" for ratio in grid.columns], fontsize=8, rotation=90)
        labels = [f"{k:.0e} N/m, {length:.0f} m, friction {mu:g}" for k, length, mu in grid.index]
        axis.set_yticks(range(grid.shape[0]), labels, fontsize=8)
        axis.set(xlabel="step / stability limit", title=method)
    marks = [Patch(color=colour) for colour in COLOURS.values()]
    labels = ["stable", "stable, but bounces are off by 5 % of critical damping or more", "diverged"]
    if len(table) < len(methods) * len(table.drop_duplicates([*ROWS, "ratio"])):
        marks.append(Patch(facecolor="white", edgecolor=GREY))
        labels.append("not run: below the least step")
    figure.legend(marks, labels, loc="outside lower center", ncols=len(marks), frameon=False)
    save(figure, path, dpi=90, grid=False)


def bounce(method: str, omega_dt: float) -> tuple[float, float]:
    """Mean restitution (speed after / before) of many bounces between two walls, and its damping ratio.

    A linear spring of damping ratio zeta has restitution exp(-pi zeta); a gain is negative damping. NaN: diverged.
    """
    free = dict.fromkeys(("axial_compliance", "shear_compliance", "bending_compliance"), 1e9)
    walls = {"contact_stiffness": np.array([STIFFNESS, 0.0]), "outer_gap": np.array([GAP, np.inf])}
    chain = bare_chains.uniform_chain(1, damping_time=0.0, coupling_compliance=0.0, **free, **walls)
    omega = math.sqrt(STIFFNESS / chain.mass)
    time_step = omega_dt / omega
    period = GAP / SPEED + math.pi / omega
    steps = math.ceil(BOUNCES * period / time_step)
    state = at_rest(2)
    radial = bare_chains.RADIAL
    state.d[0, radial], state.v[0, radial] = 0.4321 * GAP, -SPEED
    run = bare_chains.run_chain(method, bare_chains.DrivenChain(chain), time_step, state, steps, 1)
    y = run.samples[:, radial]
    if not run.stable:
        return float("nan"), float("nan")
    # speeds of free flights: steps that start and end between the walls
    inside = (y > 0.0) & (y < GAP)
    flying = inside[1:] & inside[:-1]
    speed = np.diff(y) / time_step
    flights = np.split(speed, np.flatnonzero(~flying))
    speeds = [abs(float(np.median(part[1:]))) for part in flights if len(part) > 2]
    if len(speeds) < 3:
        return float("nan"), float("nan")
    restitution = (speeds[-1] / SPEED) ** (1.0 / (len(speeds) - 1))
    return restitution, -math.log(max(restitution, 1e-12)) / math.pi
