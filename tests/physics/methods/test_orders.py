"""The order that every method declares is the one it shows where the motion is smooth."""

import numpy as np
import pytest
from oracles.orders import observed_order

from agents.studies.chart.smooth import cases
from probe_env.physics.closed_forms.bare_chains import run_chain
from probe_env.physics.methods import METHODS

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
    if METHODS[method].start:
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
