"""Trials of designs: compared segment in helices of 40 and 80 m and in other bores, and vibration measures."""

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

from probe_env import Context, Design, Fidelity, Plant, SimulatorBatch
from probe_env.design import CLEARANCE, RANGES, ranges_in
from probe_env.envs import trials
from probe_env.envs.design_env import STUDY_FEED, DesignEnv
from probe_env.envs.episodes.limits import check_simulable
from probe_env.envs.task.config import TaskConfig
from probe_env.envs.task.rules import FAILURES
from probe_env.envs.trials import Candidate
from probe_env.schedule import Schedule

IMPROVED = Design(guide_length=10.0, guide_float_diameter=0.020, carrier_float_diameter=0.016)
MAX_LENGTH = RANGES["guide_length"][1]


def task(helix_length, **fields):
    return Plant(tube={"helix_length": helix_length}, **fields).configured()


@pytest.mark.parametrize(
    ("helix_length", "positions"),
    [
        (40.0, (10.0, 20.0, 30.0)),
        (60.0, (10.0, 20.0, 30.0, 40.0, 50.0)),
        (80.0, (10.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0)),
        (45.0, (8.75, 17.5, 26.25, 35.0)),
        (24.0, (14.0 / 3.0, 28.0 / 3.0, 14.0)),
    ],
)
def test_sections_cover_the_segment(helix_length, positions):
    """Every metre of the segment belongs to its nearest section."""
    segment = trials.segment_of(task(helix_length))
    assert segment.positions == pytest.approx(positions)
    assert segment.end == helix_length - MAX_LENGTH
    assert sum(segment.widths) == pytest.approx(segment.span) == helix_length - MAX_LENGTH - trials.SENSOR_START
    ends = trials.SENSOR_START + np.cumsum(segment.widths)
    for end, near, far in zip(ends, segment.positions, segment.positions[1:], strict=False):
        assert end - near == pytest.approx(far - end)


def test_the_last_section_equals_a_simulator_run():
    """Of the second of two probes, with bore, damping and feed range of a plant."""
    plant = Plant(
        tube={"helix_length": 40.0, "inner_diameter": 22.1e-3}, probe={"damping_time": 8e-5},
        feed={"feed_speeds": [0.03, 0.15]}, air={"air_supply_step": 5.0 / 3600.0},
    )  # fmt: skip
    config, tube = plant.configured(), Context(friction=0.2, helix_diameter=1.4)
    candidates = [Candidate(design, tube, STUDY_FEED, seed) for design, seed in ((Design(), 5), (IMPROVED, 6))]
    trial = trials.try_sections(candidates, config)
    changes = {"probe": IMPROVED.probe(plant.probe), "carrier_length": 30.0, "feed_speed": 0.15}
    scene = tube.apply(plant.scene).model_copy(update=changes | {"air_supply_rate": trials.GENTLE})
    assert scene.probe.damping_time == 8e-5
    start = {"perturbation": trials.PERTURBATION, "air_lag": trials.AIR_LAG}
    alone = SimulatorBatch([scene], Fidelity().method, seeds=[6], **start)
    alone.advance(None, 65.0 / 3600.0, trials.SETTLE)  # 63 in steps of 5
    window = alone.advance(None, None, trials.MEASURE)
    assert trial.radial_rms[1, -1] == window.statistics["radial_rms_m"][0]
    assert trial.root_tension[1, -1] == window.statistics["tension_mean_n"][0]
    _, kpis = trials.score_designs([Design(), IMPROVED], trial, config)
    assert kpis["inspected_m"][1] + kpis["missed_m"][1] == pytest.approx(30.0 - trials.SENSOR_START)


@pytest.mark.parametrize(("helix_length", "full"), [(40.0, True), (80.0, False)])
def test_the_environment_simulates_the_whole_helix_of_a_tube(helix_length, full):
    tube = {"tube": {"helix_length": helix_length, "helix_diameter": [1.0, 2.0]}, "contact": {"friction": 0.12}}
    tube["feed"] = {"feed_speeds": [0.05, 0.1]}
    fidelity = {"time_lapse": 20.0} if full else "standard"
    env = gym.make("probe_env/Design-v1", tube=tube, full=full, fidelity=fidelity)
    _, info = env.reset(seed=1)
    assert info["context"]["friction"] == 0.12
    assert info["context"]["helix_diameter"] in (1.0, 2.0)
    _, _, _, _, info = env.step(DesignEnv.action_of(Design()))
    assert info["kpis"]["inspected_m"] + info["kpis"]["missed_m"] == pytest.approx(helix_length - 5.0, abs=0.01)
    covered = trials.segment_of(env.unwrapped.config).span - info["kpis"]["missed_m"]
    assert covered > 0.0
    assert info["kpis"]["inspection_time_s"] == pytest.approx(covered / 0.1, rel=0.01)  # the nearest to 0.2 m/s


def test_floats_are_cut_to_the_bore():
    narrow = Plant(tube={"inner_diameter": 0.0185}, probe={n: 0.016 for n in RANGES if n.endswith("float_diameter")})
    env = gym.make("probe_env/Design-v1", tube=narrow)
    env.reset(seed=0)
    _, _, _, _, info = env.step(DesignEnv.action_of(IMPROVED))
    assert info["design"]["guide_float_diameter"] == pytest.approx(0.0185 - CLEARANCE)
    assert info["design"]["carrier_float_diameter"] == pytest.approx(0.016)
    assert info["design"]["guide_length"] == pytest.approx(10.0)
    settings = {"probes": "random", "fidelity": "fast", "config": {"settle_time": 0.1}}
    sampled = gym.make("probe_env/Insertion-v1", tube=narrow, **settings)
    floats = [sampled.reset(seed=seed)[1]["probe"]["guide_float_diameter"] for seed in range(4)]
    assert max(floats) == pytest.approx(0.0175)
    assert IMPROVED.cut_to(Plant().scene) is IMPROVED
    assert ranges_in(Plant().scene) == RANGES


def test_tubes_and_measures_that_are_not_comparable_are_refused():
    probe = {name: 0.015 for name in RANGES if name.endswith("float_diameter")}
    for tube, message in (
        ({"helix_length": 23.9}, "helix_length = 23.9 m: designs are compared .* it must be at least 24 m"),
        ({"inner_diameter": 0.0165}, "inner_diameter = 0.0165 m: no guide_float_diameter of the design space"),
    ):
        with pytest.raises(ValueError, match=message):
            DesignEnv(tube={"tube": tube, "probe": probe}).reset()
    with pytest.raises(ValueError, match="vibration_measure = 'velocity': designs are scored by displacement or snr"):
        trials.check_measure(TaskConfig(vibration_measure="velocity"))


class Alternating:
    """Feeds 0.2 m/s with the least and the most air alternately."""

    def __init__(self, config):
        self.targets = [config.action(0.2, rate) for rate in config.air_supply_rates]
        self.number = 0

    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        self.number += 1
        return np.tile(self.targets[self.number % 2], (len(observation), 1)), state


def test_air_of_a_period_is_the_mean_of_both_ends():
    """It approaches the mean of the targets, as the supply lags.

    With five periods per metre, the air at their ends would differ between odd and even metres.
    """
    config = task(40.0, feed={"feed_speeds": [0.05, 0.3]})
    alternating = Candidate(Design(), Context(), Alternating(config))
    trial = trials.try_insertions([alternating], config, Fidelity(time_lapse=20.0))
    assert (np.diff(trial.air_supply_rate[0]) > 0.0).all()
    assert trial.air_supply_rate[0, -1] == pytest.approx(np.mean(config.air_supply_rates), rel=1e-3)


@pytest.mark.parametrize("design", [Design(), IMPROVED])
def test_sections_are_stable_with_max_air(design):
    """At 2e-4 s and 130 m3/h, 24 of 256 probes diverged from a start with the full supply, none from the gentle start.

    Measured once at 20 to 55 m in similar tubes. The full supply at rest is refused, the gentle start is not.
    """
    config = Plant().configured()
    feed = Schedule("inserted_length", "linear", (5.0,), (0.1,), (config.air_supply_rates[1],))
    tubes = [Context(friction=mu, helix_diameter=d) for mu, d in ((0.1, 1.0), (0.2, 1.4), (0.15, 2.4))]
    for tube in tubes:
        trials.check_candidate(design, tube, config, Fidelity(), feed)
        start, air = trials.sections_of(design, tube, feed, config)[-1]
        at_once = start.model_copy(update={"air_supply_rate": air})
        with pytest.raises(ValueError, match="N as it starts from rest"):
            check_simulable(at_once, Fidelity(), start.inserted_length, air)
    trial = trials.try_sections([Candidate(design, tube, feed) for tube in tubes], config)
    assert not trial.failed["diverged"].any()
    assert trial.air_supply_rate == pytest.approx(config.air_supply_rates[1])


SNR = TaskConfig(vibration_measure="snr", vibration_weight=4.0)


@pytest.fixture(scope="module")
def measures():
    candidates = [Candidate(Design(), Context(friction=mu, helix_diameter=1.2), STUDY_FEED) for mu in (0.1, 0.25)]
    return trials.try_sections(candidates, SNR), trials.try_sections(candidates, TaskConfig())


@pytest.mark.processor
def test_snr_of_the_first_metres_is_that_at_rest(measures):
    """7.5 for a 20 % groove at 0.2 m/s in a smooth tube; below 3 where the probe vibrates."""
    noisy, _ = measures
    quiet, loud = 1.0 / SNR.sensor.quiet_snr, 1.0 / SNR.sensor.shaken_snr
    assert (noisy.noise >= quiet * (1.0 - 1e-6)).all()
    assert noisy.noise[0, 0] == pytest.approx(quiet, rel=0.02)  # some um of rms; 0.1 mm gives 2.5 times as much noise
    assert noisy.noise[1].max() > loud
    # 0.1 mm in the band gives S/N 3, and half of the rms is in the band
    assert (noisy.radial_rms[noisy.noise > loud] > 5e-5).all()


def test_the_measure_changes_the_reward_and_nothing_else(measures):
    noisy, plain = measures
    assert plain.noise is None
    for name in ("widths", "feed_speed", "radial_rms", "root_tension"):
        assert (getattr(noisy, name) == getattr(plain, name)).all(), name
    assert all((noisy.failed[name] == plain.failed[name]).all() for name in FAILURES)
    # a metre at the limit, S/N 3, costs its weight; half of the noise costs a quarter
    designs, span = [Design(), Design()], noisy.widths.sum(axis=1)
    for fraction in (1.0, 0.5):
        same = replace(noisy, noise=np.full_like(noisy.noise, fraction / 3.0))
        terms, kpis = trials.score_designs(designs, same, SNR)
        assert terms["vibration"] == pytest.approx(-4.0 * fraction**2 * span, rel=1e-9)
        assert kpis["share_within_limit"] == pytest.approx(1.0, abs=1e-9)
