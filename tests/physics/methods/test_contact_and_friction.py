"""Contact pushes only on contact; friction is mu N against the sliding of the step before."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.chains import tip_equation, uniform_chain

from probe_env.physics.model.state import at_rest

K, MU, GAP, LEVER, FEED = 1e5, 0.15, 5.2e-3, 9.5e-3, 0.2
CHAIN = uniform_chain(1, contact_stiffness=np.array([K, 0.0]), outer_gap=np.full(2, GAP), lever=np.full(2, LEVER))
CHAIN = CHAIN._replace(friction=MU)
INPUTS = np.array([FEED, 0.0, 0.0, 0.0, 1.0])


def contact_force(y, v_x, v_t, y_new):
    """(x, y, moment) that contact adds to the float's equation, for a new radial displacement."""
    state = at_rest(2)
    state.d[0, 1], state.v[0, 0], state.v[0, 2] = y, v_x, v_t
    forces = []
    for chain in (CHAIN, CHAIN._replace(contact_stiffness=np.zeros(2))):
        P, q = tip_equation(chain, INPUTS, state)
        forces.append(q - P[[1, 2, 4]] * y_new)
    return forces[0] - forces[1]


velocity = st.floats(-1.0, 1.0)


@settings(max_examples=200, deadline=None)
@given(y=st.floats(-0.02, 0.02), y_new=st.floats(-0.02, 0.02), v_x=velocity, v_t=st.floats(-50.0, 50.0))
def test_contact_and_friction_of_one_float(y, y_new, v_x, v_t):
    force_x, force_y, moment = contact_force(y, v_x, v_t, y_new)
    if 0.0 <= y <= GAP:
        assert (force_x, force_y, moment) == (0.0, 0.0, 0.0)
        return
    inner = y < 0.0
    normal = -K * y_new if inner else K * (y_new - GAP)  # away from the wall; negative: adhesive
    rounding = 1e-9 * K * (abs(y_new) + GAP)
    assert abs(force_y - (normal if inner else -normal)) <= rounding
    assert abs(force_x) <= MU * abs(normal) + rounding
    sliding = FEED + v_x + (v_t * LEVER if inner else -v_t * LEVER)
    direction = 1.0 if sliding >= 0.0 else -1.0
    assert abs(force_x + direction * MU * normal) <= rounding
    contact_point = -LEVER if inner else LEVER  # radial position of the contact point on the float
    assert abs(moment + contact_point * force_x) <= rounding
