"""TorchRL, skrl, Minari and tianshou with the environments, in a Python environment of their own."""

import re
from pathlib import Path

import gymnasium as gym
import minari
import numpy as np
import pytest
import torch
from skrl.envs.wrappers.torch import wrap_env
from tianshou.algorithm import PPO
from tianshou.algorithm.modelfree.reinforce import ProbabilisticActorPolicy
from tianshou.algorithm.optim import AdamOptimizerFactory
from tianshou.data import Collector, VectorReplayBuffer
from tianshou.env import DummyVectorEnv
from tianshou.trainer import OnPolicyTrainerParams
from tianshou.utils.net.common import Net
from tianshou.utils.net.continuous import ContinuousActorProbabilistic, ContinuousCritic
from torch.distributions import Independent, Normal
from torchrl.envs import GymEnv, check_env_specs

import probe_env

PAGE = Path(__file__).parents[2] / "docs" / "policies.md"
SETTINGS = {"fidelity": "fast", "contexts": [probe_env.Context(friction=0.2)], "config": {"time_limit": 5}}


def rewards_of(seed, actions, resets=0):
    """Rewards of a single environment after more resets."""
    env = gym.make("probe_env/Insertion-v1", **SETTINGS)
    env.reset(seed=seed)
    for _ in range(resets):
        env.reset()
    return [env.step(action)[1] for action in actions]


def test_torchrl_rolls_out_an_episode():
    env = GymEnv("probe_env/Insertion-v1", **SETTINGS)
    check_env_specs(env)
    env.set_seed(3, static_seed=True)
    rollout = env.rollout(10)
    assert rollout["next", "truncated"].squeeze(-1).tolist() == [False] * 4 + [True]
    rewards = rewards_of(3, rollout["action"].numpy(), resets=1)  # set_seed resets, too
    assert rollout["next", "reward"].squeeze(-1).tolist() == pytest.approx(rewards, rel=1e-6)


def test_skrl_steps_the_native_batch():
    env = wrap_env(gym.make_vec("probe_env/Insertion-v1", 2, **SETTINGS))
    assert env.num_envs == 2
    env.reset()
    env.unwrapped.reset(seed=3)  # skrl gives no seed
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (5, 2, 2)).astype(np.float32)
    steps = [env.step(torch.from_numpy(action)) for action in actions]
    for k in range(2):
        rewards = [float(reward[k]) for _, reward, *_ in steps]
        assert rewards == pytest.approx(rewards_of(3 + k, actions[:, k]), rel=1e-6)
    assert [bool(truncated.all()) for *_, truncated, _ in steps] == [False] * 4 + [True]


def test_minari_stores_the_infos_and_the_environment(tmp_path, monkeypatch):
    (block,) = (one for one in re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL) if "minari" in one)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    names = {"__name__": "example"}
    exec(compile(block, "docs/policies.md", "exec"), names)
    dataset = minari.load_dataset("probe/random-v0")
    (episode,) = dataset
    assert episode.infos["time"].tolist() == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    assert episode.truncations.tolist() == [False] * 4 + [True]
    env = dataset.recover_environment()
    assert env.unwrapped.config == names["env"].unwrapped.config
    env.reset(seed=0)
    assert [env.step(action)[1] for action in episode.actions] == pytest.approx(episode.rewards.tolist())


def test_tianshou_trains():
    envs = DummyVectorEnv([lambda: gym.make("probe_env/Insertion-v1", **SETTINGS | {"fidelity": "surrogate"})] * 2)
    space, actions = envs.observation_space[0], envs.action_space[0]
    body, critic = (Net(state_shape=space.shape, hidden_sizes=(8,)) for _ in range(2))
    actor = ContinuousActorProbabilistic(preprocess_net=body, action_shape=actions.shape, unbounded=True)
    policy = ProbabilisticActorPolicy(
        actor=actor, dist_fn=lambda means: Independent(Normal(*means), 1), action_space=actions
    )
    optim = AdamOptimizerFactory(lr=1e-3)
    algorithm = PPO(policy=policy, critic=ContinuousCritic(preprocess_net=critic), optim=optim)
    before = [parameter.clone() for parameter in actor.parameters()]
    steps = {"max_epochs": 1, "epoch_num_steps": 40, "collection_step_num_env_steps": 20}
    collector = Collector(algorithm, envs, VectorReplayBuffer(40, len(envs)))
    result = algorithm.run_training(OnPolicyTrainerParams(training_collector=collector, test_collector=None, **steps))
    assert (result.train_step, result.train_episode) == (40, 8)  # episodes of five steps
    assert any((old != new).any() for old, new in zip(before, actor.parameters(), strict=True))
