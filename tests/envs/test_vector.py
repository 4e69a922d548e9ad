"""The native batches conform to their single environments, and the checks find broken ones."""

import pickle

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv

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


def test_other_people_s_batches_of_our_environment_conform():
    env_id = "probe_env/Snapshot-v1"
    check_vector_env(lambda n: SyncVectorEnv([single(env_id)] * n), single(env_id))
    check_vector_env(lambda n: DummyVecEnv([single(env_id)] * n), single(env_id))


class OneBuffer(ProbeVecEnv):
    """Hands out the same observation buffer again and again."""

    def step_wait(self):
        observation, reward, done, infos = super().step_wait()
        self.buffer = getattr(self, "buffer", np.zeros_like(observation))
        self.buffer[:] = observation
        return self.buffer, reward, done, infos


class NoTruncation(ProbeVecEnv):
    def step_wait(self):
        observation, reward, done, infos = super().step_wait()
        for info in infos:
            info["TimeLimit.truncated"] = False
        return observation, reward, done, infos


class NewObservationAsLast(ProbeVecEnv):
    def step_wait(self):
        observation, reward, done, infos = super().step_wait()
        for k in np.flatnonzero(done):
            infos[k]["terminal_observation"] = observation[k]
        return observation, reward, done, infos


class OneGenerator(ProbeVecEnv):
    def seed(self, seed=None):
        return super().seed(seed) and [setattr(self, "_seeds", [seed] * self.num_envs)]


class Sloppy(ProbeVecEnv):
    def step_wait(self):
        observation, reward, done, infos = super().step_wait()
        return observation, reward + 1e-3 * (self.num_envs > 1), done, infos


def test_broken_batches_are_found():
    env_id, found = "probe_env/Snapshot-v1", {}
    for broken in (OneBuffer, NoTruncation, NewObservationAsLast, OneGenerator, Sloppy):
        with pytest.raises(AssertionError) as error:
            check_vector_env(lambda n, broken=broken: broken(env_id, n, **CASES[env_id]), single(env_id))
        found[broken] = str(error.value)
    messages = ("written to later", "terminated of step", "last observation of", "first observation", "reward of step")
    assert [text for text, message in zip(found.values(), messages, strict=True) if message not in text] == []


def advantage_of_ppo(make):
    """Rewards that PPO collects in one rollout: with its value of the last observation where an episode is cut."""
    env = make("probe_env/Snapshot-v1", 2, **CASES["probe_env/Snapshot-v1"])
    model = PPO("MlpPolicy", env, n_steps=8, batch_size=8, n_epochs=1, seed=0, gamma=0.99)
    model.learn(16)
    return model.rollout_buffer.rewards.copy()


def test_truncation_reaches_ppo_s_bootstrap():
    with_flag, without = advantage_of_ppo(ProbeVecEnv), advantage_of_ppo(NoTruncation)
    cut = np.abs(with_flag - without) > 1e-6
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


def test_a_batch_can_be_copied_half_way():
    env = ProbeVecEnv("probe_env/Snapshot-v1", 2, **CASES["probe_env/Snapshot-v1"])
    env.seed(3)
    env.reset()
    action = np.full((2, 2), 0.5, dtype=np.float32)
    env.step(action)
    other = pickle.loads(pickle.dumps(env))
    for _ in range(6):  # over an autoreset
        a, b = env.step(action), other.step(action)
        assert (a[0] == b[0]).all()
        assert (a[1] == b[1]).all()


def test_sb3_seeds_options_and_attributes():
    env = ProbeVecEnv("probe_env/Snapshot-v1", 2, **CASES["probe_env/Snapshot-v1"])
    env.set_options([{"friction": 0.11}, {"friction": 0.22}])
    env.reset()
    assert [info["context"]["friction"] for info in env.reset_infos] == [0.11, 0.22]
    assert env.get_attr("render_mode") == [None, None]
    assert env.env_is_wrapped(gym.Wrapper) == [False, False]
    with pytest.raises(ValueError, match="leave indices out"):
        env.set_attr("x", 1, indices=[0])
