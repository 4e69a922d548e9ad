"""Conformance checks of a vector environment against its single environment; a failure is an ``AssertionError``.

The checks: N environments equal N single ones bit for bit, for any N and order; autoreset follows the declared mode;
truncation, termination and the final observation are reported; returned arrays are not modified later.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from stable_baselines3.common.vec_env import VecEnv

Make = Callable[[int], Any]
MakeSingle = Callable[[], gym.Env[Any, Any]]


@dataclass
class VectorStep:
    """One step of N environments; ``final`` has the final observations of those that were reset in this step."""

    observation: np.ndarray
    reward: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    final: dict[int, np.ndarray]


def check_vector_env(make: Make, make_single: MakeSingle, num_envs: int = 3, steps: int = 12, seed: int = 5) -> None:
    """Run all checks for a factory of ``VectorEnv`` or SB3's ``VecEnv``; an episode must end within ``steps``."""
    actions = _actions(make_single, num_envs, steps)
    seeds = [seed + k for k in range(num_envs)]
    mode = _mode(make, num_envs)
    expected_start, expected = _reference(make_single, seeds, actions, mode)
    assert any((o.terminated | o.truncated).any() for o in expected), (
        f"no episode ends within {steps} steps: nothing to check"
    )
    start, first = _run(make(num_envs), seed, actions)
    _compare(start, first, expected_start, expected, "N environments differ from N single ones")
    second_start, second = _run(make(num_envs), seed, actions)
    _compare(second_start, second, expected_start, expected, "a second run with the same seed differs")
    one_start, one = _run(make(1), seed, actions[:, :1])
    _compare(one_start, one, expected_start[:1], [_take(o, [0]) for o in expected], "the result depends on num_envs")
    env = make(num_envs)
    if isinstance(env, VectorEnv):  # accepts one seed per environment
        order = list(reversed(range(num_envs)))
        permuted_start, permuted = _run(env, [seeds[k] for k in order], actions[:, order])
        reordered = [_take(o, order) for o in expected]
        _compare(permuted_start, permuted, expected_start[order], reordered, "the result depends on the order")
    # with autoreset disabled, an ended episode would need a reset
    _check_aliasing(make(num_envs), seed, actions[:1] if mode is AutoresetMode.DISABLED else actions)


def _check_aliasing(env: Any, seed: int, actions: np.ndarray) -> None:
    copies: list[tuple[np.ndarray, np.ndarray]] = []
    observation = _reset(env, seed)
    copies.append((observation, observation.copy()))
    for action in actions:
        outcome = _step(env, action)
        copies += [(array, array.copy()) for array in (outcome.observation, outcome.reward)]
        copies += [(array, array.copy()) for array in outcome.final.values()]
    for array, saved in copies:
        assert np.array_equal(array, saved), "a returned array was modified later"
    env.close()


def _mode(make: Make, num_envs: int) -> AutoresetMode:
    env = make(num_envs)
    mode = env.metadata["autoreset_mode"] if isinstance(env, VectorEnv) else AutoresetMode.SAME_STEP
    assert isinstance(mode, AutoresetMode), f"metadata['autoreset_mode'] = {mode!r} is not an AutoresetMode"
    env.close()
    return mode


def _actions(make_single: MakeSingle, num_envs: int, steps: int) -> np.ndarray:
    space = make_single().action_space
    space.seed(1)
    return np.array([[space.sample() for _ in range(num_envs)] for _ in range(steps)])


def _reference(
    make_single: MakeSingle, seeds: Sequence[int], actions: np.ndarray, mode: AutoresetMode
) -> tuple[np.ndarray, list[VectorStep]]:
    """Steps of single environments, with explicit autoreset."""
    singles = [make_single() for _ in seeds]
    start = np.array([env.reset(seed=seed)[0] for env, seed in zip(singles, seeds, strict=True)])
    ended = [False] * len(seeds)
    outcomes = []
    for row in actions:
        rows, final = [], {}
        for k, env in enumerate(singles):
            if ended[k]:
                fresh = env.reset()[0]
                ended[k] = False
                if mode is AutoresetMode.NEXT_STEP:  # this step is the reset
                    rows.append((fresh, 0.0, False, False))
                    continue
            observation, reward, terminated, truncated, _ = env.step(row[k])
            if terminated or truncated:
                if mode is AutoresetMode.SAME_STEP:
                    final[k] = observation
                    observation = env.reset()[0]
                else:
                    ended[k] = True
            rows.append((observation, float(reward), terminated, truncated))
        columns = [np.array(column) for column in zip(*rows, strict=True)]
        outcomes.append(VectorStep(columns[0], columns[1], columns[2], columns[3], final))
    return start, outcomes


def _reset(env: Any, seed: Any) -> np.ndarray:
    if isinstance(env, VecEnv):
        env.seed(seed)
        return np.asarray(env.reset())
    return np.asarray(env.reset(seed=seed)[0])


def _step(env: Any, action: np.ndarray) -> VectorStep:
    if isinstance(env, VecEnv):
        observation, reward, done, infos = env.step(action)
        truncated = np.array([bool(info.get("TimeLimit.truncated", False)) for info in infos])
        final = {k: infos[k]["terminal_observation"] for k in np.flatnonzero(done).tolist()}
        return VectorStep(np.asarray(observation), reward, done & ~truncated, truncated, final)
    observation, reward, terminated, truncated, infos = env.step(action)
    final = {}
    if env.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP:
        final = {k: np.asarray(infos["final_obs"][k]) for k in np.flatnonzero(terminated | truncated).tolist()}
    return VectorStep(observation, reward, terminated, truncated, final)


def _run(env: Any, seed: Any, actions: np.ndarray) -> tuple[np.ndarray, list[VectorStep]]:
    start = _reset(env, seed).copy()
    by_mask = not isinstance(env, VecEnv) and env.metadata["autoreset_mode"] is AutoresetMode.DISABLED
    outcomes: list[VectorStep] = []
    for action in actions:
        if by_mask and outcomes and (ended := outcomes[-1].terminated | outcomes[-1].truncated).any():
            env.reset(options={"reset_mask": ended})
        outcomes.append(copy.deepcopy(_step(env, action)))
    env.close()
    return start, outcomes


def _take(outcome: VectorStep, order: Sequence[int]) -> VectorStep:
    rows, final = list(order), {index: outcome.final[k] for index, k in enumerate(order) if k in outcome.final}
    return VectorStep(
        outcome.observation[rows], outcome.reward[rows], outcome.terminated[rows], outcome.truncated[rows], final
    )


def _compare(
    start: np.ndarray, outcomes: list[VectorStep], expected_start: np.ndarray, expected: list[VectorStep], claim: str
) -> None:
    assert np.array_equal(start, expected_start), f"{claim}: first observation"
    for step, (a, b) in enumerate(zip(outcomes, expected, strict=True)):
        for name in ("terminated", "truncated", "observation"):
            assert np.array_equal(getattr(a, name), getattr(b, name)), f"{claim}: {name} of step {step}"
        assert np.array_equal(a.reward.astype(np.float32), b.reward.astype(np.float32)), (
            f"{claim}: reward of step {step}"
        )
        assert a.final.keys() == b.final.keys(), f"{claim}: environments with a final observation in step {step}"
        for k in a.final:
            assert np.array_equal(a.final[k], b.final[k]), f"{claim}: final observation of {k} in step {step}"
