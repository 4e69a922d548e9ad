"""Bundles: an agent survives its file bit for bit, and no file can do anything but be refused."""

import json
import pickle
import zipfile

import numpy as np
import pytest
import torch
from poisons import Poison
from safetensors.numpy import save
from stable_baselines3 import PPO

from probe_agents.policies.bundle import Agent, Description, StoredNetwork, build_policy, load_bundle, write_bundle
from probe_agents.policies.catalogue import make_policy
from probe_agents.policies.trained import read_weights
from probe_agents.policies.view import View
from probe_agents.vec_env import ProbeVecEnv
from probe_env.envs.task.config import TaskConfig
from probe_env.envs.task.scales import OBSERVATIONS

TASK = TaskConfig()
ACTIONS = np.random.default_rng(0).uniform(-1.0, 1.0, (50, 2))


def described(algorithm="ppo", task=TASK):
    seen = View(observations=tuple(task.observations))
    network = StoredNetwork(net_arch=(8,), lstm_hidden_size=4)
    return Description(algorithm=algorithm, network=network, view=seen, task=task, trained={"seed": 0})


def saved(folder, algorithm="ppo", task=TASK):
    torch.manual_seed(1)
    description, path = described(algorithm, task), folder / "agent.safetensors"
    policy = build_policy(description)
    write_bundle(path, description, policy)
    return Agent(description, policy, task), path


def observations(seed=0, config=TASK):
    return np.random.default_rng(seed).normal(size=(3, len(config.observations))).astype(np.float32)


@pytest.mark.parametrize("algorithm", ["ppo", "sac", "recurrent-ppo"])
def test_an_agent_survives_its_file(algorithm, tmp_path):
    agent, path = saved(tmp_path, algorithm)
    loaded, states = load_bundle(path), [None, None]
    for step in range(4):
        rows, start = observations(seed=step), np.array([step == 0, False, step == 2])
        actions = []
        for k, policy in enumerate((agent, loaded)):
            action, states[k] = policy.predict(rows, states[k], start, deterministic=True)
            actions.append(action)
        assert (actions[0] == actions[1]).all()
        assert (np.abs(actions[0]) <= 1.0).all()
    assert make_policy(str(path), TASK).describe() == loaded.describe()
    assert loaded.describe()["bundle"]


def test_agent_state_resets_with_a_new_episode(tmp_path):
    agent, path = saved(tmp_path)
    _, state = agent.predict(observations(seed=1), deterministic=True)
    remembering, _ = agent.predict(observations(seed=2), state, np.array([False, True, False]), deterministic=True)
    fresh, _ = agent.predict(observations(seed=2), deterministic=True)
    assert (remembering[1] == fresh[1]).all()
    assert (remembering[0] != fresh[0]).any()
    alone, _ = agent.predict(observations(seed=2)[0], deterministic=True)
    assert alone == pytest.approx(fresh[0], abs=1e-6)
    blind, wide = TaskConfig(observe_root_tension=False), TaskConfig(privileged=True)
    agent, rows = saved(tmp_path, task=blind)[0], observations(config=wide)
    chosen = rows[:, [list(wide.observations).index(name) for name in blind.observations]]
    shown, _ = load_bundle(path, wide).predict(rows, deterministic=True)
    assert (shown == agent.predict(chosen, deterministic=True)[0]).all()


def test_another_task_is_refused(tmp_path):
    _, path = saved(tmp_path)
    for config, message in (
        ({"observe_root_tension": False}, "observations = root_tension are not observed"),
        ({"period": 2.0}, "period = 2.0 differs from 1.0"),
        ({"growing": False, "period": 0.1}, "growing = False"),
    ):
        with pytest.raises(ValueError, match=f"agent.safetensors: {message}"):
            load_bundle(path, TaskConfig(**config))
    with pytest.raises(ValueError, match="observations = moon are not observed"):
        View(observations=("moon",)).columns(TASK)
    with pytest.raises(FileNotFoundError):
        load_bundle(tmp_path / "nowhere.safetensors")


def test_pickles_are_refused_and_not_executed(tmp_path):
    """A bare pickle, and SB3's own zip file with one in it."""
    victim, bare, archive = tmp_path / "victim", tmp_path / "bare.safetensors", tmp_path / "sb3.safetensors"
    bare.write_bytes(pickle.dumps(Poison(victim)))
    env = ProbeVecEnv("probe_env/Snapshot-v1", 1)
    PPO("MlpPolicy", env, n_steps=2, batch_size=2, policy_kwargs={"net_arch": [4]}, device="cpu").save(tmp_path / "sb3")
    with zipfile.ZipFile(tmp_path / "sb3.zip") as old, zipfile.ZipFile(archive, "w") as new:
        for name in old.namelist():
            new.writestr(name, pickle.dumps(Poison(victim)) if name == "data" else old.read(name))
    for path in (bare, archive):
        with pytest.raises(ValueError, match="not an agent's bundle"):
            load_bundle(path)
    with pytest.raises(ValueError, match="unknown policy"):
        make_policy(str(tmp_path / "sb3.zip"), TASK)
    assert not victim.exists()
    pickle.loads(bare.read_bytes()).close()
    assert victim.exists()  # so the poison would have worked


def test_statistics_of_another_size_are_refused():
    statistics = {"mean": (0.0,), "var": (1.0,), "clip_obs": 10.0, "epsilon": 1e-8}
    fields = described().model_dump() | {"normalisation": statistics}
    with pytest.raises(ValueError, match="normalisation: mean and var must have 33 values each"):
        Description.model_validate(fields)


def test_a_changed_file_is_named(tmp_path):
    agent, path = saved(tmp_path)
    _, digest, weights = read_weights(path)
    text = json.dumps(json.loads(agent.description.model_dump_json()) | {"trained": {"seed": 1}})
    path.write_bytes(save(weights, {"description": text, "hash": digest}))
    with pytest.raises(ValueError, match=r"agent.safetensors: changed or cut off"):
        load_bundle(path)


def test_view_averages_and_logarithmic_feed():
    """After n periods of a step from 0 to 1 an average is 1 - exp(-n T / tau); equal actions are equal ratios."""
    view = View(observations=("rf_noise", "root_tension"), averages=(5.0, 20.0))
    rows = np.zeros((1, len(OBSERVATIONS)), dtype=np.float32)
    _, averages = view.features(TASK, rows, None, np.ones(1, dtype=bool))
    for _ in range(7):
        features, averages = view.features(TASK, rows + 1.0, averages, np.zeros(1, dtype=bool))
    expected = [1.0, 1.0, *[1.0 - np.exp(-7.0 / 5.0)] * 2, *[1.0 - np.exp(-7.0 / 20.0)] * 2]
    assert features[0] == pytest.approx(expected, rel=1e-5)
    feeds = TASK.targets(view.env_actions(TASK, np.array([[-1.0, 0.0], [0.0, 0.0], [1.0, 0.3]])))
    assert feeds[:, 0] == pytest.approx([0.02, np.sqrt(0.02 * 0.4), 0.4], rel=1e-5)
    assert view.agent_actions(TASK, view.env_actions(TASK, ACTIONS)) == pytest.approx(ACTIONS, abs=1e-4)


def test_agent_keeps_its_min_air():
    """Its air action spans from there to the task's most; a teacher's lower air becomes the least."""
    minimum = 45.0 / 3600.0
    view = View(least_air_supply_rate=minimum)
    maximum = TASK.air_supply_rates[1]
    blown = TASK.targets(view.env_actions(TASK, np.array([[0.0, -1.0], [0.0, 0.0], [0.0, 1.0]])))[:, 1]
    assert blown == pytest.approx([minimum, 0.5 * (minimum + maximum), maximum], rel=1e-6)
    assert view.agent_actions(TASK, view.env_actions(TASK, ACTIONS)) == pytest.approx(ACTIONS, abs=1e-4)
    assert view.agent_actions(TASK, np.array([[0.0, -1.0]]))[0, 1] == -1.0
    with pytest.raises(ValueError, match=r"least_air_supply_rate = 0.1 m3/s must be below"):
        View(least_air_supply_rate=0.1).columns(TASK)
