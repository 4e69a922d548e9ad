"""Checks of a batch (``VectorEnv`` or SB3's ``VecEnv``) against single environments.

N environments equal N single ones bit for bit, for any N and order; autoreset follows the declared mode; truncation,
termination and the final observation are reported; returned arrays are not modified later.
"""

import copy
from typing import NamedTuple

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from stable_baselines3.common.vec_env import VecEnv


class Step(NamedTuple):
    """A step of N environments; ``final`` has the final observations of those that were reset in it."""

    observation: np.ndarray
    reward: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    final: dict[int, np.ndarray]


def check_vector_env(make, make_single, num_envs=3, steps=12, seed=5):
    """Run all checks for a factory of batches; an episode must end within ``steps``."""
    space = make_single().action_space
    space.seed(1)
    actions = np.array([[space.sample() for _ in range(num_envs)] for _ in range(steps)])
    seeds, every, batch = [seed + k for k in range(num_envs)], list(range(num_envs)), make(num_envs)
    mode = batch.metadata["autoreset_mode"] if isinstance(batch, VectorEnv) else AutoresetMode.SAME_STEP
    expected = reference(make_single, seeds, actions, mode)
    assert any((step.terminated | step.truncated).any() for step in expected[1:]), "no episode ends: nothing to check"
    for which, seeding, claim in (
        (every, seed, "N environments differ from N single ones"),
        (every, seed, "a second run with the same seed differs"),
        ([0], seed, "the result depends on num_envs"),
        (every[::-1], seeds[::-1], "the result depends on the order"),
    ):
        env = make(len(which))
        if seeding == seed or isinstance(env, VectorEnv):  # which accepts one seed per environment
            compare(run(env, seeding, actions[:, which]), [of(step, which) for step in expected], claim)


def reference(make_single, seeds, actions, mode):
    """The first observation and the steps of single environments, with explicit autoreset."""
    singles, nothing = [make_single() for _ in seeds], np.zeros(len(seeds))
    start = np.array([env.reset(seed=seed)[0] for env, seed in zip(singles, seeds, strict=True)])
    ended, found = [False] * len(seeds), [Step(start, nothing, nothing > 0.0, nothing > 0.0, {})]
    for row in actions:
        rows, final = [], {}
        for k, env in enumerate(singles):
            if ended[k]:
                fresh, ended[k] = env.reset()[0], False
                if mode is AutoresetMode.NEXT_STEP:  # this step is the reset
                    rows.append((fresh, 0.0, False, False))
                    continue
            observation, reward, terminated, truncated, _ = env.step(row[k])
            if (terminated or truncated) and mode is AutoresetMode.SAME_STEP:
                final[k], observation = observation, env.reset()[0]
            else:
                ended[k] = terminated or truncated
            rows.append((observation, float(reward), terminated, truncated))
        found.append(Step(*(np.array(column) for column in zip(*rows, strict=True)), final))
    return found


def run(env, seed, actions):
    """The first observation and the steps of a batch; its arrays must stay as they were returned."""
    if isinstance(env, VecEnv):
        env.seed(seed)
    start = env.reset() if isinstance(env, VecEnv) else env.reset(seed=seed)[0]
    nothing = np.zeros(len(start))
    returned = [Step(start, nothing, nothing > 0.0, nothing > 0.0, {})]
    copies = copy.deepcopy(returned)
    for action in actions:
        ended = copies[-1].terminated | copies[-1].truncated
        if isinstance(env, VectorEnv) and env.metadata["autoreset_mode"] is AutoresetMode.DISABLED and ended.any():
            env.reset(options={"reset_mask": ended})
        returned.append(step_of(env, action))
        copies.append(copy.deepcopy(returned[-1]))
    compare(returned, copies, "a returned array was modified later")
    env.close()
    return copies


def step_of(env, action):
    if isinstance(env, VecEnv):
        observation, reward, done, infos = env.step(action)
        truncated = np.array([info["TimeLimit.truncated"] for info in infos])
        final = {k: infos[k]["terminal_observation"] for k in np.flatnonzero(done).tolist()}
        return Step(observation, reward, done & ~truncated, truncated, final)
    observation, reward, terminated, truncated, infos = env.step(action)
    reset = env.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    ended = np.flatnonzero(reset & (terminated | truncated)).tolist()
    return Step(observation, reward, terminated, truncated, {k: infos["final_obs"][k] for k in ended})


def of(step, order):
    final = {index: step.final[k] for index, k in enumerate(order) if k in step.final}
    return Step(*(array[order] for array in step[:4]), final)


def compare(steps, expected, claim):
    for number, (a, b) in enumerate(zip(steps, expected, strict=True)):
        for name in ("terminated", "truncated", "observation", "reward"):
            first, second = (np.asarray(getattr(step, name), dtype=np.float32) for step in (a, b))
            text = f"{claim}: {name} of step {number}" if number else f"{claim}: first {name}"
            assert np.array_equal(first, second), text
        assert a.final.keys() == b.final.keys(), f"{claim}: environments with a final observation in step {number}"
        for k in a.final:
            assert np.array_equal(a.final[k], b.final[k]), f"{claim}: final observation of {k} in step {number}"
