"""Terms that the study leaves out: shortening of the bent span, friction that holds, force of the entrance."""

import math

import numpy as np
import pytest
from oracles.chains import bent, energy, matrices, tip_equation, uniform_chain

from probe_env import Scene, Simulator, SimulatorBatch
from probe_env.physics.closed_forms import friction_from_tension, steady_root_tension, steady_tensions
from probe_env.physics.closed_forms.bare_chains import DrivenChain, run_chain
from probe_env.physics.methods import METHODS
from probe_env.physics.model.state import HELD, SHORTENING, at_rest

SIMULATING = [name for name, method in METHODS.items() if method.simulates_terms]
SPAN, NODES = 4, 18


def whole_energy(chain, state):
    """Energy of a chain whose bent spans of length p shorten by Q: K and M, and V Q + EA Q^2 / (2 p) of every span."""
    h = chain.element_length
    rigidity = h / chain.axial_compliance
    x, y, t = state.d.T
    strain = chain.cos_phi * (x[:-1] - x[1:]) + chain.sin_phi * (y[:-1] + y[1:])
    squares = 0.25 * h * (t[:-1] ** 2 + t[1:] ** 2)
    total = energy(*matrices(chain), state)
    for first in range(0, len(strain), chain.span):
        span = slice(first, first + chain.span)
        p, Q = h * len(strain[span]), squares[span].sum()
        total += rigidity * strain[span].sum() / p * Q + 0.5 * rigidity * Q * Q / p
    return total


@pytest.mark.parametrize("method", ["newmark", "imex"])
def test_shortening_conserves_energy_to_first_order(method):
    """Spans thrown to 2 mm in 4 ms without damping: V and N are of the last step, so that the error is of order one.

    Without the axial force of N the energy would change by V Q, a tenth of it.
    """
    chain = bent(uniform_chain(NODES))._replace(span=SPAN, couple_length=0.025)
    place = 0.025 * np.arange(NODES) * np.pi / 0.1
    errors = []
    for time_step in (5e-6, 2.5e-6, 1.25e-6):
        state = at_rest(NODES + 1)
        state.v[:-1, 1], state.v[:-1, 2] = 0.5 * np.sin(place), -0.5 * np.pi / 0.1 * np.cos(place)
        start, worst = whole_energy(chain, state), 0.0
        for _ in range(5):
            run_chain(method, DrivenChain(chain), time_step, state, round(1e-3 / time_step), 100)
            worst = max(worst, abs(whole_energy(chain, state) / start - 1.0))
        errors.append(worst)
    assert math.log2(errors[0] / errors[1]) == pytest.approx(1.0, abs=0.2)
    assert math.log2(errors[1] / errors[2]) == pytest.approx(1.0, abs=0.15)
    assert errors[2] < 1e-3
    assert state.memory[:, SHORTENING].max() > 20.0  # [N]; the couple alone is below 1 N


FLUTTER = Scene(
    tube={"helix_diameter": 2.5}, contact={"friction": 0.25}, feed_speed=0.4, air_supply_rate=130 / 3600,
    carrier_length=47.5,
)  # fmt: skip


def test_shortening_keeps_a_fluttering_probe_bounded():
    """Table 2's probe at 0.4 m/s and 130 m3/h, P_E = 47 N: bouncing at the entrance buckles spans, which unload."""
    for shortening in (False, True):
        scene = FLUTTER.model_copy(update={"terms": {"shortening": shortening}})
        batch = SimulatorBatch([scene] * 8, "superelement32", perturbation=1e-7)
        batch.advance(None, None, 2.0)
        window = batch.advance(None, None, 4.0)
        assert window.diverged.any() == (not shortening)
    assert window.statistics["tension_mean_n"].mean() == pytest.approx(steady_tensions(scene)[-1], rel=0.01)
    for simulator in batch.simulators:  # a part of the tension that is reported
        pull = simulator.state.memory[: simulator.root, SHORTENING]
        assert pull.max() > 1.0
        assert (simulator.tension == (simulator.state.axial_force[: simulator.root] + pull)[::-1]).all()


K, MU, LEVER = 1e5, 0.15, 9.5e-3
HELD_CHAIN = uniform_chain(
    1, contact_stiffness=np.array([K, 0.0]), outer_gap=np.full(2, 5.2e-3), lever=np.full(2, LEVER)
)
HELD_CHAIN = HELD_CHAIN._replace(friction=MU)


@pytest.mark.parametrize("weight", [0.0, 0.11])
@pytest.mark.parametrize(("y", "normal"), [(-2e-6, 0.2), (5.2e-3 + 1e-6, 0.1)])
@pytest.mark.parametrize(("v_x", "held"), [(0.1, 0.0), (-0.3, 0.0), (-0.2, 0.01), (-0.2, 1.0), (-0.2 + 5e-4, -0.01)])
def test_friction_of_one_float_slides_or_holds(y, normal, v_x, held, weight):
    """Feed 0.2 m/s, a step of 1e-4 s: R = held + k slip dt, as long as it is below mu sqrt(N^2 + w^2)."""
    chain = HELD_CHAIN._replace(float_weight=weight)
    state = at_rest(2)
    state.d[0, 1], state.v[0, 0], state.memory[0, HELD] = y, v_x, held
    forces = []
    for one in (chain._replace(stiction=True), chain, chain._replace(contact_stiffness=np.zeros(2), float_weight=0.0)):
        P, q = tip_equation(one, (0.2, 0.0, 0.0), state)
        new = np.array([1e-4 * v_x, y, 0.0])  # moved on by v_x for a step
        applied = q - [P[0] * new[0] + P[1] * y, P[2] * y, P[3] * new[0] + P[4] * y]
        forces.append(applied)
    held_force, sign_force = forces[0] - forces[2], forces[1] - forces[2]
    total = math.hypot(normal, weight)
    trial, limit = held + K * 1e-4 * (0.2 + v_x), MU * total
    arm = (LEVER if y < 0.0 else -LEVER) * normal / total
    if abs(trial) < limit:
        assert held_force[0] == pytest.approx(-trial, abs=1e-9)
        assert held_force[2] == pytest.approx(-arm * trial, abs=1e-9)
    else:
        assert abs(held_force[0]) == pytest.approx(limit, rel=1e-6)
        assert held_force[0] * trial < 0.0
        if trial * (0.2 + v_x) > 0.0:
            assert held_force == pytest.approx(sign_force, abs=1e-9)


QUIET = Scene(carrier_length=2.5, probe={"guide_length": 0.5}, feed_speed=0.2)


@pytest.mark.parametrize("weight", [False, True])
@pytest.mark.parametrize("method", SIMULATING)
def test_a_stopped_probe_keeps_its_tension(method, weight):
    """Once the cable has come to rest, no float moves by a micrometre a second, and the root tension remains.

    With the sign of the last sliding the root tension rises from 2.3 N to that without friction, 2.9 N, in a second.
    The friction is low enough that floats do not bounce, which lets the cable slide on a little as the feed stops.
    """
    scene = QUIET.model_copy(update={"terms": {"stiction": True}, "contact": {"weight": weight, "friction": 0.08}})
    simulator = Simulator(scene, method, METHODS[method].usual_step, ramp=0.5)
    sliding = simulator.advance(duration=1.0, points=("root",)).tension[500:, 0].mean()
    simulator.advance(0.0, duration=1.0)
    before = simulator.state.d.copy()
    run = simulator.advance(0.0, duration=1.0, points=("root",))
    assert np.abs(simulator.state.d - before)[:, 0].max() < 1e-6
    assert np.ptp(run.tension) < 1e-3 * sliding
    assert run.tension[-1, 0] < 1.1 * sliding < 2.6


@pytest.mark.parametrize("method", [name for name in SIMULATING if name != "implicit"])
def test_sliding_friction_is_that_of_the_sign(method):
    """A sliding probe is continued with held friction, which yields within a step: nothing changes but rounding."""
    steps = METHODS[method].usual_step, 200 * METHODS[method].usual_step
    first = Simulator(QUIET, method, steps[0])
    first.advance(duration=5.0 * steps[1])
    ended = []
    for terms in ({}, {"stiction": True}):
        simulator = first.branch(QUIET.model_copy(update={"terms": terms}))
        ended.append(simulator.advance(duration=steps[1]).tension)
    tolerance = 1e-3 if method.endswith("32") else 1e-8
    assert ended[1] == pytest.approx(ended[0], rel=tolerance)


@pytest.mark.parametrize("method", SIMULATING)
def test_the_entrance_reduces_the_root_tension(method):
    """By (EI / r + m)^2 / (2 EI): 0.067 N at rest; m is that of a clamped span under the load T / r, T p^2 / (12 r)."""
    tensions = []
    for entrance in (False, True):
        scene = Scene(carrier_length=4.5, probe={"guide_length": 0.5}, terms={"entrance": entrance})
        simulator = Simulator(scene, method, METHODS[method].usual_step)
        start = simulator.advance(duration=1.0, points=("root", "tip"))
        run = simulator.advance(duration=0.5, points=("root", "tip"))
        tensions.append((start.tension[0, 0], run.tension[1:, 0].mean(), run.tension[1:, 1].mean()))
    (rest, sliding, tip), (rest_less, sliding_less, tip_less) = tensions
    moment = 0.048 / 0.6
    clamped = sliding * 0.1**2 / (12.0 * 0.6)
    assert rest - rest_less == pytest.approx(moment**2 / (2.0 * 0.048), rel=1e-9)
    assert sliding - sliding_less == pytest.approx((moment + clamped) ** 2 / (2.0 * 0.048), rel=0.02)
    assert tip == tip_less
    scene = scene.model_copy(update={"carrier_length": 47.5})
    measurements = {
        "root_tension": steady_root_tension(scene), "inserted_length": 50.0, "feed_speed": 0.2,
        "air_supply_rate": 63 / 3600, "helix_diameter": 1.2,
    }  # fmt: skip
    arrays = {name: np.array([value]) for name, value in measurements.items()}
    assert friction_from_tension(arrays, scene)[0] == pytest.approx(0.15, abs=1e-4)
    assert friction_from_tension(arrays, scene.model_copy(update={"terms": {"entrance": False}}))[0] > 0.152


@pytest.mark.parametrize("term", ["shortening", "stiction"])
def test_explicit_refuses_the_terms(term):
    with pytest.raises(
        ValueError, match=rf"^terms.{term} = true: explicit does not simulate it; use newmark, wilson, "
    ):
        Simulator(Scene(terms={term: True}), "explicit", 5e-6)
