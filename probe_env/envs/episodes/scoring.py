"""Scores control periods of N probes: what each metre counts for, reward, costs, endings and the episode's metrics.

On insertion a metre counts as what was measured there. In a round trip it counts again on withdrawal where the task
says so: alone, or where it is better than what insertion showed, so that at the end every metre counts as the better.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from probe_env.arrays import BoolArray, FloatArray
from probe_env.envs.task import COSTS, END_TOLERANCE, MEASURES, Score, TaskConfig, rules
from probe_env.inspection.metrics import TURN, DetectionMetrics, RoundTripMetrics
from probe_env.inspection.snr import FilteredSignal
from probe_env.physics.simulation.signals import SAMPLE_PERIOD
from probe_env.physics.simulation.window import Window

LOWEST, HIGHEST, PER_DECADE = 1e-9, 1e6, 200
BINS = round(np.log10(HIGHEST / LOWEST) * PER_DECADE)
SIGNALS = {"radial": "m", "radial_acceleration": "m_per_s2"}
"""Signals of the figures and their units; rms is over the length inspected, p99 and max over the magnitude in time."""
COLUMNS: Final = 3 + len(SIGNALS)
"""Of sums over the length: of 1, the capped square, whether within the limit, and squares of the signals' rms."""
BIN: Final = 1.0
"""Length over which insertion is remembered [m]."""


class StepRecord(NamedTuple):
    """What happened to N probes in a control period, (N,) each; SI units."""

    stepped: BoolArray
    good: BoolArray  # stepped, and did not diverge
    before: FloatArray  # inserted length at its beginning
    after: FloatArray  # and at its end
    helix_length: FloatArray
    air: FloatArray  # used [m3]
    seconds: FloatArray  # of motion
    action_change: FloatArray  # (N, 2) action less the one before
    buckling_load: FloatArray  # of the cable between two floats [N]
    window: Window  # motion of the sensor and root tension
    signals: Mapping[int, FilteredSignal]  # of each good probe, see ``SnrEstimator.last``


class Percentiles:
    """Percentiles of the magnitude of many samples, to 1.2 %, in a histogram of logarithmic bins."""

    def __init__(self) -> None:
        self.counts = np.zeros(BINS, dtype=np.int64)

    def add(self, samples: FloatArray) -> None:
        """Count samples of any sign, unit and shape."""
        bins = np.log10(np.clip(np.abs(samples), LOWEST, HIGHEST * 0.999) / LOWEST) * PER_DECADE
        self.counts += np.bincount(bins.astype(np.int64).ravel(), minlength=BINS)

    def percentile(self, percent: float) -> float:
        """Upper edge of the bin that holds the percentile; 0 without samples."""
        total = int(self.counts.sum())
        if total == 0:
            return 0.0
        bin_ = int(np.searchsorted(np.cumsum(self.counts), percent / 100.0 * total))
        return float(LOWEST * 10.0 ** ((bin_ + 1) / PER_DECADE))


@dataclass
class EpisodeMetrics:
    """Figures of one episode up to now; lengths in m, times in s, air in m3, costs in periods."""

    time: float = 0.0
    inspected: float = 0.0
    within_limit: float = 0.0
    air: float = 0.0
    reward: float = 0.0
    lost_drive_events: int = 0
    consecutive_slack_steps: int = 0
    costs: dict[str, float] = field(default_factory=lambda: dict.fromkeys(COSTS, 0.0))
    squares: dict[str, float] = field(default_factory=lambda: dict.fromkeys(SIGNALS, 0.0))
    greatest: dict[str, float] = field(default_factory=lambda: dict.fromkeys(SIGNALS, 0.0))
    samples: dict[str, Percentiles] = field(default_factory=lambda: {name: Percentiles() for name in SIGNALS})
    last_radial: npt.NDArray[np.floating] = field(default_factory=lambda: np.zeros(2))
    detection: DetectionMetrics | RoundTripMetrics = field(default_factory=DetectionMetrics)

    def add_signals(self, squares: Sequence[float], radial: FloatArray, sample_period: float, rest: float) -> None:
        """Add a period: sums over length of each square, and radial displacements (k,) [m] around ``rest``."""
        acceleration = np.diff(np.concatenate([self.last_radial, radial]), n=2) / sample_period**2
        self.last_radial = radial[-2:].copy()
        for name, square, values in zip(SIGNALS, squares, (radial - rest, acceleration), strict=True):
            self.squares[name] += square
            self.greatest[name] = max(self.greatest[name], float(np.abs(values).max()))
            self.samples[name].add(values)

    def totals(self, length: float, ended: Mapping[str, float]) -> dict[str, float]:
        """Figures that need no samples; ``length`` was to be inspected [m], ``ended`` as from ``Score.kpis``."""
        return {
            "inspection_time_s": self.time,
            "inspected_m": self.inspected,
            "inspected_share": self.inspected / length if length > 0.0 else 0.0,
            "share_within_limit": self.within_limit / length if length > 0.0 else 0.0,
            "air_m3": self.air,
            "reward": self.reward,
            "lost_drive_events": float(self.lost_drive_events),
            **ended,
            "cost": sum(self.costs.values()),
            **{f"cost_{name}": value for name, value in self.costs.items()},
        }

    def kpis(self, length: float, tube_length: float, ended: Mapping[str, float]) -> dict[str, float]:
        """All figures of the episode, in a tube of a length [m]; see ``totals``."""
        values = self.totals(length, ended)
        for name, unit in SIGNALS.items():
            mean_square = max(self.squares[name] / self.inspected, 0.0) if self.inspected > 0.0 else 0.0
            values[f"{name}_rms_{unit}"] = float(np.sqrt(mean_square))
            values[f"{name}_p99_{unit}"] = self.samples[name].percentile(99.0)
            values[f"{name}_max_{unit}"] = self.greatest[name]
        return values | self.detection.kpis(length, tube_length)


class Scorer:
    """Scores N episodes of one pass: probes are fed in, or stay where they are.

    Args:
        count: N.
        config: the task.

    Attributes:
        direction: (N,) 1 on insertion, -1 on withdrawal.
        start: (N,) inserted length at the start [m].
        metrics: of each episode, up to now.
    """

    def __init__(self, count: int, config: TaskConfig) -> None:
        self.config: Final = config
        self.direction, self.start = np.ones(count), np.zeros(count)
        self.metrics = [EpisodeMetrics() for _ in range(count)]

    def fork(self, which: Sequence[int]) -> Self:
        """A scorer of copies of some episodes, which rewards and ends them as this one; metrics count from here on."""
        new, index = copy.copy(self), list(which)
        for name, values in vars(self).items():
            if isinstance(values, np.ndarray):
                setattr(new, name, values[index])
        new.metrics = []
        for of in (self.metrics[k] for k in index):
            copied = EpisodeMetrics(of.time, detection=self._detection(), last_radial=of.last_radial)
            copied.consecutive_slack_steps = of.consecutive_slack_steps
            new.metrics.append(copied)
        return new

    def begin(self, k: int, start: float, helix_length: float) -> None:
        """An episode of probe ``k`` begins at an inserted length, in a helix of a length [m]."""
        self.direction[k], self.start[k] = 1.0, start
        self.metrics[k] = EpisodeMetrics(detection=self._detection())

    def score(self, record: StepRecord) -> Score:
        """Score a control period and add it to the metrics."""
        config, window = self.config, record.window
        assert window.tension is not None
        ratio = window.statistics[MEASURES[config.vibration_measure][0]] / config.limit
        squares = [window.statistics[f"{name}_rms_{unit}"] ** 2 for name, unit in SIGNALS.items()]
        each_metre = np.column_stack([np.ones(len(ratio)), rules.capped_square(config, ratio), ratio <= 1.0, *squares])
        sums = self.count(record, each_metre)
        tension = window.statistics["tension_mean_n"]
        is_slack = rules.slack(config, tension, record.after) & (self.direction > 0.0)
        terms = rules.cost_terms(config, is_slack, tension, np.nanmax(window.tension, axis=0), record.buckling_load)
        costs = {name: np.where(record.good, cost, 0.0) for name, cost in terms.items()}
        for k in np.flatnonzero(record.stepped).tolist():
            self.metrics[k].time += config.period
            if record.good[k]:
                self._add(k, record, sums[k].tolist(), bool(is_slack[k]), costs)
        slack_steps, time = (
            np.array([getattr(metrics, name) for metrics in self.metrics])
            for name in ("consecutive_slack_steps", "time")
        )
        ends = rules.ending(
            config, record.after, record.helix_length, slack_steps, time, record.stepped, window.diverged
        )
        ends["complete"] = self.complete(ends["complete"], record)
        scored = rules.score(
            config, record.stepped, ends, costs, inspected=sums[:, 0], squares=sums[:, 1], air=record.air,
            uninspected=self.uninspected(record), action_change=record.action_change,
        )  # fmt: skip
        for k in np.flatnonzero(record.stepped).tolist():
            self.metrics[k].reward += float(scored.reward[k])
        return scored

    def kpis(self, k: int, tube_length: float, scored: Score) -> dict[str, float]:
        """Figures of an episode that has ended, in a tube of a length [m]."""
        length = tube_length - self.start[k] if self.config.growing else self.metrics[k].inspected
        return self.metrics[k].kpis(float(length), tube_length, scored.kpis(k))

    def _add(
        self, k: int, record: StepRecord, sums: list[float], is_slack: bool, costs: Mapping[str, FloatArray]
    ) -> None:
        """Add a period to the metrics of a probe; ``sums`` are those of ``count``."""
        metrics, radial = self.metrics[k], record.window.radial_of(k)
        for name, values in costs.items():
            metrics.costs[name] += float(values[k])
        metrics.inspected += sums[0]
        metrics.within_limit += sums[2]
        metrics.air += float(record.air[k])
        metrics.consecutive_slack_steps = metrics.consecutive_slack_steps + 1 if is_slack else 0
        metrics.lost_drive_events += metrics.consecutive_slack_steps == self.config.lost_drive_periods
        rest = float(radial.mean()) if self.direction[k] < 0.0 else 0.0  # on the outer wall, or on its way there
        metrics.add_signals(sums[3:], radial, SAMPLE_PERIOD, rest)
        self._detect(k, sums[0], float(record.seconds[k]), record.signals[k])

    def _detection(self) -> DetectionMetrics | RoundTripMetrics:
        return DetectionMetrics(self.config.sensor)

    def count(self, record: StepRecord, each_metre: FloatArray) -> FloatArray:
        """(N, COLUMNS) sums of ``each_metre`` (N, COLUMNS) over the length that the period inspected."""
        length = rules.travel(self.config, record.before, record.after, record.window.feed_speed)
        return np.where(record.good, length, 0.0)[:, None] * each_metre

    def _detect(self, k: int, inspected: float, seconds: float, signal: FilteredSignal) -> None:
        """Add a period's signal-to-noise: over the length inspected [m], in seconds of motion."""
        self.metrics[k].detection.add(inspected, signal)  # type: ignore[call-arg, arg-type]

    def complete(self, at_end: BoolArray, record: StepRecord) -> BoolArray:
        """(N,) whose inspection is complete, where ``at_end`` (N,) are at the helix's end."""
        return at_end

    def uninspected(self, record: StepRecord) -> FloatArray:
        """(N,) what is left to inspect [m], where the length grows."""
        # what passed in a period that diverged was not inspected
        return record.helix_length - np.where(record.good, record.after, record.before)


class RoundTripScorer(Scorer):
    """Scores N episodes of two passes: probes are fed in to the helix's end and drawn back to where they began.

    Attributes:
        reached: (N,) greatest inserted length so far [m].
        left: (N,) least inserted length on withdrawal so far [m].
    """

    def __init__(self, count: int, config: TaskConfig) -> None:
        super().__init__(count, config)
        self.reached, self.left = np.zeros(count), np.full(count, np.inf)
        self._since_turn, self._piece = np.zeros(count), np.zeros((count, 2))  # [s]; ends of what was counted last [m]
        self._on_insertion = np.ones(count, dtype=bool)  # of that piece
        self._insertion: list[FloatArray] = [np.zeros((0, COLUMNS)) for _ in range(count)]

    def fork(self, which: Sequence[int]) -> Self:
        """See ``Scorer.fork``."""
        new = super().fork(which)
        new._insertion = [self._insertion[k].copy() for k in which]
        return new

    def begin(self, k: int, start: float, helix_length: float) -> None:
        """See ``Scorer.begin``."""
        super().begin(k, start, helix_length)
        self.reached[k], self.left[k], self._since_turn[k] = start, np.inf, 0.0
        self._insertion[k] = np.zeros((math.ceil(helix_length / BIN) + 1, COLUMNS))  # a row a bin, sums over its length

    def still_to_pass(self) -> tuple[FloatArray, FloatArray]:
        """(N,) length [m] that withdrawal is still to pass, and the sums of squares that insertion had there."""
        metres = np.maximum(np.minimum(self.left, self.reached) - self.start, 0.0)
        squares = np.zeros(len(metres))
        for k, (low, length) in enumerate(zip(self.start.tolist(), metres.tolist(), strict=True)):
            for bin_, piece in _bins(low, low + length):
                known, sum_of_squares = self._insertion[k][bin_, :2]
                squares[k] += piece * sum_of_squares / known if known > 0.0 else 0.0
        return metres, squares

    def _detection(self) -> DetectionMetrics | RoundTripMetrics:
        return RoundTripMetrics(self.config.sensor, self.config.inspects)

    def count(self, record: StepRecord, each_metre: FloatArray) -> FloatArray:
        """See ``Scorer.count``."""
        sums = np.zeros_like(each_metre)
        for k in np.flatnonzero(record.good).tolist():
            after, remembered, measured = record.after[k], self._insertion[k], each_metre[k]
            self._piece[k], self._on_insertion[k] = after, True
            if after > self.reached[k]:
                self._piece[k] = self.reached[k], after
                for bin_, length in _bins(self.reached[k], after):
                    remembered[bin_] += length * measured
                if self.config.inspects != "back":
                    sums[k] += (after - self.reached[k]) * measured
                self.reached[k] = after
            if self.direction[k] < 0.0:
                high, low = min(self.left[k], self.reached[k]), max(after, self.start[k])
                if low < high:
                    self._piece[k], self._on_insertion[k] = (low, high), False
                    for bin_, length in _bins(low, high):
                        sums[k] += self._again(remembered[bin_], length, measured)
                    self.left[k] = low
        return sums

    def _again(self, known: FloatArray, length: float, measured: FloatArray) -> FloatArray:
        """What a piece of a bin adds on withdrawal."""
        if self.config.inspects == "back":
            return length * measured
        if self.config.inspects == "in" or known[0] == 0.0:
            return np.zeros_like(measured)
        before = known / known[0]
        better = measured[1] < before[1]
        gain = np.where(better, measured - before, 0.0)
        gain[2] = max(measured[2] - before[2], 0.0)
        return np.asarray(length * gain)

    def _detect(self, k: int, inspected: float, seconds: float, signal: FilteredSignal) -> None:
        (low, high), turning = self._piece[k].tolist(), self._since_turn[k] < TURN
        stretch = "in" if self._on_insertion[k] else "turn" if turning else "back"
        self.metrics[k].detection.add(stretch, low, high, signal)  # type: ignore[call-arg, arg-type]
        if self.direction[k] < 0.0:
            self._since_turn[k] += seconds

    def complete(self, at_end: BoolArray, record: StepRecord) -> BoolArray:
        """See ``Scorer.complete``; those at the helix's end are sent back."""
        self.direction[at_end] = -1.0
        is_back = (self.direction < 0.0) & (record.after <= self.start + END_TOLERANCE)
        return is_back & record.good

    def uninspected(self, record: StepRecord) -> FloatArray:
        """Of both passes, whatever counts: else losing the drive before the turn would pay."""
        withdrawing = self.direction < 0.0
        to_draw_back = np.where(withdrawing, np.minimum(self.left, self.reached), record.helix_length) - self.start
        return np.asarray(record.helix_length - self.reached + to_draw_back)


def _bins(low: float, high: float) -> list[tuple[int, float]]:
    """Bins between two lengths, and how much of each."""
    first, last = int(low / BIN), int(high / BIN)
    edges = [low, *(BIN * k for k in range(first + 1, last + 1)), high]
    pieces = zip(range(first, last + 1), edges[:-1], edges[1:], strict=True)
    return [(bin_, end - begin) for bin_, begin, end in pieces if end > begin]
