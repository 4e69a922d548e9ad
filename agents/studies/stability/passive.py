"""Conserved energy of a passive chain over 100,000 steps."""

from __future__ import annotations

import math
from itertools import product
from typing import Final

import numpy as np
import pandas as pd

from probe_env.physics.closed_forms.bare_chains import Driven, bent_chain, linear_matrix, masses, run_chain
from probe_env.physics.methods import ON_NODES
from probe_env.physics.model.chain import Chain
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


def run_energy() -> pd.DataFrame:
    """Energy after 100,000 steps over that at the start, of a frictionless chain thrown about with and without walls.

    Columns method, time_step_s, damping_time_s, walls, ratio (infinite where it diverged).
    """
    rows, floats = [], np.arange(ELEMENTS + 1) % 4 == 0
    gaps, levers = np.full(ELEMENTS + 1, GAP), np.full(ELEMENTS + 1, FLOAT_RADIUS)
    contact = {"contact_stiffness": np.where(floats, STIFFNESS, 0.0), "outer_gap": gaps, "lever": levers}
    for (method, steps), damping_time, walls in product(METHODS.items(), DAMPING, (False, True)):
        chain = bent_chain(ELEMENTS, damping_time=damping_time)._replace(**(contact if walls else {}))  # type: ignore[arg-type]
        for time_step in steps:
            state = at_rest(ELEMENTS + 1)
            state.v[:-1] = np.random.default_rng(0).normal(size=(ELEMENTS, 3)) * (0.1, 0.1, 1.0)
            before = energy(chain, state)
            held = run_chain(method, Driven(chain), time_step, state, STEPS, STEPS).held
            rows.append((method, time_step, damping_time, walls, energy(chain, state) / before if held else math.inf))
    return pd.DataFrame(rows, columns=["method", "time_step_s", "damping_time_s", "walls", "ratio"])


def energy(chain: Chain, state: State) -> float:
    """Kinetic, elastic and contact energy [J]."""
    n = chain.node_count - 1
    d, v, mass, y = state.d[:n].ravel(), state.v[:n].ravel(), masses(chain), state.d[:n, 1]
    depth = np.maximum(-y, 0.0) + np.maximum(y - chain.outer_gap[:n], 0.0)
    wall = (chain.contact_stiffness[:n] * depth**2).sum()
    return float(0.5 * (mass @ v**2 + (mass * d) @ (linear_matrix(chain) @ d) + wall))
