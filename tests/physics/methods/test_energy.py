"""Energy of passive chains: constant without damping, decreasing with it."""

import numpy as np
from oracles.chains import advance, bent, energy, matrices, uniform_chain

from probe_env.physics.methods import ticm
from probe_env.physics.methods.newmark import newmark, workspace
from probe_env.physics.model.state import at_rest

N, STEPS, CHUNKS, TIME_STEP = 100, 20_000, 20, 1e-4
PASSIVE = bent(uniform_chain(N))


def energies(chain):
    """Energy of a chain shaken at the start, over 20,000 Newmark steps; infinite once it has diverged."""
    M, K = matrices(PASSIVE)
    state, work = at_rest(N + 1), workspace(N + 1)
    state.v[:-1] = np.random.default_rng(0).normal(size=(N, 3)) * [0.1, 0.1, 1.0]
    values = [energy(M, K, state)]
    for _ in range(CHUNKS):
        status, _ = advance(chain, newmark(TIME_STEP), state, STEPS // CHUNKS, STEPS, work=work)
        if status == ticm.DIVERGED:
            return np.append(values, np.inf)
        values.append(energy(M, K, state))
    return np.array(values)


def test_newmark_keeps_the_energy_of_the_linear_chain():
    values = energies(PASSIVE)
    # every step rounds an acceleration B_a d with B_a d / a of up to about (omega dt / 2)^-2 ~ 1e3 for the
    # bending modes: 20,000 steps * 1e3 eps
    assert np.abs(values / values[0] - 1.0).max() <= STEPS * 1e3 * np.finfo(float).eps


def test_damping_takes_energy_all_the_time():
    values = energies(PASSIVE._replace(damping_time=5e-5))
    assert (np.diff(values) < 0.0).all()
    assert values[-1] < 0.05 * values[0]
