"""Order of convergence where the motion is smooth: as declared, and Newmark and Wilson towards the exact solution."""

import numpy as np
import pytest
from oracles.chains import bent, integrate, matrices, uniform_chain
from oracles.orders import observed_order
from scipy.linalg import eigh, expm
from scipy.stats import linregress

from probe_agents.studies.smooth import cases
from probe_env.physics.closed_forms.bare_chains import run_chain
from probe_env.physics.methods import METHODS
from probe_env.physics.methods.newmark import newmark, wilson

CASE = cases()["linear"]
STEPS = {
    "newmark": (4e-4, 2e-4, 1e-4, 5e-5),
    "wilson": (4e-4, 2e-4, 1e-4, 5e-5),
    "implicit": (1e-5, 5e-6, 2.5e-6, 1.25e-6),  # below the damping time theta has come down to one half
    "imex": (1e-5, 5e-6, 2.5e-6, 1.25e-6),
    "superelement": (1e-5, 5e-6, 2.5e-6, 1.25e-6),
    "explicit": (2e-6, 1e-6, 5e-7),  # below the limit of its fastest mode
}
"""[s] where a method's own error is above rounding and its order has set in."""
TWINS = {"imex32": "imex", "superelement32": "superelement"}
"""Methods of single precision: rounding is their error at every step that they accept, so they show no order."""


def shape(method, time_step):
    steps, every = round(0.048 / time_step), round(1.6e-3 / time_step)
    start = CASE.start(method, time_step)
    if not METHODS[method].on_nodes:
        chain = CASE.driven.chain
        start = METHODS[method].at_rest(chain, 4, time_step, chain.node_count - 1, start.d)
    return run_chain(method, CASE.driven, time_step, start, steps, every).samples[:, CASE.point[1]]


@pytest.mark.parametrize("method", METHODS)
def test_every_method_shows_the_order_that_it_declares(method):
    """Within 0.1, which orders one and two cannot both pass; a method without steps or a twin here is an error."""
    if method in TWINS:
        twin = METHODS[TWINS[method]]
        assert METHODS[method].order == twin.order  # the same scheme
        exact = shape(twin.name, 2e-4)
        assert 0.0 < np.abs(shape(method, 2e-4) - exact).max() < 5e-3 * np.abs(exact).max()
        return
    order, left, _ = observed_order(lambda dt: shape(method, dt), STEPS[method])
    assert order == pytest.approx(METHODS[method].order, abs=0.1)
    assert 0.0 < left < 1e-5


@pytest.mark.parametrize("scheme", [newmark, wilson])
@pytest.mark.parametrize(("consistent", "order", "finest"), [(True, 2.0, 5e-5), (False, 1.0, 1.25e-5)])
def test_the_study_s_schemes_converge_to_the_matrix_exponential(scheme, consistent, order, finest):
    """A bent, damped chain of 20 elements at 0.02 s: order two, and one from the printed start of zero acceleration.

    What is of order two in the latter is 11 % of the slope at 4e-4 s, so its steps are shorter.
    """
    N, delta, duration = 20, 5e-5, 0.02
    chain = bent(uniform_chain(N))._replace(damping_time=delta)
    M, K = matrices(chain)
    modes = eigh(K, M)[1]
    d0 = 1e-5 * modes[:, 0] + 1e-6 * modes[:, 2]
    flow, n = np.linalg.solve(M, K), 3 * N
    system = np.block([[np.zeros((n, n)), np.eye(n)], [-flow, -delta * flow]])
    exact = (expm(system * duration) @ np.concatenate([d0, np.zeros(n)]))[:n].reshape(-1, 3)
    d, a = np.zeros((N + 1, 3)), np.zeros((N + 1, 3))
    d[:-1] = d0.reshape(-1, 3)
    a[:-1] = -(flow @ d0).reshape(-1, 3)
    time_steps, errors = finest * np.array([8.0, 4.0, 2.0, 1.0]), []
    for dt in time_steps:
        steps = round(duration / dt)
        _, state = integrate(chain, scheme(dt), d=d, a=a if consistent else None, steps=steps, every=steps)
        errors.append(np.abs(state.d[:-1] - exact).max() / np.abs(exact).max())
    assert linregress(np.log(time_steps), np.log(errors)).slope == pytest.approx(order, abs=0.1)
    assert not consistent or errors[-1] < 5e-6
