"""Model-predictive control on copies of the simulator: an upper bound for feedback, no controller for a rig.

Every few control periods, candidates of feed and air are simulated on copies of the running episodes; the one with the
largest sum of simulated and expected remaining reward is applied. Averages over copies with noise on the state, and
tubes inferred from the measurements, remove information that a rig does not have.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from functools import lru_cache
from itertools import chain
from typing import Any, Final, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from probe_agents.policies.on_map import MARGIN, expected_costs, knots, min_air, targets_on_map
from probe_agents.policies.policy import Domain
from probe_env import Context
from probe_env.arrays import BoolArray, FloatArray
from probe_env.envs.episodes import Episodes
from probe_env.envs.episodes.predicted import MEASURED
from probe_env.envs.task.config import TaskConfig
from probe_env.envs.task.observations import in_si_units
from probe_env.envs.task.rules import metre_reward, uninspected_weight
from probe_env.envs.task.scales import RF_FLOOR
from probe_env.envs.vibration_map import CONTEXT, VibrationMap, stored_map
from probe_env.physics.closed_forms import entrance_tension, sliding_tension

WIDE: Final = (0.5, 0.25)
"""Standard deviations of wide candidates: of the logarithm of the feed, and of the air as a share of its range."""
NEAR: Final = (0.12, 0.06)
"""Standard deviations of near candidates."""
BLUR: Final = 1e-5
"""Uncertainty of the radial position of every float on a rig [m]."""
ENSEMBLE: Final = 256
"""Number of tubes among which the true one is inferred."""
INDEPENDENT: Final = (1.0 + MEASURED.tension.correlation) / (1.0 - MEASURED.tension.correlation)
"""Time in which errors of the tension are as good as one independent error [s]; those of the noise persist as long."""
PLANNERS: Final[dict[str, dict[str, Any]]] = {
    "planner": {},
    "planner-averaged": {"blur": BLUR, "copies": 8},
    "planner-inferred": {"blur": BLUR, "copies": 8, "tube": "inferred"},
}
"""Names and settings."""


class Memory(NamedTuple):
    """State of an episode: periods since its start, current feed [m/s] and air [m3/s].

    ``likelihood`` (``ENSEMBLE``,) is the logarithm of the likelihood of all measurements in each tube.
    """

    time: int
    feed: float
    air: float
    likelihood: FloatArray


@dataclass
class InsertionPlanner:
    """Every ``every`` control periods, simulates ``candidates`` of feed and air for ``periods`` and applies the best.

    With ``tube = "inferred"`` each copy of a candidate is in a tube of an ensemble, resampled for each decision by the
    likelihood of the root tension and noise so far. The ensemble is uniform in the map's ranges of friction, contact
    stiffness and drag. The helix diameter is observed.

    Attributes:
        config: the task.
        periods: control periods for which a candidate is held.
        candidates: number of candidates.
        every: control periods between two decisions.
        blur: standard deviation of the noise on the nodes' radial positions [m].
        copies: simulations of a candidate, each with other noise; the mean of their rewards counts.
        seed: seed of candidates, noise and inferred tubes.
        vibration: vibration map of the remaining reward; default: the shipped one.
        tube: "true" or "inferred".
    """

    config: TaskConfig
    periods: int = 4
    candidates: int = 16
    every: int = 2
    blur: float = 0.0
    copies: int = 1
    seed: int = 0
    vibration: VibrationMap = field(default_factory=stored_map)
    tube: Literal["true", "inferred"] = "true"

    def __post_init__(self) -> None:
        for name in ("periods", "candidates", "every", "copies"):
            if not 1 <= getattr(self, name) <= 1000:
                raise ValueError(f"{name} = {getattr(self, name)!r} is outside the accepted range 1 to 1000")

    @property
    def domain(self) -> Domain:
        """Tubes of the map."""
        return Domain.of_map(self.vibration)

    def predict(
        self,
        observation: npt.NDArray[np.floating],
        state: Any = None,
        episode_start: npt.NDArray[np.bool_] | None = None,
        deterministic: bool = False,
    ) -> tuple[npt.NDArray[np.float32], Any]:
        """Not available."""
        raise ValueError("a planner needs the simulator, not only observations: run it with `probe-env evaluate`")

    def describe(self) -> dict[str, Any]:
        """JSON-ready, with a hash of the map."""
        settings = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in ("config", "vibration")}
        return {"policy": type(self).__name__, **settings, "map": self.vibration.digest, "margin": MARGIN}

    def plan_actions(
        self, episodes: Episodes, which: Sequence[int], observation: npt.NDArray[np.float32], states: Sequence[Any]
    ) -> tuple[npt.NDArray[np.float32], list[Any]]:
        """Actions (n, 2) and new states of n running episodes for their observations (n, d) and states."""
        memories: list[Memory] = []
        for k, state in zip(which, states, strict=True):
            simulator = episodes.simulated().simulators[k]
            memories.append(state or Memory(0, simulator.feed_speed, simulator.air_supply_rate, np.zeros(ENSEMBLE)))
        memories = self._with_likelihood(observation, memories)
        due = [row for row, memory in enumerate(memories) if memory.time % self.every == 0]
        # grouped by time: candidates depend on the time of an episode, not on the other episodes of the batch
        for time in sorted({memories[row].time for row in due}):
            rows = [row for row in due if memories[row].time == time]
            best = self._best(episodes, [which[row] for row in rows], [memories[row] for row in rows])
            for row, (feed, air) in zip(rows, best.tolist(), strict=True):
                memories[row] = memories[row]._replace(feed=feed, air=air)
        feeds, airs = (np.array([getattr(memory, name) for memory in memories]) for name in ("feed", "air"))
        actions = self.config.actions(feeds, airs).astype(np.float32)
        return actions, [memory._replace(time=memory.time + 1) for memory in memories]

    def _best(self, episodes: Episodes, which: Sequence[int], memories: Sequence[Memory]) -> FloatArray:
        """(n, 2) feed [m/s] and air [m3/s] of the best candidates; the episodes are not changed."""
        entropy = [self.seed, memories[0].time]
        held = np.array([(memory.feed, memory.air) for memory in memories])
        inserted = episodes.inserted_length[list(which)]
        tubes = self._tubes([episodes.context[k] for k in which], memories)
        candidates = self._candidates(tubes, inserted, held, entropy)
        candidates[..., 0] = np.minimum(candidates[..., 0], self.config.permitted_feed)
        copies = episodes.branch(np.repeat(which, self.copies * self.candidates).tolist())
        for row, tube in enumerate(chain.from_iterable(tubes)):
            alike = range(row * self.candidates, (row + 1) * self.candidates)
            if tube is not copies.context[alike[0]]:
                move_to(tube, copies, alike)
            blur_states(copies, alike, self.blur, [*entropy, row % self.copies])
        rows = np.repeat(candidates, self.copies, axis=0).reshape(-1, 2)
        worth = reward_of_holding(copies, rows, self.periods) + self._rest(copies)
        best = worth.reshape(len(which), self.copies, -1).mean(axis=1).argmax(axis=1)
        return np.take_along_axis(candidates, best[:, None, None], axis=1)[:, 0]

    def _with_likelihood(self, observation: npt.NDArray[np.float32], memories: list[Memory]) -> list[Memory]:
        """Memories with the likelihood of the observations."""
        if self.tube == "true":
            return memories
        measured = in_si_units(self.config, np.asarray(observation))
        if "root_tension" not in measured:
            raise ValueError("planner-inferred needs the root tension (observe_root_tension = true)")
        fraction, weighed = self.config.period / INDEPENDENT, []
        for row, memory in enumerate(memories):  # one by one: products of matrices of other sizes round differently
            latest = self._log_likelihood({name: np.full(ENSEMBLE, column[row]) for name, column in measured.items()})
            weighed.append(memory._replace(likelihood=memory.likelihood + fraction * latest))
        return weighed

    def _log_likelihood(self, measured: dict[str, FloatArray]) -> FloatArray:
        """(``ENSEMBLE``,) of the root tension and noise of a period in each tube, up to a constant.

        The tension is that of steady sliding and the noise that of the map, with the errors fitted for the surrogate.
        """
        config, tubes = self.config, self._ensemble(measured["helix_diameter"])
        length, feed, air = (measured[name] for name in ("inserted_length", "feed_speed", "air_supply_rate"))
        steady = sliding_tension(tubes[:, 0], measured, config.scene, tubes[:, 2])
        tension = measured["root_tension"] + entrance_tension(config.scene, tubes[:, 3])
        mean = self.vibration.predict(length, np.maximum(feed, 1e-3), air, tubes, config.scene)[0] + MEASURED.bias
        noise = measured["rf_noise"] / np.hypot(10.0**mean * 1e-4, RF_FLOOR)
        scatter = MEASURED.field.deviation, MEASURED.slow.deviation, MEASURED.quick
        errors = (
            np.log(np.maximum(tension, 0.1) / np.maximum(steady, 0.1))
            / np.hypot(MEASURED.tension.deviation, config.tension_noise),
            np.log10(noise) / np.linalg.norm(scatter),
        )
        # limited: soon after a change of the feed neither holds
        return np.asarray(-0.5 * np.minimum(np.square(errors), 9.0).sum(axis=0))

    def _ensemble(self, helix_diameter: FloatArray | float) -> FloatArray:
        """(``ENSEMBLE``, 4) tubes in the order of ``CONTEXT``, by friction: so resampling is stratified by it."""
        low, high = self.vibration.ranges
        tubes = np.random.default_rng([self.seed, 0, 1]).uniform(low, high, (ENSEMBLE, len(CONTEXT)))
        tubes[:, 0].sort()
        tubes[:, 3] = helix_diameter
        return tubes

    def _tubes(self, tubes: list[Context], memories: Sequence[Memory]) -> list[list[Context]]:
        """Tubes of the simulated copies of each episode, for the true tubes."""
        if self.tube == "true":
            return [[tube] * self.copies for tube in tubes]
        start, inferred = np.random.default_rng([self.seed, memories[0].time, 2]).random(), []
        places = (np.arange(self.copies) + start) / self.copies
        for memory, tube in zip(memories, tubes, strict=True):
            below = np.cumsum(np.exp(memory.likelihood - memory.likelihood.max()))
            drawn = self._ensemble(tube.helix_diameter)[np.searchsorted(below, places * below[-1])]
            inferred.append([Context(**dict(zip(CONTEXT, values, strict=True))) for values in drawn.tolist()])
        return inferred

    def _candidates(
        self, tubes: Sequence[Sequence[Context]], inserted: FloatArray, held: FloatArray, entropy: list[int]
    ) -> FloatArray:
        """(n, candidates, 2) feed [m/s] and air [m3/s] to try."""
        each, lengths = list(chain.from_iterable(tubes)), np.repeat(inserted, self.copies)
        best = np.column_stack(targets_on_map(each, lengths, self.config, self.vibration))
        suggested = best.reshape(len(tubes), self.copies, 2).mean(axis=1)
        needed = np.array([min_air(self.config, tube, MARGIN) for tube in each]).reshape(len(tubes), -1).max(axis=1)
        least_air = np.minimum(needed, min_air(self.config))
        return candidates_near(held, suggested, self.candidates, self.config, entropy, least_air)

    def _rest(self, copies: Episodes) -> FloatArray:
        """(N,) expected reward of the rest of the insertion."""
        inserted = copies.inserted_length
        pairs = zip(copies.context, inserted, strict=True)
        rest = np.array([remaining_reward(tube, at, self.config, self.vibration) for tube, at in pairs])
        # a slack cable will lose the drive, which the map does not include
        lost_drive = -uninspected_weight(self.config) * (copies.helix_length - inserted)
        return np.where(copies.running, np.where(is_slack(copies), lost_drive, rest), 0.0)


def candidates_near(
    held: FloatArray, suggested: FloatArray, count: int, config: TaskConfig, entropy: list[int], least_air: FloatArray
) -> FloatArray:
    """(n, count, 2) feed speeds [m/s] and air supplies [m3/s], rounded like the plant's devices.

    All episodes at the same time share the random numbers, so an episode does not depend on the rest of the batch.

    Args:
        held: (n, 2) current feed and air: the first candidate.
        suggested: (n, 2) best setting by the map: the second candidate.
        count: number of candidates, at least 1.
        config: task.
        entropy: seed of the generator.
        least_air: (n,) least air of the random candidates [m3/s]: the copies do not show a drive that is lost later.
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
        tried[:, k, 1] = np.maximum(centre[:, 1] + spread[1] * (high - low) * normal[row, 1], least_air)
    # through float32 actions: in a chaotic motion digits beyond float32 would change the result
    actions = config.actions(tried[..., 0].ravel(), tried[..., 1].ravel()).astype(np.float32)
    return np.asarray(config.targets(actions)).reshape(tried.shape)


def move_to(tube: Context, copies: Episodes, which: range) -> None:
    """Continue copies of one episode in another tube."""
    simulators = copies.simulated().simulators
    begun = {name: getattr(simulators[which[0]].scene, name) for name in ("probe", "carrier_length")}
    scene = copies.sampler.build(tube, {}).model_copy(update=begun)
    moved = simulators[which[0]].branch(scene)
    for k in which:
        simulators[k] = moved.branch()
        copies.set_tube(k, tube, scene)


def blur_states(copies: Episodes, which: range, blur: float, entropy: list[int]) -> None:
    """Displace the nodes of copies of one episode radially by the same noise [m]."""
    simulators = copies.simulated().simulators
    first = simulators[which[0]]
    noise = blur * np.random.default_rng([*entropy, first.steps_done]).normal(size=first.root)
    for k in which:
        simulators[k].displace(noise)


def remaining_reward(tube: Context, inserted: FloatArray, config: TaskConfig, vibration: VibrationMap) -> FloatArray:
    """Expected reward of the best schedule from inserted lengths [m] (any shape) to the end of the helix."""
    return np.interp(inserted, *_remaining_rewards(tube, config, vibration))


@lru_cache(maxsize=1024)
def _remaining_rewards(tube: Context, config: TaskConfig, vibration: VibrationMap) -> tuple[FloatArray, FloatArray]:
    """Lengths (k,) [m] and the remaining reward at each."""
    end = config.scene.tube.helix_length
    lengths = np.minimum(knots(config), end)
    values = np.array([[getattr(tube, name) for name in CONTEXT]])
    rate = metre_reward(config, expected_costs(values, config, 0.0, vibration)[0].min(axis=1))
    if lengths[-1] < end:  # as the last knot is
        lengths, rate = np.append(lengths, end), np.append(rate, rate[-1])
    steps = 0.5 * (rate[1:] + rate[:-1]) * np.diff(lengths)
    return lengths, np.append(np.cumsum(steps[::-1])[::-1], 0.0)


def reward_of_holding(copies: Episodes, held: FloatArray, periods: int) -> FloatArray:
    """(N,) reward of some periods with constant feed [m/s] and air [m3/s] (N, 2)."""
    actions = copies.config.actions(held[:, 0], held[:, 1]).astype(np.float32)
    reward = np.zeros(len(copies))
    for _ in range(periods):
        running = copies.running.copy()
        if not running.any():
            break
        reward += np.where(running, copies.step(actions, running).reward, 0.0)
    return reward


def is_slack(episodes: Episodes) -> BoolArray:
    """(N,) whether the cable is slack, so that the drive will be lost."""
    return np.asarray(episodes.scorer.slack_periods > 0)
