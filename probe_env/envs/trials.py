"""Trials of probe designs, in sections of constant length or in whole insertions.

Probes are compared over a segment of tube that depends on the length of the helix: the length that the sensor reaches
with the longest guide. A longer guide inspects less beyond it, which reduces progress.
"""

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
from probe_env.envs.episodes.starts import EpisodeSampler
from probe_env.envs.task.config import TaskConfig
from probe_env.envs.task.rules import FAILURES, capped_square, drive_counts, reward_terms, slack
from probe_env.fidelity import Fidelity
from probe_env.inspection.snr import SPAN, SnrEstimator
from probe_env.physics.closed_forms import buckling_load
from probe_env.physics.simulation.batch import SimulatorBatch
from probe_env.physics.simulation.signals import SAMPLE_PERIOD, dominant_frequencies
from probe_env.scene import Scene
from probe_env.schedule import Schedule


class Controller(Protocol):
    """SB3's ``predict``."""

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Any, Any]:
        """Action and state."""


@runtime_checkable
class PlanningPolicy(Protocol):
    """Model-predictive control on copies of the simulator; an upper bound for feedback."""

    def plan_actions(
        self, episodes: Episodes, which: Sequence[int], observation: npt.NDArray[np.float32], states: Sequence[Any]
    ) -> tuple[npt.NDArray[np.float32], list[Any]]:
        """Actions (n, 2) and states of the n episodes ``which`` from their observations (n, d) and states.

        The episodes are not changed; the state is None at the start of an episode.
        """


class PolicyBatch:
    """Policies of N episodes, each with its state."""

    def __init__(self, count: int) -> None:
        self.controllers: list[Controller | None] = [None] * count
        self.states: list[Any] = [None] * count

    def begin(self, k: int, controller: Controller) -> None:
        """Assign a policy to episode ``k`` at its start."""
        self.controllers[k], self.states[k] = controller, None

    def act(
        self, observation: npt.NDArray[np.float32], active: BoolArray, episodes: Episodes | None = None
    ) -> npt.NDArray[np.float32]:
        """Actions (N, 2) for observations (N, d); 0 for episodes that are not active.

        ``episodes`` is the simulator for model-predictive policies.
        """
        actions = np.zeros((len(self.states), 2), dtype=np.float32)
        planning: dict[int, list[int]] = {}
        for k in np.flatnonzero(active).tolist():
            controller, start = self.controllers[k], np.array([self.states[k] is None])
            assert controller is not None
            if isinstance(controller, PlanningPolicy) and episodes is not None:
                planning.setdefault(id(controller), []).append(k)
                continue
            action, self.states[k] = controller.predict(
                observation[k : k + 1], self.states[k], start, deterministic=True
            )
            actions[k] = action[0]
        for which in planning.values():
            controller = self.controllers[which[0]]
            assert isinstance(controller, PlanningPolicy)
            assert episodes is not None
            before = [self.states[k] for k in which]
            actions[which], after = controller.plan_actions(episodes, which, observation[which], before)
            for k, state in zip(which, after, strict=True):
                self.states[k] = state
        return actions


def rollout(
    episodes: Episodes, policies: Sequence[Controller], observation: npt.NDArray[np.float32]
) -> Iterator[tuple[Step, BoolArray]]:
    """Run episodes to their end; yields every step and which (N,) episodes were active in it.

    Args:
        episodes: all N were reset.
        policies: N, one per episode.
        observation: (N, d) of the reset.
    """
    players = PolicyBatch(len(policies))
    for k, policy in enumerate(policies):
        players.begin(k, policy)
    while episodes.running.any():
        active = episodes.running.copy()
        step = episodes.step(players.act(observation, active, episodes), active)
        observation = step.observation
        yield step, active


SENSOR_START: Final = 2.5
"""Distance of the sensor from the entrance at the start of an insertion [m]."""
SPACING: Final = 10.0
"""Approximate distance between sections [m]."""
MIN_SECTIONS: Final = 3


class TubeSegment(NamedTuple):
    """Segment of tube over which probes are compared [m]."""

    end: float  # greatest distance of the sensor from the entrance
    positions: tuple[float, ...]  # positions of the sensor, simulated at constant length
    widths: tuple[float, ...]  # length of tube represented by each position

    @property
    def span(self) -> float:
        """Length of the segment [m]."""
        return self.end - SENSOR_START


def segment_of(config: TaskConfig) -> TubeSegment:
    """Segment of the helix of a task.

    Raises:
        ValueError: the helix is too short to compare the probes of the design space.
    """
    return _segment(config.scene.tube.helix_length, config.lost_drive_from)


@lru_cache
def _segment(helix_length: float, lost_drive_from: float) -> TubeSegment:
    shortest, max_length, _ = RANGES["guide_length"]
    end = helix_length - max_length
    minimum = max_length + max(
        lost_drive_from - shortest, SENSOR_START + SPACING
    )  # so that every probe has a drive margin
    if helix_length < minimum:
        raise ValueError(
            f"helix_length = {helix_length:g} m: designs are compared as far as the sensor reaches with a guide of"
            f" {max_length:g} m, and where drive may be lost (lost_drive_from = {lost_drive_from:g} m): it must be at"
            f" least {minimum:g} m"
        )
    count = max(round(end / SPACING), MIN_SECTIONS)
    positions = tuple(end * k / count for k in range(1, count + 1))
    middles = [0.5 * (one + other) for one, other in pairwise(positions)]
    edges = (SENSOR_START, *middles, end)
    widths = tuple(high - low for low, high in pairwise(edges))
    return TubeSegment(end, positions, widths)


DETECTION_KPIS: Final = ("a50_percent_wall", "a90_percent_wall", "length_with_snr_over_3_m", "noise_peak_to_peak_v")
"""Detection KPIs of whole insertions, see ``inspection.metrics``."""
MIN_SNR: Final = 1e-3
"""Lower bound of the signal-to-noise, so that its inverse is finite."""


@dataclass(frozen=True)
class Candidate:
    """A probe to simulate in a tube."""

    design: Design
    context: Context
    feed: Schedule | Controller
    """A schedule over inserted length, or for whole insertions a policy."""
    seed: int | None = None
    """Seed of the initial perturbation; default: index of the candidate."""


@dataclass(frozen=True)
class Trial:
    """Results of N probes at p positions, (N, p) unless noted; SI units."""

    widths: FloatArray  # inspected length; 0 at positions that the probe did not reach
    feed_speed: FloatArray
    air_supply_rate: FloatArray
    radial_rms: FloatArray
    root_tension: FloatArray
    deep: BoolArray  # whether lost drive is checked at this inserted length
    failed: Mapping[str, BoolArray]  # (N,) by each of ``FAILURES``
    inspected: FloatArray | None = None  # (N,) inspected length of whole insertions
    noise: FloatArray | None = None  # noise over the signal of a 20 % groove, if that is the vibration measure
    detection: Mapping[str, FloatArray] = field(default_factory=dict)  # (N,) of each of ``DETECTION_KPIS``
    frequency: FloatArray | None = None  # of the radial vibration's highest peak at constant length, NaN at rest [Hz]


def start_seeds(candidates: Sequence[Candidate]) -> list[int]:
    """Seeds of the initial perturbations."""
    return [k if candidate.seed is None else int(candidate.seed) for k, candidate in enumerate(candidates)]


DESIGN_MEASURES: Final = ("displacement", "snr")
"""Vibration measures accepted for designs."""


def check_measure(config: TaskConfig) -> None:
    """Raise ValueError unless the vibration measure of the task is accepted for designs."""
    if config.vibration_measure not in DESIGN_MEASURES:
        raise ValueError(
            f"vibration_measure = {config.vibration_measure!r}: designs are scored by {' or '.join(DESIGN_MEASURES)}"
        )


def score_designs(
    designs: Sequence[Design], trial: Trial, config: TaskConfig
) -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
    """Reward terms and KPIs (N,) of designs, by the weights of the insertion task.

    Progress is the length that the sensor inspects until the tip is at the end of the helix: a long guide inspects
    less. Vibration, time and air are over the segment that all designs share; detection is over the length that the
    guide allows a probe to inspect. The Euler margin is Euler's load of a pitch over the greatest mean root tension.
    """
    check_measure(config)
    span = segment_of(config).span
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
    terms = reward_terms(
        config, inspected=inspected, squares=squares, seconds=time, air=air, uninspected=missed,
        diverged=trial.failed["diverged"],
    )  # fmt: skip
    length = np.maximum(covered, 1e-9)
    margin = np.where(trial.deep, trial.root_tension, np.inf).min(axis=1) - config.required_tension
    loads = np.array([buckling_load(design.probe(config.scene.probe)) for design in designs])
    pull = np.abs(np.where(trial.widths > 0.0, trial.root_tension, 0.0)).max(axis=1)
    kpis = {
        "radial_rms_m": np.sqrt((trial.widths * trial.radial_rms**2).sum(axis=1) / length),
        "mean_square_ratio": squares / length,
        "share_within_limit": np.where(ratio <= 1.0, trial.widths, 0.0).sum(axis=1) / span,
        "inspection_time_s": time,
        "air_m3": air,
        "inspected_m": inspected,
        "missed_m": missed,
        "drive_margin_n": np.where(np.isfinite(margin), margin, -config.required_tension),
        "euler_margin": np.divide(loads, pull, out=np.zeros_like(loads), where=pull > 0.0),
        **trial.detection,
        **{name: trial.failed[name].astype(float) for name in FAILURES},
    }
    return terms, kpis


SETTLE, MEASURE, PERTURBATION = 1.0, 2.0, 1e-7  # [s], [s], [m]
GENTLE, AIR_LAG = 20.0 / 3600.0, 0.2
"""Greatest air supply at rest [m3/s], and time constant towards the target [s]; 99 % is reached while settling. A step
to the full supply sends a wave through the probe with twice its final tension."""


def try_sections(
    candidates: Sequence[Candidate], config: TaskConfig, fidelity: Fidelity | None = None, threads: int | None = None
) -> Trial:
    """N probes at constant length, with the sensor at the positions of the task's segment, in one batch.

    Sections from the first that diverges or has less than the required tension do not count as inspected.

    Args:
        candidates: N.
        config: the task, with the base scene and the ranges of feed and air.
        fidelity: method, step and mesh; time-lapse is not used at constant length.
        threads: maximum number of threads; default: all cores.

    Raises:
        ValueError: the feed is a policy or a schedule over time, or the helix is too short.
    """
    fidelity, segment = fidelity or Fidelity(), segment_of(config)
    shape = (len(candidates), len(segment.positions))
    scenes, rates = [], []
    for candidate in candidates:
        if not isinstance(candidate.feed, Schedule) or candidate.feed.over != "inserted_length":
            raise ValueError(
                "feed: a policy or a schedule over time has no meaning at constant length; give one over inserted"
                " length"
            )
        for start, supply in sections_of(candidate.design, candidate.context, candidate.feed, config):
            scenes.append(start)
            rates.append(supply)
    air = np.array(rates)
    inserted, speed = (
        np.array([getattr(scene, name) for scene in scenes]).reshape(shape)
        for name in ("inserted_length", "feed_speed")
    )
    batch = SimulatorBatch(
        scenes, *fidelity.numerics, threads=threads, perturbation=PERTURBATION, air_lag=AIR_LAG,
        seeds=[seed for seed in start_seeds(candidates) for _ in segment.positions],
    )  # fmt: skip
    settled = batch.advance(None, air, SETTLE, SAMPLE_PERIOD)
    by_snr = config.vibration_measure == "snr"
    window = batch.advance(None, None, MEASURE, SAMPLE_PERIOD, ~settled.diverged, keep_samples=True)
    diverged = (settled.diverged | window.diverged).reshape(shape)
    rms, tension = (window.statistics[name].reshape(shape) for name in ("radial_rms_m", "tension_mean_n"))
    is_slack = slack(config, tension, inserted) & ~diverged
    reached = np.cumsum(diverged | is_slack, axis=1) == 0
    widths = np.where(reached, segment.widths, 0.0)
    failed = dict.fromkeys(FAILURES, np.zeros(len(candidates), dtype=bool))  # two are possible at constant length
    failed |= {"lost_drive": np.asarray(is_slack.any(axis=1)), "diverged": np.asarray(diverged.any(axis=1))}
    noise = None
    assert window.radial is not None
    peaks = [[*dominant_frequencies(radial, SAMPLE_PERIOD, 1), np.nan][0] for radial in window.radial.T]
    if by_snr:
        meter, every = SnrEstimator(config.sensor, len(scenes), SAMPLE_PERIOD), np.arange(len(scenes))
        for second in np.split(window.radial, round(MEASURE / SPAN)):
            estimate = meter.update(every, second, speed.ravel())
        noise = np.asarray(1.0 / np.maximum(estimate.snr, MIN_SNR)).reshape(shape)
    deep = drive_counts(config, inserted) & ~diverged
    return Trial(
        widths, speed, air.reshape(shape), rms, tension, deep, failed, noise=noise, frequency=np.reshape(peaks, shape)
    )


def sections_of(design: Design, context: Context, feed: Schedule, config: TaskConfig) -> list[tuple[Scene, float]]:
    """Initial scene and air supply [m3/s] of a design in a tube, for each position of the task's segment."""
    base = config.scene
    probe, tube, sections = design.probe(base.probe), context.apply(base), []
    for position in segment_of(config).positions:
        carrier = round(round(position / probe.float_pitch) * probe.float_pitch, 6)
        inserted = carrier + probe.guide_length
        feed_speed, supply = config.feasible(*feed.at(inserted))[0].tolist()
        length = max(base.tube.helix_length, inserted)  # rounding to the pitch may add some cm
        update = {"probe": probe, "carrier_length": carrier, "feed_speed": feed_speed}
        update["air_supply_rate"] = min(supply, GENTLE)
        start = tube.model_copy(update={"tube": {"helix_length": length}, **update})
        sections.append((start, supply))
    return sections


HARDEST: Final = tuple(
    Design.from_unit([float(name in high) for name in RANGES])
    for high in (
        ("tensile_rigidity", "flexural_rigidity"),
        ("guide_length", "guide_float_diameter", "carrier_float_diameter"),
    )
)
"""The stiff, light design, which needs the shortest step and the stiffest wall; and the one with the most drag."""


def check_candidate(
    design: Design, context: Context, config: TaskConfig, fidelity: Fidelity, feed: Schedule | None = None
) -> None:
    """Raise ValueError if a design does not fit a tube or cannot be simulated in it.

    ``feed`` is the schedule of sections of constant length; None: whole insertions.
    """
    if feed is None:
        scene = EpisodeSampler(config, (context,)).build(context, {"probe": design.built.model_dump()})
        check_simulable(scene, fidelity, scene.tube.helix_length, config.air_supply_rates[1])
    else:
        for start, air in sections_of(design, context, feed, config):
            check_simulable(start, fidelity, start.inserted_length, air)


def try_insertions(
    candidates: Sequence[Candidate],
    config: TaskConfig,
    fidelity: Fidelity | str = "fast",
    threads: int | None = None,
) -> Trial:
    """N whole insertions, averaged per metre of the sensor's position; arguments as in ``try_sections``."""
    policies = []
    for candidate in candidates:
        if isinstance(candidate.feed, Schedule):
            raise ValueError("feed: a whole insertion needs a policy; convert the schedule to one")
        policies.append(candidate.feed)
    count, segment = len(candidates), segment_of(config)
    episodes = Episodes(count, config, threads=threads, allow_standstill=True, fidelity=fidelity)
    episodes.simulated()  # raises for the surrogate
    designs = [candidate.design.built for candidate in candidates]
    options = {k: {"context": c.context, "probe": designs[k].model_dump()} for k, c in enumerate(candidates)}
    rngs = {k: np.random.default_rng(seed) for k, seed in enumerate(start_seeds(candidates))}
    observation, _ = episodes.reset(range(count), rngs, options)
    bins = int(np.ceil(segment.span))
    names = ("travel", "seconds", "air", "square", "noise", "tension", "periods")
    sums = {name: np.zeros((count, bins)) for name in names}
    failed = {name: np.zeros(count, dtype=bool) for name in FAILURES}
    guides = np.array([design.guide_length for design in designs])
    inspected, air = np.zeros(count), np.zeros(count)
    for step, active in rollout(episodes, policies, observation):
        before, inspected = inspected, episodes.scorer.totals["inspected"].copy()
        air_before, air = air, episodes.scorer.totals["air"].copy()
        for k in np.flatnonzero(active).tolist():
            info = step.infos[k]
            for name, flags in failed.items():
                flags[k] |= info[name]
            sensor = info["inserted_length"] - guides[k]
            bin_ = min(int(np.floor(sensor - SENSOR_START - 1e-6)), bins - 1)
            if bin_ >= 0 and sensor <= segment.end + 0.5 * config.period * info["feed_speed"] and not info["diverged"]:
                travel = info["inspected_length"] - before[k]
                sums["travel"][k, bin_] += travel
                sums["seconds"][k, bin_] += config.period
                sums["air"][k, bin_] += air[k] - air_before[k]
                sums["square"][k, bin_] += travel * info["radial_rms_m"] ** 2
                sums["noise"][k, bin_] += travel / max(info["snr"], MIN_SNR) ** 2
                sums["tension"][k, bin_] += info["tension_mean_n"]
                sums["periods"][k, bin_] += 1.0
    travel, seconds = np.maximum(sums["travel"], 1e-12), np.maximum(sums["seconds"], 1e-12)
    visited = sums["periods"] > 0.0
    # the metres of a whole insertion add up to the span except part of a period at each end
    widths = np.where(visited, sums["travel"], 0.0)
    covered = widths.sum(axis=1, keepdims=True)
    widths = np.where(covered > segment.span - 1.0, widths * segment.span / np.maximum(covered, 1e-12), widths)
    # length that the guide excludes is not charged to detection
    tube = config.scene.tube.helix_length
    reach = (tube - guides - SENSOR_START).tolist()
    rows = zip(episodes.scorer.signals, inspected.tolist(), reach, strict=True)
    found = [signals.detection.kpis(max(length, reached), tube) for signals, length, reached in rows]
    return Trial(
        widths=widths,
        feed_speed=np.where(visited, travel / seconds, 0.0),
        air_supply_rate=np.where(visited, sums["air"] / seconds, 0.0),
        radial_rms=np.sqrt(np.where(visited, sums["square"] / travel, 0.0)),
        root_tension=sums["tension"] / np.maximum(sums["periods"], 1.0),
        deep=visited & drive_counts(config, SENSOR_START + np.arange(bins) + 1.0 + guides[:, None]),
        failed=failed,
        inspected=inspected,
        noise=np.sqrt(np.where(visited, sums["noise"] / travel, 0.0)) if config.vibration_measure == "snr" else None,
        detection={name: np.array([row[name] for row in found]) for name in DETECTION_KPIS},
    )
