"""The soft string: capstan, straight part, helix, and an integration by SciPy; the least air and what it rests on."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from probe_env import Scene
from probe_env.physics.closed_forms import GRAVITY, drag_per_metre, steady_root_tension
from probe_env.physics.closed_forms.route import Segment, min_air, required_root_tension, route_forces
from probe_env.physics.model.chain import air_speed

HELIX, RISING = Segment(helix=True), Segment(length=12.0, slope=90.0)
AREA = math.pi / 4.0 * (0.0242**2 - 0.00835**2)
SCENE = Scene()
WEIGHT = 0.111 * GRAVITY


EXPANDING = SCENE.model_copy(update={"air": {"compressible": True, "exit_pressure": 101325.0}})


def pull(air, feed=0.2):
    """Drag of table 2's probe in air at the pressure of the exit [N/m], after (10)."""
    wind = air / AREA - feed
    return 10.0 * 0.5 * 0.44 * 1.023 * math.pi / 4.0 * (0.019**2 - 0.00835**2) * wind * abs(wind)


@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_a_bend_divides_or_multiplies_as_a_capstan_does(direction):
    """25 kN from 10 m of helix that is nearly straight; the weight of the bend's cable is 1e-5 of it.

    The drag q in the bend adds q R / mu' (exp(mu' phi) - 1) to the force times exp(mu' phi), or with -mu'.
    """
    blown = {"air": {"drag_coefficient": 10.0}, "air_supply_rate": 0.2, "feed_speed": 0.2 * direction}
    narrow = {"tube": {"helix_diameter": 1e4, "helix_length": 10.0}, "probe": {"line_density": 0.01}}
    scene, q = Scene.fitted(narrow).model_copy(update=blown), 10.0 / 0.44 * pull(0.2, 0.2 * direction)
    for angle in (0.5 * math.pi, 3.0):
        forces = route_forces((Segment(length=0.5 * angle, bend_radius=0.5), HELIX), scene)
        mu = -direction * scene.contact.friction * (1.0 - 0.019 / 2.0 / 0.5)
        assert forces.root[-1] == pytest.approx(10.0 * q, rel=1e-3)
        expected = forces.root[-1] * math.exp(mu * angle) + q * 0.5 / mu * math.expm1(mu * angle)
        assert forces.feed[-1] == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("slope", [90.0, 30.0])
def test_min_air_balances_a_straight_part(slope):
    route = (Segment(length=12.0, slope=slope), HELIX)
    minimum = float(min_air(route, SCENE)[-1])
    uphill = math.sin(math.radians(slope)) + SCENE.contact.friction * math.cos(math.radians(slope))
    wind = air_speed(SCENE, minimum) - SCENE.feed_speed
    needed = 12.0 * (SCENE.probe.line_density * GRAVITY * uphill - drag_per_metre(SCENE) * wind**2)
    assert needed > 1.0
    assert required_root_tension(route, SCENE) == pytest.approx(needed, rel=1e-6)
    thin = {"air": {"drag_coefficient": 0.3}, "feed_speed": 0.05}
    for scene in (SCENE, EXPANDING):  # of the air only the drag counts
        expected = required_root_tension(route, scene)
        assert required_root_tension(route, scene.model_copy(update=thin)) == pytest.approx(expected, rel=1e-6)
    assert required_root_tension((Segment(length=12.0, slope=-90.0), HELIX), SCENE) == 0.0


def test_a_helix_alone_is_steady_sliding():
    """Without weight, mu w / q = 1.5 % of a cable of 10 g/m, squared; with it, in balance when dT/ds = 0."""
    light = SCENE.model_copy(update={"probe": {"line_density": 0.01}})
    forces = route_forces((HELIX,), light)
    for length in (20.0, 57.5):
        steady = steady_root_tension(light.model_copy(update={"carrier_length": length - 2.5}))
        assert np.interp(length, forces.tip, forces.feed) == pytest.approx(steady, rel=3e-4)
    normal = math.sqrt((pull(SCENE.air_supply_rate) / 0.15) ** 2 - WEIGHT**2)
    assert route_forces((HELIX,), SCENE).feed[-1] == pytest.approx(normal * 0.6 / (1.0 - 0.019 / 1.2), rel=1e-5)


@pytest.mark.parametrize(
    ("direction", "air", "darcy"), [(1.0, 80.0, 0.0), (1.0, 130.0, 0.02), (-1.0, 130.0, 0.0), (-1.0, 130.0, 0.02)]
)
def test_a_whole_route_is_integrated_right(direction, air, darcy):
    """Against a fine integration from the tip: legs, bends, helix and outlet, in air that expands.

    The loss of pressure is -dp/dx = (q / A + f rho w^2 / 2 d / (d^2 - d_c^2)) p_e / p from the exit on: the end of the
    route, or on withdrawal the feed device.
    """
    drive = {"feed_speed": 0.2 * direction, "air_supply_rate": direction * air / 3600.0}
    scene = EXPANDING.model_copy(update=drive | {"air": {"darcy_factor": darcy}})
    route = (
        Segment(length=5.3, slope=90.0), Segment(length=0.8, slope=45.0, bend_radius=0.5), Segment(length=9.0),
        Segment(helix=True, slope=3.0), Segment(length=0.4, slope=-45.0, bend_radius=0.3),
        Segment(length=6.0, slope=-90.0),
    )  # fmt: skip
    forces, at_exit = route_forces(route, scene), pull(air / 3600.0)
    wall = 0.5 * darcy * 1.023 * np.array([air / 3600.0 / AREA, air / 3600.0 / (math.pi / 4.0 * 0.0242**2)]) ** 2
    wall *= np.array([0.0242 / (0.0242**2 - 0.00835**2), 1.0 / 0.0242])
    lengths = [60.0 if segment.helix else segment.length for segment in route]
    radii = [0.6 if segment.helix else segment.bend_radius for segment in route]
    ends = np.cumsum(lengths)
    for k in (8, 25, 60, 120, len(forces.tip) - 1):
        tip, force, at_root = forces.tip[k], 0.0, math.nan
        for segment, radius, length, end in reversed(list(zip(route, radii, lengths, ends, strict=True))):
            if tip <= end - length + 1e-9:
                continue

            def growth(behind, tension, segment=segment, radius=radius, tip=tip):
                side = math.copysign(1.0, tension[0])
                bend = tension[0] * (1.0 - side * 0.019 / 2.0 / radius) / radius if radius else 0.0
                normal = math.hypot(bend, WEIGHT * math.cos(math.radians(segment.slope)))
                cable, empty = (behind, ends[-1] - tip) if direction > 0.0 else (tip - behind, 0.0)
                lost = (at_exit / AREA + wall[0]) * cable + wall[1] * empty
                drag = direction * at_exit / math.sqrt(1.0 + 2.0 * lost / 101325.0)
                return drag - WEIGHT * math.sin(math.radians(segment.slope)) - direction * 0.15 * normal

            near, far = max(tip - end, 0.0), tip - end + length
            force = solve_ivp(growth, (near, far), [force], rtol=1e-8, atol=1e-8, max_step=0.05).y[0, -1]
            at_root = force if segment.helix else at_root
        # drag at the middle of a step of 0.5 m: q'' h^2 / 24 over some 5 m, with q'' up to 0.12 N/m3 near the tip
        assert forces.feed[k] == pytest.approx(force, abs=6e-3)
        assert forces.root[k] == pytest.approx(at_root, abs=6e-3, nan_ok=True)
        assert forces.in_helix[k] == (ends[2] < tip < ends[3] + 1e-9)


def test_expanding_air_needs_more_than_uniform_air():
    """30 m of rising tube before the helix: the cable's weight against the air. At the tip of both, the same.

    In the rising part the balance is 2 q A p / (2 q) (sqrt(1 + 2 q x / A p) - 1) = w x.
    """
    route = (Segment(length=30.0, slope=90.0), HELIX)
    uniform, spread = min_air(route, SCENE), min_air(route, EXPANDING)

    assert 3600.0 * uniform.max() == pytest.approx(3600.0 * brentq(lambda air: pull(air) - WEIGHT, 0.01, 0.1))
    assert 67.0 < 3600.0 * uniform.max() < 68.0

    def left(air):
        rate = 2.0 * pull(air) / (101325.0 * AREA)
        return 2.0 * pull(air) / rate * (math.sqrt(1.0 + 30.0 * rate) - 1.0) - 30.0 * WEIGHT

    tip = route_forces(route, SCENE).tip
    assert spread[np.argmin(abs(tip - 30.0))] == pytest.approx(brentq(left, 0.01, 0.1), rel=1e-4)
    assert 3600.0 * spread[-1] == pytest.approx(120.0, abs=1.0)


def test_min_air_leaves_no_force_and_less_is_not_enough():
    route = (Segment(length=3.0), Segment(length=0.8, slope=45.0, bend_radius=0.5), RISING, HELIX)
    rough = SCENE.model_copy(update={"contact": {"friction": 0.4}, "tube": {"helix_diameter": 1.0}})
    for scene in (SCENE, rough, EXPANDING):
        air = min_air(route, scene)
        assert np.abs(route_forces(route, scene, air).feed).max() < 1e-6
        assert (route_forces(route, scene, 0.99 * air).feed < 0.0).all()
    still = SCENE.model_copy(update={"air": {"drag_coefficient": 0.0}})
    assert np.isinf(min_air(route, still)).all()  # beyond the scene's most
