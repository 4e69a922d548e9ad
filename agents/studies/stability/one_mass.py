"""Stability and numerical damping of every method on one mass, by its own kernel.

Two springs: an elastic element, and a wall's contact spring. Inside each the step is linear, so one step from unit
vectors gives the amplification matrix that theory speaks of. In between, bounces off two walls show what the
switching of contact does: the study's contact flag is that of the step before.
"""

from __future__ import annotations

import math
from itertools import product
from typing import Final

import numpy as np
import pandas as pd

from probe_env.arrays import FloatArray
from probe_env.physics import methods
from probe_env.physics.closed_forms.bare_chains import AXIAL, RADIAL, Driven, plain_chain, run_chain
from probe_env.physics.methods.newmark import Newmark
from probe_env.physics.model.chain import Chain
from probe_env.physics.model.state import at_rest

METHODS: Final = tuple(name for name, method in methods.ON_NODES.items() if method.least_step == 0.0)
"""Those whose rounding does not show at the smallest steps."""
OMEGA_DT: Final = (0.1, 0.2, 0.3, 0.5, 0.75, 1.0, 1.25, 1.5, 1.8, 1.95, 2.05, 2.5, 3.0, 4.0, 6.0)
BOUNCES: Final = 60
GAP, SPEED, STIFFNESS = 1e-3, 0.5, 1e5  # [m], [m/s], [N/m]
DEEP, SMALL = 1e-4, 1e-7  # [m] where a step starts in its spring, and the differences that give its matrix


def one_mass(spring: str, stiffness: float = STIFFNESS, gap: float = math.inf) -> tuple[Chain, int]:
    """A chain of one node on a spring, and the component that it moves in."""
    free = dict.fromkeys(("axial_compliance", "shear_compliance", "bending_compliance"), 1e9)
    if spring == "elastic":
        free["axial_compliance"] = 1.0 / stiffness
        return plain_chain(1, damping_time=0.0, coupling_compliance=0.0, **free), AXIAL
    walls = {"contact_stiffness": np.array([stiffness, 0.0]), "outer_gap": np.array([gap, np.inf])}
    return plain_chain(1, damping_time=0.0, coupling_compliance=0.0, **free, **walls), RADIAL


def _step(method: str, chain: Chain, time_step: float, start: FloatArray, component: int) -> FloatArray:
    """Displacement, velocity and acceleration of the mass after a step; NaN if it diverged."""
    state = at_rest(2)
    state.d[0, component], state.v[0, component], state.memory[0, component] = start
    if not run_chain(method, Driven(chain), time_step, state, 1, 1).held:
        return np.full(3, np.nan)
    return np.array([state.d[0, component], state.v[0, component], state.memory[0, component]])


def amplification(method: str, spring: str, omega_dt: float) -> tuple[float, float, float]:
    """Spectral radius, damping ratio and relative change of the period of one mode, undamped in truth.

    The largest complex pair of the matrix counts; damping is -log|z| / arg z, NaN if no eigenvalue oscillates.
    """
    chain, component = one_mass(spring)
    omega = math.sqrt(STIFFNESS / chain.mass)
    time_step = omega_dt / omega
    # acceleration is part of the state of those that solve for it
    size = 3 if isinstance(methods.METHODS[method], Newmark) else 2
    scale = np.array([1.0, omega, omega**2])
    base = np.array([-DEEP, 0.0, 0.0])  # so deep in the contact spring that a step does not leave it
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
    """Mean restitution, speed after over before, of many bounces between two walls, and its damping ratio.

    A linear spring of damping ratio zeta returns exp(-pi zeta); a gain is negative damping. NaN where it diverged.
    """
    chain, component = one_mass("contact", gap=GAP)
    omega = math.sqrt(STIFFNESS / chain.mass)
    time_step = omega_dt / omega
    period = GAP / SPEED + math.pi / omega
    steps = math.ceil(BOUNCES * period / time_step)
    state = at_rest(2)
    state.d[0, component], state.v[0, component] = 0.4321 * GAP, -SPEED
    run = run_chain(method, Driven(chain), time_step, state, steps, 1)
    y = run.samples[:, component]
    if not run.held:
        return float("nan"), float("nan")
    # speeds of free flights: steps whose both ends are between the walls
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
    rows = []
    for method, omega_dt in product(METHODS, OMEGA_DT):
        restitution, bounce_damping = bounce(method, omega_dt)
        for spring in ("elastic", "contact"):
            bounces = (restitution, bounce_damping) if spring == "contact" else (math.nan, math.nan)
            rows.append((method, spring, omega_dt, *amplification(method, spring, omega_dt), *bounces))
    columns = ["method", "spring", "omega_dt", "spectral_radius", "damping", "period_error"]
    return pd.DataFrame(rows, columns=[*columns, "restitution", "bounce_damping"])
