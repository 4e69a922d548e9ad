"""Checks for any vector environment against its single environment; they raise ``AssertionError`` and say why.

A vector environment comes as a factory ``make(num_envs)``, Gymnasium's or SB3's, the single one as ``make_single()``.
It conforms if N of them equal N single ones bit for bit, in any number and order; if ended episodes start anew as
its autoreset mode says; if truncation is told apart from termination and the last observation is kept; and if it
hands out no memory that it writes to later. Episodes must be able to end within ``steps``.
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
class Outcome:
    """One step of N environments; ``final`` has the last observation of those that ended and start anew at once."""

    observation: np.ndarray
    reward: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    final: dict[int, np.ndarray]


def check_vector_env(make: Make, make_single: MakeSingle, num_envs: int = 3, steps: int = 12, seed: int = 5) -> None:
    """All checks, for Gymnasium's ``VectorEnv`` or SB3's ``VecEnv``."""
    actions = _actions(make_single, num_envs, steps)
    seeds = [seed + k for k in range(num_envs)]
    mode = _mode(make, num_envs)
    expected_start, expected = _reference(make_single, seeds, actions, mode)
    assert any((o.terminated | o.truncated).any() for o in expected), (
        f"no episode ends within {steps} steps: nothing shown"
    )
    start, first = _run(make(num_envs), seed, actions)
    _compare(start, first, expected_start, expected, "N environments differ from N single ones")
    second_start, second = _run(make(num_envs), seed, actions)
    _compare(second_start, second, expected_start, expected, "the same seed gives another run")
    one_start, one = _run(make(1), seed, actions[:, :1])
    _compare(one_start, one, expected_start[:1], [_take(o, [0]) for o in expected], "the batch's size changes a member")
    env = make(num_envs)
    if isinstance(env, VectorEnv):  # takes a seed for each member
        order = list(reversed(range(num_envs)))
        permuted_start, permuted = _run(env, [seeds[k] for k in order], actions[:, order])
        reordered = [_take(o, order) for o in expected]
        _compare(permuted_start, permuted, expected_start[order], reordered, "the order of the members changes them")
    # an ended episode of a disabled autoreset would have to be reset
    _check_aliasing(make(num_envs), seed, actions[:1] if mode is AutoresetMode.DISABLED else actions)


def _check_aliasing(env: Any, seed: int, actions: np.ndarray) -> None:
    kept: list[tuple[np.ndarray, np.ndarray]] = []
    observation = _reset(env, seed)
    kept.append((observation, observation.copy()))
    for action in actions:
        outcome = _step(env, action)
        kept += [(array, array.copy()) for array in (outcome.observation, outcome.reward)]
        kept += [(array, array.copy()) for array in outcome.final.values()]
    for array, saved in kept:
        assert np.array_equal(array, saved), "an array that was handed out has been written to later"
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
) -> tuple[np.ndarray, list[Outcome]]:
    """What single environments do, with the autoreset written out."""
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
        outcomes.append(Outcome(columns[0], columns[1], columns[2], columns[3], final))
    return start, outcomes


def _reset(env: Any, seed: Any) -> np.ndarray:
    if isinstance(env, VecEnv):
        env.seed(seed)
        return np.asarray(env.reset())
    return np.asarray(env.reset(seed=seed)[0])


def _step(env: Any, action: np.ndarray) -> Outcome:
    if isinstance(env, VecEnv):
        observation, reward, done, infos = env.step(action)
        truncated = np.array([bool(info.get("TimeLimit.truncated", False)) for info in infos])
        final = {k: infos[k]["terminal_observation"] for k in np.flatnonzero(done).tolist()}
        return Outcome(np.asarray(observation), reward, done & ~truncated, truncated, final)
    observation, reward, terminated, truncated, infos = env.step(action)
    final = {}
    if env.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP:
        final = {k: np.asarray(infos["final_obs"][k]) for k in np.flatnonzero(terminated | truncated).tolist()}
    return Outcome(observation, reward, terminated, truncated, final)


def _run(env: Any, seed: Any, actions: np.ndarray) -> tuple[np.ndarray, list[Outcome]]:
    start = _reset(env, seed).copy()
    by_mask = not isinstance(env, VecEnv) and env.metadata["autoreset_mode"] is AutoresetMode.DISABLED
    outcomes: list[Outcome] = []
    for action in actions:
        if by_mask and outcomes and (ended := outcomes[-1].terminated | outcomes[-1].truncated).any():
            env.reset(options={"reset_mask": ended})
        outcomes.append(copy.deepcopy(_step(env, action)))
    env.close()
    return start, outcomes


def _take(outcome: Outcome, order: Sequence[int]) -> Outcome:
    final = {place: outcome.final[k] for place, k in enumerate(order) if k in outcome.final}
    rows = list(order)
    return Outcome(
        outcome.observation[rows], outcome.reward[rows], outcome.terminated[rows], outcome.truncated[rows], final
    )


def _compare(
    start: np.ndarray, outcomes: list[Outcome], expected_start: np.ndarray, expected: list[Outcome], claim: str
) -> None:
    assert np.array_equal(start, expected_start), f"{claim}: first observation"
    for step, (a, b) in enumerate(zip(outcomes, expected, strict=True)):
        for name in ("terminated", "truncated", "observation"):
            assert np.array_equal(getattr(a, name), getattr(b, name)), f"{claim}: {name} of step {step}"
        assert np.array_equal(a.reward.astype(np.float32), b.reward.astype(np.float32)), (
            f"{claim}: reward of step {step}"
        )
        assert a.final.keys() == b.final.keys(), f"{claim}: who has a last observation in step {step}"
        for k in a.final:
            assert np.array_equal(a.final[k], b.final[k]), f"{claim}: last observation of {k} in step {step}"
