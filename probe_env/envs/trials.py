"""Trials of probe designs, in sections of constant length or in whole insertions.

Probes are compared over a stretch of tube that follows from the length of the helix: where the sensor gets with the
longest guide. What a long guide cannot inspect beyond it counts as lost progress.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import pairwise
from typing import Any, Final, NamedTuple, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from probe_env.arrays import BoolArray, FloatArray
from probe_env.design import RANGES, Design
from probe_env.envs.contexts import Context
from probe_env.envs.episodes import Episodes, Step
from probe_env.envs.episodes.limits import check_simulable
from probe_env.envs.episodes.starts import EpisodeSampler, settling
from probe_env.envs.task import FAILURES, TaskConfig, capped_square, drive_counts, reward_terms, slack
from probe_env.fidelity import Fidelity
from probe_env.inspection.snr import SPAN, SnrEstimator
from probe_env.physics.simulation.batch import SimulatorBatch
from probe_env.physics.simulation.signals import SAMPLE_PERIOD
from probe_env.scene import Scene
from probe_env.schedule import Schedule


class Controller(Protocol):
    """SB3's ``predict``."""

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Any, Any]:
        """Action and state."""


@runtime_checkable
class ModelPredictivePolicy(Protocol):
    """A policy that tries things out on copies of the probes themselves, which no rig can: what is possible at best."""

    def decide(
        self, episodes: Episodes, which: Sequence[int], observation: npt.NDArray[np.float32], states: Sequence[Any]
    ) -> tuple[npt.NDArray[np.float32], list[Any]]:
        """Actions (n, 2) and states of the n episodes of ``which``, by their observations (n, d) and states.

        The episodes themselves stay as they are; a state of None begins one.
        """


class Players:
    """Policies that act in N episodes side by side, each with the memory of its own episode."""

    def __init__(self, count: int) -> None:
        self.controllers: list[Controller | None] = [None] * count
        self.states: list[Any] = [None] * count

    def begin(self, k: int, controller: Controller) -> None:
        """Give episode ``k``, which begins, to a policy."""
        self.controllers[k], self.states[k] = controller, None

    def act(
        self, observation: npt.NDArray[np.float32], active: BoolArray, episodes: Episodes | None = None
    ) -> npt.NDArray[np.float32]:
        """Actions (N, 2) for observations (N, d); zero where an episode is not active.

        ``episodes`` are what they act in, for those that look ahead.
        """
        actions = np.zeros((len(self.states), 2), dtype=np.float32)
        looking: dict[int, list[int]] = {}
        for k in np.flatnonzero(active).tolist():
            controller, start = self.controllers[k], np.array([self.states[k] is None])
            assert controller is not None
            if isinstance(controller, ModelPredictivePolicy) and episodes is not None:
                looking.setdefault(id(controller), []).append(k)
                continue
            action, self.states[k] = controller.predict(
                observation[k : k + 1], self.states[k], start, deterministic=True
            )
            actions[k] = action[0]
        for which in looking.values():
            controller = self.controllers[which[0]]
            assert isinstance(controller, ModelPredictivePolicy)
            assert episodes is not None
            before = [self.states[k] for k in which]
            actions[which], after = controller.decide(episodes, which, observation[which], before)
            for k, state in zip(which, after, strict=True):
                self.states[k] = state
        return actions


def periods_of(
    episodes: Episodes, policies: Sequence[Controller], observation: npt.NDArray[np.float32]
) -> Iterator[tuple[Step, BoolArray]]:
    """Play what has been reset until it has ended; gives every period and which (N,) were in it.

    Args:
        episodes: that were reset, all N.
        policies: N, whose episode is each.
        observation: (N, d) that the reset gave.
    """
    players = Players(len(policies))
    for k, policy in enumerate(policies):
        players.begin(k, policy)
    simulated = episodes if isinstance(episodes, Episodes) else None
    while episodes.running.any():
        active = episodes.running.copy()
        step = episodes.step(players.act(observation, active, simulated), active)
        observation = step.observation
        yield step, active


SENSOR_START: Final = 2.5
"""[m] of the sensor from the entrance, where an insertion begins."""
SPACING: Final = 10.0
"""[m] between sections, or the nearest that divides the stretch."""
LEAST_SECTIONS: Final = 3


class Stretch(NamedTuple):
    """Where probes are compared [m]."""

    end: float  # greatest distance of the sensor from the entrance
    positions: tuple[float, ...]  # of the sensor, simulated at constant length
    widths: tuple[float, ...]  # of the tube that each position stands for

    @property
    def span(self) -> float:
        """Length of the stretch [m]."""
        return self.end - SENSOR_START


def stretch_of(config: TaskConfig) -> Stretch:
    """The stretch of a task's helix.

    Raises:
        ValueError: the helix is too short to compare the probes of the design space.
    """
    return _stretch(config.scene.tube.helix_length, config.lost_drive_from)


@lru_cache
def _stretch(helix_length: float, lost_drive_from: float) -> Stretch:
    shortest, longest, _ = RANGES["guide_length"]
    end = helix_length - longest
    least = longest + max(lost_drive_from - shortest, SENSOR_START + SPACING)  # so that every probe has a drive margin
    if helix_length < least:
        raise ValueError(
            f"helix_length = {helix_length:g} m: designs are compared as far as the sensor gets with a guide of"
            f" {longest:g} m, and where drive may be lost (lost_drive_from = {lost_drive_from:g} m): it must be at"
            f" least {least:g} m"
        )
    count = max(round(end / SPACING), LEAST_SECTIONS)
    positions = tuple(end * k / count for k in range(1, count + 1))
    middles = [0.5 * (one + other) for one, other in pairwise(positions)]
    edges = (SENSOR_START, *middles, end)
    widths = tuple(high - low for low, high in pairwise(edges))
    return Stretch(end, positions, widths)


FOUND_KPIS: Final = ("a50_percent_wall", "a90_percent_wall", "length_with_snr_over_3_m", "noise_peak_to_peak_v")
"""What whole insertions are told by of what would be found, see ``inspection.metrics``."""
LEAST_SNR: Final = 1e-3
"""What no signal at all counts as, so that its inverse is finite."""


@dataclass(frozen=True)
class Candidate:
    """A probe that is tried in a tube."""

    design: Design
    context: Context
    feed: Schedule | Controller
    """A schedule over inserted length, or for whole insertions a policy."""
    seed: int | None = None
    """Of the start's perturbation; default: its place among the candidates."""


@dataclass(frozen=True)
class Trial:
    """What N probes did in p places, (N, p) unless it says otherwise; SI units."""

    widths: FloatArray  # length of tube that was inspected there; 0 where the probe did not get to
    feed_speed: FloatArray
    air_supply_rate: FloatArray
    radial_rms: FloatArray
    root_tension: FloatArray
    deep: BoolArray  # whether so much is inserted that lost drive counts
    failed: Mapping[str, BoolArray]  # (N,) whether it ended so, by each of ``FAILURES``
    inspected: FloatArray | None = None  # (N,) to the end, where that was simulated
    noise: FloatArray | None = None  # over the signal of a 20 % groove, where the task is judged by that
    detection: Mapping[str, FloatArray] = field(default_factory=dict)  # (N,) of each of ``FOUND_KPIS``


def seeds_of(candidates: Sequence[Candidate]) -> list[int]:
    """Of the starts."""
    return [k if candidate.seed is None else int(candidate.seed) for k, candidate in enumerate(candidates)]


JUDGED: Final = ("displacement", "snr")
"""Vibration measures that designs are judged by."""


def check_measure(config: TaskConfig) -> None:
    """Raise ValueError unless designs can be judged by the task's vibration measure."""
    if config.vibration_measure not in JUDGED:
        raise ValueError(
            f"vibration_measure = {config.vibration_measure!r}: designs are judged by {' or '.join(JUDGED)}"
        )


def judge(
    designs: Sequence[Design], trial: Trial, config: TaskConfig
) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
    """Reward terms and KPIs (N,) of designs, by the weights of the insertion task.

    Progress is the length that the sensor sees until the guide's tip is at the end of the helix: a long guide inspects
    less. Vibration, time and air are of the span that all designs share; what would be found, of what its guide lets a
    probe inspect.

    Raises:
        ValueError: the task's vibration measure is not one of ``JUDGED``.
    """
    check_measure(config)
    span = stretch_of(config).span
    guides = np.array([design.built.guide_length for design in designs])
    covered = trial.widths.sum(axis=1)
    missed = np.maximum(span - covered, 0.0)
    ratio = (trial.radial_rms if trial.noise is None else trial.noise) / config.limit
    seconds = trial.widths / np.maximum(trial.feed_speed, 1e-9)
    squares = (trial.widths * capped_square(config, ratio)).sum(axis=1)
    time, air = seconds.sum(axis=1), (seconds * trial.air_supply_rate).sum(axis=1)
    inspected = trial.inspected
    if inspected is None:
        inspected = np.maximum(config.scene.tube.helix_length - guides - SENSOR_START - missed, 0.0)
    terms = reward_terms(config, inspected, squares, time, air, missed, trial.failed["diverged"])
    length = np.maximum(covered, 1e-9)
    margin = np.where(trial.deep, trial.root_tension, np.inf).min(axis=1) - config.required_tension
    kpis = {
        "radial_rms_m": np.sqrt((trial.widths * trial.radial_rms**2).sum(axis=1) / length),
        "mean_square_ratio": squares / length,
        "share_within_limit": np.where(ratio <= 1.0, trial.widths, 0.0).sum(axis=1) / span,
        "inspection_time_s": time,
        "air_m3": air,
        "inspected_m": inspected,
        "missed_m": missed,
        "drive_margin_n": np.where(np.isfinite(margin), margin, -config.required_tension),
        **trial.detection,
        **{name: trial.failed[name].astype(float) for name in FAILURES},
    }
    return terms, kpis


SETTLE, MEASURE, PERTURBATION = 1.0, 2.0, 1e-7  # [s], [s], [m]
GENTLE, AIR_LAG = 20.0 / 3600.0, 0.2
"""[m3/s] a probe at rest starts with at most, and [s] with which the rest follows; as it settles, 99 % has come. All of
it at once sends a wave through the probe that is twice as high as its tension in the end."""


def try_sections(
    candidates: Sequence[Candidate], config: TaskConfig, fidelity: Fidelity | None = None, threads: int | None = None
) -> Trial:
    """N probes at constant length, the sensor at the positions of the task's stretch, all in one batch.

    From the first section on that diverges or has less than the required tension, nothing counts as inspected.

    Args:
        candidates: N.
        config: the task, with the scene that designs and contexts change; its ranges are those of the feed and the air.
        fidelity: method, step and mesh; there is no time-lapse at constant length.
        threads: at most so many; default: all cores.

    Raises:
        ValueError: a policy, or a schedule over time; or a helix that is too short.
    """
    fidelity, stretch = fidelity or Fidelity(), stretch_of(config)
    shape = (len(candidates), len(stretch.positions))
    scenes, blown = [], []
    for candidate in candidates:
        if not isinstance(candidate.feed, Schedule) or candidate.feed.over != "inserted_length":
            raise ValueError(
                "feed: a policy or a schedule over time has no meaning at constant length; give one over inserted"
                " length"
            )
        for start, supply in sections_of(candidate.design, candidate.context, candidate.feed, config):
            scenes.append(start)
            blown.append(supply)
    air = np.array(blown)
    inserted, speed = (
        np.array([getattr(scene, name) for scene in scenes]).reshape(shape)
        for name in ("inserted_length", "feed_speed")
    )
    batch = SimulatorBatch(
        scenes, fidelity.method, fidelity.time_step, fidelity.nodes_per_pitch, threads=threads,
        seeds=[seed for seed in seeds_of(candidates) for _ in stretch.positions], perturbation=PERTURBATION,
        air_lag=AIR_LAG,
    )  # fmt: skip
    settled = batch.advance(None, air, SETTLE, SAMPLE_PERIOD)
    heard = config.vibration_measure == "snr"
    window = batch.advance(None, None, MEASURE, SAMPLE_PERIOD, ~settled.diverged, keep_samples=heard)
    diverged = (settled.diverged | window.diverged).reshape(shape)
    rms, tension = (window.statistics[name].reshape(shape) for name in ("radial_rms_m", "tension_mean_n"))
    is_slack = slack(config, tension, inserted) & ~diverged
    reached = np.cumsum(diverged | is_slack, axis=1) == 0
    widths = np.where(reached, stretch.widths, 0.0)
    failed = dict.fromkeys(FAILURES, np.zeros(len(candidates), dtype=bool))  # at constant length in two ways alone
    failed |= {"lost_drive": np.asarray(is_slack.any(axis=1)), "diverged": np.asarray(diverged.any(axis=1))}
    noise = None
    if heard:
        assert window.radial is not None
        meter, every = SnrEstimator(config.sensor, len(scenes), SAMPLE_PERIOD), np.arange(len(scenes))
        for second in np.split(window.radial, round(MEASURE / SPAN)):
            reading = meter.update(every, second, speed.ravel())
        noise = np.asarray(1.0 / np.maximum(reading.snr, LEAST_SNR)).reshape(shape)
    deep = drive_counts(config, inserted) & ~diverged
    return Trial(widths, speed, air.reshape(shape), rms, tension, deep, failed, noise=noise)


def sections_of(design: Design, context: Context, feed: Schedule, config: TaskConfig) -> list[tuple[Scene, float]]:
    """Scene at the start and air supply [m3/s] of a design in a tube, for each position of the task's stretch."""
    base = config.scene
    probe, tube, sections = design.probe(base.probe), context.apply(base), []
    for position in stretch_of(config).positions:
        carrier = round(round(position / probe.float_pitch) * probe.float_pitch, 6)
        inserted = carrier + probe.guide_length
        fed, blown = config.given(*feed.at(inserted))[0].tolist()
        room = max(base.tube.helix_length, inserted)  # rounding to the pitch may go some cm beyond
        update = {"probe": probe, "carrier_length": carrier, "feed_speed": fed, "air_supply_rate": min(blown, GENTLE)}
        start = tube.model_copy(update={"tube": {"helix_length": room}, **update})
        sections.append((start, blown))
    return sections


HARDEST: Final = tuple(
    Design.from_unit([float(name in high) for name in RANGES])
    for high in (
        ("tensile_rigidity", "flexural_rigidity"),
        ("guide_length", "guide_float_diameter", "carrier_float_diameter"),
    )
)
"""The stiff, light design that asks for the shortest step and the hardest wall; the one that drag stretches most."""


def check_candidate(
    design: Design, context: Context, config: TaskConfig, fidelity: Fidelity, feed: Schedule | None = None
) -> None:
    """Raise ValueError if a design does not fit a tube, or cannot be simulated in it.

    ``feed`` is that of sections of constant length; None: whole insertions.
    """
    if feed is None:
        starts = EpisodeSampler(config, (context,), "scene", *settling(config, {}))
        scene = starts.build(context, {"probe": design.built.model_dump()})
        check_simulable(scene, fidelity, scene.tube.helix_length, config.air_supply_rates[1])
    else:
        for start, air in sections_of(design, context, feed, config):
            check_simulable(start, fidelity, start.inserted_length, air)


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
    policies = []
    for candidate in candidates:
        if isinstance(candidate.feed, Schedule):
            raise ValueError("feed: a whole insertion is fed by a policy; make one of the schedule")
        policies.append(candidate.feed)
    count, stretch = len(candidates), stretch_of(config)
    episodes = Episodes(count, config, threads=threads, allow_standstill=True, fidelity=fidelity)
    designs = [candidate.design.built for candidate in candidates]
    options = {k: {"context": c.context, "probe": designs[k].model_dump()} for k, c in enumerate(candidates)}
    rngs = {k: np.random.default_rng(seed) for k, seed in enumerate(seeds_of(candidates))}
    observation, _ = episodes.reset(range(count), rngs, options)
    places = int(np.ceil(stretch.span))
    names = ("travel", "seconds", "air", "square", "noise", "tension", "periods")
    sums = {name: np.zeros((count, places)) for name in names}
    failed = {name: np.zeros(count, dtype=bool) for name in FAILURES}
    guides = np.array([design.guide_length for design in designs])
    inspected, blown = np.zeros(count), np.zeros(count)
    for step, active in periods_of(episodes, policies, observation):
        before, inspected = inspected, np.array([metrics.inspected for metrics in episodes.scorer.metrics])
        blown_before, blown = blown, np.array([metrics.air for metrics in episodes.scorer.metrics])
        for k in np.flatnonzero(active).tolist():
            info = step.infos[k]
            for name, flags in failed.items():
                flags[k] |= info[name]
            sensor = info["inserted_length"] - guides[k]
            place = min(int(np.floor(sensor - SENSOR_START - 1e-6)), places - 1)
            if place >= 0 and sensor <= stretch.end + 0.5 * config.period * info["feed_speed"] and not info["diverged"]:
                travel = info["inspected_length"] - before[k]
                sums["travel"][k, place] += travel
                sums["seconds"][k, place] += config.period
                sums["air"][k, place] += blown[k] - blown_before[k]
                sums["square"][k, place] += travel * info["radial_rms_m"] ** 2
                sums["noise"][k, place] += travel / max(info["snr"], LEAST_SNR) ** 2
                sums["tension"][k, place] += info["tension_mean_n"]
                sums["periods"][k, place] += 1.0
    travel, seconds = np.maximum(sums["travel"], 1e-12), np.maximum(sums["seconds"], 1e-12)
    seen = sums["periods"] > 0.0
    # the metres of a whole insertion add up to the span but for a part of a period at each end
    widths = np.where(seen, sums["travel"], 0.0)
    covered = widths.sum(axis=1, keepdims=True)
    widths = np.where(covered > stretch.span - 1.0, widths * stretch.span / np.maximum(covered, 1e-12), widths)
    # what a probe misses by its guide is not charged to what it finds
    tube = config.scene.tube.helix_length
    reach = (tube - guides - SENSOR_START).tolist()
    pairs = zip(episodes.scorer.metrics, reach, strict=True)
    found = [metrics.detection.kpis(max(metrics.inspected, own), tube) for metrics, own in pairs]
    return Trial(
        widths=widths,
        feed_speed=np.where(seen, travel / seconds, 0.0),
        air_supply_rate=np.where(seen, sums["air"] / seconds, 0.0),
        radial_rms=np.sqrt(np.where(seen, sums["square"] / travel, 0.0)),
        root_tension=sums["tension"] / np.maximum(sums["periods"], 1.0),
        deep=seen & drive_counts(config, SENSOR_START + np.arange(places) + 1.0 + guides[:, None]),
        failed=failed,
        inspected=inspected,
        noise=np.sqrt(np.where(seen, sums["noise"] / travel, 0.0)) if config.vibration_measure == "snr" else None,
        detection={name: np.array([row[name] for row in found]) for name in FOUND_KPIS},
    )
