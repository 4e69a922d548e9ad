"""Model-predictive control on copies of the simulator: an upper bound for feedback, no controller for a rig.

Every few control periods candidates of feed and air are held for a while on copies of the running episodes. The reward
of these periods and the expected reward of the rest decide. Noise on the state and an estimated tube take away what a
rig does not know. ``InsertionPlanner`` takes the rest from the vibration map; ``InspectionPlanner`` is for both passes.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from functools import lru_cache
from typing import Any, Final, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from agents.policies.fixed import gain
from agents.policies.on_map import FRICTION_STEP, FRICTIONS, LEAST_AIR, expected_costs, knots, looked_up
from agents.policies.policy import Domain
from probe_env import Context
from probe_env.arrays import BoolArray, FloatArray
from probe_env.envs.episodes import Episodes
from probe_env.envs.episodes.scoring import RoundTripScorer
from probe_env.envs.task import TaskConfig, costs, metre_reward, uninspected_weight
from probe_env.envs.task.observations import in_si_units
from probe_env.envs.vibration_map import CONTEXT, VibrationMap, stored_map
from probe_env.physics.closed_forms import MEASURED, friction_from_tension

WIDE: Final = (0.5, 0.25)
"""Standard deviations of a wide draw: of the logarithm of the feed, and of the air as a share of its range."""
NEAR: Final = (0.12, 0.06)
"""Standard deviations of a near draw."""
BLUR: Final = 1e-5
"""[m]: radial position of every float that no rig can know exactly."""
PLANNERS: Final[dict[str, dict[str, Any]]] = {
    "planner": {},
    "planner-blurred": {"blur": BLUR},
    "planner-estimated": {"blur": BLUR, "tube": "estimated"},
}
"""Names and settings of planners of insertions."""
INSPECTION_PLANNERS: Final = {name: PLANNERS[name] for name in ("planner", "planner-blurred")}
"""Those of both passes."""


class Memory(NamedTuple):
    """State of an episode: periods since its start, feed [m/s] and air [m3/s] that are held, estimated friction."""

    time: int
    feed: float
    air: float
    friction: float


@dataclass
class ModelPredictivePolicy(ABC):
    """Decides every ``every`` control periods between ``candidates`` of feed and air, held on copies for ``periods``.

    Attributes:
        config: the task.
        periods: control periods for which a candidate is held.
        candidates: number of candidates.
        every: control periods between two decisions.
        blur: standard deviation of the nodes' radial positions as they are known [m].
        seed: of the draws.
        prior: friction that is assumed at first.
    """

    config: TaskConfig
    periods: int = 4
    candidates: int = 16
    every: int = 2
    blur: float = 0.0
    seed: int = 0
    prior: float = 0.175

    def __post_init__(self) -> None:
        for name in ("periods", "candidates", "every"):
            if not 1 <= getattr(self, name) <= 1000:
                raise ValueError(f"{name} = {getattr(self, name)!r} is outside the accepted range 1 to 1000")

    def predict(
        self,
        observation: npt.NDArray[np.floating],
        state: Any = None,
        episode_start: npt.NDArray[np.bool_] | None = None,
        deterministic: bool = False,
    ) -> tuple[npt.NDArray[np.float32], Any]:
        """Not available.

        Raises:
            ValueError: always: observations alone are not enough to look ahead.
        """
        raise ValueError("a planner tries things out on the simulator itself: play it with `probe-env evaluate`")

    def describe(self) -> dict[str, Any]:
        """JSON-ready description."""
        settings = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in ("config", "vibration")}
        return {"policy": type(self).__name__, **settings}

    def decide(
        self, episodes: Episodes, which: Sequence[int], observation: npt.NDArray[np.float32], states: Sequence[Any]
    ) -> tuple[npt.NDArray[np.float32], list[Any]]:
        """Actions (n, 2) and states of n running episodes, by their observations (n, d) and states."""
        memories: list[Memory] = []
        for k, state in zip(which, states, strict=True):
            simulator = episodes.batch.simulators[k]
            memories.append(state or Memory(0, simulator.feed_speed, simulator.air_supply_rate, self.prior))
        memories = self._with_friction(observation, memories)
        due = [row for row, memory in enumerate(memories) if memory.time % self.every == 0]
        # together with those of the same time: the draws depend on the time, so not on what runs next to an episode
        for time in sorted({memories[row].time for row in due}):
            rows = [row for row in due if memories[row].time == time]
            best = self._best(episodes, [which[row] for row in rows], [memories[row] for row in rows])
            for row, (feed, air) in zip(rows, best.tolist(), strict=True):
                memories[row] = memories[row]._replace(feed=feed, air=air)
        feeds, airs = (np.array([getattr(memory, name) for memory in memories]) for name in ("feed", "air"))
        actions = self.config.actions(feeds, airs).astype(np.float32)
        return actions, [memory._replace(time=memory.time + 1) for memory in memories]

    def _best(self, episodes: Episodes, which: Sequence[int], memories: Sequence[Memory]) -> FloatArray:
        """(n, 2) feed [m/s] and air [m3/s] of the best candidates; the episodes themselves stay as they are."""
        entropy = [self.seed, memories[0].time]
        held = np.array([(memory.feed, memory.air) for memory in memories])
        inserted = episodes.inserted_length[list(which)]
        tubes = self._tubes([episodes.context[k] for k in which], memories)
        candidates = self._candidates(tubes, inserted, held, entropy)
        copies = episodes.fork(np.repeat(which, self.candidates).tolist())
        for row, (k, tube) in enumerate(zip(which, tubes, strict=True)):
            if tube is not episodes.context[k]:
                move_to(tube, copies, range(row * self.candidates, (row + 1) * self.candidates))
        blur_states(copies, self.blur, entropy)
        rows = candidates.reshape(-1, 2)
        worth = (earned(copies, rows, self.periods) + self._rest(copies, rows)).reshape(candidates.shape[:2])
        return np.take_along_axis(candidates, worth.argmax(axis=1)[:, None, None], axis=1)[:, 0]

    def _with_friction(self, observation: npt.NDArray[np.float32], memories: list[Memory]) -> list[Memory]:
        """Memories with the friction that the observations suggest."""
        return memories

    def _tubes(self, tubes: list[Context], memories: Sequence[Memory]) -> list[Context]:
        """Tubes in which is looked ahead, for the true ones."""
        return tubes

    @abstractmethod
    def _candidates(
        self, tubes: Sequence[Context], inserted: FloatArray, held: FloatArray, entropy: list[int]
    ) -> FloatArray:
        """(n, candidates, 2) feed [m/s] and air [m3/s] to try."""

    @abstractmethod
    def _rest(self, copies: Episodes, held: FloatArray) -> FloatArray:
        """(N,) expected reward after the periods in which feed and air (N, 2) were held."""


@dataclass
class InsertionPlanner(ModelPredictivePolicy):
    """Model-predictive control of an insertion.

    Attributes:
        vibration: map that the rest is taken from; default: the shipped one.
        tube: "true", or "estimated": friction from the root tension, the rest of the scene.
        rest: reward after the periods, from the "map", or "nothing".
        average: time constant of the average of the estimated friction [s].
    """

    vibration: VibrationMap = field(default_factory=stored_map)
    tube: Literal["true", "estimated"] = "true"
    rest: Literal["map", "nothing"] = "map"
    average: float = 15.0

    @property
    def domain(self) -> Domain:
        """Tubes of the map."""
        return Domain.of_map(self.vibration)

    def describe(self) -> dict[str, Any]:
        """With a hash of the map."""
        return super().describe() | {"map": self.vibration.digest, "least_air": LEAST_AIR}

    def _with_friction(self, observation: npt.NDArray[np.float32], memories: list[Memory]) -> list[Memory]:
        if self.tube == "true":
            return memories
        measured = in_si_units(self.config, np.asarray(observation))
        if "root_tension" not in measured:
            raise ValueError("a planner in an estimated tube needs a task that shows the root tension")
        friction = friction_from_tension({name: measured[name] for name in MEASURED}, self.config.scene)
        weight = gain(self.config, self.average)
        pairs = zip(memories, np.clip(friction, *FRICTIONS).tolist(), strict=True)
        return [m._replace(friction=m.friction + weight * (latest - m.friction)) for m, latest in pairs]

    def _tubes(self, tubes: list[Context], memories: Sequence[Memory]) -> list[Context]:
        if self.tube == "true":
            return tubes
        rounded = [round(round(memory.friction / FRICTION_STEP) * FRICTION_STEP, 4) for memory in memories]
        pairs = zip(rounded, tubes, strict=True)
        return [Context(friction=friction, helix_diameter=tube.helix_diameter) for friction, tube in pairs]

    def _candidates(
        self, tubes: Sequence[Context], inserted: FloatArray, held: FloatArray, entropy: list[int]
    ) -> FloatArray:
        best = np.column_stack(looked_up(tubes, inserted, self.config, self.vibration))
        return candidates_near(held, best, self.candidates, self.config, entropy)

    def _rest(self, copies: Episodes, held: FloatArray) -> FloatArray:
        inserted = copies.inserted_length
        rest = np.zeros(len(copies))
        if self.rest == "map":
            pairs = zip(copies.context, inserted, strict=True)
            rest = np.array([worth_of_rest(tube, at, self.config, self.vibration) for tube, at in pairs])
        # drive that is about to be lost is lost: the map does not know of it
        lost = -uninspected_weight(self.config) * (copies.helix_length - inserted)
        return np.where(copies.running, np.where(is_slack(copies), lost, rest), 0.0)


@dataclass
class InspectionPlanner(ModelPredictivePolicy):
    """Model-predictive control of both passes.

    The expected reward of the rest is that of holding the candidate on the present pass, and of the fastest, silent
    withdrawal. There is no map of withdrawals: a compressed probe hardly rings, but changes of its feed shake it.

    Raises:
        ValueError: a setting is out of range, or the withdrawal is not scored.
    """

    periods: int = 6
    candidates: int = 10
    every: int = 3

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.config.inspects == "in":
            raise ValueError(
                "inspects = 'in': the way back counts for nothing, so a planner of the way in is all there is; use"
                ' passes = "in"'
            )

    def _candidates(
        self, tubes: Sequence[Context], inserted: FloatArray, held: FloatArray, entropy: list[int]
    ) -> FloatArray:
        return candidates_for_both_passes(held, self.candidates, self.config, entropy)

    def _rest(self, copies: Episodes, held: FloatArray) -> FloatArray:
        return worth_of_both_passes(copies, held)


def candidates_for_both_passes(held: FloatArray, count: int, config: TaskConfig, entropy: list[int]) -> FloatArray:
    """(n, count, 2) feed speeds [m/s] and air supplies [m3/s] to try, as the plant's devices give them.

    What is held (n, 2), the fastest feed with the air that is held, and then in turn draws near what is held and the
    fastest feed with any air: what is good on one way is not on the other, and the turn leaves no time for small steps.
    """
    fastest, (least, most) = config.feed_speeds[1], config.air_supply_rates
    tried = candidates_near(held, np.column_stack([np.full(len(held), fastest), held[:, 1]]), count, config, entropy)
    airs = np.random.default_rng([*entropy, count]).uniform(least, most, size=count)
    actions = config.actions(np.full(count, fastest), airs).astype(np.float32)
    tried[:, 3::2] = config.targets(actions)[3::2]
    return tried


def candidates_near(
    held: FloatArray, suggested: FloatArray, count: int, config: TaskConfig, entropy: list[int]
) -> FloatArray:
    """(n, count, 2) feed speeds [m/s] and air supplies [m3/s] to try, as the plant's devices give them.

    The same draws serve all episodes of a time, so that an episode does not depend on what runs next to it.

    Args:
        held: (n, 2) feed and air now: the first candidate.
        suggested: (n, 2) what the map thinks best: the second, where there are two.
        count: of each, 1 and more.
        config: the task.
        entropy: of the generator.
    """
    rng = np.random.default_rng(entropy)
    tried = np.repeat(held[:, None], count, axis=1)
    tried[:, 1:2] = suggested[:, None]
    rest = np.arange(2, count)
    normal = np.clip(rng.normal(size=(len(rest), 2)), -3.0, 3.0)
    low, high = config.air_supply_rates
    for row, k in enumerate(rest.tolist()):
        spread = WIDE if row % 2 else NEAR
        centre = suggested if row % 4 == 1 else held
        tried[:, k, 0] = centre[:, 0] * np.exp(spread[0] * normal[row, 0])
        tried[:, k, 1] = centre[:, 1] + spread[1] * (high - low) * normal[row, 1]
    # as an action says it: a chaotic probe would make something else of the digits that float32 has not
    actions = config.actions(tried[..., 0].ravel(), tried[..., 1].ravel()).astype(np.float32)
    return np.asarray(config.targets(actions)).reshape(tried.shape)


def move_to(tube: Context, copies: Episodes, which: range) -> None:
    """Let copies of one episode go on in another tube."""
    simulators = copies.batch.simulators
    begun = {name: getattr(simulators[which[0]].scene, name) for name in ("probe", "carrier_length")}
    moved = simulators[which[0]].branch(copies.sampler.build(tube, {}).model_copy(update=begun))
    for k in which:
        simulators[k], copies.context[k] = moved.branch(), tube


def blur_states(copies: Episodes, blur: float, entropy: list[int]) -> None:
    """Displace the nodes of copies radially by noise [m], the same for all copies of a probe."""
    if blur <= 0.0:
        return
    for simulator in copies.batch.simulators:
        noise = np.random.default_rng([*entropy, simulator.steps_done]).normal(size=simulator.chain.node_count)
        simulator.displace(blur * noise[: simulator.root])


def worth_of_rest(tube: Context, inserted: FloatArray, config: TaskConfig, vibration: VibrationMap) -> FloatArray:
    """Expected reward of the best schedule from inserted lengths [m] (any shape) to the helix's end."""
    return np.interp(inserted, *_worth(tube, config, vibration))


@lru_cache(maxsize=1024)
def _worth(tube: Context, config: TaskConfig, vibration: VibrationMap) -> tuple[FloatArray, FloatArray]:
    """Lengths (k,) [m] and what is to come from each."""
    end = config.scene.tube.helix_length
    places = np.minimum(knots(config), end)
    values = np.array([[getattr(tube, name) for name in CONTEXT]])
    rate = metre_reward(config, expected_costs(values, config, 0.0, vibration)[0].min(axis=1))
    if places[-1] < end:  # as the last knot is
        places, rate = np.append(places, end), np.append(rate, rate[-1])
    steps = 0.5 * (rate[1:] + rate[:-1]) * np.diff(places)
    return places, np.append(np.cumsum(steps[::-1])[::-1], 0.0)


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


def is_slack(episodes: Episodes) -> BoolArray:
    """(N,) whether a cable hangs slack, so that its drive is about to be lost."""
    return np.array([metrics.consecutive_slack_steps > 0 for metrics in episodes.scorer.metrics])


def worth_of_both_passes(episodes: Episodes, held: FloatArray) -> FloatArray:
    """(N,) what is left to earn by probes that go both ways; 0 where an episode has ended.

    On the way that each is on (N, 2) feed [m/s] and air [m3/s] are held, from the turn on the feed is the fastest and
    the air the least. Of those that hang slack it is what losing the drive costs, for that is what follows.
    """
    config, passes = episodes.config, episodes.scorer
    assert isinstance(passes, RoundTripScorer)
    inserted, length = episodes.inserted_length, episodes.helix_length
    to_pass, shaken = passes.still_to_pass()
    forth, unseen = passes.direction > 0.0, length - passes.reached
    here = np.where(forth, length - inserted, to_pass) / held[:, 0]
    back = np.where(forth, length - passes.start, 0.0) / config.feed_speeds[1]
    spent = costs(config, shaken, here + back, held[:, 1] * here + config.air_supply_rates[0] * back)
    # what the way in shook was charged already, and a silent way back gives it again
    refund = spent["vibration"] if config.inspects == "best" else 0.0
    left = np.where(forth, length - passes.start, to_pass)
    metres = unseen if config.inspects == "best" else left
    worth = config.progress_weight * metres + refund - spent["time"] - spent["air"]
    lost = -uninspected_weight(config) * (unseen + left)
    return np.where(episodes.running, np.where(is_slack(episodes), lost, worth), 0.0)
