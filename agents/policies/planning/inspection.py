"""A planner of a whole inspection: what looking ahead could win at best where the probe is drawn back, too.

As ``Planner`` it holds candidates of feed and air on copies of the running episodes; what they earn decides, with what
the rest would earn: on the way that the probe is on with the candidate's feed and air, on the other as fast as the
device can, and silent on the way back. No map knows the way back, and it needs none, for a pressed probe hardly rings;
but a change of its feed shakes it, so one that counts on being faster later would never be.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from agents.policies.planning.candidates import drawn
from agents.policies.planning.outlook import blur_states
from agents.policies.planning.planner import BLUR
from probe_env.arrays import FloatArray
from probe_env.envs.episodes import Episodes
from probe_env.envs.task import TaskConfig, costs
from probe_env.envs.task.passes import BothWays

Memory = tuple[int, float, float]
"""Periods since the start, feed [m/s] and air [m3/s] that are held."""


@dataclass
class InspectionPlanner:
    """Receding horizon over ``periods`` control periods, ``candidates`` of feed and air, every ``every`` periods anew.

    Attributes:
        config: the task of both passes.
        periods: that a candidate is held on the copies.
        candidates: tried each time, see ``tried_both_ways``.
        every: periods from one plan to the next.
        blur: standard deviation of what is known of the nodes' radial places [m].
        seed: of the draws.

    Raises:
        ValueError: a setting is out of range, or the way back does not count.
    """

    config: TaskConfig
    periods: int = 6
    candidates: int = 10
    every: int = 3
    blur: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("periods", "candidates", "every"):
            if not 1 <= getattr(self, name) <= 1000:
                raise ValueError(f"{name} = {getattr(self, name)!r} is outside the accepted range 1 to 1000")
        if self.config.inspects == "in":
            raise ValueError(
                "inspects = 'in': the way back counts for nothing, so a planner of the way in is all there is; use"
                ' passes = "in"'
            )

    def predict(
        self,
        observation: npt.NDArray[np.floating],
        state: Any = None,
        episode_start: npt.NDArray[np.bool_] | None = None,
        deterministic: bool = False,
    ) -> tuple[npt.NDArray[np.float32], Any]:
        """Not there.

        Raises:
            ValueError: always: observations alone are not enough to look ahead.
        """
        raise ValueError("a planner tries things out on the simulator itself: play it with `probe-env evaluate`")

    def decide(
        self, episodes: Episodes, which: Sequence[int], observation: npt.NDArray[np.float32], states: Sequence[Any]
    ) -> tuple[npt.NDArray[np.float32], list[Any]]:
        """Actions (n, 2) and states of running episodes, see ``probe_env.envs.trials.Foresighted``."""
        started = zip(which, states, strict=True)
        memories: list[Memory] = [_settled(episodes, k) if state is None else state for k, state in started]
        due = [row for row, memory in enumerate(memories) if memory[0] % self.every == 0]
        # all that are due at the same time of their own: draws depend on that, not on company
        for time in sorted({memories[row][0] for row in due}):
            rows = [row for row in due if memories[row][0] == time]
            chosen = self._planned(episodes, [which[row] for row in rows], [memories[row] for row in rows])
            for row, (feed, air) in zip(rows, chosen.tolist(), strict=True):
                memories[row] = (time, feed, air)
        held = np.array([memory[1:] for memory in memories])
        actions = self.config.actions(held[:, 0], held[:, 1]).astype(np.float32)
        return actions, [(time + 1, feed, air) for time, feed, air in memories]

    def describe(self) -> dict[str, Any]:
        """What it is, as JSON-ready data; equal for equal policies."""
        own = {field.name: getattr(self, field.name) for field in fields(self) if field.name != "config"}
        return {"policy": type(self).__name__, **own}

    def _planned(self, episodes: Episodes, which: Sequence[int], memories: Sequence[Memory]) -> FloatArray:
        """(n, 2) feed [m/s] and air [m3/s] of the best candidates."""
        kept = np.array([memory[1:] for memory in memories])
        entropy = [self.seed, memories[0][0]]
        tried = tried_both_ways(kept, self.candidates, self.config, entropy)
        copies = episodes.fork(np.repeat(which, self.candidates).tolist())
        blur_states(copies.batch, self.blur, entropy)
        each = tried.reshape(-1, 2)
        worth = earned(copies, each, self.periods) + worth_of_rest(copies, each)
        best = worth.reshape(tried.shape[:2]).argmax(axis=1)
        return np.take_along_axis(tried, best[:, None, None], axis=1)[:, 0]


def tried_both_ways(kept: FloatArray, count: int, config: TaskConfig, entropy: list[int]) -> FloatArray:
    """(n, count, 2) feed speeds [m/s] and air supplies [m3/s] to try, as the plant's devices give them.

    What is held (n, 2), the fastest feed with the air that is held, and then in turn draws near what is held and the
    fastest feed with any air: what is good on one way is not on the other, and the turn leaves no time for small steps.
    """
    fastest, (least, most) = config.feed_speeds[1], config.air_supply_rates
    tried = drawn(kept, np.column_stack([np.full(len(kept), fastest), kept[:, 1]]), count, config, entropy)
    airs = np.random.default_rng([*entropy, count]).uniform(least, most, size=count)
    actions = config.actions(np.full(count, fastest), airs).astype(np.float32)
    tried[:, 3::2] = config.targets(actions)[3::2]
    return tried


def _settled(episodes: Episodes, k: int) -> Memory:
    simulator = episodes.batch.simulators[k]
    return 0, simulator.feed_speed, simulator.air_supply_rate


def earned(copies: Episodes, held: FloatArray, periods: int) -> FloatArray:
    """(N,) reward of episodes that go on for some periods with (N, 2) feed [m/s] and air [m3/s] held."""
    actions = copies.config.actions(held[:, 0], held[:, 1]).astype(np.float32)
    reward = np.zeros(len(copies))
    for _ in range(periods):
        running = copies.running.copy()
        if not running.any():
            break
        reward += np.where(running, copies.step(actions, running).reward, 0.0)
    return reward


def worth_of_rest(episodes: Episodes, held: FloatArray) -> FloatArray:
    """(N,) what is left to earn by probes that go both ways; 0 where an episode has ended.

    On the way that each is on (N, 2) feed [m/s] and air [m3/s] are held, from the turn on the feed is the fastest and
    the air the least. Of those that hang slack it is what losing the drive costs, for that is what follows.
    """
    config, passes = episodes.config, episodes.passes
    assert isinstance(passes, BothWays)
    inserted, length = episodes.gauges.inserted(), episodes.gauges.helix_length()
    to_pass, shaken = passes.still_to_pass()
    forth, unseen = passes.way > 0.0, length - passes.reached
    here = np.where(forth, length - inserted, to_pass) / held[:, 0]
    back = np.where(forth, length - passes.begun, 0.0) / config.feed_speeds[1]
    spent = costs(config, shaken, here + back, held[:, 1] * here + config.air_supply_rates[0] * back)
    # what the way in shook was charged already, and a silent way back gives it again
    refund = spent["vibration"] if config.inspects == "best" else 0.0
    left = np.where(forth, length - passes.begun, to_pass)
    metres = unseen if config.inspects == "best" else left
    worth = config.progress_weight * metres + refund - spent["time"] - spent["air"]
    hanging = np.array([tally.slack_periods > 0 for tally in episodes.tally])
    lost = -config.uninspected_weight * (unseen + left)
    return np.where(episodes.running, np.where(hanging, lost, worth), 0.0)


INSPECTION_PLANNERS: Final[dict[str, dict[str, Any]]] = {"planner": {}, "planner-blurred": {"blur": BLUR}}
"""Names and settings, as of those of the way in."""
