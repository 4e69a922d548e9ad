"""Runs, samples and snapshots: what is returned, and that it is the same every time."""

import copy
import pickle

import numpy as np
import pytest
from oracles.scatter import of_another

from probe_env import Scene, Simulator
from probe_env.physics.model.chain import element_blocks

SCENE = Scene(carrier_length=10.0)


def test_defaults_shapes_and_snapshots():
    simulator = Simulator(SCENE)
    assert (simulator.method.name, simulator.time_step, simulator.nodes_per_pitch) == ("newmark", 1e-4, 4)
    run = simulator.run(0.2, snapshots=(0.0, 0.05, 0.2))
    assert run.points == ("sensor", "tip")
    assert run.time == pytest.approx(np.arange(201) * 1e-3)
    assert run.axial.shape == run.radial.shape == run.rotation.shape == run.tension.shape == (201, 2)
    assert (run.axial[0] == 0.0).all()  # sample 0 is the start
    assert np.abs(run.axial[-1]).min() > 0.0
    assert run.distance_from_tip == pytest.approx([2.5, 0.0])
    assert run.mean_tension.shape == run.position.shape == (500,)
    shapes = run.shapes
    assert shapes.time == pytest.approx([0.0, 0.05, 0.2])
    assert shapes.axial.shape == shapes.radial.shape == (3, 501)
    assert shapes.tension.shape == (3, 500)
    assert (shapes.axial[0] == 0.0).all()
    assert shapes.axial[1, -1] == run.axial[50, 1]  # the tip is last
    assert shapes.radial[2, 400] == run.radial[-1, 0]  # the sensor at 10 m
    assert (simulator.tension == shapes.tension[2]).all()
    # the tension is EA times the elements' stretch, radial displacement included, but for the damping part
    d = np.stack([shapes.axial[2], shapes.radial[2], shapes.rotation[2]], axis=1)[::-1]
    head, tail = element_blocks(simulator.chain)
    stretch = (d[:-1] @ head.T + d[1:] @ tail.T)[::-1, 0]
    assert np.corrcoef(stretch, shapes.tension[2])[0, 1] > 0.99


def test_named_points_are_distances_from_the_tip():
    run = Simulator(SCENE).run(0.05, points=("tip", "sensor", "root", 0.0, 2.5, 12.5), snapshots=(0.05,))
    assert run.shapes.tension[0, 0] == run.tension[-1, 2]
    assert (run.axial[:, :3] == run.axial[:, 3:]).all()
    assert (run.axial[:, 2] == 0.0).all()
    assert run.column(2.5) == 4
    with pytest.raises(ValueError, match="'nose' was not recorded"):
        run.column("nose")


@pytest.mark.parametrize("method", ["newmark", "wilson"])
def test_runs_and_their_pieces_are_equal_bit_for_bit(method):
    simulator, other = Simulator(SCENE, method), Simulator(SCENE, method)
    whole = simulator.run(0.3, 2e-3)
    parts = [other.run(0.1, 2e-3), other.advance(duration=0.2, sample_period=2e-3)]
    for name in ("axial", "radial"):
        first, second = (getattr(part, name) for part in parts)
        assert (np.concatenate([first, second[1:]]) == getattr(whole, name)).all()
    assert np.concatenate([parts[0].time, parts[1].time[1:]]) == pytest.approx(whole.time)
    assert (simulator.run(0.3, 2e-3).radial == whole.radial).all()  # run starts afresh


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda s: pickle.loads(pickle.dumps(s)), Simulator.branch])
@pytest.mark.parametrize("method", ["newmark", "implicit", "superelement32"])
def test_a_copy_taken_mid_run_goes_on_equal(method, duplicate):
    simulator = Simulator(SCENE, method)
    simulator.run(0.05)
    other = duplicate(simulator)
    first, second = simulator.advance(duration=0.05), other.advance(duration=0.05)
    assert (first.time == second.time).all()
    assert (first.axial == second.axial).all()
    assert first.time[0] == pytest.approx(0.05)


def test_only_declared_attributes_change_with_time():
    """Else a branch would not copy them."""
    simulator = Simulator(SCENE, "implicit", growing=True, ramp=0.5, air_lag=0.1)
    fixed = {name: pickle.dumps(value) for name, value in vars(simulator).items() if name not in Simulator.CHANGING}
    simulator.advance(0.4, 0.03, 0.2)
    assert fixed == {name: pickle.dumps(vars(simulator)[name]) for name in vars(simulator) if name in fixed}
    assert set(vars(simulator)) == {*fixed, *Simulator.CHANGING}


@pytest.mark.processor
def test_one_wall_lets_the_tip_out_and_two_do_not(seeds):
    """Erratum 3: with the inner wall alone the free tip leaves the tube.

    Of sixteen starts each the logarithm of how far it goes beyond 5.2 mm, where the outer wall is, in mm: 2.88 +- 0.43
    with the inner alone (18 mm) and -2.82 +- 0.31 (0.06 mm) with both. But for 1e-4 the means of three are beyond 3.9
    mm and between 0.020 and 0.18 mm: an outer wall that is not there is noticed, or one a tenth as stiff
    (0.37 mm).
    """
    for walls, mean, deviation in (("inner", 2.88, 0.43), ("both", -2.82, 0.31)):
        scene, beyond = Scene(carrier_length=50.0, contact={"walls": walls}), []
        for seed in seeds(3):
            simulator = Simulator(scene, "imex", 2e-4, perturbation=1e-6, seed=seed)
            beyond.append(simulator.run(2.0, points=("tip",)).radial.max() * 1e3 - 5.2)
        chance = of_another(deviation, 16, among=2, members=3)
        assert np.log(beyond).mean() > mean - chance
        assert walls == "inner" or np.log(beyond).mean() < mean + chance < 0.0
