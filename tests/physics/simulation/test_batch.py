"""A batch of N equals N single runs bit for bit, for all lanes, groups and numbers of threads."""

import numpy as np
import pytest

from probe_env import Scene, Simulator, SimulatorBatch

WINDOW = 0.1  # [s]
OPTIONS = {"growing": True, "time_lapse": 3.0, "ramp": 0.5, "air_lag": 1.0, "perturbation": 1e-7}


def scene(length, friction, helix, guide=2.5, stiffness=1e5, floats=19e-3):
    probe = {"guide_length": guide, "guide_float_diameter": floats, "carrier_float_diameter": 17e-3}
    contact = {"friction": friction, "stiffness": stiffness}
    return Scene(carrier_length=length, tube={"helix_diameter": helix}, contact=contact, probe=probe)


SCENES = [
    scene(10.0, 0.15, 1.2),
    scene(5.0, 0.20, 1.0, stiffness=7e4),
    scene(12.0, 0.10, 2.5, guide=4.0),
    scene(30.0, 0.25, 1.2, floats=20e-3),
    scene(3.0, 0.15, 1.7, stiffness=1.4e5),
    scene(8.0, 0.12, 1.4, guide=1.0),
]


@pytest.fixture(scope="module", params=["imex", "imex32", "superelement", "superelement32"])
def single(request):
    """Method, and the samples of every scene run on its own by Simulator."""
    results = []
    for seed, member in enumerate(SCENES):
        simulator = Simulator(member, request.param, 2e-4, seed=seed, **OPTIONS)
        runs = [simulator.advance(0.3, 0.02, WINDOW, points=("sensor", "root")) for _ in range(2)]
        signals = (("axial", 0), ("radial", 0), ("tension", 1))
        results.append([np.concatenate([getattr(run, name)[1:, k] for run in runs]) for name, k in signals])
    return request.param, results


ORDERS = [((5, 3, 1, 0, 2, 4), 1), ((2, 2, 2, 2, 2), 2), ((3, 0), 1), ((1, 4, 1, 4, 1, 4, 0, 5, 2, 1), 2)]


@pytest.mark.parametrize(("order", "threads"), ORDERS)
def test_every_batch_equals_the_single_runs(order, threads, single):
    method, expected = single
    batch = SimulatorBatch([SCENES[k] for k in order], method, seeds=order, threads=threads, **OPTIONS)
    parts = [batch.advance(0.3, 0.02, WINDOW, keep_samples=True) for _ in range(2)]
    for number, name in enumerate(("axial", "radial", "tension")):
        values = np.concatenate([getattr(part, name) for part in parts])
        for column, k in enumerate(order):
            assert (values[:, column] == expected[k][number]).all()
            assert np.abs(values[:, column]).max() > 0.0


@pytest.mark.parametrize("method", ["newmark", "implicit"])
def test_methods_without_lanes_run_in_a_batch_too(method):
    batch = SimulatorBatch(SCENES[:3], method, 1e-4, threads=2, **OPTIONS)
    window = batch.advance(0.3, 0.02, 0.1, keep_samples=True)
    for k, member in enumerate(SCENES[:3]):
        run = Simulator(member, method, 1e-4, seed=k, **OPTIONS).advance(0.3, 0.02, 0.1, points=("sensor", "root"))
        assert (window.radial[:, k] == run.radial[1:, 0]).all()
        assert (window.tension[:, k] == run.tension[1:, 1]).all()


def test_an_inactive_probe_does_not_change_and_the_others_do(single):
    method, expected = single
    batch = SimulatorBatch(SCENES, method, seeds=range(6), **OPTIONS)
    active = np.array([True, False, True, True, False, True])
    first = batch.advance(0.3, 0.02, WINDOW, active=active, keep_samples=True)
    assert (first.statistics["radial_rms_m"] > 0.0).tolist() == active.tolist()
    assert (first.radial[:, 0] == expected[0][1][:100]).all()
    late = batch.advance(0.3, 0.02, WINDOW, active=~active, keep_samples=True)
    assert (late.radial[:, 1] == expected[1][1][:100]).all()
    assert (late.radial[:, 0] == 0.0).all()


def test_statistics_of_consecutive_windows_join():
    """Acceleration across the seam is that of the joined signal."""
    batch = SimulatorBatch(SCENES[:1], **OPTIONS)
    parts = [batch.advance(0.3, 0.02, 0.1, keep_samples=True) for _ in range(3)]
    joined = np.concatenate([[0.0, 0.0], *(part.radial[:, 0] for part in parts)])
    acceleration = np.diff(joined, n=2) / 1e-3**2
    for k, part in enumerate(parts):
        measured = part.statistics["radial_acceleration_rms_m_per_s2"][0]
        if k > 0:  # the start perturbation is not in the samples before the first window
            assert measured == pytest.approx(acceleration[100 * k : 100 * (k + 1)].std(), rel=1e-12)


def test_a_diverged_probe_is_reported_and_the_others_continue(single):
    method, expected = single
    stiffness = 5e5 if "superelement" in method else 5e6  # far too stiff for 2e-4 s
    broken = SCENES[0].model_copy(update={"contact": {"stiffness": stiffness}})
    with pytest.warns(UserWarning, match="beyond the known stable limit"):
        batch = SimulatorBatch([SCENES[3], broken, SCENES[0]], method, seeds=(3, 9, 0), **OPTIONS)
    parts = [batch.advance(0.3, 0.02, WINDOW, keep_samples=True) for _ in range(2)]
    assert parts[-1].diverged.tolist() == [False, True, False]
    for column, k in ((0, 3), (2, 0)):
        assert (np.concatenate([part.radial[:, column] for part in parts]) == expected[k][1]).all()
    for values in (*parts[-1].statistics.values(), parts[-1].radial):
        assert np.isfinite(values).all()
    assert "diverged at t" in str(batch.simulators[1].error)


def test_bad_arguments():
    for arguments, options, message in (
        ([[]], {}, "scenes is empty"),
        ([SCENES, "euler"], {}, "method = 'euler'"),
        ([SCENES], {"threads": 0}, "threads = 0"),
    ):
        with pytest.raises(ValueError, match=message):
            SimulatorBatch(*arguments, **options)
    batch = SimulatorBatch(SCENES)
    for arguments, message in (
        ((-2.1, 0.02), "feed_speed = -2.1"),
        ((0.1, 63.0), "air_supply_rate = 63.0"),
        ((float("nan"), 0.02), "feed_speed = nan"),
        ((0.1, 0.02, 1e-5), "duration = 1e-05"),
        ((0.1, 0.02, 0.1, 0.003), "duration = 0.1 s is not .* sample periods"),
    ):
        with pytest.raises(ValueError, match=message):
            batch.advance(*arguments)
        assert not any(simulator.steps_done for simulator in batch.simulators)
    single = SimulatorBatch([Scene(carrier_length=5.0)] * 9, "imex32", 2e-4)
    with pytest.raises(ValueError, match="method = 'imex' differs from the batch's 'imex32'"):
        single.replace(0, Simulator(SCENES[0], "imex", 2e-4))
    with pytest.raises(ValueError, match=r"20000002 samples of 9 points take .* GiB, more than 2"):
        single.advance(0.3, None, 20_000.0)
    assert single.simulators[0].time == 0.0
