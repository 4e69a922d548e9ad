"""A plan's policies playing its episodes side by side, a control period at a time, the next one where one ends."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from agents.records.columns import CARRIED, HEARD
from probe_env.arrays import BoolArray
from probe_env.design import RANGES
from probe_env.envs.episodes import Step
from probe_env.envs.surrogate import make_episodes
from probe_env.envs.trials import Players

if TYPE_CHECKING:
    from agents.rollouts.plan import Plan

Unit = tuple[str, int, int]
"""Policy name, context number and seed of an episode."""


class Ended(NamedTuple):
    """An episode that has ended.

    Attributes:
        unit: which one.
        kpis: what it came to.
        profile: a row a control period, the columns of ``CARRIED`` and ``HEARD``.
        probe: that was drawn; None: the scene's.
    """

    unit: Unit
    kpis: dict[str, float]
    profile: list[tuple[float, ...]]
    probe: dict[str, float] | None


class Playing:
    """Some episodes side by side, the next one starting wherever one ends.

    Args:
        plan: whose they are.
        missing: units that are to be played; those that have begun are taken out.
        batch: at most so many side by side.
        threads: at most so many; None: all cores.

    Attributes:
        episodes: the probes.
        units: what each of them plays.
        profile: of each, up to now.
        decided: whether the actions of the coming period are decided.
        actions: (N, 2) that were decided last.
        last: the period that was played last; None before the first.
    """

    def __init__(self, plan: Plan, missing: deque[Unit], batch: int, threads: int | None) -> None:
        self.plan, self.missing = plan, missing
        count = min(batch, len(missing))
        self.episodes = make_episodes(
            count,
            plan.config,
            threads=threads,
            may_stand=True,
            fidelity=plan.fidelity,
            probes=plan.probes,
            surrogate_map=plan.vibration,
        )
        self.units: list[Unit | None] = [None] * count
        self.profile: list[list[tuple[float, ...]]] = [[] for _ in range(count)]
        self.decided = False
        self.actions = np.zeros((count, 2), dtype=np.float32)
        self.last: Step | None = None
        self._probes: list[dict[str, float] | None] = [None] * count
        self._players = Players(count)
        self._observation: npt.NDArray[np.float32] = self.episodes.observation.copy()
        self._active: BoolArray = np.zeros(count, dtype=bool)

    @property
    def over(self) -> bool:
        """Whether everything has been played."""
        return not self.missing and not self.episodes.running.any()

    @property
    def active(self) -> BoolArray:
        """(N,) which probes are in the period that was decided last."""
        return self._active

    def step(self) -> Iterator[Ended]:
        """A control period of all; gives the episodes that end with it."""
        self.decide()
        yield from self.advance()

    def decide(self) -> None:
        """Begin episodes where none is running, and have the policies decide on the coming period."""
        idle = [k for k in range(len(self.units)) if not self.episodes.running[k]]
        fresh = []
        for k in idle[: len(self.missing)]:
            unit = self.units[k] = self.missing.popleft()
            self.profile[k] = []
            self._players.begin(k, self.plan.policies[unit[0]])
            fresh.append(k)
        if fresh:
            self._begin(fresh)
        self._active = self.episodes.running.copy()
        self.actions = self._players.act(self._observation, self._active, self.episodes)
        self.decided = True

    def advance(self) -> Iterator[Ended]:
        """Play the period that was decided on; gives the episodes that end with it."""
        way = self.episodes.passes.way.copy()
        step = self.last = self.episodes.step(self.actions, self._active)
        self.decided = False
        self._observation = step.observation
        for k in np.flatnonzero(self._active).tolist():
            info = step.infos[k]
            if way[k] > 0.0:  # per metre of the way in, to its last period
                self.profile[k].append(tuple(float(info.get(name, np.nan)) for name in (*CARRIED, *HEARD)))
            if "episode_kpis" in info:
                yield Ended(self.unit(k), info["episode_kpis"], self.profile[k], self._probes[k])

    def observed(self, k: int) -> npt.NDArray[np.float32]:
        """(1, d) what the policy of a probe sees when it decides next."""
        return self._observation[k : k + 1]

    def _begin(self, fresh: list[int]) -> None:
        units = {k: self.unit(k) for k in fresh}
        options = {k: {"context": self.plan.contexts[context]} for k, (_, context, _) in units.items()}
        rngs = {k: np.random.default_rng([seed, context]) for k, (_, context, seed) in units.items()}
        self._observation, started = self.episodes.reset(fresh, rngs, options)
        if self.plan.probes == "random":
            for k in fresh:
                self._probes[k] = {name: started[k]["probe"][name] for name in RANGES}

    def unit(self, k: int) -> Unit:
        """What a probe plays."""
        unit = self.units[k]
        assert unit is not None
        return unit
