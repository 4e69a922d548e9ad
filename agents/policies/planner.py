"""Model-predictive control on copies of the simulator: an upper bound for feedback, no controller for a rig.

Every few control periods candidates of feed and air are held for a while on copies of the running probes. The reward of
these periods and the expected reward of the rest decide. Blurred states and an estimated tube take away what a rig does
not know. ``Planner`` is for insertions, with the vibration map for the rest; ``InspectionPlanner`` for both passes.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import lru_cache
from typing import Any, Final, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from agents.policies.lookup import expected_costs, knots, looked_up
from agents.policies.on_map import FRICTION_STEP, FRICTIONS, MapPolicy
from probe_env import Context, Scene
from probe_env.arrays import BoolArray, FloatArray
from probe_env.envs.episodes import Episodes
from probe_env.envs.episodes.scoring import RoundTripScorer
from probe_env.envs.task import (
    MEASURES,
    TaskConfig,
    air_used,
    any_ending,
    capped_square,
    consecutive_slack,
    costs,
    ending,
    metre_reward,
    reward_terms,
    slack,
    travel,
    uninspected_weight,
)
from probe_env.envs.task.observations import in_si_units
from probe_env.envs.vibration_map import CONTEXT, VibrationMap
from probe_env.physics.closed_forms import MEASURED, friction_from_tension
from probe_env.physics.simulation.batch import SimulatorBatch
from probe_env.physics.simulation.signals import SAMPLE_PERIOD

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
Memory = tuple[int, float, float, float]
"""Periods since the start, feed [m/s] and air [m3/s] that are held, and the estimated friction."""


class _RecedingHorizon:
    """Decides every ``every`` control periods for ``candidates`` of feed and air, held for ``periods`` on copies."""

    config: TaskConfig
    periods: int
    candidates: int
    every: int
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

    def decide(
        self, episodes: Episodes, which: Sequence[int], observation: npt.NDArray[np.float32], states: Sequence[Any]
    ) -> tuple[npt.NDArray[np.float32], list[Any]]:
        """Actions (n, 2) and states of running episodes, see ``probe_env.envs.trials.ModelPredictivePolicy``."""
        memories: list[Memory] = []
        for k, state in zip(which, states, strict=True):
            simulator = episodes.batch.simulators[k]
            memories.append(state or (0, simulator.feed_speed, simulator.air_supply_rate, self.prior))
        memories = self._estimated(observation, memories)
        due = [row for row, memory in enumerate(memories) if memory[0] % self.every == 0]
        # together with those of the same time: the draws depend on the time, so not on what runs beside an episode
        for time in sorted({memories[row][0] for row in due}):
            rows = [row for row in due if memories[row][0] == time]
            chosen = self._planned(episodes, [which[row] for row in rows], [memories[row] for row in rows])
            for row, (feed, air) in zip(rows, chosen.tolist(), strict=True):
                memories[row] = (time, feed, air, memories[row][3])
        held = np.array([memory[1:3] for memory in memories])
        actions = self.config.actions(held[:, 0], held[:, 1]).astype(np.float32)
        return actions, [(time + 1, feed, air, friction) for time, feed, air, friction in memories]

    def _estimated(self, observation: npt.NDArray[np.float32], memories: list[Memory]) -> list[Memory]:
        return memories

    @abstractmethod
    def _planned(self, episodes: Episodes, which: Sequence[int], memories: Sequence[Memory]) -> FloatArray:
        """(n, 2) feed [m/s] and air [m3/s] of the best candidates."""


@dataclass
class Planner(_RecedingHorizon, MapPolicy):
    """Model-predictive control of an insertion.

    Attributes:
        periods: control periods for which a candidate is held.
        candidates: number of candidates.
        every: control periods between two plans.
        blur: standard deviation of the nodes' radial positions as they are known [m].
        tube: "true", or "estimated": friction from the root tension, the rest of the scene.
        rest: reward after the periods, from the "map", or "nothing".
        average: time constant of the average of the estimated friction [s].
        prior: friction that is assumed at first.
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

    def targets(self, seen: dict[str, FloatArray], memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Not available, see ``predict``."""
        raise NotImplementedError

    def _estimated(self, observation: npt.NDArray[np.float32], memories: list[Memory]) -> list[Memory]:
        if self.tube == "true":
            return memories
        seen = in_si_units(self.config, np.asarray(observation))
        if "root_tension" not in seen:
            raise ValueError("a planner in an estimated tube needs a task that shows the root tension")
        read = np.clip(friction_from_tension({name: seen[name] for name in MEASURED}, self.config.scene), *FRICTIONS)
        gain = 1.0 - np.exp(-self.config.period / self.average)
        return [(*m[:3], m[3] + gain * (float(mu) - m[3])) for m, mu in zip(memories, read, strict=True)]

    def _planned(self, episodes: Episodes, which: Sequence[int], memories: Sequence[Memory]) -> FloatArray:
        contexts = [episodes.context[k] for k in which]
        scenes: dict[int, Scene] | None = None
        if self.tube == "estimated":
            read = [round(round(memory[3] / FRICTION_STEP) * FRICTION_STEP, 4) for memory in memories]
            contexts = [
                Context(friction=friction, helix_diameter=context.helix_diameter)
                for friction, context in zip(read, contexts, strict=True)
            ]
            scenes = {}  # in which the episodes began, in other tubes
            for k, context in zip(which, contexts, strict=True):
                truth = episodes.batch.simulators[k].scene
                own = {"probe": truth.probe, "carrier_length": truth.carrier_length}
                scenes[k] = episodes.sampler.build(context, {}).model_copy(update=own)
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


@dataclass
class InspectionPlanner(_RecedingHorizon):
    """Model-predictive control of both passes.

    The expected reward of the rest is that of holding the candidate on the present pass, and of the fastest, silent
    withdrawal. There is no map of withdrawals: a compressed probe hardly rings, but changes of its feed shake it.

    Attributes:
        config: the task of both passes.
        periods: control periods for which a candidate is held.
        candidates: number of candidates, see ``tried_both_ways``.
        every: control periods between two plans.
        blur: standard deviation of the nodes' radial positions as they are known [m].
        seed: of the draws.

    Raises:
        ValueError: a setting is out of range, or the withdrawal is not scored.
    """

    config: TaskConfig
    periods: int = 6
    candidates: int = 10
    every: int = 3
    blur: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.config.inspects == "in":
            raise ValueError(
                "inspects = 'in': the way back counts for nothing, so a planner of the way in is all there is; use"
                ' passes = "in"'
            )

    def describe(self) -> dict[str, Any]:
        """JSON-ready description."""
        own = {field.name: getattr(self, field.name) for field in fields(self) if field.name != "config"}
        return {"policy": type(self).__name__, **own}

    def _planned(self, episodes: Episodes, which: Sequence[int], memories: Sequence[Memory]) -> FloatArray:
        kept = np.array([memory[1:3] for memory in memories])
        entropy = [self.seed, memories[0][0]]
        tried = tried_both_ways(kept, self.candidates, self.config, entropy)
        copies = episodes.fork(np.repeat(which, self.candidates).tolist())
        blur_states(copies.batch, self.blur, entropy)
        each = tried.reshape(-1, 2)
        worth = earned(copies, each, self.periods) + worth_of_both_passes(copies, each)
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


def drawn(kept: FloatArray, mapped: FloatArray, count: int, config: TaskConfig, entropy: list[int]) -> FloatArray:
    """(n, count, 2) feed speeds [m/s] and air supplies [m3/s] to try, as the plant's devices give them.

    The same draws serve all episodes of a time, so that an episode does not depend on what runs beside it.

    Args:
        kept: (n, 2) what is fed and blown now: the first candidate.
        mapped: (n, 2) what the map thinks best: the second, where there are two.
        count: of each, 1 and more.
        config: the task.
        entropy: of the generator.
    """
    rng = np.random.default_rng(entropy)
    tried = np.repeat(kept[:, None], count, axis=1)
    tried[:, 1:2] = mapped[:, None]
    rest = np.arange(2, count)
    normal = np.clip(rng.normal(size=(len(rest), 2)), -3.0, 3.0)
    low, high = config.air_supply_rates
    for row, k in enumerate(rest.tolist()):
        spread = WIDE if row % 2 else NEAR
        centre = mapped if row % 4 == 1 else kept
        tried[:, k, 0] = centre[:, 0] * np.exp(spread[0] * normal[row, 0])
        tried[:, k, 1] = centre[:, 1] + spread[1] * (high - low) * normal[row, 1]
    # as an action says it: a chaotic probe would make something else of the digits that float32 has not
    actions = config.actions(tried[..., 0].ravel(), tried[..., 1].ravel()).astype(np.float32)
    return np.asarray(config.targets(actions)).reshape(tried.shape)


class Outlook(NamedTuple):
    """Result of (n, c) copies.

    Attributes:
        reward: of the periods.
        inserted: length at their end [m].
        over: whether the episode ended in them, or is slack at their end: then nothing comes after.
    """

    reward: FloatArray
    inserted: FloatArray
    over: BoolArray


class Estimate(NamedTuple):
    """State and tubes as a planner knows them.

    Attributes:
        blur: standard deviation of the nodes' radial positions [m].
        scenes: of probes whose tube is estimated; others are in their own.
    """

    blur: float = 0.0
    scenes: Mapping[int, Scene] | None = None


def looked_ahead(
    episodes: Episodes, which: Sequence[int], tried: FloatArray, periods: int, estimate: Estimate, entropy: list[int]
) -> Outlook:
    """Try feed and air on copies of running probes; the episodes themselves stay as they are.

    Args:
        episodes: that are running.
        which: (n,) of them.
        tried: (n, c, 2) feed speeds [m/s] and air supplies [m3/s], held throughout.
        periods: control periods to try.
        estimate: what is known of state and tube.
        entropy: of the generator of what is not known.

    Raises:
        ValueError: the task's vibration measure is one that only episodes hear, or the probe is drawn back, too.
    """
    config = episodes.config
    name = MEASURES[config.vibration_measure][0]
    if config.vibration_measure == "snr" or config.returns:
        raise ValueError(
            f"vibration_measure = {config.vibration_measure!r}, passes = {config.passes!r}: a planner looks ahead for"
            " displacement, velocity or acceleration, on the way in"
        )
    count = tried.shape[1]
    copies = episodes.batch.branch(np.repeat(which, count).tolist(), estimate.scenes)
    for simulator in copies.simulators:
        simulator.feed_length()  # a look ahead is in time-lapse throughout
    blur_states(copies, estimate.blur, entropy)
    feed, air = tried[..., 0].ravel(), tried[..., 1].ravel()
    length = np.array([s.scene.tube.helix_length for s in copies.simulators])
    hung = np.repeat([episodes.scorer.metrics[k].consecutive_slack_steps for k in which], count)
    time = np.repeat([episodes.scorer.metrics[k].time for k in which], count)
    change = config.actions(feed, air) - np.repeat(episodes.actions[list(which)].astype(float), count, axis=0)
    reward, left = np.zeros(len(feed)), np.ones(len(feed), dtype=bool)
    dynamic = config.period / episodes.fidelity.time_lapse
    for _ in range(periods):
        before, air_before = inserted_of(copies), np.array([s.air_supply_rate for s in copies.simulators])
        window = copies.advance(feed, air, dynamic, SAMPLE_PERIOD, left)
        good, after = left & ~window.diverged, inserted_of(copies)
        moved = np.where(good, travel(config, before, after, window.feed_speed), 0.0)
        squares = capped_square(config, window.statistics[name] / config.limit)
        time = time + config.period
        hung = consecutive_slack(hung, slack(config, window.statistics["tension_mean_n"], after) & good)
        ends = ending(config, after, length, hung, time, left, window.diverged)
        over = any_ending(ends)
        used = np.where(good, air_used(config, air_before, window.air_supply_rate), 0.0)
        ahead = np.where(over & config.growing, length - np.where(good, after, before), 0.0)
        terms = reward_terms(
            config, moved, moved * squares, config.period, used, ahead, ends["diverged"], action_change=change
        )
        reward += np.where(left, sum(terms.values()), 0.0)
        left, change = left & ~over, np.zeros_like(change)
    inserted = inserted_of(copies)
    hanging = left & (hung > 0)  # drive that is about to be lost is lost: the map does not know of it
    lost = reward_terms(config, 0.0, 0.0, 0.0, 0.0, np.where(hanging, length - inserted, 0.0))
    reward += sum(lost.values())
    shape = tried.shape[:2]
    return Outlook(reward.reshape(shape), inserted.reshape(shape), (~left | hanging).reshape(shape))


def blur_states(copies: SimulatorBatch, blur: float, entropy: list[int]) -> None:
    """Displace the nodes of copies radially by noise [m], the same for all copies of a probe."""
    if blur <= 0.0:
        return
    for simulator in copies.simulators:
        noise = np.random.default_rng([*entropy, simulator.steps_done]).normal(size=simulator.chain.node_count)
        simulator.displace(blur * noise[: simulator.root])


def inserted_of(copies: SimulatorBatch) -> FloatArray:
    """(N,) length of cable in the helix [m]."""
    return np.array([s.length_in_helix for s in copies.simulators])


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
    hanging = np.array([metrics.consecutive_slack_steps > 0 for metrics in episodes.scorer.metrics])
    lost = -uninspected_weight(config) * (unseen + left)
    return np.where(episodes.running, np.where(hanging, lost, worth), 0.0)
