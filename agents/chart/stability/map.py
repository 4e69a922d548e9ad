"""Where each method holds and where it is wrong though it holds: step, contact stiffness, length and friction, run.

Steps are given as multiples of the step that ``Simulator.stable_time_step`` names for the method; those of
``implicit``, which has no limit, as multiples of Newmark's. A step that holds is wrong if bounces off a contact spring
of that stiffness lose or gain as much as 5 % of critical damping would take; that is tried on one mass, which
superelements do not have. Steps that a method refuses, because its rounding would show, are not run.
"""

from __future__ import annotations

import warnings
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from joblib import Parallel, delayed
from tqdm import tqdm

from agents.chart.ensembles import STIFFNESSES
from agents.chart.stability import figures as draw
from agents.chart.stability.one_mass import bounce, run_one_mass
from agents.chart.stability.passive import run_digits, run_energy
from agents.records.provenance import provenance, write_atomically, write_json
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
    return scene, ratio * named_step(method, scene)


def named_step(method: str, scene: Scene) -> float:
    """Largest step [s] known to hold; Newmark's for a method without a limit."""
    step = METHODS[method].stable_step(scene, 4)
    return step if 0.0 < step < np.inf else METHODS["newmark"].stable_step(scene, 4)


def run_cell(method: str, stiffness: float, length: float, friction: float, ratio: float) -> dict[str, Any]:
    """One run from rest: the step, omega dt of a float on its contact spring, and when it diverged (NaN: it held)."""
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


def run_map(output: Path) -> pd.DataFrame:
    """All cells, two at a time, then one mass, passive chains and the transfer matrix; stores tables and figures."""
    todo = cells()
    work = Parallel(n_jobs=2, prefer="threads", return_as="generator")(delayed(run_cell)(*cell) for cell in todo)
    table = pd.DataFrame(tqdm(work, total=len(todo), desc="stability", unit="run"))
    table["bounce_damping"] = [_bounce_damping(*row) for row in table[["method", "omega_dt"]].itertuples(index=False)]
    tables = {"map": table, "one_mass": run_one_mass(), "energy": run_energy(), "digits": run_digits()}
    for name, part in tables.items():
        write_atomically(output / f"{name}.csv", part.to_csv(index=False, float_format="%.5g"))
    write_json(output / "provenance.json", provenance())
    draw.stability_map(verdicts(table), output / "map.png")
    draw.one_mass(tables["one_mass"], output / "one_mass.png")
    draw.digits(tables["digits"], output / "digits.png")
    print(markdown(table))
    print(f"written: {output}/ ({', '.join(f'{name}.csv' for name in tables)}, map.png, one_mass.png, digits.png)")
    return table


@lru_cache(maxsize=1024)
def _bounce_damping(method: str, omega_dt: float) -> float:
    return bounce(method, omega_dt)[1] if method in ON_NODES else float("nan")


def verdicts(table: pd.DataFrame) -> pd.DataFrame:
    """With a column ``verdict``: unstable, wrong (held, but the contact's damping is off by 5 %) or stable."""
    wrong = ~(table["bounce_damping"].abs() <= WRONG) & table["method"].isin(list(ON_NODES))
    verdict = np.where(table["diverged_at_s"].notna(), "unstable", np.where(wrong, "wrong", "stable"))
    return table.assign(verdict=verdict)


def markdown(table: pd.DataFrame) -> str:
    """For every method the steps that held everywhere, somewhere and nowhere, and those that are wrong all the same."""
    lines = [
        "| method | limit named | held in all runs | held in some | held in none | held, but wrong in some |",
        "|---|---|---|---|---|---|",
    ]
    table = verdicts(table)
    named = {"explicit": "computed, damping included", "implicit": "none; multiples of Newmark's"}
    named |= dict.fromkeys(
        (name for name in METHODS if name not in ON_NODES), "computed, ω dt = 1.65 of float and cable"
    )
    for method in METHODS:
        held = table[table["method"] == method].groupby("ratio")["diverged_at_s"].apply(lambda at: at.isna().mean())
        groups = (held[held == 1.0], held[(held > 0.0) & (held < 1.0)], held[held == 0.0])
        wrong = (
            table[(table["method"] == method) & (table["verdict"] == "wrong")]["ratio"].drop_duplicates().sort_values()
        )
        ratios = [
            ", ".join(f"{ratio:g}" for ratio in cell) or "-" for cell in (*(group.index for group in groups), wrong)
        ]
        if method not in ON_NODES:
            ratios[-1] = "not tried"
        lines.append(f"| {method} | {named.get(method, 'dt √(k/m) = 1.8')} | " + " | ".join(ratios) + " |")
    return "\n".join(lines)
