"""The implicit method: no energy from contact, sticking friction, and 200 hard scenes."""

import warnings

import numpy as np
import pytest
from oracles.chains import bent, matrices, uniform_chain

from probe_env import Scene, Simulator
from probe_env.physics.methods import implicit
from probe_env.physics.methods.factors import implicit_weights
from probe_env.physics.model.drive import Drive
from probe_env.physics.model.state import at_rest

SHORT = Scene(carrier_length=10.0)
SLOW = pytest.mark.slow


def integrate(chain, time_step, steps, state=None, feed=0.0, every=1):
    """States d (k, n + 1, 3) and v after every ``every`` steps, and the counts of the iteration."""
    nodes = chain.node_count
    state = at_rest(nodes) if state is None else state
    weights = (time_step, *implicit_weights(chain.damping_time, time_step))
    limits, walls = implicit.couple_limits(chain, 4), implicit.contact_walls(chain)
    work, counts = implicit.workspace(nodes), np.zeros(2, dtype=np.int64)
    d, v = [], []
    for _ in range(steps // every):
        inputs = Drive(feed, 0.0).inputs_of_steps(every, time_step, chain.element_length, 0)
        status, *_ = implicit.advance(
            chain, weights, limits, walls, (), inputs, nodes - 1, state, work,
            every + 1, 1, np.array([0]), np.zeros((0, 1, 4)), np.zeros(nodes), counts,
        )  # fmt: skip
        assert status == 0
        d.append(state.d.copy())
        v.append(state.v.copy())
    return np.array(d), np.array(v), counts


def one_float(**changes):
    """A free point mass of 1 kg that meets the walls of a straight tube, without turning."""
    base = uniform_chain(1)
    return base._replace(
        **({"outer_gap": np.full(2, 5e-3)} | changes), mass=1.0, inertia=1.0, axial_compliance=1e12,
        shear_compliance=1e12, bending_compliance=1e12, contact_stiffness=np.full(2, 1e4),
    )  # fmt: skip


@pytest.mark.parametrize("time_step", [2e-4, 1.25e-5])
def test_the_iteration_converges_before_chaos(time_step):
    """In fewer than two iterations a step; to which trajectory, and at which order, see test_fast_methods."""
    simulator = Simulator(SHORT, "implicit", time_step)
    simulator.run(0.1, 1e-3)
    assert simulator.unconverged_steps == 0
    assert simulator.iterations < 2 * simulator.steps_done


@pytest.mark.parametrize("time_step", [1e-5, 1e-4, 1e-3, 1e-2])
@pytest.mark.parametrize("damping_time", [0.0, 5e-5])
def test_a_passive_probe_gains_no_energy(time_step, damping_time):
    """Kinetic, elastic and contact energy never grow, whatever the step, for a chain thrown about between walls.

    Without the couple and the frame's inertia terms: these are not conservative in the model itself.
    """
    chain = bent(uniform_chain(40))._replace(
        damping_time=damping_time, friction=0.3, contact_stiffness=np.where(np.arange(41) % 4 == 0, 1e5, 0.0),
        outer_gap=np.full(41, 5.2e-3), lever=np.full(41, 9.5e-3),
    )  # fmt: skip
    state = at_rest(41)
    state.v[:-1] = np.random.default_rng(3).normal(size=(40, 3)) * (1.0, 1.0, 20.0)
    M, K = matrices(chain)
    walls = implicit.contact_walls(chain)

    def energy(d, v):
        y, x, speed = d[:-1, 1], d[:-1].ravel(), v[:-1].ravel()
        deep = np.maximum(walls[:-1, 0] - y, 0.0) + np.maximum(y - walls[:-1, 1], 0.0)
        hard = np.maximum(deep - implicit.HARD_DEPTH, 0.0)
        wall = 0.5 * walls[:-1, 3] * deep**2 + 0.5 * (implicit.HARD_STIFFNESS - walls[:-1, 3]) * hard**2
        return 0.5 * speed @ M @ speed + 0.5 * x @ K @ x + wall.sum()

    energies = [energy(state.d, state.v)]
    d, v, counts = integrate(chain, time_step, 400, state)
    energies += map(energy, d, v)
    assert np.diff(energies).max() < 1e-9 * energies[0]
    assert np.abs(d[:, :, 1]).max() > 1e-3  # it did reach the walls
    assert counts[1] <= 20


@pytest.mark.parametrize("time_step", [1e-4, 1e-3])
def test_stick_and_slip_of_a_float_under_load(time_step):
    """Below mu N a pushed float creeps at less than 50 um/s, above it slides with (F - mu N) / m."""
    normal, mu = 2.0, 0.25
    for push, slides in ((0.9, False), (1.5, True)):
        load = np.zeros((2, 3))
        load[0] = push * mu * normal, -normal, 0.0
        chain = one_float(friction=mu, load=load)
        state = at_rest(2)
        state.d[0, 1] = -normal / 1e4
        d, *_ = integrate(chain, time_step, round(0.2 / time_step), state)
        expected = 0.5 * (push - 1.0) * mu * normal * 0.2**2 if slides else 0.0
        assert d[-1, 0, 0] == pytest.approx(expected, rel=0.02, abs=1e-5)


def test_amplitude_falls_by_the_same_step_each_half_cycle():
    """Coulomb oscillator with stick: turning points at A - 2 j mu N / k, until the spring cannot overcome friction."""
    stiffness, mu, normal, start = 100.0, 0.2, 4.0, 0.05
    support, load = np.zeros((2, 2, 3))
    support[0, 0], load[0, 1] = stiffness, -normal
    chain = one_float(friction=mu, support_stiffness=support, load=load)
    state = at_rest(2)
    state.d[0, :2] = start, -normal / 1e4
    d, *_ = integrate(chain, 1e-4, 30_000, state, every=10)
    x = d[:, 0, 0]
    turns = x[1:-1][(np.diff(x)[:-1] * np.diff(x)[1:] < 0.0) & (np.abs(np.diff(x)[1:]) > 1e-9)]
    drop = 2.0 * mu * normal / stiffness
    assert turns[:2] == pytest.approx([-start + drop, start - 2.0 * drop], abs=3e-4)
    assert x[-1] == pytest.approx(-start + 3.0 * drop, abs=5e-4)  # within the friction band: there it rests
    assert np.ptp(x[-100:]) < 1e-6


def test_a_bounce_does_not_gain():
    """A mass thrown at the wall leaves with at most its speed; for short steps with nearly all of it."""
    for time_step, minimum in ((1e-5, 0.99), (1e-4, 0.9), (1e-2, 0.0)):
        state = at_rest(2)
        state.d[0, 1], state.v[0, 1] = 1e-3, -1.0
        _, v, _ = integrate(one_float(outer_gap=np.full(2, np.inf)), time_step, round(0.04 / time_step), state)
        assert minimum <= v[-1, 0, 1] <= 1.0 + 1e-9


def hard_case(rng):
    """A valid scene with both walls, friction up to 0.5, stiffness 1e3 to 1e7 N/m, a step of 1e-5 to 1e-2 s."""
    scene = Scene(
        carrier_length=0.1 * int(rng.integers(1, 301)),
        feed_speed=float(rng.choice([0.0, rng.uniform(0.0, 0.4), rng.uniform(0.0, 2.0)])),
        air_supply_rate=float(rng.choice([rng.uniform(0.0, 0.04), rng.uniform(0.0, 0.2)])),
        contact={"friction": rng.uniform(0.0, 0.5), "stiffness": 10.0 ** rng.uniform(3.0, 7.0)},
        tube={"helix_diameter": 10.0 ** rng.uniform(-0.3, 0.6)},
        probe={
            "damping_time": float(rng.choice([0.0, 1e-6, 5e-5, 1e-3])),
            "guide_float_diameter": rng.uniform(0.016, 0.02),
            "guide_length": 0.1 * int(rng.integers(0, 51)),
        },
    )
    return scene, 10.0 ** rng.uniform(-5.0, -2.0), int(rng.choice([1, 2, 4, 8]))


@pytest.mark.parametrize("tens", [0, 1, 2, *(pytest.param(k, marks=SLOW) for k in range(3, 20))])
def test_two_hundred_hard_scenes_end_finite_and_within_the_tube(tens):
    steps, unconverged = 0, 0
    for case in range(10 * tens, 10 * tens + 10):
        scene, dt, nodes_per_pitch = hard_case(np.random.default_rng(case))
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # no step is beyond its limit
            simulator = Simulator(scene, "implicit", dt, nodes_per_pitch, growing=case % 2 == 0)
        run = simulator.advance(duration=400 * dt, sample_period=dt, points=("sensor", "tip"))
        assert np.isfinite([simulator.state.d, simulator.state.v]).all()
        assert max(np.abs(run.radial).max(), np.abs(simulator.state.d[:, 1]).max()) <= 0.05, f"case {case}"
        steps += simulator.steps_done
        unconverged += simulator.unconverged_steps
    assert unconverged < 0.1 * steps
