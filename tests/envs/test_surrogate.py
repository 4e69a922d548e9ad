"""Fidelity "surrogate": rewards of the task, batches equal to single probes, and vibration of the map."""

from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from probe_agents.evaluation.plan import Plan, run_plan
from probe_agents.policies.cases import load_case, read_case
from probe_agents.policies.catalogue import named_policies
from probe_agents.training.config import Training
from probe_agents.vec_env import ProbeVecEnv
from probe_env import Context
from probe_env.envs.episodes import Episodes
from probe_env.envs.episodes.predicted import Noise, Predicted, RandomField, Scatter
from probe_env.envs.task.config import TaskConfig
from probe_env.envs.vibration_map import stored_map
from probe_env.fidelity import PRESETS, Fidelity
from probe_env.physics.closed_forms import entrance_tension, sliding_tension

CONFIG = TaskConfig().full_observation
TUBE = Context(friction=0.18, helix_diameter=1.4)


def started(count, config=CONFIG, noise=None):
    episodes = Episodes(count, config, fidelity="surrogate")
    if noise is not None:
        episodes.backend = Predicted(count, config, stored_map(), noise)
    rngs = {k: np.random.default_rng(k) for k in range(count)}
    episodes.reset(range(count), rngs, {k: {"context": TUBE} for k in range(count)})
    return episodes


def test_spaces_and_infos_are_those_of_a_simulated_insertion():
    env = gym.make("probe_env/Insertion-v1", fidelity="surrogate", contexts="train").unwrapped
    check_env(env)
    assert type(env).metadata["render_modes"]
    simulated = gym.make("probe_env/Insertion-v1", fidelity="standard", contexts="train")
    assert (env.observation_space, env.action_space) == (simulated.observation_space, simulated.action_space)
    for one in (env, simulated):
        one.reset(seed=3)
    infos = [one.step(np.array([0.1, 0.3], dtype=np.float32))[4] for one in (env, simulated)]
    assert set(infos[0]) <= set(infos[1])
    predicted, expected = (info["reward_terms"] for info in infos)
    assert predicted.keys() == expected.keys()
    assert predicted["progress"] == pytest.approx(expected["progress"], abs=6e-4)
    assert predicted["air"] == pytest.approx(expected["air"], rel=1e-6)


def test_a_batch_equals_single_environments_bit_for_bit():
    batch = gym.make_vec("probe_env/Insertion-v1", 8, fidelity="surrogate")
    assert isinstance(batch.unwrapped.episodes.backend, Predicted)
    single = [gym.make("probe_env/Insertion-v1", fidelity="surrogate") for _ in range(8)]
    assert np.array_equal(batch.reset(seed=5)[0], [env.reset(seed=5 + k)[0] for k, env in enumerate(single)])
    for actions in np.random.default_rng(1).uniform(-1.0, 1.0, (150, 8, 2)).astype(np.float32):
        observation, reward, _, _, infos = batch.step(actions)
        steps = [env.step(action) for env, action in zip(single, actions, strict=True)]
        assert np.array_equal(observation, [step[0] for step in steps])
        assert reward.tolist() == [step[1] for step in steps]
        assert infos["radial_rms_m"].tolist() == [step[4]["radial_rms_m"] for step in steps]
    trained = ProbeVecEnv("probe_env/Insertion-v1", 2, fidelity={"method": "surrogate"}, contexts="train")
    trained.reset()
    trained.step(np.zeros((2, 2), dtype=np.float32))
    assert trained.kernel_seconds == 0.0


def test_a_probe_that_is_not_stepped_keeps_its_state():
    many = started(3)
    step = many.step(np.zeros((3, 2)), np.array([True, False, True]))
    assert step.infos[1] == {}
    assert step.reward[1] == 0.0
    assert many.scorer.totals["time"].tolist() == [1.0, 0.0, 1.0]


def test_without_noise_it_is_the_map_and_the_closed_form():
    episodes = started(1, noise=Noise())
    action = CONFIG.actions(np.array([0.2]), np.array([0.02]))
    for _ in range(60):
        step = episodes.step(action)
    info = step.infos[0]
    assert info["feed_speed"] == pytest.approx(0.2)
    tubes = np.array([[TUBE.friction, TUBE.contact_stiffness, TUBE.drag_factor, TUBE.helix_diameter]])
    drive = {name: np.array([info[name]]) for name in ("inserted_length", "feed_speed", "air_supply_rate")}
    mean = stored_map().predict(*drive.values(), tubes, CONFIG.scene)[0][0]
    assert info["radial_rms_m"] == pytest.approx(1e-4 * 10.0**mean)
    diameter = tubes[:, 3]
    pulled = sliding_tension(np.array([TUBE.friction]), drive | {"helix_diameter": diameter}, CONFIG.scene)
    tension = pulled[0] * TUBE.drag_factor - entrance_tension(CONFIG.scene, diameter)[0]
    assert info["tension_mean_n"] == pytest.approx(tension)


def test_target_of_the_air_follows_its_ramp():
    """From the 63 m3/h of the start by 10 m3/h a period up to 100, in a branch too; a reset begins there again."""
    config = TaskConfig(air_ramp=10.0 / 3600.0)
    episodes, action = started(1, config), config.actions(np.array([0.2]), np.array([100.0 / 3600.0]))

    def blown(episodes, periods):
        return [3600.0 * episodes.step(action).infos[0]["target_air_supply_rate"] for _ in range(periods)]

    assert blown(episodes, 2) == pytest.approx([73.0, 83.0])
    branch = episodes.branch([0])
    assert blown(episodes, 3) == blown(branch, 3) == pytest.approx([93.0, 100.0, 100.0])
    episodes.reset([0], {0: np.random.default_rng(0)})
    assert blown(episodes, 1) == pytest.approx([73.0])


def test_feed_follows_its_ramp_and_air_its_lag():
    config = TaskConfig(ramp=0.1, air_lag=2.0)
    episodes = started(1, config, noise=Noise())
    air, length = episodes.backend.air[0], episodes.inserted_length[0]
    action = config.actions(np.array([0.35]), np.array([0.03]))
    episodes.step(action)
    assert episodes.backend.feed[0] == pytest.approx(0.3)
    assert episodes.inserted_length[0] - length == pytest.approx(0.25, abs=5e-4)
    assert episodes.backend.air[0] == pytest.approx(0.03 + (air - 0.03) * np.exp(-0.5))
    length = episodes.inserted_length[0]
    episodes.step(action)
    assert episodes.inserted_length[0] - length == pytest.approx(0.35 - 0.5 * 0.05**2 / 0.1, abs=5e-4)


def test_scatter_has_its_deviation_and_correlation():
    """20,000 steps of 100 series: Bartlett's scatter is 0.1 % of the deviation and 0.0003 of the correlation."""
    rng, scatter, values = np.random.default_rng(0), Scatter(deviation=0.2, correlation=0.9), []
    value = scatter.deviation * rng.normal(size=100)
    for _ in range(20_000):
        value = scatter.next(value, rng.normal(size=100))
        values.append(value)
    series = np.array(values)
    assert series.std() == pytest.approx(0.2, rel=0.005)
    assert np.mean(series[1:] * series[:-1]) / series.var() == pytest.approx(0.9, abs=0.002)


def test_random_field_has_its_deviation_and_correlations():
    """Bounds are 4.5 standard errors of 20,000 random functions."""
    rng, field, count = np.random.default_rng(0), RandomField(deviation=0.2, feed=0.3, air=0.003, length=10.0), 20_000
    waves = np.array([field.waves(rng) for _ in range(count)])

    def values(feed, air, length):
        return field.at(waves, *(np.full(count, value) for value in (feed, air, length)))

    here = values(0.2, 0.02, 30.0)
    assert here.mean() == pytest.approx(0.0, abs=4.5 * 0.2 / np.sqrt(count))
    assert here.std() == pytest.approx(0.2, rel=4.5 / np.sqrt(2 * count))
    for feed, air, length in ((0.2 * np.exp(0.3), 0.02, 30.0), (0.2, 0.023, 30.0), (0.2, 0.02, 20.0)):
        correlation = np.mean(here * values(feed, air, length)) / 0.04
        assert correlation == pytest.approx(np.exp(-0.5), abs=4.5 * np.sqrt((1.0 + np.exp(-1.0)) / count))


def test_kpis_of_a_whole_insertion_are_sums_of_its_steps():
    episodes, total, terms = started(1, noise=Noise()), 0.0, 0.0
    action = CONFIG.actions(np.array([0.4]), np.array([0.02])).astype(np.float32)
    while episodes.running.any():
        step = episodes.step(action)
        total += float(step.reward[0])
        terms += sum(step.infos[0]["reward_terms"].values())
    kpis = step.infos[0]["episode_kpis"]
    assert kpis["reward"] == pytest.approx(total) == pytest.approx(terms)
    assert kpis["inspected_m"] == pytest.approx(55.0)
    assert kpis["complete"] == kpis["inspected_share"] == 1.0
    assert kpis["inspection_time_s"] == pytest.approx(55.0 / 0.4, abs=2.0)
    assert 0.0 < kpis["share_within_limit"] < 1.0
    with pytest.raises(RuntimeError, match="episode 0 has ended"):
        episodes.step(action)


def test_other_environments_rendering_and_planning_are_refused():
    for name, settings, message in (
        ("Snapshot-v1", {}, "Insertion-v1\\), without growing = False"),
        ("Inspection-v0", {}, "surrogate does not simulate withdrawal"),
        ("Design-v1", {}, "fidelity = 'surrogate' is for Insertion-v1 only"),
        ("Insertion-v1", {"render_mode": "rgb_array"}, "simulates no motion to render"),
    ):
        with pytest.raises(ValueError, match=message):
            gym.make(f"probe_env/{name}", fidelity="surrogate", **settings)
    with pytest.raises(ValueError, match=r"time_step: not accepted, method = 'surrogate' does not"):
        Fidelity(method="surrogate", time_step=1e-4)
    case = load_case(None, "test", 1)
    planner = named_policies(("planner",), case.config.full_observation)
    with pytest.raises(ValueError, match="simulates no motion"):
        run_plan(Plan(planner, case.contexts, (0,), case.config.full_observation, PRESETS["surrogate"]), None)


def test_a_plant_uses_the_map_next_to_its_file():
    env = gym.make("probe_env/Insertion-v1", fidelity="surrogate", tube="configs/tubes/snr.toml")
    assert env.unwrapped.episodes.backend.map == read_case(Path("snr"), "test", 1).vibration != stored_map()
    env.reset(seed=0)
    info = env.step(env.action_space.sample())[4]
    # the map is of the noise in a flaw's band; both are roots of the same mean, and differ by rounding alone
    assert info["noise_rms_m"] == pytest.approx(info["radial_rms_m"], rel=1e-14, abs=0.0)


def test_policies_keep_their_order():
    case = load_case(None, "test", 6)
    config = case.config.full_observation
    policies = named_policies(("constant", "best-schedule", "privileged"), config)
    table = run_plan(Plan(policies, case.contexts, (0,), config, PRESETS["surrogate"]), None)
    means = table.groupby("policy")["reward"].mean()
    assert means["constant"] < means["best-schedule"] - 50.0
    assert means["best-schedule"] < means["privileged"]


def test_agents_train_in_it_and_are_validated_by_simulation():
    assert Training.model_validate({"environment": {"fidelity": "surrogate"}}).environment.fidelity == "surrogate"
    with pytest.raises(ValueError, match="agents must be validated by simulation"):
        Training.model_validate({"validation": {"fidelity": "surrogate"}})
