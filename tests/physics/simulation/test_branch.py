"""Copies of a running simulation are equal and independent."""

import numpy as np
import pytest

from probe_env import Context, Scene, SimulatorBatch
from probe_env.physics.simulation.simulator import Simulator

METHODS = ("superelement32", "imex", "newmark", "explicit")


def running(method):
    scenes = [Context(friction=mu).apply(Scene(carrier_length=3.0, feed_speed=0.2)) for mu in (0.15, 0.25)]
    options = {"growing": True, "time_lapse": 4.0, "air_lag": 0.5, "ramp": 0.5}
    step, duration, options = (4e-6, 0.04, {}) if method == "explicit" else (1e-4, 0.2, options)
    batch = SimulatorBatch(scenes, method, step, threads=1, **options)
    batch.advance(0.3, 0.02, duration, 1e-3)
    return batch


@pytest.mark.parametrize("method", METHODS)
def test_copies_are_equal_and_independent(method):
    batch, alone = running(method), running(method)
    copies = batch.branch([1, 0, 1])
    other = copies.advance(np.array([0.3, 0.3, 0.1]), 0.02, 0.1, 1e-3)
    after, undisturbed = batch.advance(0.3, 0.02, 0.1, 1e-3), alone.advance(0.3, 0.02, 0.1, 1e-3)
    for name, values in after.statistics.items():
        np.testing.assert_array_equal(values, undisturbed.statistics[name])
        np.testing.assert_array_equal(values[[1, 0]], other.statistics[name][:2])
    for copied, k in zip(copies.simulators[:2], (1, 0), strict=True):
        assert all(map(np.array_equal, copied.state, batch.simulators[k].state))
    assert other.feed_speed[2] < after.feed_speed[1]


def test_a_state_is_displaced_radially_at_its_free_nodes_alone():
    simulator = running("imex").simulators[0]
    before, moved = simulator.state.d.copy(), np.linspace(1e-6, 2e-6, simulator.root)
    simulator.displace(moved)
    before[: simulator.root, 1] += moved
    np.testing.assert_array_equal(simulator.state.d, before)
    with pytest.raises(ValueError, match=f"one displacement for each of {simulator.root} free nodes"):
        simulator.displace(moved[1:])


def test_length_in_helix_is_limited():
    scene = Scene(carrier_length=3.0, tube={"helix_length": 6.0})
    simulator = Simulator(scene, "superelement32", 2e-4, growing=True, time_lapse=4.0)
    assert simulator.length_in_helix == simulator.inserted_length == pytest.approx(scene.inserted_length)
    simulator.advance(1.0, 0.02, 0.4, 1e-3)
    assert simulator.inserted_length > 6.0
    assert simulator.length_in_helix == 6.0


def test_a_copy_in_another_tube():
    batch = running("superelement32")
    rougher = batch.simulators[0].scene.model_copy(update={"contact": {"friction": 0.3}})
    same, other = batch.branch([0, 0]).simulators[0], batch.branch([0], {0: rougher}).simulators[0]
    np.testing.assert_array_equal(same.state.d, other.state.d)
    assert other.scene.contact.friction == 0.3
    copies = batch.branch([0, 1], {0: rougher})
    tension = copies.advance(0.3, 0.02, 0.5, 1e-3).statistics["tension_mean_n"]
    truth = batch.advance(0.3, 0.02, 0.5, 1e-3).statistics["tension_mean_n"]
    assert tension[0] != truth[0]
    assert tension[1] == truth[1]


def test_bad_arguments():
    batch = running("imex")
    longer = Scene(carrier_length=3.0, probe={"float_pitch": 0.05})
    for arguments, message in (
        (([0], {0: longer}), r"scene: \d+ nodes of 0\.0125 m"),
        (([],), "which is empty"),
        (([0, 99],), r"which\[1\] = 99 is none of \d probes"),
    ):
        with pytest.raises(ValueError, match=message):
            batch.branch(*arguments)
    with pytest.raises(ValueError, match=r"active has shape \(9,\); \(\d,\), a value for each probe"):
        batch.advance(active=np.ones(9, dtype=bool))
