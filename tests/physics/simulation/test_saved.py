"""Snapshots and pickles are restored if they fit; otherwise the error names the field."""

import copy
import pickle

import numpy as np
import pytest

from probe_env import Scene, SimulationError, Simulator, SimulatorBatch
from probe_env.physics.model.state import at_rest
from probe_env.physics.simulation.saved import FORMAT

SCENE = Scene(carrier_length=2.0, probe={"guide_length": 0.5})
OTHER = {
    "scene.contact.friction = 0.2; here it is 0.15": {"scene": SCENE.model_copy(update={"contact": {"friction": 0.2}})},
    "method = 'wilson'; here it is 'newmark'": {"method": "wilson"},
    "solver = 'banded'; here it is 'ticm'": {"solver": "banded"},
    "time_step = 5e-05; here it is 0.0001": {"time_step": 5e-5},
    "growing = True; here it is False": {"growing": True},
    "air_lag = 1.0; here it is 0.0": {"air_lag": 1.0},
}


def moved(simulator: Simulator) -> Simulator:
    simulator.advance(0.3, None, 0.01)
    return simulator


def refused(here, snapshot, message):
    before = pickle.dumps(here)
    with pytest.raises(ValueError, match=message):
        here.restore(snapshot)
    assert pickle.dumps(here) == before


def test_a_snapshot_of_another_simulator_is_refused_by_the_field():
    here = moved(Simulator(SCENE))
    for difference, arguments in OTHER.items():
        refused(here, Simulator(**({"scene": SCENE} | arguments)).snapshot(), f"^snapshot: {difference}$")


def changed(path, value):
    """A snapshot with one entry changed or removed."""
    snapshot = moved(Simulator(SCENE)).snapshot()
    inner = snapshot
    for name in path[:-1]:
        inner = inner[name]
    if value is None:
        del inner[path[-1]]
    else:
        inner[path[-1]] = value
    return snapshot


LONG = at_rest(500)
NODES = 101


@pytest.mark.parametrize(
    ("snapshot", "message"),
    [
        ({"foo": 1}, "format = None cannot be read; this version reads format"),
        ([], "a list without a format cannot be read"),
        (changed(["format"], FORMAT - 1), rf"format = {FORMAT - 1} cannot be read; this version reads format {FORMAT}"),
        (changed(["foo"], 1), "'foo' is unknown"),
        (changed(["built"], {}), "built: 'air_lag' is missing"),
        (changed(["built", "scene", "tube", "turns"], 3), "scene.tube: 'turns' is unknown"),
        (changed(["changing", "drive"], None), "changing: 'drive' is missing"),
        (changed(["changing", "drive"], 0.2), "drive = 0.2 is not Drive"),
        (changed(["changing", "root"], NODES), f"root = {NODES} is outside the accepted range 1 to {NODES - 1}"),
        (changed(["changing", "state"], LONG), rf"state.d has shape \(500, 3\); \({NODES}, 3\) is accepted"),
        (
            changed(["changing", "state"], at_rest(NODES)._replace(memory=np.zeros((NODES, 3), np.float32))),
            "state.memory has type",
        ),
        (changed(["changing", "state"], tuple(at_rest(NODES))), r"state \(tuple\) is not State"),
    ],
)
def test_an_invalid_snapshot_is_an_error_and_changes_nothing(snapshot, message):
    refused(moved(Simulator(SCENE)), snapshot, message)


def test_seed_and_perturbation_may_differ():
    one, other = Simulator(SCENE, perturbation=1e-5, seed=1), Simulator(SCENE)
    moved(one)
    other.restore(one.snapshot())
    assert (other.advance(duration=0.01).radial == one.advance(duration=0.01).radial).all()


@pytest.mark.parametrize("method", ["newmark", "implicit", "imex"])
def test_snapshot_has_every_attribute_that_changes(method):
    """A new attribute that changes is saved unless it is declared as fixed, and then this finds it."""
    simulator = Simulator(SCENE, method, growing=True, ramp=0.5, air_lag=0.1)
    assert set(vars(simulator)) >= Simulator.FIXED
    fixed = {name: pickle.dumps(vars(simulator)[name]) for name in Simulator.FIXED}
    simulator.advance(0.4, 0.03, 0.2)
    simulator.unconverged_steps += 1
    saved = simulator.snapshot()
    assert set(saved["changing"]) == set(vars(simulator)) - Simulator.FIXED
    simulator._error = SimulationError(method, 1e-4, 0.0, 0, 0.0, 0.0)
    simulator.restore(saved)
    simulator.reset()
    assert fixed == {name: pickle.dumps(vars(simulator)[name]) for name in fixed}


@pytest.mark.parametrize("build", [lambda: Simulator(SCENE), lambda: SimulatorBatch([SCENE])])
def test_pickles_of_other_versions_are_refused(build):
    saved = build()
    _, (kind, *_), state = saved.__reduce_ex__(2)[:3]
    assert state["format"] == FORMAT
    for old in ({name: value for name, value in state.items() if name != "format"}, state | {"format": FORMAT - 1}):
        with pytest.raises(
            ValueError, match=f"pickled {kind.__name__}: format = .* cannot be read; this version reads"
        ):
            kind.__new__(kind).__setstate__(old)
    assert type(pickle.loads(pickle.dumps(saved))) is kind


SCENES = [SCENE, SCENE.model_copy(update={"contact": {"friction": 0.2}}), SCENE]


def test_a_batch_takes_its_own_snapshots_only():
    batch = SimulatorBatch(SCENES)
    batch.advance(duration=0.01)
    saved = batch.snapshot()
    one_less = copy.deepcopy(saved)
    del one_less["probes"][-1]
    wrong_window = copy.deepcopy(saved)
    wrong_window["before"][1] = np.zeros((3, 3))
    for snapshot, message in (
        (SimulatorBatch(SCENES[:2]).snapshot(), "snapshot: 2 probes; here are 3"),
        (
            SimulatorBatch(SCENES[::-1][1:] + SCENES[:1]).snapshot(),
            "probe 0: scene.contact.friction = 0.2; here it is 0.15",
        ),
        (SimulatorBatch(SCENES, time_step=1e-4).snapshot(), "probe 0: time_step = 0.0001; here it is 0.0002"),
        (one_less, "snapshot: 2 probes; here are 3"),
        (wrong_window, r"before\[1\] has shape \(3, 3\); \(2, 3\) is accepted"),
        ([], "a list without a format"),
        (batch.simulators[0].snapshot(), "'before' is missing"),
    ):
        refused(batch, snapshot, message)
    expected = batch.advance(duration=0.01, keep_samples=True)
    batch.restore(saved)
    repeated = batch.advance(duration=0.01, keep_samples=True)
    assert (repeated.radial == expected.radial).all()
    assert repeated.statistics["radial_acceleration_rms_m_per_s2"] == pytest.approx(
        expected.statistics["radial_acceleration_rms_m_per_s2"], rel=0.0
    )
