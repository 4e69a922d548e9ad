"""Conserved energy of a passive chain over 100,000 steps, and the digits of a linear solution."""

from __future__ import annotations

import math
from itertools import product
from typing import Final

import numpy as np
import pandas as pd

from probe_env import Scene
from probe_env.physics.closed_forms.bare_chains import Driven, bent_chain, linear_matrix, masses, run_chain
from probe_env.physics.methods import ON_NODES, banded, ticm, transfer_matrix
from probe_env.physics.methods.newmark import newmark, workspace
from probe_env.physics.model.chain import Chain, build_chain
from probe_env.physics.model.drive import Drive
from probe_env.physics.model.state import State, at_rest

STEPS: Final = 100_000
ELEMENTS: Final = 40
STIFFNESS, GAP, FLOAT_RADIUS = 1e5, 5.2e-3, 9.5e-3  # [N/m], [m], [m]
OMEGA: Final = math.sqrt(STIFFNESS / (0.111 * 0.025))
CHOSEN: Final = {"implicit": (2.5e-5, 1e-3), "explicit": (5e-6, 5.6e-6)}
METHODS: Final = {name: CHOSEN.get(name, (method.usual_step, 1.8 / OMEGA)) for name, method in ON_NODES.items()}
"""Steps [s]: the usual one and the named limit, but for ``CHOSEN``: ``implicit`` has no limit, and that of ``explicit``
is rounded down."""
DAMPING: Final = (0.0, 5e-5)  # [s]
SOLVED: Final = (1, 2, 5, 10, 20, 40, 100, 200, 400)  # elements
SOLVED_STEP: Final = 1e-3  # [s]


def run_energy() -> pd.DataFrame:
    """Energy after 100,000 steps over that at the start, of a frictionless chain thrown about with and without walls.

    Columns method, time_step_s, damping_time_s, walls, ratio (infinite where it diverged).
    """
    rows = []
    for (method, steps), damping_time, walls in product(METHODS.items(), DAMPING, (False, True)):
        for time_step in steps:
            chain = _shaken(damping_time, walls)
            row = {"method": method, "time_step_s": time_step, "damping_time_s": damping_time, "walls": walls}
            rows.append(row | {"ratio": _energy_ratio(method, chain, time_step)})
    return pd.DataFrame(rows)


def _shaken(damping_time: float, walls: bool) -> Chain:
    chain = bent_chain(ELEMENTS, damping_time=damping_time)
    if not walls:
        return chain
    floats = np.arange(ELEMENTS + 1) % 4 == 0
    return chain._replace(
        contact_stiffness=np.where(floats, STIFFNESS, 0.0),
        outer_gap=np.full(ELEMENTS + 1, GAP),
        lever=np.full(ELEMENTS + 1, FLOAT_RADIUS),
    )


def _energy_ratio(method: str, chain: Chain, time_step: float) -> float:
    state = at_rest(ELEMENTS + 1)
    state.v[:-1] = np.random.default_rng(0).normal(size=(ELEMENTS, 3)) * (0.1, 0.1, 1.0)
    before = energy(chain, state)
    held = run_chain(method, Driven(chain), time_step, state, STEPS, STEPS).held
    return energy(chain, state) / before if held else math.inf


def energy(chain: Chain, state: State) -> float:
    """Kinetic, elastic and contact energy [J]."""
    n = chain.node_count - 1
    d, v, mass, y = state.d[:n].ravel(), state.v[:n].ravel(), masses(chain), state.d[:n, 1]
    depth = np.maximum(-y, 0.0) + np.maximum(y - chain.outer_gap[:n], 0.0)
    wall = (chain.contact_stiffness[:n] * depth**2).sum()
    return float(0.5 * (mass @ v**2 + (mass * d) @ (linear_matrix(chain) @ d) + wall))


def run_digits() -> pd.DataFrame:
    """Relative difference of one step's solution to LAPACK's, for the TICM and the transfer matrix, over elements.

    A probe at table 2's values with all floats in the wall, a step of 1 ms.
    """
    scheme, rows = newmark(SOLVED_STEP), []
    for elements in SOLVED:
        full = build_chain(Scene())
        nodal = {name: part[: elements + 1] for name, part in full._asdict().items() if isinstance(part, np.ndarray)}
        chain = full._replace(**nodal)  # type: ignore[arg-type]
        start = at_rest(elements + 1)
        start.d[:-1, 1] = -1e-5 * np.random.default_rng(1).random(elements)
        inputs = Drive(0.2, 50.0).inputs_of_steps(1, SOLVED_STEP, chain.element_length, 0)[0]
        work = workspace(elements + 1)
        exact, by_ticm, by_transfer = (State(*(part.copy() for part in start)) for _ in range(3))
        banded.stepper(chain, scheme)(inputs, elements, exact, work)
        ticm.ticm_step(chain, scheme, inputs, elements, by_ticm, work)
        transfer_matrix.step(chain, scheme, inputs, elements, by_transfer, work)
        scale = np.abs(exact.d).max()
        for solver, state in (("ticm", by_ticm), ("transfer-matrix", by_transfer)):
            error = float(np.abs(state.d - exact.d).max() / scale)
            rows.append({"solver": solver, "elements": elements, "error": error})
    return pd.DataFrame(rows)
