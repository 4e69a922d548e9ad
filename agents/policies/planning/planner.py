"""Sampling-based predictive control on copies of the simulator: what feedback could win at best, the measure of others.

Every few periods some candidates of feed and air are held for a while on copies of the probe, as the simulator goes on
from its present state; what they earn, and what the vibration map says of the rest, decides. Nothing of that can be
known at a rig, so a planner is no controller to build but the headroom of one. Blurred states and an estimated tube
take away, step by step, what a rig does not know.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt

from agents.policies.maps.lookup import looked_up
from agents.policies.on_map import FRICTION_STEP, FRICTIONS, MapPolicy
from agents.policies.planning.candidates import drawn
from agents.policies.planning.outlook import Estimate, looked_ahead
from agents.policies.planning.rest import worth_of_rest
from probe_env import Context
from probe_env.arrays import FloatArray
from probe_env.envs.episodes import Episodes
from probe_env.envs.task.observations import in_si_units
from probe_env.physics.closed_forms import MEASURED, friction_from_tension

Memory = tuple[int, float, float, float]
"""Periods since the start, feed [m/s] and air [m3/s] that are held, and the friction that is estimated."""


@dataclass
class Planner(MapPolicy):
    """Receding horizon over ``periods`` control periods, ``candidates`` of feed and air, every ``every`` periods anew.

    Attributes:
        periods: that a candidate is held on the copies.
        candidates: tried each time.
        every: periods from one plan to the next.
        blur: standard deviation of what is known of the nodes' radial places [m].
        tube: "true", or "estimated": friction from the root tension, the rest as the scene's.
        rest: what comes after the periods is worth what the "map" says, or "nothing".
        average: time constant of the friction's average [s].
        prior: friction that is expected at first.
        seed: of the draws.
    """

    periods: int = 4
    candidates: int = 16
    every: int = 2
    blur: float = 0.0
    tube: Literal["true", "estimated"] = "true"
    rest: Literal["map", "nothing"] = "map"
    average: float = 15.0
    prior: float = 0.175
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("periods", "candidates", "every"):
            if not 1 <= getattr(self, name) <= 1000:
                raise ValueError(f"{name} = {getattr(self, name)!r} is outside the accepted range 1 to 1000")

    def targets(self, seen: dict[str, FloatArray], memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Not there.

        Raises:
            ValueError: always: observations alone are not enough to look ahead.
        """
        raise ValueError("a planner tries things out on the simulator itself: play it with `probe-env evaluate`")

    def decide(
        self, episodes: Episodes, which: Sequence[int], observation: npt.NDArray[np.float32], states: Sequence[Any]
    ) -> tuple[npt.NDArray[np.float32], list[Any]]:
        """Actions (n, 2) and states of running episodes, see ``probe_env.envs.trials.Foresighted``.

        Raises:
            ValueError: the task does not show the root tension that an estimated tube needs, or see ``looked_ahead``.
        """
        started = zip(which, states, strict=True)
        memories = [self._begin(episodes, k) if state is None else state for k, state in started]
        if self.tube == "estimated":
            memories = self._estimated(observation, memories)
        due = [row for row, memory in enumerate(memories) if memory[0] % self.every == 0]
        # all that are due at the same time of their own: draws depend on that, not on company
        for time in sorted({memories[row][0] for row in due}):
            rows = [row for row in due if memories[row][0] == time]
            chosen = self._planned(episodes, [which[row] for row in rows], [memories[row] for row in rows])
            for row, (feed, air) in zip(rows, chosen, strict=True):
                memories[row] = (time, float(feed), float(air), memories[row][3])
        held = np.array([memory[1:3] for memory in memories])
        actions = self.config.actions(held[:, 0], held[:, 1]).astype(np.float32)
        return actions, [(time + 1, feed, air, friction) for time, feed, air, friction in memories]

    def _begin(self, episodes: Episodes, k: int) -> Memory:
        simulator = episodes.batch.simulators[k]
        return 0, simulator.feed_speed, simulator.air_supply_rate, self.prior

    def _estimated(self, observation: npt.NDArray[np.float32], memories: Sequence[Memory]) -> list[Memory]:
        """Memories with the friction that the tension suggests, averaged."""
        seen = in_si_units(self.config, np.asarray(observation))
        if "root_tension" not in seen:
            raise ValueError("a planner in an estimated tube needs a task that shows the root tension")
        read = np.clip(friction_from_tension({name: seen[name] for name in MEASURED}, self.config.scene), *FRICTIONS)
        gain = 1.0 - np.exp(-self.config.period / self.average)
        return [(*m[:3], m[3] + gain * (float(mu) - m[3])) for m, mu in zip(memories, read, strict=True)]

    def _planned(self, episodes: Episodes, which: Sequence[int], memories: Sequence[Memory]) -> FloatArray:
        """(n, 2) feed [m/s] and air [m3/s] of the best candidates."""
        contexts = [episodes.context[k] for k in which]
        scenes = None
        if self.tube == "estimated":
            contexts = [_tube(context, memory[3]) for context, memory in zip(contexts, memories, strict=True)]
            scenes = {k: _moved(episodes, k, context) for k, context in zip(which, contexts, strict=True)}
        inserted = np.array([episodes.batch.simulators[k].inserted_length for k in which])
        mapped = np.column_stack(looked_up(contexts, inserted, self.config, self.vibration))
        kept = np.array([memory[1:3] for memory in memories])
        entropy = [self.seed, memories[0][0]]
        tried = drawn(kept, mapped, self.candidates, self.config, entropy)
        outlook = looked_ahead(episodes, which, tried, self.periods, Estimate(self.blur, scenes), entropy)
        worth = outlook.reward.copy()
        if self.rest == "map":
            for row, context in enumerate(contexts):
                rest = worth_of_rest(context, outlook.inserted[row], self.config, self.vibration)
                worth[row] += np.where(outlook.over[row], 0.0, rest)
        return np.take_along_axis(tried, worth.argmax(axis=1)[:, None, None], axis=1)[:, 0]


def _tube(context: Context, friction: float) -> Context:
    """What a rig takes the tube for: its own helix, the friction that it estimates, the rest as usual."""
    return Context(
        friction=round(round(friction / FRICTION_STEP) * FRICTION_STEP, 4), helix_diameter=context.helix_diameter
    )


def _moved(episodes: Episodes, k: int, tube: Context) -> Any:
    """The scene that an episode began in, in another tube."""
    scene = episodes.starts.build(tube, {})
    truth = episodes.batch.simulators[k].scene
    return scene.model_copy(update={"probe": truth.probe, "carrier_length": truth.carrier_length})


BLUR: Final = 1e-5
"""[m]: what no rig can know exactly, the radial place of every float."""
PLANNERS: Final[dict[str, dict[str, Any]]] = {
    "planner": {},
    "planner-blurred": {"blur": BLUR},
    "planner-estimated": {"blur": BLUR, "tube": "estimated"},
}
"""Names and settings."""
