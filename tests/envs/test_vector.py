"""The native batches conform to their single environments, and the checks find broken ones."""

import json
from functools import partial

import gymnasium as gym
import numpy as np
import pytest
from conformance import check_vector_env
from gymnasium.vector import AutoresetMode
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor

import probe_env
from probe_agents.vec_env import ProbeVecEnv

CASES = {
    "probe_env/Insertion-v1": {"config": {"period": 0.1, "time_limit": 0.5, "settle_time": 0.1}},
    "probe_env/IncrementalInsertion-v1": {"config": {"time_limit": 10.0}, "fidelity": "surrogate"},
    "probe_env/Snapshot-v1": {"config": {"time_limit": 0.5}, "scene": probe_env.Scene(carrier_length=8.0)},
    "probe_env/Inspection-v0": {
        "config": {"period": 0.1, "time_limit": 0.5, "settle_time": 0.1},
        "scene": {"tube": {"helix_length": 5.1}},  # it turns within the five steps
        "fidelity": "fast",
    },
}


@pytest.mark.parametrize("env_id", CASES)
@pytest.mark.parametrize("limit", [{}, {"max_episode_steps": 3}], ids=["", "three steps"])  # the task's: five
@pytest.mark.parametrize(
    ("make", "mode"), [*((gym.make_vec, {"autoreset_mode": mode}) for mode in AutoresetMode), (ProbeVecEnv, {})]
)
def test_batches_conform(env_id, make, mode, limit):
    settings = CASES[env_id] | limit
    check_vector_env(lambda n: make(env_id, n, **settings, **mode), lambda: gym.make(env_id, **settings))


class Broken(ProbeVecEnv):
    """A batch with a fault."""

    def __init__(self, fault, *arguments, **settings):
        super().__init__(*arguments, **settings)
        self.fault, self.buffer = fault, None

    def step_wait(self):
        observation, reward, done, infos = super().step_wait()
        if self.fault == "modified later":  # one buffer for all observations
            self.buffer = observation if self.buffer is None else self.buffer
            self.buffer[:] = observation
            observation = self.buffer
        if self.fault == "terminated of step":
            for info in infos:
                info["TimeLimit.truncated"] = False
        if self.fault == "final observation of":
            for k in np.flatnonzero(done):
                infos[k]["terminal_observation"] = observation[k]
        return observation, reward + 1e-3 * (self.fault == "reward of step" and self.num_envs > 1), done, infos

    def seed(self, seed=None):
        seeds = super().seed(seed)
        if self.fault == "first observation":  # one generator's seed for all
            self._seeds = [seed] * self.num_envs
        return seeds


def test_broken_batches_are_found():
    env_id, settings = "probe_env/Snapshot-v1", CASES["probe_env/Snapshot-v1"]
    for fault in "modified later", "terminated of step", "final observation of", "first observation", "reward of step":
        with pytest.raises(AssertionError, match=fault):
            check_vector_env(partial(Broken, fault, env_id, **settings), lambda: gym.make(env_id, **settings))


def test_truncation_reaches_ppo_s_bootstrap():
    """Rewards of a rollout contain PPO's value of the last observation of a truncated episode."""
    rewards = []
    for fault in ("", "terminated of step"):
        env = Broken(fault, "probe_env/Snapshot-v1", 2, **CASES["probe_env/Snapshot-v1"])
        model = PPO("MlpPolicy", env, n_steps=8, batch_size=8, n_epochs=1, seed=0, gamma=0.99)
        model.learn(16)
        rewards.append(model.rollout_buffer.rewards.copy())
    cut = np.abs(rewards[0] - rewards[1]) > 1e-6
    assert cut[4].all()  # the fifth step ends every episode
    assert not cut[:4].any()


def test_make_vec_options_and_refusals():
    for make, settings, message in (
        (gym.make_vec, {"max_episode_steps": 0}, "max_episode_steps = 0 is outside the accepted range 1 and more"),
        (gym.make_vec, {"render_mode": "rgb_array"}, "render_mode = 'rgb_array'"),
        (ProbeVecEnv, {"num_envs": 0}, "num_envs = 0"),
        (ProbeVecEnv, {"max_episode_steps": 0}, "max_episode_steps = 0"),
    ):
        with pytest.raises(ValueError, match=message):
            make("probe_env/Snapshot-v1", **settings)
    for what, make in (("gym.make", gym.make), ("gym.make_vec", gym.make_vec), ("gym.make_vec", ProbeVecEnv)):
        message = rf"{what}\(\) got an unexpected keyword argument 'fidelty'; accepted are .*; the closest: fidelity"
        with pytest.raises(TypeError, match=message):
            make("probe_env/Snapshot-v1", fidelty="fast")
    env = gym.make_vec("probe_env/Snapshot-v1", num_envs=2, **CASES["probe_env/Snapshot-v1"])
    with pytest.raises(ValueError, match="seed has 3 entries for 2"):
        env.reset(seed=[1, 2, 3])
    _, info = env.reset(seed=1, options={"friction": 0.2})
    assert info["context"]["friction"].tolist() == [0.2, 0.2]
    assert env.spec.id == "probe_env/Snapshot-v1"
    for env_id, settings in CASES.items():  # libraries recognise a batch by its direct bases
        assert gym.vector.VectorEnv in type(gym.make_vec(env_id, 1, **settings)).__bases__


def test_seeds_of_a_batch_are_those_of_its_environments():
    batch = gym.make_vec("probe_env/Snapshot-v1", 2, **CASES["probe_env/Snapshot-v1"])
    sync = gym.make_vec("probe_env/Snapshot-v1", 2, vectorization_mode="sync", **CASES["probe_env/Snapshot-v1"])
    assert len(set(batch.np_random_seed)) == 2  # drawn, if read before a reset
    for seed, python_seed, expected in (
        (7, 7, (7, 8)),
        (np.int64(3), 3, (3, 4)),
        (np.array([8, 9]), [8, 9], (8, 9)),
        ([np.int32(5), None], [5, None], (5, 9)),
        (None, None, (5, 9)),
    ):
        assert np.array_equal(batch.reset(seed=seed)[0], sync.reset(seed=python_seed)[0])
        assert batch.np_random_seed == sync.np_random_seed == expected
        states = [[rng.bit_generator.state for rng in envs.np_random] for envs in (batch, sync)]
        assert states[0] == states[1]
    with pytest.raises(TypeError, match="cannot be interpreted as an integer"):
        batch.reset(seed=[0.5, 1])


def test_sb3_seeds_options_and_attributes():
    env = ProbeVecEnv("probe_env/Snapshot-v1", 2, **CASES["probe_env/Snapshot-v1"])
    env.set_options([{"friction": 0.11}, {"friction": 0.22}])
    env.reset()
    assert [info["context"]["friction"] for info in env.reset_infos] == [0.11, 0.22]
    assert env.get_attr("render_mode") == [None, None]
    assert env.env_is_wrapped(gym.Wrapper) == [False, False]
    with pytest.raises(ValueError, match="leave indices out"):
        env.set_attr("x", 1, indices=[0])


def test_sb3_spec_is_that_of_single_environments(tmp_path):
    for env_id, settings in CASES.items():
        for options in ({}, settings, settings | {"max_episode_steps": 3}):
            env = ProbeVecEnv(env_id, 2, **options)
            single = DummyVecEnv([partial(gym.make, env_id, **options)] * 2)
            assert env.get_attr("spec") == single.get_attr("spec"), (env_id, options)
        VecMonitor(env, str(tmp_path / "monitor")).close()
        header = (tmp_path / "monitor.monitor.csv").read_text().partition("\n")[0]
        assert json.loads(header.removeprefix("#"))["env_id"] == env_id
