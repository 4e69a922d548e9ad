"""A single probe, with its floats in the lanes, equals the probe in a group bit for bit."""

import numpy as np
import pytest

from probe_env import Scene, Simulator, SimulatorBatch, StabilityWarning
from probe_env.physics.methods import METHODS
from probe_env.physics.methods.method import KernelArguments
from probe_env.physics.simulation.batch import groups_of

LENGTHS = (0.4, 0.8, 1.3, 7.0)
"""Carrier cable [m] behind 0.5 m of guide: fewer floats than lanes, and some blocks of them."""
MODES = {1e5: (2, 1), 2.5e5: (3, 3), 7e5: (5, 5)}
"""Contact stiffness [N/m]: even and odd modes that a kernel has room for."""
ROOMS = [("superelement", 1e5), ("superelement32", 1e5)]
ROOMS += [pytest.param(*room, marks=pytest.mark.slow) for room in (("superelement", 2.5e5), ("superelement32", 7e5))]
"""Every room, and each precision with more than the usual one: those kernels take 20 s to compile."""


def run_single_and_grouped(scene, method, time_step, steps, **options):
    """Results of a kernel for a single probe, and for the same probe in a group with two others."""
    results = []
    longer = scene.model_copy(update={"carrier_length": scene.carrier_length + 1.2})
    for company in ((), (longer, longer)):
        members = [Simulator(s, method, time_step, seed=3, perturbation=1e-6, **options) for s in (scene, *company)]
        points = np.array([0, members[0].sensor, members[0].sensor + 2, members[0].root - 1, -1], dtype=np.int64)
        lanes = []
        for s in members:
            room, samples = s.chain.node_count - 1 - s.root, np.zeros((steps // 5, len(points), 4))
            inputs = s.drive.inputs_of_steps(steps, time_step, s.chain.element_length, room)
            sums = np.zeros(s.chain.node_count)
            lanes.append(KernelArguments(s.constants, s.state, s.root, inputs, points, samples, sums))
        METHODS[method].run(lanes, time_step, 4, 5, 5)
        first = lanes[0]
        results.append((first.failed, first.root, first.samples, first.tension_sum, *first.state))
    return results


@pytest.mark.processor
@pytest.mark.parametrize(("method", "stiffness"), ROOMS)
@pytest.mark.parametrize("length", LENGTHS)
@pytest.mark.parametrize("terms", [False, True])
def test_single_equals_grouped(method, length, stiffness, terms):
    """Held, and fed in over floats and blocks of them: state, samples at and between floats, sums of tension."""
    scene = Scene(
        carrier_length=length, feed_speed=0.4, probe={"guide_length": 0.5},
        contact={"stiffness": stiffness, "weight": terms, "damping": 3.0 * terms, "friction_slope": 0.1 * terms},
        terms={"shortening": terms, "stiction": terms},
        couple="tangent" if terms else "frame",
    )  # fmt: skip
    for options in ({}, {"growing": True, "time_lapse": 80.0}):
        alone, beside = run_single_and_grouped(scene, method, 5e-5, 1500, **options)
        assert alone[0] == beside[0] == 0
        assert alone[1] == beside[1]
        assert all(map(np.any, alone[2:]))
        assert all(map(np.array_equal, alone[2:], beside[2:]))
    held = Simulator(scene, method, 5e-5)
    assert METHODS[method].kind(held.constants)[:2] == MODES[stiffness]
    assert alone[1] > held.root + 8 * 4  # the root has gone beyond the lanes of a block


@pytest.mark.parametrize("method", ["superelement", "superelement32"])
def test_it_diverges_in_the_same_step(method):
    scene = Scene(carrier_length=3.0)
    with pytest.warns(StabilityWarning):
        alone, beside = run_single_and_grouped(scene, method, 4e-4, 4000)
    assert alone[0] == beside[0] > 0


def test_small_groups_are_split_if_single_probes_are_faster():
    """Of ten probes a group and two alone, in double precision two groups and two together."""
    for method, grouped in (("superelement32", [8, 1, 1]), ("superelement", [4, 4, 2]), ("imex32", [8, 2])):
        batch = SimulatorBatch([Scene(carrier_length=5.0)] * 10, method)
        assert [len(group) for group in groups_of(batch.simulators, list(range(10)))] == grouped
