"""One's own models beside ours: as a policy, and as a bundle that every command takes."""

import numpy as np
import pytest
from sb3_contrib import RecurrentPPO
from stable_baselines3 import A2C, PPO, SAC
from stable_baselines3.common.vec_env import VecNormalize

from agents.policies.bundle import from_sb3, load_bundle, save_bundle
from agents.vec_env import ProbeVecEnv
from probe_env import Scene, TaskConfig

CONFIG = TaskConfig(growing=False, period=0.05, time_limit=1.0, settle_time=0.05)
KINDS = {"ppo": (PPO, "MlpPolicy"), "sac": (SAC, "MlpPolicy"), "recurrent-ppo": (RecurrentPPO, "MlpLstmPolicy")}


@pytest.fixture(scope="module")
def env():
    return ProbeVecEnv("probe_env/Snapshot-v1", 1, CONFIG, scene=Scene(carrier_length=2.0))


def rows(config, count=6):
    rng = np.random.default_rng(0)
    low, high = np.array([bounds[:2] for bounds in config.observations.values()]).T
    return rng.uniform(np.maximum(low, -2.0), np.minimum(high, 2.0), (count, len(low))).astype(np.float32)


@pytest.mark.parametrize("kind", KINDS)
def test_a_policy_and_a_bundle_act_as_the_model(kind, env, tmp_path):
    algorithm, name = KINDS[kind]
    model = algorithm(name, env, policy_kwargs={"net_arch": [16, 8]}, seed=1, device="cpu")
    everything = CONFIG.full_observation
    shown = rows(everything)
    names = list(everything.observations)
    own = shown[:, [names.index(one) for one in CONFIG.observations]]
    expected, _ = model.predict(own, episode_start=np.ones(len(own), dtype=bool), deterministic=True)
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
    with pytest.raises(ValueError, match="model is a A2C; PPO, SAC, RecurrentPPO are accepted"):
        from_sb3(A2C("MlpPolicy", env, device="cpu"), CONFIG)
    with pytest.raises(ValueError, match="VecNormalize"):
        from_sb3(PPO("MlpPolicy", VecNormalize(env), device="cpu"), CONFIG)
    import torch

    other = PPO("MlpPolicy", env, policy_kwargs={"activation_fn": torch.nn.ReLU}, device="cpu")
    with pytest.raises(ValueError, match="policy_kwargs: a bundle does not describe activation_fn"):
        save_bundle(tmp_path / "other.safetensors", other, CONFIG)
    assert not list(tmp_path.iterdir())
