"""Warm start of PPO: the network first imitates a teacher that knows the tube (DAgger: Ross, Gordon, Bagnell 2011).

The teacher acts in the first round, the network itself in the others, so that it learns what to do where it gets to;
its critic learns the return that follows.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from stable_baselines3 import PPO

from agents.policies.policy import Policy
from agents.training.config import Imitation
from agents.training.view_env import ViewVecEnv

MINIBATCH = 256
Floats = npt.NDArray[np.float32]


def imitate(model: PPO, env: ViewVecEnv, teacher: Policy, settings: Imitation, report: Callable[[int], Any]) -> None:
    """Train the model's actor and critic in place.

    Args:
        model: PPO on ``env``.
        env: its task must show what the teacher looks at.
        teacher: acts in the environment's own terms.
        settings: rounds, steps and so on.
        report: called with the number of environment steps after each of them.
    """
    optimiser = torch.optim.Adam(model.policy.parameters(), lr=settings.learning_rate)
    kept: list[tuple[Floats, Floats, Floats]] = []
    for number in range(settings.rounds):
        kept.append(_gather(model, env, teacher, max(settings.steps // env.num_envs, 1), number == 0, report))
        features, actions, returns = (np.concatenate(parts) for parts in zip(*kept, strict=True))
        fresh = len(kept[-1][0])  # the critic learns what follows the latest behaviour
        _fit(model, optimiser, features, actions, features[-fresh:], returns[-fresh:], settings.epochs)


def _gather(
    model: PPO, env: ViewVecEnv, teacher: Policy, steps: int, teacher_acts: bool, report: Callable[[int], Any]
) -> tuple[Floats, Floats, Floats]:
    """Features (n, f), the teacher's actions (n, 2) and discounted returns (n,) of one round."""
    features = np.asarray(env.reset())
    state, start = None, np.ones(env.num_envs, dtype=bool)
    seen, taught, rewards, dones = [], [], [], []
    for _ in range(steps):
        action, state = teacher.predict(env.rows, state, start, deterministic=True)
        wanted = env.view.agent_actions(env.config, action, env.guided)
        seen.append(features)
        taught.append(wanted)
        acted = wanted if teacher_acts else model.predict(features, deterministic=True)[0]
        new, reward, start, _ = env.step(acted)
        features = np.asarray(new)
        rewards.append(reward)
        dones.append(start)
        report(env.num_envs)
    with torch.no_grad():
        following = model.policy.predict_values(torch.as_tensor(features)).numpy().ravel()
    returns = np.zeros((steps, env.num_envs), dtype=np.float32)
    for k in reversed(range(steps)):
        following = rewards[k] + model.gamma * following * ~dones[k]
        returns[k] = following
    return np.concatenate(seen), np.concatenate(taught), returns.ravel()


def _fit(
    model: PPO,
    optimiser: torch.optim.Optimizer,
    features: Floats,
    actions: Floats,
    valued: Floats,
    returns: Floats,
    epochs: int,
) -> None:
    policy = model.policy
    policy.set_training_mode(True)
    x, wanted, v, targets = (torch.as_tensor(part) for part in (features, actions, valued, returns))
    for _ in range(epochs):
        for chosen in torch.split(torch.randperm(len(x)), MINIBATCH):
            others = torch.randint(len(v), (MINIBATCH,))
            gaussian = policy.get_distribution(x[chosen]).distribution
            assert isinstance(gaussian, torch.distributions.Normal)
            value = policy.predict_values(v[others]).ravel()
            loss = ((gaussian.mean - wanted[chosen]) ** 2).mean() + torch.nn.functional.smooth_l1_loss(
                value, targets[others]
            )
            optimiser.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            optimiser.step()
    policy.set_training_mode(False)
