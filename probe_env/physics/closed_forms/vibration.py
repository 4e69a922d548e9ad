"""The linear chain under a load that changes, and an impact on a spring."""

from __future__ import annotations

import math

import numpy as np

from probe_env.arrays import FloatArray
from probe_env.physics.closed_forms.bare_chains import linear_matrix, masses
from probe_env.physics.model.chain import Chain


def linear_chain(chain: Chain, times: FloatArray, before: FloatArray, load: FloatArray) -> FloatArray:
    """Displacements (k, n, 3) of a damped chain without contact that rested under one load when another one set in.

    Every mode obeys q'' + delta lambda q' + lambda q = p; exact for the discrete chain, so what a method is off by is
    its error in time alone. The chain must be without the frame's inertia terms.

    Args:
        chain: n nodes and the held root.
        times: (k,) since the change [s]; 0 gives the rest under the load before.
        before: (n, 3) load until then [N], [N m].
        load: (n, 3) load from then on.
    """
    root_mass = np.sqrt(masses(chain))
    symmetric = root_mass[:, None] * linear_matrix(chain) / root_mass
    squares, modes = np.linalg.eigh(0.5 * (symmetric + symmetric.T))
    start, at_rest = (modes.T @ (force.ravel() / root_mass) / squares for force in (before, load))
    discriminant = np.sqrt((chain.damping_time * squares).astype(complex) ** 2 - 4.0 * squares)
    slow, fast = (0.5 * (sign * discriminant - chain.damping_time * squares) for sign in (1.0, -1.0))
    amplitude = (start - at_rest) / (slow - fast)
    moving = amplitude * (slow * np.exp(np.outer(times, fast)) - fast * np.exp(np.outer(times, slow)))
    return np.asarray(((at_rest + moving.real) @ modes.T / root_mass).reshape(len(times), -1, 3))


def impact(mass: float, stiffness: float, height: float, speed: float, times: FloatArray) -> FloatArray:
    """Height (k,) of a free mass above a spring that it flies at and leaves again; the contact lasts pi / omega."""
    omega = math.sqrt(stiffness / mass)
    arrival = height / speed
    departure = arrival + math.pi / omega
    inside = -speed / omega * np.sin(omega * (times - arrival))
    return np.where(
        times < arrival, height - speed * times, np.where(times < departure, inside, speed * (times - departure))
    )
