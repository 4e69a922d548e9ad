"""Models of Stable-Baselines3 as policies and as bundles."""

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.wrappers import NormalizeObservation, RescaleAction, RescaleObservation
from sb3_contrib import TQC, RecurrentPPO
from stable_baselines3 import A2C, PPO, SAC, TD3
from stable_baselines3.common.vec_env import VecNormalize

from probe_agents.evaluation.plan import Plan, run_plan
from probe_agents.policies.bundle import ACTIVATIONS, from_sb3, load_bundle, save_bundle
from probe_agents.vec_env import ProbeVecEnv
from probe_env import Context, Scene, TaskConfig

CONFIG = TaskConfig(growing=False, period=0.05, time_limit=0.5, settle_time=0.05, scene=Scene(carrier_length=2.0))
ROLLOUT = {"n_steps": 8, "batch_size": 8, "n_epochs": 1}
REPLAY = {"learning_starts": 4, "buffer_size": 64, "batch_size": 4}
ALGORITHMS = {
    "ppo": (PPO, "MlpPolicy", ROLLOUT),
    "recurrent-ppo": (RecurrentPPO, "MlpLstmPolicy", ROLLOUT),
    "sac": (SAC, "MlpPolicy", REPLAY),
    "td3": (TD3, "MlpPolicy", REPLAY),
    "tqc": (TQC, "MlpPolicy", REPLAY),
}


@pytest.fixture(scope="module")
def env():
    return ProbeVecEnv("probe_env/Snapshot-v1", 1, CONFIG)


def observations():
    """Observations (6, d) of the full task, and those of ``CONFIG`` among them."""
    everything = CONFIG.full_observation.observations
    low, high = np.clip([bounds[:2] for bounds in everything.values()], -2.0, 2.0).T
    rows = np.random.default_rng(0).uniform(low, high, (6, len(low))).astype(np.float32)
    return rows, rows[:, [list(everything).index(name) for name in CONFIG.observations]]


@pytest.mark.parametrize("normalised", [False, True], ids=["", "normalised"])
@pytest.mark.parametrize("kind", ALGORITHMS)
def test_trained_model_as_policy_and_bundle(kind, normalised, env, tmp_path):
    """After a few steps and after loading; with ``VecNormalize`` its statistics are needed and some inputs clipped."""
    algorithm, name, settings = ALGORITHMS[kind]
    sizes = {"net_arch": [16, 8]} | ({"lstm_hidden_size": 8} if kind == "recurrent-ppo" else {})
    train = VecNormalize(env, clip_obs=1.5, epsilon=1e-4) if normalised else env
    model = algorithm(name, train, policy_kwargs=sizes, seed=1, device="cpu", **settings).learn(24)
    rows, visible = observations()
    inputs = train.normalize_obs(visible) if normalised else visible
    expected, _ = model.predict(inputs, episode_start=np.ones(len(rows), dtype=bool), deterministic=True)
    assert not normalised or (np.abs(inputs) == 1.5).any()
    model.save(tmp_path / "model")
    if normalised:
        train.save(tmp_path / "statistics")
        with pytest.raises(ValueError, match=r"load it with env=VecNormalize.load\(statistics, env\)"):
            from_sb3(algorithm.load(tmp_path / "model", device="cpu"), CONFIG)
    stored = VecNormalize.load(tmp_path / "statistics", env) if normalised else None
    digest = save_bundle(tmp_path / "own.safetensors", model, CONFIG)
    policies = {
        "model": from_sb3(model, CONFIG),
        "loaded": from_sb3(algorithm.load(tmp_path / "model", stored, device="cpu"), CONFIG),
        "bundle": load_bundle(tmp_path / "own.safetensors", CONFIG.full_observation),
    }
    assert policies["bundle"].hash == digest
    for policy in policies.values():
        assert np.allclose(policy.predict(rows, deterministic=True)[0], expected, atol=1e-6)
        assert policy.describe()["algorithm"] == kind
    table = run_plan(Plan(policies, [Context()], (0,), CONFIG.full_observation), None, progress=False)
    assert table["reward"].nunique() == 1
    assert len(table) == 3


def test_statistics_of_normalised_rewards_are_not_needed(env, tmp_path):
    rewards = PPO("MlpPolicy", VecNormalize(env, norm_obs=False), device="cpu", seed=1, **ROLLOUT).learn(8)
    rewards.save(tmp_path / "model")
    for model in (rewards, PPO.load(tmp_path / "model", device="cpu")):
        assert from_sb3(model, CONFIG).description.normalisation is None


def test_models_that_would_act_differently_are_refused(env, tmp_path):
    with pytest.raises(ValueError, match=r"observation_space .* has shape \(11,\); that of the task is \(14,\)"):
        from_sb3(PPO("MlpPolicy", env, device="cpu"), CONFIG.model_copy(update={"privileged": True}))
    with pytest.raises(ValueError, match="model is a A2C; PPO, SAC, RecurrentPPO, TD3, TQC are accepted"):
        from_sb3(A2C("MlpPolicy", env, device="cpu"), CONFIG)
    for settings, message in (
        ({"policy_kwargs": {"activation_fn": torch.nn.Softplus}}, r"activation_fn = Softplus \(only ReLU, Tanh, ELU"),
        ({"policy_kwargs": {"net_arch": {"pi": [4], "vf": [8]}}}, "net_arch with different networks"),
        ({"use_sde": True}, "use_sde"),
    ):
        other = PPO("MlpPolicy", env, device="cpu", **settings)
        with pytest.raises(ValueError, match=f"policy_kwargs: a bundle cannot store {message}"):
            save_bundle(tmp_path / "other.safetensors", other, CONFIG)
    assert not list(tmp_path.iterdir())


@pytest.mark.filterwarnings("ignore:.*Box .* precision lowered by casting")
def test_wrappers_that_rescale_are_refused():
    env = gym.make("probe_env/Snapshot-v1", config=CONFIG)
    action = r"action_space.low\[0\] of the model is 0; that of the task is -1: train without wrappers that rescale"
    for wrapped, message in (
        (RescaleAction(env, *np.float32([0.0, 1.0])), action),
        (NormalizeObservation(env), r"observation_space.low\[0\] of the model is -inf; that of the task is 0"),
        (RescaleObservation(env, *np.float32([-2.0, 2.0])), r"observation_space.low\[0\] of the model is -2"),
    ):
        with pytest.raises(ValueError, match=message):
            from_sb3(PPO("MlpPolicy", wrapped, device="cpu"), CONFIG)


@pytest.mark.parametrize("name", ACTIVATIONS)
def test_activations_survive_a_bundle(name, env, tmp_path):
    model = PPO("MlpPolicy", env, policy_kwargs={"activation_fn": ACTIVATIONS[name]}, seed=1, device="cpu")
    with torch.no_grad():
        for weights in model.policy.parameters():
            weights.mul_(3.0)  # beyond the linear range
    save_bundle(tmp_path / "own.safetensors", model, CONFIG)
    _, visible = observations()
    expected, _ = model.predict(visible, deterministic=True)
    agent = load_bundle(tmp_path / "own.safetensors", CONFIG)
    assert np.allclose(agent.predict(visible, deterministic=True)[0], expected, atol=1e-6)
    other = PPO("MlpPolicy", env, policy_kwargs={"activation_fn": torch.nn.Softplus}, seed=1, device="cpu").policy
    other.load_state_dict(model.policy.state_dict())
    assert not np.allclose(other.predict(visible, deterministic=True)[0], expected, atol=1e-3)
