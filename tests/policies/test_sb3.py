"""One's own models beside ours: as a policy, and as a bundle that every command takes."""

import gymnasium as gym
import numpy as np
import pytest
import torch
from gymnasium.wrappers import NormalizeObservation, RescaleAction, RescaleObservation
from sb3_contrib import TQC, RecurrentPPO
from stable_baselines3 import A2C, PPO, SAC, TD3
from stable_baselines3.common.vec_env import VecNormalize

from probe_agents.policies.bundle import ACTIVATIONS, from_sb3, load_bundle, save_bundle
from probe_agents.vec_env import ProbeVecEnv
from probe_env import Scene, TaskConfig

CONFIG = TaskConfig(growing=False, period=0.05, time_limit=1.0, settle_time=0.05)
KINDS = {
    "ppo": (PPO, "MlpPolicy"),
    "sac": (SAC, "MlpPolicy"),
    "recurrent-ppo": (RecurrentPPO, "MlpLstmPolicy"),
    "td3": (TD3, "MlpPolicy"),
    "tqc": (TQC, "MlpPolicy"),
}


@pytest.fixture(scope="module")
def env():
    return ProbeVecEnv("probe_env/Snapshot-v1", 1, CONFIG, scene=Scene(carrier_length=2.0))


def rows(config, count=6):
    rng = np.random.default_rng(0)
    low, high = np.array([bounds[:2] for bounds in config.observations.values()]).T
    return rng.uniform(np.maximum(low, -2.0), np.minimum(high, 2.0), (count, len(low))).astype(np.float32)


def own(config):
    """``rows`` of the full observation, without what the task does not show."""
    names = list(config.full_observation.observations)
    return rows(config.full_observation)[:, [names.index(one) for one in config.observations]]


@pytest.mark.parametrize("kind", KINDS)
def test_a_policy_and_a_bundle_act_as_the_model(kind, env, tmp_path):
    algorithm, name = KINDS[kind]
    model = algorithm(name, env, policy_kwargs={"net_arch": [16, 8]}, seed=1, device="cpu")
    everything = CONFIG.full_observation
    shown = rows(everything)
    expected, _ = model.predict(own(CONFIG), episode_start=np.ones(len(shown), dtype=bool), deterministic=True)
    policy = from_sb3(model, CONFIG)
    assert np.allclose(policy.predict(shown, deterministic=True)[0], expected, atol=1e-6)
    assert policy.describe()["algorithm"] == kind
    path = tmp_path / "own.safetensors"
    digest = save_bundle(path, model, CONFIG)
    agent = load_bundle(path, everything)
    assert agent.hash == digest
    assert np.array_equal(agent.predict(shown, deterministic=True)[0], policy.predict(shown, deterministic=True)[0])


def test_what_would_act_otherwise_is_refused(env, tmp_path):
    model = PPO("MlpPolicy", env, device="cpu")
    with pytest.raises(
        ValueError, match=r"observation_space of the model has shape \(11,\); that of the task is \(14,\)"
    ):
        from_sb3(model, CONFIG.model_copy(update={"privileged": True}))
    with pytest.raises(ValueError, match="model is a A2C; PPO, SAC, RecurrentPPO, TD3, TQC are accepted"):
        from_sb3(A2C("MlpPolicy", env, device="cpu"), CONFIG)
    for kwargs, message in (
        ({"activation_fn": torch.nn.Softplus}, r"activation_fn = Softplus \(only ReLU, Tanh, ELU"),
        ({"net_arch": {"pi": [4], "vf": [8]}}, "net_arch with different networks"),
    ):
        other = PPO("MlpPolicy", env, policy_kwargs=kwargs, device="cpu")
        with pytest.raises(ValueError, match=f"policy_kwargs: a bundle cannot store {message}"):
            save_bundle(tmp_path / "other.safetensors", other, CONFIG)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("wrapper", "message"),
    [
        (lambda env: RescaleAction(env, np.float32(0.0), np.float32(1.0)), r"action_space.low\[0\] of the model is 0;"
         " that of the task is -1: train without wrappers that rescale actions"),
        (NormalizeObservation, r"observation_space.low\[0\] of the model is -inf; that of the task is 0"),
        (lambda env: RescaleObservation(env, np.float32(-2.0), np.float32(2.0)), r"observation_space.low\[0\] of the"
         " model is -2"),
    ],
)  # fmt: skip
@pytest.mark.filterwarnings("ignore:.*Box .* precision lowered by casting")
def test_wrappers_that_rescale_are_refused(wrapper, message):
    env = gym.make("probe_env/Snapshot-v1", config=CONFIG, scene=Scene(carrier_length=2.0))
    with pytest.raises(ValueError, match=message):
        from_sb3(PPO("MlpPolicy", wrapper(env), device="cpu"), CONFIG)


def test_a_bundle_acts_as_the_model_behind_vec_normalize(env, tmp_path):
    """Its statistics are those of a short training; some observations are clipped."""
    behind = VecNormalize(env, clip_obs=1.5, epsilon=1e-4)
    model = PPO("MlpPolicy", behind, n_steps=8, batch_size=8, n_epochs=1, seed=1, device="cpu").learn(16)
    shown = rows(CONFIG)
    normalised = behind.normalize_obs(shown)
    assert (np.abs(normalised) == 1.5).any()
    expected, _ = model.predict(normalised, deterministic=True)
    save_bundle(tmp_path / "own.safetensors", model, CONFIG)
    agent = load_bundle(tmp_path / "own.safetensors", CONFIG)
    assert np.allclose(agent.predict(shown, deterministic=True)[0], expected, atol=1e-6)
    assert not np.allclose(model.predict(shown, deterministic=True)[0], expected, atol=1e-3)  # they matter
    model.save(tmp_path / "model")
    behind.save(tmp_path / "statistics")
    with pytest.raises(ValueError, match=r"load it with env=VecNormalize.load\(statistics, env\)"):
        from_sb3(PPO.load(tmp_path / "model", device="cpu"), CONFIG)
    loaded = PPO.load(tmp_path / "model", VecNormalize.load(tmp_path / "statistics", env), device="cpu")
    action, _ = from_sb3(loaded, CONFIG).predict(rows(CONFIG.full_observation), deterministic=True)
    assert np.allclose(action, model.predict(behind.normalize_obs(own(CONFIG)), deterministic=True)[0], atol=1e-6)
    rewards = PPO("MlpPolicy", VecNormalize(env, norm_obs=False), device="cpu", seed=1)
    assert from_sb3(rewards, CONFIG).description.normalisation is None


@pytest.mark.parametrize("name", ACTIVATIONS)
def test_activations_survive_a_bundle(name, env, tmp_path):
    model = PPO("MlpPolicy", env, policy_kwargs={"activation_fn": ACTIVATIONS[name]}, seed=1, device="cpu")
    with torch.no_grad():
        for weights in model.policy.parameters():
            weights.mul_(3.0)  # beyond the linear range
    save_bundle(tmp_path / "own.safetensors", model, CONFIG)
    agent = load_bundle(tmp_path / "own.safetensors", CONFIG)
    shown = rows(CONFIG)
    expected, _ = model.predict(shown, deterministic=True)
    assert np.allclose(agent.predict(shown, deterministic=True)[0], expected, atol=1e-6)
    other = PPO("MlpPolicy", env, policy_kwargs={"activation_fn": torch.nn.Softplus}, seed=1, device="cpu").policy
    other.load_state_dict(model.policy.state_dict())
    assert not np.allclose(other.predict(shown, deterministic=True)[0], expected, atol=1e-3)


def test_a_model_with_state_dependent_exploration_survives_a_bundle(env, tmp_path):
    model = PPO("MlpPolicy", env, use_sde=True, seed=1, device="cpu")
    save_bundle(tmp_path / "own.safetensors", model, CONFIG)
    expected, _ = model.predict(rows(CONFIG), deterministic=True)
    agent = load_bundle(tmp_path / "own.safetensors", CONFIG)
    assert np.allclose(agent.predict(rows(CONFIG), deterministic=True)[0], expected, atol=1e-6)
