"""The kernels against closed forms. Tolerances follow from the discretisation, as each comment derives."""

import math

import numpy as np
import pytest
from oracles.chains import integrate, uniform_chain
from scipy.integrate import solve_ivp
from scipy.signal import find_peaks

from probe_env import Scene, Simulator
from probe_env.physics.closed_forms import (
    friction_from_tension,
    sliding_tension,
    steady_root_tension,
)
from probe_env.physics.methods.newmark import newmark
from probe_env.physics.model.chain import air_pressure, air_speed


@pytest.mark.parametrize("mode", [1, 2, 7, 30])
def test_discrete_axial_frequencies(mode):
    """Newmark turns a mode by 2 atan(omega dt / 2) a step, exactly; what is left is rounding."""
    N, dt, steps = 30, 2e-5, 2000
    chain = uniform_chain(N)
    stiffness = 1.0 / chain.axial_compliance
    omega = 2.0 * math.sqrt(stiffness / chain.mass) * math.sin((2 * mode - 1) * math.pi / (2 * (2 * N + 1)))
    from_root = np.arange(N, -1, -1)
    d = np.zeros((N + 1, 3))
    d[:, 0] = 1e-3 * np.sin(from_root * (2 * mode - 1) * math.pi / (2 * N + 1))
    samples, _ = integrate(chain, newmark(dt), d=d, a=-(omega**2) * d, steps=steps)
    angle = 2.0 * math.atan(omega * dt / 2.0)
    expected = d[0, 0] * np.cos(angle * np.arange(1, steps + 1))
    # each step adds a few eps relative to B_a d, times at most (omega_max dt / 2)^2 + 1 < 2: a random walk
    # of the phase over 2,000 steps stays below 2000 * 100 eps
    assert np.abs(samples[:, 0, 0] - expected).max() <= 2000 * 100 * np.finfo(float).eps * 1e-3


@pytest.mark.parametrize(("mode", "beta_L"), [(1, 1.8751), (2, 4.6941), (3, 7.8548)])
def test_cantilever_frequencies(mode, beta_L):
    """Euler-Bernoulli cantilever; the tip node carries a whole mass where the bar has half of one.

    The extra half mass lowers every mode by h / L to first order (phi(L)^2 = 4 mean(phi^2)); the rest is
    second order in beta h.
    """
    N = 60
    chain = uniform_chain(N)
    h, EI, density = chain.element_length, 4.8e-2, 0.111
    length = N * h
    beta = beta_L / length
    omega = beta**2 * math.sqrt(EI / density)
    x = h * np.arange(N, -1, -1)
    ratio = (math.cosh(beta_L) + math.cos(beta_L)) / (math.sinh(beta_L) + math.sin(beta_L))
    d = np.zeros((N + 1, 3))
    d[:, 1] = np.cosh(beta * x) - np.cos(beta * x) - ratio * (np.sinh(beta * x) - np.sin(beta * x))
    d[:, 2] = beta * (np.sinh(beta * x) + np.sin(beta * x) - ratio * (np.cosh(beta * x) - np.cos(beta * x)))
    d *= 1e-4
    periods, per_period = 20, 200
    dt = 2.0 * math.pi / omega / per_period
    samples, _ = integrate(chain, newmark(dt), d=d, a=-(omega**2) * d, steps=periods * per_period + per_period)
    y = np.concatenate([[d[0, 1]], samples[:, 0, 1]])
    peaks, _ = find_peaks(y, height=0.5 * y.max(), distance=per_period // 2)
    refine = [p + 0.5 * (y[p - 1] - y[p + 1]) / (y[p - 1] - 2 * y[p] + y[p + 1]) for p in peaks]
    period = (refine[-1] - refine[0]) / (len(refine) - 1) * dt
    measured = 2.0 * math.pi / period * (1.0 + (omega * dt) ** 2 / 12.0)  # Newmark lengthens the period
    tolerance = (h / length) ** 2 + (beta * h) ** 2 / 2.0 + 2e-3 / periods
    assert abs(measured / omega - 1.0 + h / length) <= tolerance


def test_mean_root_tension_under_drag():
    """Steady sliding: T = (q r / mu') (1 - exp(-mu' L / r)), within the 1 % that its ripple leaves."""
    scene = Scene(carrier_length=10.0, contact={"friction": 0.1})
    q = 0.5 * 0.44 * 1.023 * math.pi / 4 * (0.019**2 - 0.00835**2)
    q *= (63 / 3600 / (math.pi / 4 * (0.0242**2 - 0.00835**2)) - 0.2) ** 2 / 0.1
    mu = 0.1 * (1.0 - 0.019 / 1.2)
    expected = q * 0.6 / mu * (1.0 - math.exp(-mu * 12.5 / 0.6))
    assert steady_root_tension(scene) == pytest.approx(expected, rel=1e-2)  # floats are discrete: 1 in 125
    run = Simulator(scene, time_step=2e-4).run(4.0, points=("root",))
    assert run.tension[run.time > 2.0, 0].mean() == pytest.approx(expected, rel=1e-2)


@pytest.mark.parametrize("darcy", [0.0, 0.02])
@pytest.mark.parametrize(
    ("length", "friction", "diameter", "air"),
    [
        (3.0, 0.5, 0.5, 130.0),
        (30.0, 0.15, 1.2, 63.0),
        (60.0, 0.02, 3.0, 60.0),
        (80.0, 0.4, 1.0, 100.0),
        (80.0, 0.1, 2.0, 130.0),
    ],
)
def test_sliding_with_weight_in_expanding_air(length, friction, diameter, air, darcy):
    """Against an integration by SciPy, for two float sizes; the friction of that tension; drag as in the scene."""
    scene = Scene(
        tube={"helix_diameter": diameter, "helix_length": 85.0}, contact={"friction": friction, "weight": True},
        probe={"guide_float_diameter": 0.015}, air={"compressible": True, "darcy_factor": darcy},
        terms={"entrance": True}, air_supply_rate=air / 3600.0,
    )  # fmt: skip
    speed, tension = air_speed(scene, air / 3600.0), np.zeros(1)
    for start, end, d in ((0.0, 2.6, 0.015), (2.6, length, 0.019)):
        drag = 0.5 * 0.44 * 1.023 * math.pi / 4 * (d**2 - 0.00835**2) * (speed - 0.2) ** 2 / 0.1

        def growth(s, T, drag=drag, lever=d / diameter):
            normal = T[0] / diameter * 2.0
            local = drag * 101325.0 / air_pressure(scene, np.array(s), length, 0.2, speed)
            return local - friction * (math.hypot(normal, 0.111 * 9.80665) - lever * normal)

        tension = solve_ivp(growth, (start, end), tension, rtol=1e-8, atol=1e-8, max_step=0.5).y[:, -1]
    values = {"inserted_length": length, "feed_speed": 0.2, "air_supply_rate": air / 3600.0, "helix_diameter": diameter}
    measurements = {name: np.array([value]) for name, value in values.items()}
    # steps of 0.4 r / mu: 0.4^5 / 120 a step, of which the last r / mu counts, 3e-4; as much for steps of 2 m in p
    pulled = sliding_tension(np.array([friction]), measurements, scene)
    assert pulled == pytest.approx(tension, rel=1e-3)
    felt = {"root_tension": pulled - 2.0 * 0.048 / diameter**2}
    # the number of steps jumps with friction, and with it the error
    assert friction_from_tension(measurements | felt, scene) == pytest.approx(friction, rel=3e-4)
    thin = scene.model_copy(update={"air": {"drag_coefficient": 0.22}})
    halved = sliding_tension(np.array([[friction]]), measurements, thin, np.array([[2.0]]))
    assert halved == pytest.approx(pulled[None], rel=1e-12)


@pytest.mark.parametrize("wall", ["inner", "outer"])
def test_point_mass_on_the_contact_spring(wall):
    """Contact lasts pi sqrt(m / k), peak force v0 sqrt(k m).

    A flag that is late by a share s of a step finds the mass s v0 dt beyond the wall: (s omega dt)^2 of its energy,
    half of that of its speed, as it comes and as it goes.
    """
    k, gap, v0 = 1e5, 5e-3, 0.05
    chain = uniform_chain(1, contact_stiffness=np.array([k, 0.0]), outer_gap=np.array([gap, np.inf]))
    chain = chain._replace(axial_compliance=1e6, shear_compliance=1e6, bending_compliance=1e6, coupling_compliance=0.0)
    omega = math.sqrt(k / chain.mass)
    d, v = np.zeros((2, 3)), np.zeros((2, 3))
    d[0, 1], v[0, 1] = (0.0, -v0) if wall == "inner" else (gap, v0)
    for dt in (2e-6, 1e-6):
        samples, state = integrate(chain, newmark(dt), d=d, v=v, steps=round(1.2 * math.pi / omega / dt))
        y = samples[:, 0, 1]
        depth = -y if wall == "inner" else y - gap
        peak, duration = k * depth.max(), (depth > 0).sum() * dt
        assert peak == pytest.approx(v0 * math.sqrt(k * chain.mass), rel=omega * dt)
        assert duration == pytest.approx(math.pi / omega, rel=omega * dt)
        assert abs(abs(state.v[0, 1]) / v0 - 1.0) <= (omega * dt) ** 2


def test_coulomb_oscillator_loses_a_fixed_amplitude():
    """The amplitude falls by 2 mu N / k; the sign of friction lags one step, so by omega dt of that."""
    k_x, normal, mu, start = 400.0, 2.0, 0.15, 8e-3
    support, load, d = np.zeros((3, 2, 3))
    support[0, 0], load[0, 1] = k_x, -normal
    chain = uniform_chain(
        1, contact_stiffness=np.array([1e5, 0.0]), friction=mu, support_stiffness=support, load=load
    )._replace(axial_compliance=1e9, shear_compliance=1e9, bending_compliance=1e9, coupling_compliance=0.0)
    d[0] = start, -normal / 1e5, 0.0
    omega, dt = math.sqrt(k_x / chain.mass), 1e-5
    samples, _ = integrate(chain, newmark(dt), d=d, steps=round(2.6 * 2 * math.pi / omega / dt))
    x = samples[:, 0, 0]
    turns = np.flatnonzero(np.diff(np.sign(np.diff(x)))) + 1
    amplitudes = np.abs(np.concatenate([[start], x[turns]]))[:5]
    drop = 2.0 * mu * normal / k_x
    assert np.diff(amplitudes) == pytest.approx(-drop, rel=2.0 * omega * dt * start / drop)
