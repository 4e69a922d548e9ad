"""Order of the study's scheme: two where it is linear and starts smoothly, one as printed.

In contact, with the other methods: test_fast_methods.
"""

import numpy as np
import pytest
from oracles.chains import bent, integrate, matrices, plain_chain
from scipy.linalg import eigh, expm
from scipy.stats import linregress

from probe_env import Scene
from probe_env.physics.methods.newmark import newmark, wilson
from probe_env.physics.model.chain import air_speed, build_chain

SCHEMES = pytest.mark.parametrize("scheme", [newmark, wilson])


def order(time_steps, errors):
    """Fitted slope of log error over log step, and its standard error."""
    fit = linregress(np.log(time_steps), np.log(errors))
    return fit.slope, fit.stderr


def linear_errors(scheme, time_steps, consistent_start):
    """Relative error at 0.02 s of a bent, damped chain of 20 elements against the matrix exponential."""
    N, delta, duration = 20, 5e-5, 0.02
    chain = bent(plain_chain(N))._replace(damping_time=delta)
    M, K = matrices(chain)
    modes = eigh(K, M)[1]
    d0 = 1e-5 * modes[:, 0] + 1e-6 * modes[:, 2]
    flow = np.linalg.solve(M, K)
    n = 3 * N
    system = np.block([[np.zeros((n, n)), np.eye(n)], [-flow, -delta * flow]])
    exact = (expm(system * duration) @ np.concatenate([d0, np.zeros(n)]))[:n].reshape(-1, 3)
    d, a = np.zeros((N + 1, 3)), np.zeros((N + 1, 3))
    d[:-1] = d0.reshape(-1, 3)
    a[:-1] = -(flow @ d0).reshape(-1, 3)
    errors = []
    for dt in time_steps:
        steps = round(duration / dt)
        _, state = integrate(chain, scheme(dt), d=d, a=a if consistent_start else None, steps=steps, every=steps)
        errors.append(np.abs(state.d[:-1] - exact).max() / np.abs(exact).max())
    return errors


@SCHEMES
def test_order_two_on_the_linear_chain_with_a_consistent_start(scheme):
    time_steps = (4e-4, 2e-4, 1e-4, 5e-5)
    errors = linear_errors(scheme, time_steps, consistent_start=True)
    assert order(time_steps, errors)[0] == pytest.approx(2.0, abs=0.1)
    assert errors[-1] < 5e-6


@SCHEMES
def test_order_one_with_the_printed_start_of_zero_acceleration(scheme):
    time_steps = (1e-4, 5e-5, 2.5e-5, 1.25e-5)  # what is of order two in it is 11 % of the slope at 4e-4 s
    errors = linear_errors(scheme, time_steps, consistent_start=False)
    assert order(time_steps, errors)[0] == pytest.approx(1.0, abs=0.1)


@SCHEMES
def test_order_one_on_the_full_scene_before_contact(scheme):
    scene = Scene(carrier_length=3.0)
    chain = build_chain(scene)
    chain = chain._replace(contact_stiffness=0.0 * chain.contact_stiffness)
    drive = {"feed": scene.feed_speed, "air": air_speed(scene, scene.air_supply_rate)}
    duration = 0.02

    def shape(dt):
        steps = round(duration / dt)
        return integrate(chain, scheme(dt), steps=steps, every=steps, **drive)[1].d[:, 0]

    reference = shape(6.25e-7)
    time_steps = (2e-4, 1e-4, 5e-5, 2.5e-5)
    errors = [np.abs(shape(dt) - reference).max() / np.abs(reference).max() for dt in time_steps]
    assert order(time_steps, errors)[0] == pytest.approx(1.0, abs=0.1)
