"""Policies that play episodes."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from probe_env.arrays import BoolArray


class Controller(Protocol):
    """SB3's ``predict``."""

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Any, Any]:
        """Action and state."""


class Players:
    """Policies that act in N episodes side by side, each with the memory of its own episode."""

    def __init__(self, count: int) -> None:
        self.controllers: list[Controller | None] = [None] * count
        self.states: list[Any] = [None] * count

    def begin(self, k: int, controller: Controller) -> None:
        """Give episode ``k``, which begins, to a policy."""
        self.controllers[k], self.states[k] = controller, None

    def act(self, observation: npt.NDArray[np.float32], active: BoolArray) -> npt.NDArray[np.float32]:
        """Actions (N, 2) for observations (N, d); zero where an episode is not active."""
        actions = np.zeros((len(self.states), 2), dtype=np.float32)
        for k in np.flatnonzero(active).tolist():
            controller, start = self.controllers[k], np.array([self.states[k] is None])
            assert controller is not None
            action, self.states[k] = controller.predict(
                observation[k : k + 1], self.states[k], start, deterministic=True
            )
            actions[k] = action[0]
        return actions
