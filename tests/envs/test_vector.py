"""The native batches conform to their single environments, and the checks find broken ones."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from stable_baselines3 import PPO

import probe_env
from agents.conformance import check_vector_env
from agents.vec_env import ProbeVecEnv

CASES = {
    "probe_env/Insertion-v1": {"config": {"period": 0.1, "time_limit": 0.5, "settle_time": 0.1}},
    "probe_env/Snapshot-v1": {"config": {"time_limit": 0.5}, "scene": probe_env.Scene(carrier_length=8.0)},
    "probe_env/Inspection-v0": {
        "config": {"period": 0.1, "time_limit": 0.5, "settle_time": 0.1},
        "scene": {"tube": {"helix_length": 5.1}},  # turned round within the five steps
        "fidelity": "fast",
    },
}
IDS = pytest.mark.parametrize("env_id", list(CASES))


def single(env_id):
    return lambda: gym.make(env_id, **CASES[env_id])


LIMITS = pytest.mark.parametrize("limit", [{}, {"max_episode_steps": 3}], ids=["", "three steps"])  # the task's: five


@IDS
@LIMITS
@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_the_native_batch_conforms(env_id, mode, limit):
    given = CASES[env_id] | limit
    check_vector_env(
        lambda n: gym.make_vec(env_id, num_envs=n, **given, autoreset_mode=mode), lambda: gym.make(env_id, **given)
    )


@IDS
@LIMITS
def test_the_sb3_batch_conforms(env_id, limit):
    given = CASES[env_id] | limit
    check_vector_env(lambda n: ProbeVecEnv(env_id, n, **given), lambda: gym.make(env_id, **given))


class Broken(ProbeVecEnv):
    """A batch with a fault."""

    def __init__(self, fault, *arguments, **given):
        super().__init__(*arguments, **given)
        self.fault, self.buffer = fault, None

    def step_wait(self):
        observation, reward, done, infos = super().step_wait()
        if self.fault == "written to later":  # one buffer for all observations
            self.buffer = observation if self.buffer is None else self.buffer
            self.buffer[:] = observation
            observation = self.buffer
        if self.fault == "terminated of step":
            for info in infos:
                info["TimeLimit.truncated"] = False
        if self.fault == "last observation of":
            for k in np.flatnonzero(done):
                infos[k]["terminal_observation"] = observation[k]
        return observation, reward + 1e-3 * (self.fault == "reward of step" and self.num_envs > 1), done, infos

    def seed(self, seed=None):
        seeds = super().seed(seed)
        if self.fault == "first observation":  # one generator's seed for all
            self._seeds = [seed] * self.num_envs
        return seeds


def test_broken_batches_are_found():
    env_id = "probe_env/Snapshot-v1"
    faults = "written to later", "terminated of step", "last observation of", "first observation", "reward of step"
    for fault in faults:
        with pytest.raises(AssertionError, match=fault):
            check_vector_env(lambda n, fault=fault: Broken(fault, env_id, n, **CASES[env_id]), single(env_id))


def test_truncation_reaches_ppo_s_bootstrap():
    """In the rewards of one rollout: with PPO's value of the last observation where an episode is cut."""
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
    with pytest.raises(ValueError, match="max_episode_steps = 0 is outside the accepted range 1 and more"):
        gym.make_vec("probe_env/Snapshot-v1", num_envs=1, max_episode_steps=0)
    with pytest.raises(ValueError, match="render_mode = 'rgb_array'"):
        gym.make_vec("probe_env/Snapshot-v1", num_envs=1, render_mode="rgb_array")
    with pytest.raises(ValueError, match="num_envs = 0"):
        ProbeVecEnv(num_envs=0)
    with pytest.raises(ValueError, match="max_episode_steps = 0"):
        ProbeVecEnv(max_episode_steps=0)
    with pytest.raises(
        TypeError, match=r"Episodes\(\) has no argument fidelty; accepted are tube, scene, fidelity, contexts"
    ):
        ProbeVecEnv(fidelty="fast")
    env = gym.make_vec("probe_env/Snapshot-v1", num_envs=2, **CASES["probe_env/Snapshot-v1"])
    with pytest.raises(ValueError, match="seed has 3 entries for 2"):
        env.reset(seed=[1, 2, 3])
    _, info = env.reset(seed=1, options={"friction": 0.2})
    assert info["context"]["friction"].tolist() == [0.2, 0.2]
    assert env.spec.id == "probe_env/Snapshot-v1"


def test_sb3_seeds_options_and_attributes():
    env = ProbeVecEnv("probe_env/Snapshot-v1", 2, **CASES["probe_env/Snapshot-v1"])
    env.set_options([{"friction": 0.11}, {"friction": 0.22}])
    env.reset()
    assert [info["context"]["friction"] for info in env.reset_infos] == [0.11, 0.22]
    assert env.get_attr("render_mode") == [None, None]
    assert env.env_is_wrapped(gym.Wrapper) == [False, False]
    with pytest.raises(ValueError, match="leave indices out"):
        env.set_attr("x", 1, indices=[0])
