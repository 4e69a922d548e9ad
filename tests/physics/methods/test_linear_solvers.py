"""TICM against a dense solution, LAPACK's banded solver, and the transfer matrix that loses its digits."""

import numpy as np
import pytest
from oracles import banded, transfer_matrix
from oracles.dense import dense_step

from probe_env import Scene
from probe_env.physics.methods import ticm
from probe_env.physics.methods.newmark import newmark, wilson, workspace
from probe_env.physics.model.chain import build_chain
from probe_env.physics.model.state import State

INPUTS = np.array([0.2, 0.3, 60.0, 0.0, 1.0])  # u, du/dt, air speed


def random_chain(rng, n, stiffness):
    """n elements of table 2's cable in a helix, random floats with random contact stiffness and gaps."""
    base = build_chain(Scene(carrier_length=0.1))
    nodes = n + 1
    is_float = rng.random(nodes) < 0.5
    return base._replace(
        contact_stiffness=np.where(is_float, stiffness, 0.0),
        outer_gap=rng.uniform(1e-3, 6e-3, nodes),
        lever=rng.uniform(0.008, 0.01, nodes),
        drag=np.where(is_float, base.drag.max(), 0.0),
        support_stiffness=np.zeros((nodes, 3)),
        load=rng.normal(size=(nodes, 3)) * [1.0, 1.0, 0.01],
    )


def random_state(rng, nodes):
    """Floats on both walls and in between, sliding both ways."""
    d = rng.normal(size=(nodes, 3)) * [1e-3, 1e-2, 1e-2]
    v = rng.normal(size=(nodes, 3)) * 0.3
    a = rng.normal(size=(nodes, 3)) * 10.0
    for array in (d, v, a):
        array[-1] = 0.0
    return State(d, v, a, rng.normal(size=nodes) * 4.0)


def compressed(chain, rng):
    """The same chain with a cable that touches the walls and a couple that counts from the tangent."""
    return chain._replace(
        cable_stiffness=10 ** rng.uniform(3.0, 7.0), cable_radius=4e-3, couple_turn=chain.curvature, max_pressure=5.0
    )


def copy(state):
    return State(*(array.copy() for array in state))


@pytest.mark.parametrize("n", [1, 2, 3, 10, 50, pytest.param(500, marks=pytest.mark.slow)])
@pytest.mark.parametrize("time_step", [1e-5, 1e-4, 1e-3])
@pytest.mark.parametrize(("scheme", "withdrawal"), [(newmark, False), (wilson, False), (newmark, True)])
def test_ticm_and_banded_equal_the_dense_solution(n, time_step, scheme, withdrawal):
    rng = np.random.default_rng([n, round(1e5 * time_step), scheme is wilson])
    chain = random_chain(rng, n, 10 ** rng.uniform(3.0, 7.0))
    start = random_state(rng, n + 1)
    if withdrawal:
        chain = compressed(chain, rng)
        start.d[-1] = rng.normal(size=3) * [1e-2, 1e-3, 1e-2]  # where the root is held
    coefficients = scheme(time_step)._replace(wilson=False)  # the solution of (17)-(18) itself
    h_a = coefficients.a_d * start.d + coefficients.a_v * start.v + coefficients.a_a * start.memory
    h_v = coefficients.v_d * start.d + coefficients.v_v * start.v + coefficients.v_a * start.memory
    h_v[-1] = -coefficients.B_v * start.d[-1]  # at rest
    d, axial = dense_step(
        chain, coefficients.B_a, coefficients.B_v, INPUTS, h_a, h_v, start.d, start.v, start.axial_force
    )
    work = workspace(n + 1)
    for step in (
        lambda s: ticm.ticm_step(chain, coefficients, INPUTS, n, s, work),
        lambda s: banded.stepper(chain, coefficients)(INPUTS, n, s, work),
    ):
        state = copy(start)
        step(state)
        assert np.abs(state.d - d).max() <= 1e-10 * np.abs(d).max()
        assert np.abs(state.axial_force - axial)[:-1].max() <= 1e-9 * np.abs(axial).max()


def loss_of_digits(n, time_step, stiffness):
    """Relative error of the TICM and the transfer matrix against the banded solution, all floats on the wall."""
    rng = np.random.default_rng(1)
    chain = random_chain(rng, n, stiffness)
    start = random_state(rng, n + 1)
    start.d[:-1, 1] = -np.abs(start.d[:-1, 1])
    scheme = newmark(time_step)
    work = workspace(n + 1)
    exact = copy(start)
    banded.stepper(chain, scheme)(INPUTS, n, exact, work)
    scale = np.abs(exact.d).max()
    by_ticm, by_transfer = copy(start), copy(start)
    ticm.ticm_step(chain, scheme, INPUTS, n, by_ticm, work)
    transfer_matrix.step(chain, scheme, INPUTS, n, by_transfer, work)
    return np.abs(by_ticm.d - exact.d).max() / scale, np.abs(by_transfer.d - exact.d).max() / scale


def test_transfer_matrix_loses_digits_and_ticm_does_not():
    errors = {n: loss_of_digits(n, 1e-3, 1e5) for n in (2, 5, 10, 20, 40)}
    assert errors[2][1] < 1e-9  # a short chain is fine by either method
    assert errors[20][1] > 1e3 * errors[5][1]  # digits go with length ...
    assert errors[40][1] > 1e-2  # ... until none is left at one metre, with a step as large as 1 ms
    soft, hard = loss_of_digits(8, 1e-3, 1e3), loss_of_digits(8, 1e-3, 1e9)
    assert hard[1] > 1e3 * soft[1]
    assert max(error for error, _ in (*errors.values(), soft, hard)) < 1e-10
