"""A person as a policy: feed and air are what the hand has set, and what was set is the schedule that is kept."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from agents.policies.fixed import STUDY_AIR, STUDY_FEED
from probe_env.envs.task import TaskConfig

BY_HAND: Final = "by hand"


class Driven:
    """Feeds and blows what is set; one insertion.

    Args:
        config: the task that it acts in.

    Attributes:
        feed_speed, air_supply_rate: what is set [m/s], [m3/s].
    """

    def __init__(self, config: TaskConfig) -> None:
        self.config = config
        (feed, air), *_ = config.given(STUDY_FEED, STUDY_AIR)
        self.feed_speed, self.air_supply_rate = float(feed), float(air)
        self._set: list[tuple[float, float]] = []

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[npt.NDArray[np.float32], Any]:
        """The action (1, 2) that asks for what is set, and no memory; it is noted."""
        if state is None:
            self._set.clear()
        self._set.append((self.feed_speed, self.air_supply_rate))
        return self.config.actions(self.feed_speed, self.air_supply_rate).astype(np.float32), ()

    def describe(self) -> dict[str, Any]:
        """With the schedule over time that was driven until now."""
        feed, air = zip(*self._set, strict=True) if self._set else ((), ())
        schedule = {
            "over": "time", "interpolation": "steps", "position": [k * self.config.period for k in range(len(feed))],
            "feed_speed": list(feed), "air_supply_rate": list(air), "start_length": None,
        }  # fmt: skip
        return {"policy": type(self).__name__, "schedule": schedule}
