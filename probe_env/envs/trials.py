"""How loud, slow and hard to drive a probe design is, in sections of constant length or in whole insertions.

All designs are compared over the same tube: the sensor from ``SENSOR_START`` to ``SENSOR_END``, which the longest guide
still reaches. What a long guide cannot inspect beyond it counts as lost progress.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Protocol

import numpy as np
import numpy.typing as npt

from probe_env.arrays import BoolArray, FloatArray
from probe_env.design import Design
from probe_env.envs.contexts import Context
from probe_env.envs.episodes import Episodes
from probe_env.envs.task import Outcome, TaskConfig, capped_square, reward_terms
from probe_env.fidelity import Fidelity
from probe_env.physics.batch import SimulatorBatch
from probe_env.scene import Scene
from probe_env.schedule import Schedule

SENSOR_START, SENSOR_END = 2.5, 50.0  # [m] from the entrance
SPAN: Final = SENSOR_END - SENSOR_START
POSITIONS: Final = (10.0, 20.0, 30.0, 40.0, 50.0)
"""[m] of the sensor, simulated at constant length."""
WIDTHS: Final = (12.5, 10.0, 10.0, 10.0, 5.0)
"""[m] of tube that each position stands for."""
SETTLE, MEASURE, SAMPLE_PERIOD, PERTURBATION = 1.0, 2.0, 1e-3, 1e-7  # [s], [s], [s], [m]


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


@dataclass(frozen=True)
class Candidate:
    """A probe that is tried in a tube.

    Attributes:
        design: of the probe.
        context: the tube.
        feed: a schedule over inserted length, or for whole insertions a policy.
        seed: of the start's perturbation; default: its place among the candidates.
    """

    design: Design
    context: Context
    feed: Schedule | Controller
    seed: int | None = None


@dataclass(frozen=True)
class Trial:
    """What N probes did in p places; SI units.

    Attributes:
        widths: (N, p) length of tube that was inspected there; 0 where the probe did not get to.
        feed_speed, air_supply_rate: (N, p) fed and blown there.
        radial_rms, root_tension: (N, p).
        deep: (N, p) whether so much is inserted that lost drive counts.
        lost_drive, diverged: (N,) whether it ended so.
        inspected: (N,) what the sensor saw to the end, where that was simulated.
    """

    widths: FloatArray
    feed_speed: FloatArray
    air_supply_rate: FloatArray
    radial_rms: FloatArray
    root_tension: FloatArray
    deep: BoolArray
    lost_drive: BoolArray
    diverged: BoolArray
    inspected: FloatArray | None = None


def try_sections(
    candidates: Sequence[Candidate],
    config: TaskConfig,
    fidelity: Fidelity | None = None,
    threads: int | None = None,
) -> Trial:
    """N probes at constant length, the sensor at ``POSITIONS``, all in one batch.

    From the first section on that diverges or has less than the required tension, nothing counts as inspected.

    Args:
        candidates: N.
        config: the task, with the scene that designs and contexts change.
        fidelity: method, step and mesh; there is no time-lapse at constant length.
        threads: at most so many; default: all cores.

    Raises:
        ValueError: a policy, or a schedule over time.
    """
    fidelity, base = fidelity or Fidelity(), config.scene
    shape = (len(candidates), len(POSITIONS))
    scenes = [
        scene
        for candidate in candidates
        for scene in section_scenes(candidate.design, candidate.context, _over_length(candidate.feed), base)
    ]
    inserted, speed, air = (
        np.array([getattr(scene, name) for scene in scenes]).reshape(shape)
        for name in ("inserted_length", "feed_speed", "air_supply_rate")
    )
    batch = SimulatorBatch(
        scenes, fidelity.method, fidelity.time_step, fidelity.nodes_per_pitch, threads=threads,
        seeds=[seed for seed in _seeds(candidates) for _ in POSITIONS], perturbation=PERTURBATION,
    )  # fmt: skip
    settled = batch.advance(None, None, SETTLE, SAMPLE_PERIOD)
    window = batch.advance(None, None, MEASURE, SAMPLE_PERIOD, ~settled.diverged)
    diverged = (settled.diverged | window.diverged).reshape(shape)
    rms, tension = (window.statistics[name].reshape(shape) for name in ("radial_rms_m", "tension_mean_n"))
    deep = inserted >= config.lost_drive_from
    slack = deep & ~diverged & (tension < config.required_tension)
    reached = np.cumsum(diverged | slack, axis=1) == 0
    widths = np.where(reached, WIDTHS, 0.0)
    lost, broken = np.asarray(slack.any(axis=1)), np.asarray(diverged.any(axis=1))
    return Trial(widths, speed, air, rms, tension, deep & ~diverged, lost, broken)


def _over_length(feed: Schedule | Controller) -> Schedule:
    if not isinstance(feed, Schedule) or feed.over != "inserted_length":
        raise ValueError(
            "feed: a policy or a schedule over time has no meaning at constant length; give one over inserted length"
        )
    return feed


def _seeds(candidates: Sequence[Candidate]) -> list[int]:
    return [k if candidate.seed is None else int(candidate.seed) for k, candidate in enumerate(candidates)]


def section_scenes(design: Design, context: Context, feed: Schedule, base: Scene) -> list[Scene]:
    """What is simulated of a design in a tube, for each of ``POSITIONS``."""
    probe, tube, scenes = design.probe(base.probe), context.apply(base), []
    for position in POSITIONS:
        carrier = round(round(position / probe.float_pitch) * probe.float_pitch, 6)
        inserted = carrier + probe.guide_length
        fed, blown = map(float, feed.at(inserted))
        room = max(base.tube.helix_length, inserted)  # rounding to the pitch may go some cm beyond
        update = {"probe": probe, "carrier_length": carrier, "feed_speed": fed, "air_supply_rate": blown}
        scenes.append(tube.model_copy(update={"tube": {"helix_length": room}, **update}))
    return scenes


def try_insertions(
    candidates: Sequence[Candidate],
    config: TaskConfig,
    fidelity: Fidelity | str = "standard",
    threads: int | None = None,
) -> Trial:
    """N whole insertions side by side, gathered by metre of the sensor's position; arguments as ``try_sections``.

    Raises:
        ValueError: a feed that is no policy with SB3's ``predict``.
    """
    count = len(candidates)
    episodes = Episodes(count, config, fidelity=fidelity, threads=threads)
    options = {
        k: {"context": candidate.context, "probe": candidate.design.built.model_dump()}
        for k, candidate in enumerate(candidates)
    }
    rngs = {k: np.random.default_rng(seed) for k, seed in enumerate(_seeds(candidates))}
    observation, _ = episodes.reset(range(count), rngs, options)
    places = int(np.ceil(SPAN))
    sums = {name: np.zeros((count, places)) for name in ("travel", "seconds", "air", "square", "tension", "periods")}
    ended = {name: np.zeros(count, dtype=bool) for name in ("lost_drive", "diverged")}
    guides = np.array([candidate.design.built.guide_length for candidate in candidates])
    players = Players(count)
    for k, candidate in enumerate(candidates):
        if isinstance(candidate.feed, Schedule):
            raise ValueError("feed: a whole insertion is fed by a policy; make one of the schedule")
        players.begin(k, candidate.feed)
    while episodes.running.any():
        active = episodes.running.copy()
        before = np.array([tally.inspected for tally in episodes.tally])
        step = episodes.step(players.act(observation, active), active)
        observation = step.observation
        for k in np.flatnonzero(active).tolist():
            info = step.infos[k]
            for name, flags in ended.items():
                flags[k] |= info[name]
            sensor = info["inserted_length"] - guides[k]
            place = int(np.floor(sensor - SENSOR_START - 1e-6))
            if place >= 0 and sensor <= SENSOR_END + 0.5 * config.period * info["feed_speed"] and not info["diverged"]:
                travel = info["inspected_length"] - before[k]
                sums["travel"][k, place] += travel
                sums["seconds"][k, place] += config.period
                sums["air"][k, place] += info["air_supply_rate"] * config.period
                sums["square"][k, place] += travel * info["radial_rms_m"] ** 2
                sums["tension"][k, place] += info["tension_mean_n"]
                sums["periods"][k, place] += 1.0
    inspected = np.array([tally.inspected for tally in episodes.tally])
    return _gathered(sums, ended, guides, inspected, config)


def _gathered(
    sums: Mapping[str, FloatArray],
    ended: Mapping[str, BoolArray],
    guides: FloatArray,
    inspected: FloatArray,
    config: TaskConfig,
) -> Trial:
    travel, seconds = np.maximum(sums["travel"], 1e-12), np.maximum(sums["seconds"], 1e-12)
    seen = sums["periods"] > 0.0
    metres = SENSOR_START + np.arange(travel.shape[1]) + 1.0
    deep = seen & (metres + guides[:, None] >= config.lost_drive_from)
    # the metres of a whole insertion add up to the span but for a part of a period at each end
    widths = np.where(seen, sums["travel"], 0.0)
    complete = widths.sum(axis=1, keepdims=True) > SPAN - 1.0
    widths = np.where(complete, widths * SPAN / np.maximum(widths.sum(axis=1, keepdims=True), 1e-12), widths)
    return Trial(
        widths,
        np.where(seen, travel / seconds, 0.0),
        np.where(seen, sums["air"] / seconds, 0.0),
        np.sqrt(np.where(seen, sums["square"] / travel, 0.0)),
        sums["tension"] / np.maximum(sums["periods"], 1.0),
        deep,
        ended["lost_drive"],
        ended["diverged"],
        inspected,
    )


def judge(
    designs: Sequence[Design], trial: Trial, config: TaskConfig, helix_length: float = 60.0
) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
    """Reward terms and KPIs (N,) of designs, by the weights of the insertion task.

    Progress is the length that the sensor sees until the guide's tip is at the end of the helix: a long guide inspects
    less. Vibration, time and air are of the span that all designs share.

    Raises:
        ValueError: another vibration measure than displacement.
    """
    if config.vibration_measure != "displacement":
        raise ValueError(f"vibration_measure = {config.vibration_measure!r}: designs are judged by displacement")
    guides = np.array([design.built.guide_length for design in designs])
    covered = trial.widths.sum(axis=1)
    missed = np.maximum(SPAN - covered, 0.0)
    ratio = trial.radial_rms / config.limit
    seconds = trial.widths / np.maximum(trial.feed_speed, 1e-9)
    squares = (trial.widths * capped_square(config, ratio)).sum(axis=1)
    time, air = seconds.sum(axis=1), (seconds * trial.air_supply_rate).sum(axis=1)
    inspected = trial.inspected
    if inspected is None:
        inspected = np.maximum(helix_length - guides - SENSOR_START - missed, 0.0)
    terms = reward_terms(config, Outcome(inspected, squares, time, air, missed, trial.diverged))
    length = np.maximum(covered, 1e-9)
    margin = np.where(trial.deep, trial.root_tension, np.inf).min(axis=1) - config.required_tension
    kpis = {
        "radial_rms_m": np.sqrt((trial.widths * trial.radial_rms**2).sum(axis=1) / length),
        "mean_square_ratio": squares / length,
        "share_within_limit": np.where(ratio <= 1.0, trial.widths, 0.0).sum(axis=1) / SPAN,
        "inspection_time_s": time,
        "air_m3": air,
        "inspected_m": inspected,
        "missed_m": missed,
        "drive_margin_n": np.where(np.isfinite(margin), margin, -config.required_tension),
        "lost_drive": trial.lost_drive.astype(float),
        "diverged": trial.diverged.astype(float),
    }
    return terms, kpis
