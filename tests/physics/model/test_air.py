"""Compressible air: pressure along the tube, drag of the floats, and the methods that simulate it."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from probe_env import Scene, Simulator
from probe_env.physics.closed_forms import steady_root_tension, steady_tensions
from probe_env.physics.methods import METHODS
from probe_env.physics.model.chain import air_pressure, air_speed, drag_factors

AREA = math.pi / 4.0 * (0.0242**2 - 0.00835**2)
EXPANDING = {"compressible": True}
SHORT = {"carrier_length": 2.5, "probe": {"guide_length": 0.5}, "air": EXPANDING}


def pressure_of(scene, distance):
    """Pressure at the scene's length, feed and air."""
    speed = air_speed(scene, scene.air_supply_rate)
    return air_pressure(scene, np.asarray(distance), scene.inserted_length, scene.feed_speed, speed)


@pytest.mark.parametrize(("darcy", "length"), [(0.0, 30.0), (0.02, 57.5)])
def test_pressure_equals_a_quadrature(darcy, length):
    """Integration of dp/dx with local density and speed: from the exit past the tip along guide and carrier."""
    air = EXPANDING | {"darcy_factor": darcy, "exit_pressure": 9e4}
    scene = Scene(carrier_length=length - 2.5, probe={"guide_float_diameter": 0.015}, air=air)
    volume = 63.0 / 3600.0

    def slope(x, p):
        density, rate = 1.023 * p / 9e4, volume * 9e4 / p
        if x < 0.0:  # ahead of the tip
            return darcy * 0.5 * density * (rate / (math.pi / 4.0 * 0.0242**2)) ** 2 / 0.0242
        speed = rate / AREA
        frontal = math.pi / 4.0 * ((0.015 if x < 2.6 else 0.019) ** 2 - 0.00835**2)
        relative = speed * (1.0 - 0.2 * AREA / volume)  # u / w as at the exit
        wall = darcy / 8.0 * density * speed**2 * math.pi * 0.0242
        return (0.5 * 0.44 * density * relative**2 * frontal / 0.1 + wall) / AREA

    p, expected = np.array([9e4]), []
    for start, end in ((length - 60.0, 0.0), (0.0, 2.6), (2.6, length)):
        p = solve_ivp(slope, (start, end), p, rtol=1e-10, atol=1e-6).y[:, -1]
        expected.append(p[0])
    assert pressure_of(scene, [0.0, 2.6, length]) == pytest.approx(expected, rel=1e-7)


def test_limits_of_pressure_and_drag():
    edges = np.array([0.0, 10.0, 30.0])
    scene = Scene(air=EXPANDING)
    for uniform in ({"air_supply_rate": 1e-6}, {"air": {"drag_coefficient": 0.0}}):
        assert pressure_of(scene.model_copy(update=uniform), edges) == pytest.approx(101325.0, rel=1e-6)
    assert (drag_factors(Scene(), edges, 52.5, 0.2, 43.0) == 1.0).all()
    # towards the feed device: the exit is the entrance, and the pressure is the same seen from there
    back = scene.model_copy(update={"feed_speed": -0.2, "air_supply_rate": -63.0 / 3600.0})
    assert pressure_of(back, 52.5 - edges) == pytest.approx(pressure_of(scene, edges), rel=1e-12)
    # the drag of a stretch is the loss of pressure over the free area
    pressure = pressure_of(scene, edges)
    (first, second) = drag_factors(scene, edges, 52.5, 0.2, air_speed(scene, 63.0 / 3600.0))
    pull = 10.0 * 0.5 * 0.44 * 1.023 * math.pi / 4.0 * (0.019**2 - 0.00835**2) * (63.0 / 3600.0 / AREA - 0.2) ** 2
    assert np.array([10.0 * first, 20.0 * second]) * pull == pytest.approx(AREA * np.diff(pressure), rel=1e-6)


@pytest.mark.parametrize("method", ["newmark", "superelement"])
def test_root_tension_at_rest_is_the_loss_of_pressure(method):
    """Without friction in a nearly straight tube: T = (a - A_c) (p_root - p_e); the ringing averages out."""
    straight = {"contact": {"friction": 0.0}, "tube": {"helix_diameter": 1e3}}
    scene = Scene(**SHORT, **straight, feed_speed=0.0, air_supply_rate=0.04)
    expected = AREA * (pressure_of(scene, 3.0) - 101325.0)
    assert steady_root_tension(scene) == pytest.approx(expected, rel=1e-9)
    assert expected < 0.9 * steady_root_tension(scene.model_copy(update={"air": {"compressible": False}}))
    simulator = Simulator(scene, method, 2e-4)
    simulator.advance(duration=0.6)
    run = simulator.advance(duration=0.6, points=("root",))
    assert run.tension[1:, 0].mean() == pytest.approx(expected, rel=1e-4)


def test_pressure_follows_the_growing_length():
    scene = Scene.model_validate(SHORT | {"feed_speed": 0.4})
    simulator = Simulator(scene, growing=True, time_lapse=10.0, air_lag=1.0)
    for _ in range(2):
        simulator.advance(0.4, 0.03, 0.2)
        factors = simulator.drag(simulator.root)[::4][:30] / simulator.chain.drag[::4][:30]
        speed = air_speed(scene, simulator.air_supply_rate)
        ends = air_pressure(scene, 0.1 * np.arange(31), simulator.inserted_length, 0.4, speed)
        assert factors == pytest.approx(101325.0 * 2.0 / (ends[1:] + ends[:-1]), rel=1e-12)
    assert simulator.inserted_length > 4.5


@pytest.mark.parametrize("method", ["newmark", "imex", "implicit"])
def test_drag_changes_linearly_in_a_call(method):
    """Withdrawal changes the drag. In one call of 0.4 s the root force is that of many short ones.

    A linear drag is exact to T^2 / 8 of its second derivative, less than a tenth of its change in the call, which is
    the error of a constant one. Without friction in a nearly straight tube both runs ring equally.
    """
    straight = {"contact": {"friction": 0.0}, "tube": {"helix_diameter": 1e3}, "couple": "tangent"}
    short = SHORT | {"carrier_length": 4.5, "feed_speed": -2.0, "air_supply_rate": -0.04}
    scene = Scene.model_validate(short | straight)
    force = []
    for calls in (1, 40):
        simulator = Simulator(scene, method, 2e-4, growing=True)
        runs = [simulator.advance(duration=0.4 / calls, points=("root",)) for _ in range(calls)]
        force.append(runs[-1].tension[-10:, 0].mean())
    ends = scene, scene.model_copy(update={"carrier_length": 3.7})
    change = -np.subtract(*map(steady_root_tension, ends))
    uniform = [one.model_copy(update={"air": {"compressible": False}}) for one in ends]
    change += np.subtract(*map(steady_root_tension, uniform))
    assert force[0] == pytest.approx(force[1], abs=0.1 * abs(change))


@pytest.mark.parametrize("method", METHODS)
def test_methods_simulate_compressible_air_or_refuse_it(method):
    scene, kind = Scene.model_validate(SHORT), METHODS[method]
    if not kind.simulates_expansion:
        with pytest.raises(ValueError, match=f"^air.compressible = true: {method} does not simulate it; use newmark, "):
            Simulator(scene, method, kind.usual_step)
        return
    uniform = scene.model_copy(update={"air": {"compressible": False}})
    runs = [Simulator(s, method, kind.usual_step).run(0.02, points=("root",)) for s in (uniform, scene)]
    tension = [run.tension[:, 0].mean() for run in runs]
    assert 0.9 * tension[0] < tension[1] < 0.999 * tension[0]


def test_steady_sliding_with_weight():
    """Without weight the known form, in a straight tube T = (q - mu w) s, in between a quadrature."""
    expanding, scene = (Scene(carrier_length=20.0, air={"compressible": k}) for k in (True, False))
    for one in (expanding, scene):
        assert steady_tensions(one, 1e-9) == pytest.approx(steady_tensions(one), rel=1e-7)
    for feed, sign in ((0.2, -1.0), (-0.2, 1.0)):
        straight = Scene(tube={"helix_diameter": 1e4}, air={"drag_coefficient": 0.0}, feed_speed=feed)
        assert steady_tensions(straight, 1.089)[-1] == pytest.approx(sign * 0.15 * 1.089 * 52.5, rel=1e-3)
    q = steady_tensions(scene.model_copy(update={"contact": {"friction": 0.0}}))[0] / 0.1

    def slope(s, tension):
        return q - 0.15 * (np.sqrt((tension / 0.6) ** 2 + 1.089**2) - 0.019 / 1.2 * tension / 0.6)

    exact = solve_ivp(slope, (0.0, 22.5), [0.0], rtol=1e-10, atol=1e-12).y[0, -1]
    assert steady_tensions(scene, 1.089)[-1] == pytest.approx(exact, rel=1e-8)
