"""TICM against a dense solution."""

import numpy as np
import pytest
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
    """Floats on both walls and in between, sliding both ways, also as they turn."""
    d = rng.normal(size=(nodes, 3)) * [1e-3, 1e-2, 1e-2]
    v = rng.normal(size=(nodes, 3)) * [0.3, 0.3, 30.0]
    a = rng.normal(size=(nodes, 3)) * 10.0
    for array in (d, v, a):
        array[-1] = 0.0
    return State(d, v, a, rng.normal(size=nodes) * 4.0)


def assert_equals_dense(chain, scheme, state, bound):
    h_a = scheme.a_d * state.d + scheme.a_v * state.v + scheme.a_a * state.memory[:, :3]
    h_v = scheme.v_d * state.d + scheme.v_v * state.v + scheme.v_a * state.memory
    h_v[-1] = -scheme.B_v * state.d[-1]  # at rest
    d, axial = dense_step(chain, scheme.B_a, scheme.B_v, INPUTS, h_a, h_v, state.d, state.v, state.axial_force)
    ticm.ticm_step(chain, scheme, INPUTS, chain.node_count - 1, state, workspace(chain.node_count))
    assert np.abs(state.d - d).max() <= bound * np.abs(d).max()
    assert np.abs(state.axial_force - axial)[:-1].max() <= 10.0 * bound * np.abs(axial).max()


@pytest.mark.parametrize("n", [1, 2, 3, 10, 50, pytest.param(500, marks=pytest.mark.slow)])
@pytest.mark.parametrize("time_step", [1e-5, 1e-4, 1e-3])
@pytest.mark.parametrize(("scheme", "withdrawal"), [(newmark, False), (wilson, False), (newmark, True)])
def test_ticm_equals_the_dense_solution(n, time_step, scheme, withdrawal):
    rng = np.random.default_rng([n, round(1e5 * time_step), scheme is wilson])
    chain = random_chain(rng, n, 10 ** rng.uniform(3.0, 7.0))
    state = random_state(rng, n + 1)
    if withdrawal:  # a cable that touches the walls and a couple that counts from the tangent
        k = 10 ** rng.uniform(3.0, 7.0)
        chain = chain._replace(cable_stiffness=k, cable_radius=4e-3, couple_turn=chain.curvature, max_pressure=5.0)
        state.d[-1] = rng.normal(size=3) * [1e-2, 1e-3, 1e-2]  # where the root is held
    assert_equals_dense(chain, scheme(time_step)._replace(wilson=False), state, 1e-10)  # (17)-(18) itself


@pytest.mark.parametrize(("n", "stiffness"), [(2, 1e5), (10, 1e5), (40, 1e5), (8, 1e3), (8, 1e9)])
def test_no_digits_are_lost_with_all_floats_on_the_wall(n, stiffness):
    """Where the transfer matrix, the predecessor of the TICM, has none left."""
    rng = np.random.default_rng(1)
    chain, state = random_chain(rng, n, stiffness), random_state(rng, n + 1)
    state.d[:-1, 1] = -np.abs(state.d[:-1, 1])
    assert_equals_dense(chain, newmark(1e-3), state, 1e-10)
