"""Both passes: a policy for the way in with a schedule for the way back, and how closely they are simulated."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from agents.policies.domain import Domain
from agents.policies.fixed import STUDY_AIR
from agents.rollouts.plan import Policy
from probe_env.envs.task import TaskConfig
from probe_env.envs.task.observations import in_si_units
from probe_env.fidelity import BOTH_WAYS, PRESETS, Fidelity, draws_back, resolve_fidelity
from probe_env.schedule import Schedule

if TYPE_CHECKING:
    from agents.policies.bundle import Agent

SIGNED: Final = ("feed_speed", "air_supply_rate", "root_tension")
"""What turns round with the probe."""


def fastest_back(config: TaskConfig) -> Schedule:
    """Drawn as fast as the feed device can, with the study's air, or the nearest that there is."""
    feed, air = config.given(config.feed_speeds[1], STUDY_AIR)[0]
    return Schedule("inserted_length", "linear", (0.0,), (float(feed),), (float(air),))


@dataclass
class BothWays:
    """A policy of the way in, which sees the task of an insertion, and a schedule over length for the way back.

    Attributes:
        config: the task of both passes.
        forth: made for ``way_in`` of the task.
        back: over inserted length.
    """

    config: TaskConfig
    forth: Policy
    back: Schedule = field(default_factory=lambda: fastest_back(TaskConfig()))

    def predict(
        self,
        observation: npt.NDArray[np.floating],
        state: Any = None,
        episode_start: npt.NDArray[np.bool_] | None = None,
        deterministic: bool = False,
    ) -> tuple[npt.NDArray[np.float32], Any]:
        """Actions for observations (d,) or (N, d), and the state to give back next time.

        On the way back what is seen of the drive is shown to the policy of the way in as if the probe were pulled, so
        that it remains in its range; what it says is not asked for.
        """
        rows = np.atleast_2d(observation)
        names = list(self.config.observations)
        seen = in_si_units(self.config, rows)
        back = seen["way"] < 0.0
        shown = rows.copy()
        for name in SIGNED:
            if name in names:
                column = names.index(name)
                shown[back, column] = np.abs(shown[back, column])
        shown = np.delete(shown, names.index("way"), axis=1)
        actions, state = self.forth.predict(shown, state, episode_start, deterministic)
        drawn = self.config.actions(*self.back.at(seen["inserted_length"])).astype(np.float32)
        actions = np.where(back[:, None], drawn, np.atleast_2d(actions))
        return (actions[0] if np.ndim(observation) == 1 else actions), state

    def describe(self) -> dict[str, Any]:
        """What it is, as JSON-ready data; equal for equal policies."""
        way_back = {"position": self.back.position, "feed_speed": self.back.feed_speed}
        way_back["air_supply_rate"] = self.back.air_supply_rate
        return {"policy": type(self).__name__, "forth": self.forth.describe(), "back": way_back}


@dataclass
class InSteps:
    """An agent of both ways whose feed is in whole steps, as of the device that it was trained with.

    Every change of the feed shakes a probe that is drawn back, and what a network says is never twice the same.

    Attributes:
        config: the task that it acts in.
        agent: made for this task.
        step: of the feed [m/s].
    """

    config: TaskConfig
    agent: Agent
    step: float

    @property
    def domain(self) -> Domain:
        """That of the agent."""
        return self.agent.domain

    def predict(
        self,
        observation: npt.NDArray[np.floating],
        state: Any = None,
        episode_start: npt.NDArray[np.bool_] | None = None,
        deterministic: bool = False,
    ) -> tuple[npt.NDArray[np.float32], Any]:
        """Actions for observations (d,) or (N, d), and the state to give back next time."""
        actions, state = self.agent.predict(observation, state, episode_start, deterministic)
        feed, air = self.config.targets(np.atleast_2d(actions)).T
        stepped = self.config.actions(self.step * np.round(feed / self.step), air).astype(np.float32)
        return (stepped[0] if np.ndim(observation) == 1 else stepped), state

    def describe(self) -> dict[str, Any]:
        """What it is, as JSON-ready data; equal for equal policies."""
        return {"policy": type(self).__name__, "step": self.step, "of": self.agent.describe()}


def way_in(config: TaskConfig) -> TaskConfig:
    """The task of the way in alone."""
    return config.model_copy(update={"passes": "in"})


def fidelity_of(name: str) -> Fidelity:
    """A fidelity of both ways by its name.

    Raises:
        ValueError: no such fidelity, or one that does not simulate the way back.
    """
    check_goes_back("fidelity", name)
    return resolve_fidelity(name, both_ways=True)


def check_goes_back(field: str, name: str) -> None:
    """Raise ValueError unless a fidelity, by its name, simulates the way back; ``field`` is whose value it is."""
    presets = [preset for preset, settings in PRESETS.items() if draws_back(settings)]
    known = (*BOTH_WAYS, *presets)
    if name not in known:
        raise ValueError(f"{field} = {name!r} does not simulate the way back; give one of {', '.join(known)}")
