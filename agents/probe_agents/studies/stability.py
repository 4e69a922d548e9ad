"""Stability of time steps: simulated map, amplification of one mass, energy of passive chains.

Map: steps are multiples of ``Simulator.stable_time_step``; for ``implicit``, which has no limit, of Newmark's. A stable
step is wrong if the bounces of one mass off a contact spring gain or lose more than 5 % of critical damping (not for
superelements). Steps below a method's ``min_step`` are not run.

One mass on an elastic element or on a contact spring: the step is linear, so steps from unit vectors give the
amplification matrix. Bounces between two walls show the effect of the contact flag, which is that of the step before.

Passive chains: energy after 100,000 steps.
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
from probe_env.arrays import FloatArray
from probe_env.physics.closed_forms import bare_chains
from probe_env.physics.methods import METHODS, ON_NODES
from probe_env.physics.methods.newmark import Newmark
from probe_env.physics.model.chain import Chain
from probe_env.physics.model.state import State, at_rest

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

OMEGA_DT: Final = (0.1, 0.2, 0.3, 0.5, 0.75, 1.0, 1.25, 1.5, 1.8, 1.95, 2.05, 2.5, 3.0, 4.0, 6.0)
BOUNCES: Final = 60
GAP, SPEED, STIFFNESS = 1e-3, 0.5, 1e5  # [m], [m/s], [N/m]
DEEP, SMALL = 1e-4, 1e-7  # [m] where a step starts in its spring, and the differences that give its matrix

STEPS: Final = 100_000
ELEMENTS: Final = 40
ROOM, FLOAT_RADIUS = 5.2e-3, 9.5e-3  # [m] of a float between the walls, and its radius
OMEGA: Final = math.sqrt(STIFFNESS / (0.111 * 0.025))
CHOSEN: Final = {"implicit": (2.5e-5, 1e-3), "explicit": (5e-6, 5.6e-6)}
ENERGY_STEPS: Final = {name: CHOSEN.get(name, (method.usual_step, 1.8 / OMEGA)) for name, method in ON_NODES.items()}
"""Steps [s]: the usual step and the limit, except for ``CHOSEN`` (``implicit`` has no limit)."""
DAMPING: Final = (0.0, 5e-5)  # [s]


def run(output: Path, assumptions: str = "study", workers: Workers = HERE) -> pd.DataFrame:
    """Run what is not stored of the map, one mass and passive chains; writes tables and map.png.

    With ``assumptions="whole"`` the map alone, of the whole model at friction 0.15.
    """
    whole = assumptions == "whole"
    chosen = [cell for cell in cells() if not whole or (METHODS[cell[0]].simulates_terms and cell[3] == FRICTIONS[1])]
    runs = {cell: cell for cell in chosen}
    table = Store(output / "map.csv", KEYS).fill(runs, lambda cell: [run_cell(*cell, whole=whole)], jobs=workers.jobs)
    table = table.set_index(list(KEYS)).loc[list(runs)].reset_index()
    tables = {"steps": by_step(table)} | ({} if whole else {"one_mass": run_one_mass(), "energy": run_energy()})
    write_manifest(output, ["map.csv", *write_tables(output, tables, 5)], commits=table["commit"])
    draw_map(classify(table), output / "map.png")
    print_frame("Shares of the cells of a step (ratio to the stability limit)", tables["steps"])
    print_line(f"written: {output}/ (map, {', '.join(tables)} as .csv, map.png)")
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


def one_mass(spring: str, stiffness: float = STIFFNESS, gap: float = math.inf) -> tuple[Chain, int]:
    """A chain of one node on a spring, and the component of its motion."""
    free = dict.fromkeys(("axial_compliance", "shear_compliance", "bending_compliance"), 1e9)
    if spring == "elastic":
        free["axial_compliance"] = 1.0 / stiffness
        return bare_chains.uniform_chain(1, damping_time=0.0, coupling_compliance=0.0, **free), bare_chains.AXIAL
    walls = {"contact_stiffness": np.array([stiffness, 0.0]), "outer_gap": np.array([gap, np.inf])}
    return bare_chains.uniform_chain(1, damping_time=0.0, coupling_compliance=0.0, **free, **walls), bare_chains.RADIAL


def _step(method: str, chain: Chain, time_step: float, start: FloatArray, component: int) -> FloatArray:
    """Displacement, velocity and acceleration of the mass after a step; NaN if it diverged."""
    state = at_rest(2)
    state.d[0, component], state.v[0, component], state.memory[0, component] = start
    if not bare_chains.run_chain(method, bare_chains.DrivenChain(chain), time_step, state, 1, 1).stable:
        return np.full(3, np.nan)
    return np.array([state.d[0, component], state.v[0, component], state.memory[0, component]])


def amplification(method: str, spring: str, omega_dt: float) -> tuple[float, float, float]:
    """Spectral radius, damping ratio and relative period error of one undamped mode.

    Values of the largest complex pair z of the matrix; damping is -log|z| / arg z, NaN if no eigenvalue oscillates.
    """
    chain, component = one_mass(spring)
    omega = math.sqrt(STIFFNESS / chain.mass)
    time_step = omega_dt / omega
    # acceleration is part of the state of Newmark methods
    size = 3 if isinstance(METHODS[method], Newmark) else 2
    scale = np.array([1.0, omega, omega**2])
    base = np.array([-DEEP, 0.0, 0.0])  # deep enough that a step stays in the contact spring
    rest = _step(method, chain, time_step, base * scale, component)
    steps = [_step(method, chain, time_step, (base + SMALL * unit) * scale, component) for unit in np.eye(3)[:size]]
    values = np.linalg.eigvals(np.array([(step - rest) / SMALL / scale for step in steps]).T[:size])
    oscillating = values[np.abs(values.imag) > 1e-9]
    radius = float(np.abs(values).max())
    if len(oscillating) == 0:
        return radius, float("nan"), float("nan")
    z = oscillating[np.abs(oscillating).argmax()]
    angle = abs(float(np.angle(z)))
    return radius, float(-math.log(abs(z)) / angle), omega_dt / angle - 1.0


def bounce(method: str, omega_dt: float) -> tuple[float, float]:
    """Mean restitution (speed after / before) of many bounces between two walls, and its damping ratio.

    A linear spring of damping ratio zeta has restitution exp(-pi zeta); a gain is negative damping. NaN: diverged.
    """
    chain, component = one_mass("contact", gap=GAP)
    omega = math.sqrt(STIFFNESS / chain.mass)
    time_step = omega_dt / omega
    period = GAP / SPEED + math.pi / omega
    steps = math.ceil(BOUNCES * period / time_step)
    state = at_rest(2)
    state.d[0, component], state.v[0, component] = 0.4321 * GAP, -SPEED
    run = bare_chains.run_chain(method, bare_chains.DrivenChain(chain), time_step, state, steps, 1)
    y = run.samples[:, component]
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


def run_one_mass() -> pd.DataFrame:
    """Rows of method, spring, omega_dt, spectral_radius, damping, period_error, restitution, bounce_damping."""
    names = [name for name, method in ON_NODES.items() if method.min_step == 0.0]  # rounding does not show
    rows = []
    for method, omega_dt in product(names, OMEGA_DT):
        restitution, bounce_damping = bounce(method, omega_dt)
        for spring in ("elastic", "contact"):
            bounces = (restitution, bounce_damping) if spring == "contact" else (math.nan, math.nan)
            rows.append((method, spring, omega_dt, *amplification(method, spring, omega_dt), *bounces))
    columns = ["method", "spring", "omega_dt", "spectral_radius", "damping", "period_error"]
    return pd.DataFrame(rows, columns=[*columns, "restitution", "bounce_damping"])


def run_energy() -> pd.DataFrame:
    """Energy after 100,000 steps over initial energy, of a frictionless chain with and without walls.

    Columns method, time_step_s, damping_time_s, walls, ratio (infinite where it diverged).
    """
    rows, floats = [], np.arange(ELEMENTS + 1) % 4 == 0
    gaps, levers = np.full(ELEMENTS + 1, ROOM), np.full(ELEMENTS + 1, FLOAT_RADIUS)
    contact = {"contact_stiffness": np.where(floats, STIFFNESS, 0.0), "outer_gap": gaps, "lever": levers}
    for (method, steps), damping_time, walls in product(ENERGY_STEPS.items(), DAMPING, (False, True)):
        chain = bare_chains.bent_chain(ELEMENTS, damping_time=damping_time)._replace(**(contact if walls else {}))  # type: ignore[arg-type]
        for time_step in steps:
            state = at_rest(ELEMENTS + 1)
            state.v[:-1] = np.random.default_rng(0).normal(size=(ELEMENTS, 3)) * (0.1, 0.1, 1.0)
            before = energy(chain, state)
            held = bare_chains.run_chain(method, bare_chains.DrivenChain(chain), time_step, state, STEPS, STEPS).stable
            rows.append((method, time_step, damping_time, walls, energy(chain, state) / before if held else math.inf))
    return pd.DataFrame(rows, columns=["method", "time_step_s", "damping_time_s", "walls", "ratio"])


def energy(chain: Chain, state: State) -> float:
    """Kinetic, elastic and contact energy [J]."""
    n = chain.node_count - 1
    d, v, mass, y = state.d[:n].ravel(), state.v[:n].ravel(), bare_chains.masses(chain), state.d[:n, 1]
    depth = np.maximum(-y, 0.0) + np.maximum(y - chain.outer_gap[:n], 0.0)
    wall = (chain.contact_stiffness[:n] * depth**2).sum()
    return float(0.5 * (mass @ v**2 + (mass * d) @ (bare_chains.linear_matrix(chain) @ d) + wall))
