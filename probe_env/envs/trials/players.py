"""Policies that play episodes, and the loop in which they do."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from probe_env.arrays import BoolArray
from probe_env.envs.episodes import Episodes, Step


class Controller(Protocol):
    """SB3's ``predict``."""

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Any, Any]:
        """Action and state."""


@runtime_checkable
class Foresighted(Protocol):
    """A policy that tries things out on copies of the probes themselves, which no rig can: what is possible at best."""

    def decide(
        self, episodes: Episodes, which: Sequence[int], observation: npt.NDArray[np.float32], states: Sequence[Any]
    ) -> tuple[npt.NDArray[np.float32], list[Any]]:
        """Actions (n, 2) and states of the n episodes of ``which``, by their observations (n, d) and states.

        The episodes themselves stay as they are; a state of None begins one.
        """


class Players:
    """Policies that act in N episodes side by side, each with the memory of its own episode."""

    def __init__(self, count: int) -> None:
        self.controllers: list[Controller | None] = [None] * count
        self.states: list[Any] = [None] * count

    def begin(self, k: int, controller: Controller) -> None:
        """Give episode ``k``, which begins, to a policy."""
        self.controllers[k], self.states[k] = controller, None

    def act(
        self, observation: npt.NDArray[np.float32], active: BoolArray, episodes: Episodes | None = None
    ) -> npt.NDArray[np.float32]:
        """Actions (N, 2) for observations (N, d); zero where an episode is not active.

        ``episodes`` are what they act in, for those that look ahead.
        """
        actions = np.zeros((len(self.states), 2), dtype=np.float32)
        looking: dict[int, list[int]] = {}
        for k in np.flatnonzero(active).tolist():
            controller, start = self.controllers[k], np.array([self.states[k] is None])
            assert controller is not None
            if isinstance(controller, Foresighted) and episodes is not None:
                looking.setdefault(id(controller), []).append(k)
                continue
            action, self.states[k] = controller.predict(
                observation[k : k + 1], self.states[k], start, deterministic=True
            )
            actions[k] = action[0]
        for which in looking.values():
            controller = self.controllers[which[0]]
            assert isinstance(controller, Foresighted)
            assert episodes is not None
            before = [self.states[k] for k in which]
            actions[which], after = controller.decide(episodes, which, observation[which], before)
            for k, state in zip(which, after, strict=True):
                self.states[k] = state
        return actions


def periods_of(
    episodes: Episodes, policies: Sequence[Controller], observation: npt.NDArray[np.float32]
) -> Iterator[tuple[Step, BoolArray]]:
    """Play what has been reset until it has ended; gives every period and which (N,) were in it.

    Args:
        episodes: that were reset, all N.
        policies: N, whose episode is each.
        observation: (N, d) that the reset gave.
    """
    players = Players(len(policies))
    for k, policy in enumerate(policies):
        players.begin(k, policy)
    simulated = episodes if isinstance(episodes, Episodes) else None
    while episodes.running.any():
        active = episodes.running.copy()
        step = episodes.step(players.act(observation, active, simulated), active)
        observation = step.observation
        yield step, active
