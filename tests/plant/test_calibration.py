"""Calibration: priors, metres, estimates from logs of known truth, gauge errors, and the command."""

import json
from pathlib import Path
from traceback import walk_stack
from types import MappingProxyType

import emcee
import numpy as np
import pytest
from oracles.scatter import CHANCE, of_another
from rig import rig_logs, write_log
from scipy.stats import chi2, norm

from probe_agents.cli import main
from probe_agents.plant import inference
from probe_agents.plant.calibration import (
    Calibration,
    calibrate,
    check_log,
    draw_bands,
    print_check,
    read_cases,
    tube_file,
)
from probe_agents.plant.inference import (
    LIMIT,
    Gain,
    Likelihood,
    LogCase,
    Posterior,
    drag_of_pressure,
    fit_gain,
    fit_sliding,
    sample_posterior,
)
from probe_agents.plant.logs import Log
from probe_agents.plant.prior import DAMPING, DRAG, FRICTION, STIFFNESS, prior_of
from probe_agents.plant.response import CHANNELS, Metres, metres_of, observed, steady_tension, stored_response
from probe_agents.records.cells import ReadOptions
from probe_env import Context, Plant, Scene
from probe_env.files import FileError
from probe_env.physics.closed_forms import air_pressure
from probe_env.physics.model.chain import air_speed

RESPONSE, PRIOR = stored_response(), prior_of(Plant())
LENGTH = np.arange(6.5, 50.0)
TRUTH = np.array([0.2, 1e5, 0.44, 6e-5])


@pytest.fixture(params=[(200, 200)])
def short(monkeypatch, request):
    """Few steps: enough for a mean and an interval."""
    for name, steps in zip(("BURN_IN", "STEPS"), request.param, strict=True):
        monkeypatch.setattr(inference, name, steps)


def log_like(truth, rng, diameter=1.3, tube="", length=LENGTH, channels=CHANNELS, gain=1.0):
    """A log at a truth (4,): drawn from the response, or without scatter if there is no generator."""
    scene = Scene.fitted({"tube": {"helix_diameter": diameter}}).whole()
    feed = np.interp(length, [5.0, 20.0, 50.0], [0.3, 0.2, 0.1])
    air = np.interp(length, [5.0, 30.0, 50.0], [0.018, 0.025, 0.03])
    mean, spread = RESPONSE.predict(truth[None], Metres(length, feed, air, {}), scene)
    if rng:
        factor = np.linalg.cholesky(RESPONSE.covariance(length, list(range(len(CHANNELS)))))
        mean[0] += spread[0] * (factor @ rng.normal(size=len(factor))).reshape(mean[0].shape)
    measured = 10.0 ** mean[0]
    measured[:, 0] *= gain
    return LogCase("log", tube, scene, Metres(length, feed, air, {n: measured[:, CHANNELS.index(n)] for n in channels}))


def with_measurements(case, measured):
    """The case with other measurements."""
    m = case.metres
    return case._replace(metres=Metres(m.length, m.feed, m.air, measured))


def test_the_prior_is_what_the_file_says():
    """All is open without a file; a number is known, but not as friction; figures become their quantiles."""
    drag = pytest.approx([fraction * 0.44 for fraction in DRAG])
    ranges = {"friction": FRICTION, "contact_stiffness": STIFFNESS, "drag_coefficient": drag, "damping_time": DAMPING}
    assert PRIOR.ranges == ranges
    assert len(PRIOR.assumed) == 4
    middle = [sum(FRICTION) / 2.0, *(np.sqrt(low * high) for low, high in [*PRIOR.ranges.values()][1:])]
    np.testing.assert_allclose(PRIOR.values(np.zeros((1, 4)), 1)[0, 0], middle)
    numbers = {"contact": {"friction": 0.2, "stiffness": 8e4}, "air": {"drag_coefficient": 0.4}}
    prior = prior_of(Plant(**numbers, probe={"damping_time": 6e-5}))
    assert prior.fixed == {"contact_stiffness": 8e4, "drag_coefficient": 0.4, "damping_time": 6e-5}
    table = prior.values(np.zeros((3, 2)), 2)
    np.testing.assert_allclose(table, np.broadcast_to([sum(FRICTION) / 2.0, 8e4, 0.4, 6e-5], (2, 3, 4)))
    figures = {"friction": {"low": 0.1, "high": 0.2}, "stiffness": {"mean": 1e5, "std": 1e4}}
    prior = prior_of(Plant(contact=figures, air={"drag_coefficient": 0.44}, probe={"damping_time": 5e-5}))
    # standard normal coordinates of the 5th percentile, the median and the 95th
    values = prior.values(np.array([[z, z] for z in (-1.6449, 0.0, 1.6449)]), 1)[0, :, :2]
    np.testing.assert_allclose(values, [[0.105, 83551.5], [0.15, 1e5], [0.195, 116448.5]], rtol=1e-3)
    for tables, problem in [
        ({"contact": {"friction": {"low": 0.1, "high": 0.6}}}, "contact.friction = 0.6 is outside 0.05 to 0.35"),
        ({"contact": {"stiffness": 1e6}}, r"contact.stiffness = 1e\+06 N/m is outside 50000 to 190000 N/m"),
        ({"probe": {"damping_time": 1e-5}}, "probe.damping_time = 1e-05 s is outside 3e-05 to 0.00012 s"),
        ({"air": {"drag_coefficient": {"mean": 3.0, "std": 0.1}}}, "air.drag_coefficient = 3 is outside 0.1 to 2"),
    ]:
        with pytest.raises(ValueError, match=f"mine.toml: {problem}"):
            prior_of(Plant.model_validate(tables), "mine.toml")


def recorded(feed, tension, noise, parts=1):
    """A log from 5 m on, with ``parts`` rows a second."""
    fed = np.repeat(feed, parts)
    length = 5.0 + np.concatenate([[0.0], np.cumsum(fed)[:-1]]) / parts
    measured = {"root_tension": np.repeat(tension, parts), "rf_noise_rms": np.repeat(noise, parts)}
    time = np.arange(len(fed)) / parts
    return Log(time, length, fed, np.full(len(fed), 0.02), MappingProxyType(measured))


def test_metres_are_means_over_time_and_of_squares():
    noise = [3e-5, 4e-5, 3e-5, 4e-5, 1e-5, 1e-5, 1e-5, 1e-5]
    averaged = metres_of(recorded([0.25] * 8, [1, 2, 3, 4, 5, 5, 5, 5], noise))
    np.testing.assert_allclose(averaged.length, [5.5, 6.5])
    np.testing.assert_allclose(averaged.feed, 0.25)
    np.testing.assert_allclose(averaged.measured["root_tension"], [2.5, 5.0])
    np.testing.assert_allclose(averaged.measured["rf_noise_rms"], [np.sqrt(12.5) * 1e-5, 1e-5])
    assert len(metres_of(recorded([0.0] * 5, [1.0] * 5, [1e-5] * 5))) == 0
    coarse, *fine = (metres_of(recorded([0.25] * 12, list(range(12)), [1e-5] * 12, parts)) for parts in (1, 2, 5))
    for finer in fine:
        np.testing.assert_allclose(finer.measured["root_tension"], coarse.measured["root_tension"])


def test_a_standstill_and_its_restart_do_not_count():
    """Ten seconds of rest change nothing but the metre that they interrupt, of which half is left out."""
    feed, tension = [0.25] * 4 + [0.0] * 10 + [0.25] * 12, [2.0] * 4 + [9.0] * 13 + [2.0] * 9
    stood = metres_of(recorded(feed, tension, [1e-5] * 26))
    np.testing.assert_allclose(stood.measured["root_tension"], 2.0)
    np.testing.assert_allclose(stood.length, [5.5, 7.5, 8.5])  # of the second metre a quarter is left


def test_a_creep_below_the_least_feed_is_left_out_and_noted(tmp_path):
    """It changes the metres as a standstill does, and the note has its duration and place."""
    feed, tension = [0.25] * 4 + [0.015] * 8 + [0.25] * 12, [2.0] * 4 + [9.0] * 11 + [2.0] * 9
    log = recorded(feed, tension, [1e-5] * 24)
    np.testing.assert_allclose(metres_of(log, 0.018).measured["root_tension"], 2.0)
    path = tmp_path / "rig.csv"
    path.write_text(log.to_csv())
    (case,) = read_cases([path], Plant(), [1.3], [])
    np.testing.assert_allclose(case.metres.measured["root_tension"], 2.0)
    assert "8 s between 6 and 6.105 m with a feed below 0.02 m/s" in case.notes[-1]
    assert "8 s" not in str(read_cases([path], Plant(feed={"feed_speeds": (0.01, 0.4)}), [1.3], [])[0].notes)


@pytest.mark.slow
@pytest.mark.processor
def test_truths_are_where_the_posterior_says(short, seeds):
    """Ten logs of the response's own making, of truths from the prior: the rank of each among its draws is uniform.

    So are the ranks of one unknown over logs, which have nothing in common, but not those of four in one log: each
    unknown has bounds of its own, eight in all. As normal scores the ranks have a mean of 0 and a square of 1. Every
    other metre of a log is enough.
    """
    logs = 10
    truths = PRIOR.values(np.random.default_rng(seeds(1)[0]).normal(size=(logs, 1 + len(PRIOR.shared))), 1)[0]
    ranks = np.empty((logs, 4))
    for k, (truth, seed) in enumerate(zip(truths, seeds(logs), strict=True)):
        case = log_like(truth, np.random.default_rng([4, seed]), length=LENGTH[::2])
        draws = sample_posterior(RESPONSE, [case], PRIOR, seed=seed).draws[0]
        ranks[k] = ((draws < truth).sum(axis=0) + 0.5) / (len(draws) + 1)
    scores = norm.ppf(ranks)
    assert (np.abs(scores.mean(axis=0)) < norm.isf(CHANCE / 16) / np.sqrt(logs)).all()
    low, high = chi2.ppf([CHANCE / 16, 1.0 - CHANCE / 16], logs)
    squares = (scores**2).sum(axis=0)
    assert ((low < squares) & (squares < high)).all()


@pytest.mark.slow
@pytest.mark.processor
def test_logs_of_one_tube_share_its_friction(short, seeds):
    """Three logs give a friction more precisely than one; each of two tubes has its own friction."""
    truth, ratios, worlds = np.array([0.18, 9e4, 0.44, 6e-5]), [], 4
    for seed in seeds(worlds):
        rng = np.random.default_rng([2, seed])
        logs = [log_like(truth, rng, length=LENGTH[::2]) for _ in range(3)]  # every other metre is enough
        one, three = (sample_posterior(RESPONSE, logs[:n], PRIOR, seed).draws[0, :, 0].std() for n in (1, 3))
        ratios.append(np.log(three / one))
    # exp(-0.352), for drag, which acts alike, is known no better; scatters by 0.095 over 16 worlds
    assert np.mean(ratios) < -0.352 + of_another(0.095, 16, members=worlds) < 0.0
    own = {"a": 0.18, "b": 0.12}
    others = [log_like(np.array([friction, 9e4, 0.44, 6e-5]), rng, tube=tube) for tube, friction in own.items()]
    draws = sample_posterior(RESPONSE, others, PRIOR).draws
    # 0.181 +- 0.0033 and 0.120 +- 0.0029 over 16 worlds
    assert np.median(draws[0, :, 0]) > 0.181 - of_another(0.0033, 16, among=2) > 0.15
    assert np.median(draws[1, :, 0]) < 0.120 + of_another(0.0029, 16, among=2) < 0.15


@pytest.mark.parametrize("short", [(10, 20)], indirect=True)
def test_two_tubes_share_all_unknowns_but_friction(short):
    rng = np.random.default_rng(0)
    own, every = {"a": 0.3, "b": 0.1}, LENGTH[::4]
    cases = [log_like(np.array([mu, 9e4, 0.44, 6e-5]), rng, tube=k, length=every) for k, mu in own.items()]
    first, second = (sample_posterior(RESPONSE, cases, PRIOR).draws for _ in range(2))
    np.testing.assert_array_equal(first, second)
    assert first.shape[0] == 2
    np.testing.assert_array_equal(first[0, :, 1:], first[1, :, 1:])
    assert np.median(first[0, :, 0]) > np.median(first[1, :, 0])


@pytest.mark.processor
def test_misfit_of_own_logs_and_of_random_numbers(seeds):
    """The mean square of its own deviations is 1 within its scatter; numbers that follow nothing are far beyond."""
    rng = np.random.default_rng(seeds(1)[0])
    case = log_like(TRUTH, rng)
    own = Likelihood(RESPONSE, [case]).misfit(0, TRUTH)
    # mean squares of 44 numbers each; the sensors' scatter, which was not drawn, makes them smaller
    assert (own[:4] < chi2.isf(CHANCE / 4, len(LENGTH)) / len(LENGTH)).all()
    noisy = {name: values * np.exp(rng.normal(size=len(values))) for name, values in case.metres.measured.items()}
    assert (Likelihood(RESPONSE, [with_measurements(case, noisy)]).misfit(0, TRUTH) > RESPONSE.misfit).any()


def test_short_logs_and_logs_without_channels_are_refused():
    """Before anything is sampled, by its name."""
    with pytest.raises(ValueError, match="log: 5 metres of insertion, at least 8 are needed"):
        sample_posterior(RESPONSE, [log_like(TRUTH, None, length=LENGTH[:5])], PRIOR)
    with pytest.raises(ValueError, match="log: has none of the channels root_tension, radial_acceleration_rms"):
        sample_posterior(RESPONSE, [log_like(TRUTH, None, channels=())], PRIOR)


def settled(gain, channels=CHANNELS):
    """Of a log without scatter whose tension is read with a gain; the scatter is that at the truth."""
    truth = np.array([0.12, 9e4, 0.44, 7e-5])
    likelihood = Likelihood(RESPONSE, [log_like(truth, None, diameter=1.6, channels=channels, gain=gain)])
    likelihood.settle(truth[None, None])
    return likelihood


def test_missing_channels_and_the_settled_scatter():
    """The likelihood of some channels is that of the others integrated out: their block of the covariance."""
    case = log_like(TRUTH, np.random.default_rng(1))
    part = with_measurements(case, {n: case.metres.measured[n] for n in CHANNELS[1:]})
    assert Likelihood(RESPONSE, [part]).chosen == [[1, 2, 3]]
    np.testing.assert_array_equal(observed(part.metres, [1, 2, 3]), observed(case.metres, [0, 1, 2, 3])[:, 1:])
    whole = RESPONSE.covariance(LENGTH, [0, 1, 2, 3]).reshape(len(LENGTH), 4, len(LENGTH), 4)
    block = RESPONSE.covariance(LENGTH, [1, 2, 3]).reshape(len(LENGTH), 3, len(LENGTH), 3)
    np.testing.assert_allclose(whole[:, 1:, :, 1:], block)
    likelihood, draws = Likelihood(RESPONSE, [case]), np.array([TRUTH, TRUTH * [2.0, 1.0, 1.0, 1.0]])
    spread = likelihood.deviations(0, draws)[1]
    likelihood.settle(draws[None])
    np.testing.assert_allclose(likelihood.settled[0], np.sqrt(spread[0] * spread[1]))


def test_the_best_gain_is_exact():
    """It is as likely as no gain of the same log with its tension divided by it, and likelier than any other."""
    normal = np.array([[0.3, -0.5, 0.2, 0.1]])

    def likely(gain, free):
        return inference.GainLikelihood(settled(gain), 0, PRIOR, free).logarithm(normal)

    log, best = likely(1.3, True)
    below, same, above = (likely(1.3 / np.exp(best[0] + k), False)[0][0] for k in (-0.02, 0.0, 0.02))
    assert log[0] == pytest.approx(same, rel=1e-9)
    assert same > max(below, above)


def test_excess_gain_of_a_gauge_is_found():
    """A gain of 1.5 is beyond the 15 % that drag may be, and the tension's bend fixes the friction; 1.1 is within."""
    true, drag, scaled = (fit_gain(settled(gain), 0, PRIOR) for gain in (1.0, 1.1, 1.5))
    assert max(true.ratio, drag.ratio) < LIMIT < scaled.ratio
    assert scaled.gain > 1.5 / 1.15 / 1.15  # drag may be at either edge of its prior
    assert fit_gain(settled(1.0, CHANNELS[1:]), 0, PRIOR) is None


def calibrated(case, draws, gain=None):
    """A calibration with given draws (n, 4)."""
    likelihood = Likelihood(RESPONSE, [case])
    posterior = Posterior(draws[None], [likelihood.misfit(0, draws.mean(axis=0))], likelihood)
    return Calibration(PRIOR, posterior, {case.tube: None}, [], [gain], [])


def test_notes_begin_with_cause_and_cure_and_end_with_numbers():
    """The only channel that deviates may be left out; of two, none is offered."""
    case = log_like(TRUTH, None)._replace(heads={"root_tension": "Seilkraft"})
    draws = np.tile(TRUTH, (64, 1))
    assert calibrated(case, draws).misfits == []
    (note,) = calibrated(case, draws, Gain(30.0, 1.3)).misfits
    assert note.startswith("log: the load cell seems to read 30% too high: are its scale, zero and unit right")
    assert "calibrate without it: --columns 'Seilkraft=none'. (2 log likelihood ratio 30.0, limit 4.5)" in note
    measured = dict(case.metres.measured)
    rng = np.random.default_rng(0)
    for name, count in (("rf_noise_rms", 1), ("axial_acceleration_rms", 2)):
        measured[name] = measured[name] * np.exp(2.0 * rng.normal(size=len(LENGTH)))
        notes = calibrated(with_measurements(case, measured), draws).misfits
        assert len(notes) == count
        assert ["without it: --columns 'rf_noise_rms=none'" in note for note in notes][-1] == (count == 1)
        assert "of simulated logs are below" in notes[-1].rpartition("? ")[2]


def test_a_second_log_of_the_tube_is_predicted_and_of_another_not(capsys, tmp_path):
    """The draws are those of a calibration, with a standard deviation of the friction of 0.005."""
    rng = np.random.default_rng(3)
    fit = calibrated(log_like(TRUTH, rng), TRUTH * (1.0 + [0.025, 0.0, 0.0, 0.0] * rng.normal(size=(512, 1))))
    own, other = (check_log(fit, log_like(TRUTH * [k, 1.0, 1.0, 1.0], rng)) for k in (1.0, 1.25))
    assert print_check(own) == {"log": "log", "verdict": "the calibration predicts log", "reasons": []}
    record = print_check(other)
    assert record["verdict"] == "the calibration does not predict log"
    assert "measured / predicted" in capsys.readouterr().out
    assert draw_bands(other, tmp_path / "check.png").stat().st_size > 1000


def with_pressure(case, drag, loss=0.0, error=0.0):
    """The case with the pressure of a gauge in front of a hose, ``error`` relative."""
    metres, air = case.metres, case.scene.model_copy(update={"air": {"drag_coefficient": drag}})
    speed = metres.air * air_speed(air, 1.0)
    inlet = air_pressure(air, metres.length, metres.length, metres.feed, speed)
    gauge = np.sqrt(inlet**2 + loss * metres.air**2) - air.air.exit_pressure
    return with_measurements(case, metres.measured | {"inlet_pressure": gauge * (1.0 + error)})


def test_inlet_pressure_gives_the_drag_coefficient():
    """Exactly without noise, whatever is lost before the helix."""
    bare = log_like(TRUTH, None)
    bare = bare._replace(scene=bare.scene.model_copy(update={"air": {"darcy_factor": 0.02}}))
    for drag, loss in ((0.44, 0.0), (0.5, 4e12)):
        mean, deviation = drag_of_pressure(with_pressure(bare, drag, loss))
        assert mean == pytest.approx(drag, rel=1e-6)
        assert deviation == pytest.approx(inference.PRESSURE_SCATTER, rel=1e-3)
    noise = 0.02 * np.random.default_rng(0).normal(size=len(LENGTH))
    mean, deviation = drag_of_pressure(with_pressure(bare, 0.44, 4e12, noise))
    assert abs(np.log(mean / 0.44)) < norm.isf(CHANCE / 2) * deviation
    assert drag_of_pressure(bare) is None


@pytest.mark.slow
@pytest.mark.parametrize("short", [(60, 60)], indirect=True)
def test_inlet_pressure_narrows_the_posterior(short):
    """Of the shipped simulated log, whose drag coefficient is 0.44 and friction 0.2.

    The range of the drag alone has a relative standard deviation of 8.7 %, log-uniform over +-15 %; the pressure, 3 %.
    """
    (case,) = read_cases([Path("example-rig")], Plant(), [], [])
    noise = 0.01 * np.random.default_rng(0).normal(size=len(case.metres))
    without, given = (
        sample_posterior(RESPONSE, [c], PRIOR).draws[0] for c in (case, with_pressure(case, 0.44, 4e12, noise))
    )
    friction, _, drag, _ = given.std(axis=0) / without.std(axis=0)
    assert drag < 0.6
    assert friction < 0.8
    low, high = np.quantile(given[:, 0], [0.01, 0.99])
    assert low < 0.2 < high


def sliding_log(friction, drag, bore, noise=0.0):
    """A log of steady sliding: feed and air change over 50 m."""
    scene = Scene.fitted({"tube": {"inner_diameter": bore, "helix_diameter": 1.4}}).whole()
    length = np.arange(5.5, 55.0)
    bare = Metres(length, np.linspace(0.3, 0.1, len(length)), 0.02 + 0.005 * np.sin(length / 5.0), {})
    tension = steady_tension(np.full((1, 1), friction), bare, scene, drag)[0] * np.exp(noise)
    return with_measurements(LogCase("log", "", scene, bare), {"root_tension": tension})


def test_sliding_is_the_inverse_of_the_closed_form():
    """Without scatter the friction is found: drag is table 2's, and so is the middle of its prior."""
    for bore in (0.022, 0.0242, 0.026):
        for friction in (0.08, 0.2, 0.33):
            fit = fit_sliding([sliding_log(friction, 1.0, bore)], PRIOR)
            assert fit.friction[0] == pytest.approx(friction, rel=2e-3)  # drag is drawn to the middle of its range
            assert fit.friction[1] < friction < fit.friction[2]
    case = sliding_log(0.2, 1.0, 0.0242)
    assert fit_sliding([with_measurements(case, {"rf_noise_rms": 1e-5 * case.metres.length})], PRIOR) is None
    # a pull 10 % stronger than the file says is found as drag; otherwise the friction would be 9 % off
    fit = fit_sliding([sliding_log(0.2, 1.1, 0.0242)], PRIOR)
    for (mean, low, high), true in ((fit.friction, 0.2), (fit.drag_coefficient, 1.1 * 0.44)):
        assert low < true < high
        assert mean == pytest.approx(true, rel=0.05)


def test_intervals_cover_under_correlated_scatter():
    """Of 40 logs whose deviations decay over 3 m, at least 27 are covered by 90 % intervals.

    Fewer come with a chance of 2e-5, were the coverage just 0.9 (binomial).
    """
    covered, apart = 0, np.abs(np.subtract.outer(np.arange(50.0), np.arange(50.0)))
    for seed in range(40):
        rng = np.random.default_rng([5, seed])
        noise = np.linalg.cholesky(np.exp(-apart / 3.0) + 1e-9 * np.eye(50)) @ rng.normal(size=50) * 0.05
        friction = float(rng.uniform(0.08, 0.3))
        fit = fit_sliding([sliding_log(friction, 1.0, 0.0242, noise)], PRIOR)
        covered += fit.friction[1] <= friction <= fit.friction[2]
    assert covered >= 27


@pytest.mark.processor
@pytest.mark.parametrize("short", [(60, 60)], indirect=True)
def test_the_shipped_log_is_calibrated(short, tmp_path, capsys):
    """It was simulated with a friction of 0.2: the interval has it, and the tension alone comes within 0.02."""
    tube_path = tmp_path.parent / "mine.toml"
    arguments = [
        "calibrate",
        "example-rig",
        "--output",
        str(tmp_path),
        "--write-tube",
        str(tube_path),
        "--check",
        "example-rig",
    ]
    assert main(arguments) == 0
    record = json.loads((tmp_path / "calibration.json").read_text())
    for name in ("friction", "contact_stiffness", "drag_coefficient", "damping_time"):
        assert record[name]["low"] < record[name]["mean"] < record[name]["high"]
        assert len(record["draws"][name]) == len(record["draws"]["friction"])
    assert record["friction"]["low"] <= 0.2 <= record["friction"]["high"]
    (tube,) = record["tubes"].values()
    assert tube["by_tension_alone"]["friction"]["mean"] == pytest.approx(0.2, abs=0.02)
    assert not record["misspecified"], record["reasons"]
    assert {p.name for p in tmp_path.iterdir()} == {"calibration.json", "corner.png", "bands.png", "check.png"}
    assert record["check"]["verdict"] == "the calibration predicts example-rig"
    assert "verdict" in capsys.readouterr().out
    plant = Plant.from_toml(tube_path)
    assert plant.scene.contact.friction == pytest.approx(record["friction"]["mean"], abs=0.01)
    assert plant.bundle == Plant.from_toml("configs/tubes/example.toml").bundle is not None


@pytest.mark.slow
def test_logs_of_a_rig_with_stops_and_creeps(short, tmp_path):
    """Friction is found in logs of the whole model; in those of the study's model the cause is told.

    The 90 % intervals of eight such logs reach 0.015 to either side at most, so a standard deviation is 0.009, and an
    error of four of them is rarer than 1e-4.
    """
    tubes = [Context(friction=0.13, helix_diameter=1.3), Context(friction=0.2, helix_diameter=1.3)]
    for assumptions, halts in (("whole", [{12.0: 0.0, 30.0: 0.0}, {20.0: 0.01, 40.0: 0.0}]), ("study", [{}, {}])):
        plant = Plant(assumptions=assumptions, tube={"helix_diameter": 1.3}, task={"lost_drive_periods": 1000})
        logs = rig_logs(tubes, halts, plant, "fast", 7)
        paths = [write_log(tmp_path / f"{assumptions}-{k}.csv", log) for k, log in enumerate(logs)]
        for path, tube in zip(paths, tubes, strict=True):
            fit = calibrate(read_cases([path], Plant(), [1.3], []), Plant(), RESPONSE, progress=False)
            if assumptions == "study":
                assert "as in the study's model" in fit.misfits[0]
            else:
                assert fit.misfits == []
                assert fit.summary("friction")["mean"] == pytest.approx(tube.friction, abs=0.036)


def test_tube_file_keeps_tables_and_replaces_calibration(tmp_path):
    tube, other, posterior = tmp_path / "tube.toml", tmp_path / "new" / "mine.toml", tmp_path / "out/calibration.json"
    tube.write_text('# mine\nposterior = "old.json"\n\n[tube]\nhelix_length = 45.0  # m\n')
    new = "# mine\n[tube]\nhelix_length = 45.0  # m\n"
    assert tube_file(tube, posterior, tube) == f'posterior = "out/calibration.json"\n{new}'
    assert tube_file(other, posterior, tube) == f'posterior = "../out/calibration.json"\n{new}'
    with pytest.raises(FileError, match="exists and has other tables"):
        tube_file(tube, posterior, None)
    with pytest.raises(FileError, match=r"must end with .toml"):
        tube_file(tmp_path / "mine.txt", posterior, tube)


def test_an_interrupt_of_the_sampling_prints_nothing(monkeypatch, capfd):
    case, logarithm = log_like(TRUTH, None), Likelihood.logarithm

    def interrupt(self, values):
        if emcee.EnsembleSampler in (type(frame.f_locals.get("self")) for frame, _ in walk_stack(None)):
            raise KeyboardInterrupt
        return logarithm(self, values)

    monkeypatch.setattr(Likelihood, "logarithm", interrupt)
    with pytest.raises(KeyboardInterrupt):
        sample_posterior(RESPONSE, [case], PRIOR, progress=False)
    assert capfd.readouterr() == ("", "")


def test_arguments_are_checked_before_a_log_is_read():
    """The files need not even exist."""
    paths = [Path("a.csv"), Path("b.csv")]
    usual = {"paths": paths, "plant": Plant(), "helix_diameters": [], "tubes": []}
    three, two = (Plant(tube={"helix_diameter": diameters}) for diameters in ((1.0, 1.2, 1.4), (1.0, 1.2)))
    for arguments, problem in [
        ({"paths": []}, "logs: at least one is needed"),
        ({"helix_diameters": [1.0, 1.2, 1.4]}, "--helix-diameters: 3 for 2 logs"),
        ({"helix_diameters": [0.1]}, "helix_diameter = 0.1 m is outside the accepted range 0.3 to 10000 m"),
        ({"tubes": ["a"]}, "--tubes: 1 names for 2 logs"),
        ({"tubes": ["a", "a"], "helix_diameters": [1.0, 1.2]}, "'a' has helix diameters of 1 and 1.2 m"),
        ({"plant": three}, "tube.helix_diameter: 3 for 2 logs"),
        ({"options": ReadOptions(passage="out")}, "pass = 'out': calibration is of insertions"),
        ({"plant": two, "helix_diameters": [9.0]}, "--helix-diameters: 9 m is none of the plant's: 1, 1.2 m"),
    ]:
        with pytest.raises(ValueError, match=problem):
            read_cases(**(usual | arguments))


def test_a_log_without_air_is_refused_by_file_column_and_value(tmp_path):
    path, head = tmp_path / "rig.csv", "time [s];inserted_length [m];air_supply [m3/h];root_tension [N]"
    for switched_off, at in ((0, 5.5), (50, 20.5)):  # the first metre in which the air is off throughout
        rows = [f"{k};{5 + 0.3 * k:.1f};{63 * (k < switched_off)};5" for k in range(100)]
        path.write_text("\n".join([head, *rows]))
        place = f"^{path}: air_supply = 0 m3/h at an inserted length of {at} m: .*faster than the feed"
        with pytest.raises(FileError, match=place):
            read_cases([path], Plant(), (1.0,), ())
