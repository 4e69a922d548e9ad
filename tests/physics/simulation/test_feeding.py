"""Feeding: ramped speed with the frame's inertia, lagging air, and a length that grows node by node."""

import math

import numpy as np
import pytest
from scipy.signal import detrend

from probe_env import Scene, Simulator
from probe_env.physics.closed_forms import steady_root_tension
from probe_env.physics.model.chain import air_speed, build_chain
from probe_env.physics.model.drive import Drive

QUIET = Scene(carrier_length=5.0, contact={"friction": 0.05})


def test_the_drive_ramps_lags_and_appends():
    drive, pieces = (Drive(0.2, 60.0, ramp=0.5, air_lag=1.0, growth=1.0) for _ in range(2))
    for one in (drive, pieces):
        one.feed_speed_target, one.air_speed_target = 0.4, 90.0
    dt, h = 1e-3, 0.025
    inputs = drive.inputs_of_steps(1000, dt, h, room=100)
    time = np.arange(1000) * dt
    assert inputs[:, 0] == pytest.approx(np.minimum(0.2 + 0.5 * time, 0.4))
    assert inputs[:, 1] == pytest.approx(np.where(time < 0.4 - 1e-9, 0.5, 0.0))
    assert inputs[:, 2] == pytest.approx(90.0 - 30.0 * np.exp(-time))
    assert drive.feed_speed == 0.4
    fed = 0.2 * 0.4 + 0.25 * 0.4**2 + 0.4 * 0.6
    assert inputs[:, 3].sum() == math.floor(fed / h)
    assert drive.travel == pytest.approx(fed - inputs[:, 3].sum() * h, abs=0.4 * dt)
    parts = [pieces.inputs_of_steps(steps, dt, h, room=100) for steps in (1, 499, 500)]
    assert (np.concatenate(parts) == inputs).all()
    assert drive == pieces
    assert pieces.inputs_of_steps(1000, dt, h, room=3)[:, 3].sum() == 3  # at the end of the helix


def test_ripple_is_periodic_in_the_fed_length():
    """1 % at a period of 8 mm: 25 Hz at 0.2 m/s. The slope is the difference of the speeds, the mean is the feed."""
    drive, pieces = Drive(0.2, 0.0), Drive(0.2, 0.0)
    inputs = drive.inputs_of_steps(4000, 1e-4, 0.025, 0, ripple=(0.01, 8e-3))
    assert inputs[:, 0] == pytest.approx(0.2 + 0.002 * np.sin(2.0 * np.pi * 25.0 * 1e-4 * np.arange(4000)), abs=1e-12)
    assert inputs[:-1, 1] == pytest.approx(np.diff(inputs[:, 0]) / 1e-4, abs=1e-9)
    parts = [pieces.inputs_of_steps(steps, 1e-4, 0.025, 0, ripple=(0.01, 8e-3)) for steps in (1, 1999, 2000)]
    assert (np.concatenate(parts) == inputs).all()


@pytest.mark.parametrize(("length", "hertz", "rounded"), [(2.5, 25.0, 1.9), (17.5, 25.0, 7.5), (17.5, 60.0, 45.0)])
def test_friction_amplifies_ripple_towards_the_tip(length, hertz, rounded):
    """Closed form for small waves in a sliding cable: (X'' - m X') / C = density X.. + d X., X' = 0 at the tip.

    m = mu (1 - d_f / d_h) / r, and d is the slope of the drag. C is the compliance of the cable, of the contact springs
    and of the spans, which bend inwards by p^4 / (720 EI) of the load on average. It is static: within 5 % up to 60 Hz,
    a quarter of the frequency of a span.
    """
    scene = Scene(carrier_length=length, contact={"friction": 0.1}, feed_ripple=1e-3, ripple_length=0.2 / hertz)
    omega, radius, pitch = 2.0 * np.pi * hertz, 0.6, 0.1
    cable = 1.0 / 1.1e5 + pitch**4 / (720.0 * 0.048 * radius**2)
    compliance = cable / (1.0 + 5e-5j * omega) + pitch / (1e5 * radius**2)
    slope = 2.0 * build_chain(scene).drag[0] / pitch * (air_speed(scene, scene.air_supply_rate) - 0.2)
    m = 0.1 * (1.0 - 0.019 / 1.2) / radius
    first, second = np.roots([1.0, -m, compliance * (0.111 * omega**2 - 1j * omega * slope)])
    ends = np.exp(np.array([first, second]) * scene.inserted_length)
    gain = abs(ends.prod() * (second - first) / (second * ends[1] - first * ends[0]))
    run = Simulator(scene, "imex", 1e-4).run(2.0, points=("tip",))
    chosen = run.time > 1.6 + 1e-9
    root = -0.2 * 1e-3 / omega  # amplitude of the device's path, of cos omega t
    tip = root + 2.0 * np.mean(detrend(run.axial[chosen, 0]) * np.exp(-1j * omega * run.time[chosen]))
    assert gain == pytest.approx(rounded, rel=0.02)
    assert abs(tip / root) == pytest.approx(gain, rel=0.05)


@pytest.mark.parametrize("method", ["newmark", "imex", "imex32"])
@pytest.mark.parametrize("slope", [0.5, -0.5])
def test_inertia_of_the_frame_moves_a_free_probe(method, slope):
    """In a straight tube nothing but a soft root spring holds the nodes: x = -slope t^2 / 2, exactly for Newmark.

    The cable is soft (EA 1e2 N) and the time short, so that the wave from the root has not come to the tip.
    """
    scene = Scene(
        tube={"helix_diameter": 1e4}, probe={"tensile_rigidity": 100.0}, carrier_length=5.0, feed_speed=1.0,
        air_supply_rate=0.0, air={"drag_coefficient": 0.0},
    )  # fmt: skip
    simulator = Simulator(scene, method, 1e-4, ramp=abs(slope))
    run = simulator.advance(1.0 + slope, None, 0.1, points=("tip",))
    assert simulator.feed_speed == pytest.approx(1.0 + 0.1 * slope)
    expected = -0.5 * slope * run.time**2
    # Newmark starts with a = 0 as printed: it lags a quarter step of velocity; imex kicks first: half a step
    assert run.axial[:, 0] == pytest.approx(expected, abs=0.6 * abs(slope) * 1e-4 * 0.1 + 1e-12)
    assert np.abs(run.axial[-1, 0]) > 0.0024


@pytest.mark.parametrize(
    ("method", "time_step"),
    [("newmark", 1e-4), ("imex", 2e-4), ("imex32", 2e-4), ("superelement32", 2e-4), ("implicit", 1e-4)],
)
def test_mass_length_and_root_tension_are_right_at_every_append(method, time_step):
    """Slow growth in a quiet tube: the root tension follows the closed form of the length that is in."""
    simulator = Simulator(QUIET, method, time_step, growing=True)
    simulator.advance(None, None, 2.0)
    assert simulator.inserted_length == pytest.approx(7.5 + 0.4, abs=1e-4)
    assert 0.0 <= simulator.inserted_length - simulator.root * 0.025 < 0.025 * (1.0 + 1e-9)
    chain = build_chain(QUIET, 4, simulator.root * 0.025)
    assert chain.mass == pytest.approx(0.111 * 0.025)
    for name in ("contact_stiffness", "drag", "lever"):
        grown = getattr(simulator.chain, name)[: simulator.root]
        assert (grown == getattr(chain, name)[: simulator.root]).all()
    run = simulator.advance(None, None, 1.0, points=("root",))
    length = round(simulator.inserted_length, 1)
    expected = steady_root_tension(QUIET.model_copy(update={"carrier_length": round(length - 2.5, 1)}))
    assert run.tension[:, 0].mean() == pytest.approx(expected, rel=0.03)  # 0.1 m of drag is 1.3 %


@pytest.mark.parametrize(("method", "feed_speed"), [("imex", 0.4), ("imex", 0.2), ("imex32", 0.4)])
def test_appending_nodes_does_not_shake_a_quiet_probe(method, feed_speed):
    """8 or 16 nodes a second come in: radial rms below 0.5 um, 1 kHz acceleration below 0.2 m/s2, a line of nm."""
    scene = Scene(carrier_length=5.0, feed_speed=feed_speed, contact={"friction": 0.1})
    simulator = Simulator(scene, method, 2e-4, growing=True)
    simulator.advance(None, None, 4.0)
    run = simulator.advance(None, None, 4.0)
    radial = run.radial[1:, 0]
    assert radial.std() < 0.5e-6
    assert (np.diff(radial, n=2) / 1e-3**2).std() < 0.2
    line = round(feed_speed / simulator.chain.element_length * 4.0)  # u / h in steps of 0.25 Hz
    assert 2.0 * np.abs(np.fft.rfft(detrend(radial))[line]) / len(radial) < 30e-9
