"""Scores control periods of N probes: reward, costs, endings and episode metrics.

On insertion a metre is scored by its measured vibration. In a round trip, ``config.inspects`` selects the scored pass:
insertion, withdrawal, or the better of both in each metre.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple, Self

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
"""Signals of the KPIs and their units; rms is over the inspected length, p99 and max over the magnitude in time."""
COLUMNS: Final = 3 + len(SIGNALS)
"""Number of sums over length: 1, capped square, within limit (0 or 1), and squared rms of each signal."""
BIN: Final = 1.0
"""Bin length of the stored insertion [m]."""


class StepRecord(NamedTuple):
    """What happened to N probes in a control period, (N,) each; SI units."""

    stepped: BoolArray
    good: BoolArray  # stepped, and did not diverge
    before: FloatArray  # inserted length at the start
    after: FloatArray  # inserted length at the end
    helix_length: FloatArray
    air: FloatArray  # used [m3]
    seconds: FloatArray  # of motion
    action_change: FloatArray  # (N, 2) change of the action
    buckling_load: FloatArray  # of the cable between two floats [N]
    window: Window  # motion of the sensor and root tension
    signals: Mapping[int, FilteredSignal]  # good probes, see ``SnrEstimator.last``


class Percentiles:
    """Percentiles of the magnitude of samples from a histogram with logarithmic bins; accurate to 1.2 %."""

    def __init__(self) -> None:
        self.counts = np.zeros(BINS, dtype=np.int64)

    def add(self, samples: FloatArray) -> None:
        """Add samples of any sign, unit and shape."""
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
    """Running sums of one episode; lengths in m, times in s, air in m3, costs in periods."""

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
        """KPIs without samples; ``length`` is the length to inspect [m], ``ended`` is ``Score.kpis``."""
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

    def kpis(self, length: float, tube_length: float, ended: Mapping[str, float]) -> dict[str, Any]:
        """All KPIs of the episode in a tube of ``tube_length`` [m]; see ``totals``."""
        values: dict[str, Any] = self.totals(length, ended)
        for name, unit in SIGNALS.items():
            mean_square = max(self.squares[name] / self.inspected, 0.0) if self.inspected > 0.0 else 0.0
            values[f"{name}_rms_{unit}"] = float(np.sqrt(mean_square))
            values[f"{name}_p99_{unit}"] = self.samples[name].percentile(99.0)
            values[f"{name}_max_{unit}"] = self.greatest[name]
        return values | self.detection.kpis(length, tube_length)


class Scorer:
    """Scores N episodes of one pass, or at constant length.

    Args:
        count: N.
        config: the task.

    Attributes:
        direction: (N,) 1 on insertion, -1 on withdrawal.
        start: (N,) inserted length at the start [m].
        metrics: running metrics of each episode.
    """

    def __init__(self, count: int, config: TaskConfig) -> None:
        self.config: Final = config
        self.direction, self.start = np.ones(count), np.zeros(count)
        self.metrics = [EpisodeMetrics() for _ in range(count)]

    def fork(self, which: Sequence[int]) -> Self:
        """Scorer of copies of the episodes ``which``: same rewards and endings; metrics start from zero."""
        new, index = copy.copy(self), list(which)
        for name, values in vars(self).items():
            if isinstance(values, np.ndarray):
                setattr(new, name, values[index])
        new.metrics = []
        for old in (self.metrics[k] for k in index):
            metrics = EpisodeMetrics(old.time, detection=self._detection(), last_radial=old.last_radial)
            metrics.consecutive_slack_steps = old.consecutive_slack_steps
            new.metrics.append(metrics)
        return new

    def begin(self, k: int, start: float, helix_length: float) -> None:
        """Start the episode of probe ``k`` at an inserted length ``start`` [m] in a helix of ``helix_length`` [m]."""
        self.direction[k], self.start[k] = 1.0, start
        self.metrics[k] = EpisodeMetrics(detection=self._detection())

    def score(self, record: StepRecord) -> Score:
        """Score a control period and add it to the metrics."""
        config, window = self.config, record.window
        assert window.tension is not None
        ratio = window.statistics[MEASURES[config.vibration_measure][0]] / config.limit
        squares = [window.statistics[f"{name}_rms_{unit}"] ** 2 for name, unit in SIGNALS.items()]
        per_metre = np.column_stack([np.ones(len(ratio)), rules.capped_square(config, ratio), ratio <= 1.0, *squares])
        sums = self.sums_over_length(record, per_metre)
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
        uninspected = np.where(rules.any_ending(ends) & config.growing, self.uninspected(record), 0.0)
        rewards = rules.reward_terms(
            config, sums[:, 0], sums[:, 1], np.full(len(sums), config.period), record.air, uninspected,
            ends["diverged"], action_change=record.action_change,
        )  # fmt: skip
        scored = Score(rewards, costs, ends, np.where(record.stepped, sum(rewards.values()), 0.0))
        for k in np.flatnonzero(record.stepped).tolist():
            self.metrics[k].reward += float(scored.reward[k])
        return scored

    def kpis(self, k: int, tube_length: float, scored: Score) -> dict[str, Any]:
        """KPIs of a finished episode in a tube of ``tube_length`` [m]."""
        length = tube_length - self.start[k] if self.config.growing else self.metrics[k].inspected
        return self.metrics[k].kpis(float(length), tube_length, scored.kpis(k))

    def _add(
        self, k: int, record: StepRecord, sums: list[float], is_slack: bool, costs: Mapping[str, FloatArray]
    ) -> None:
        """Add a period to the metrics of a probe; ``sums`` is a row of ``sums_over_length``."""
        metrics, radial = self.metrics[k], record.window.radial_of(k)
        for name, values in costs.items():
            metrics.costs[name] += float(values[k])
        metrics.inspected += sums[0]
        metrics.within_limit += sums[2]
        metrics.air += float(record.air[k])
        metrics.consecutive_slack_steps = metrics.consecutive_slack_steps + 1 if is_slack else 0
        metrics.lost_drive_events += metrics.consecutive_slack_steps == self.config.lost_drive_periods
        rest = float(radial.mean()) if self.direction[k] < 0.0 else 0.0  # on the outer wall, or moving towards it
        metrics.add_signals(sums[3:], radial, SAMPLE_PERIOD, rest)
        self._detect(k, sums[0], float(record.seconds[k]), record.signals[k])

    def _detection(self) -> DetectionMetrics | RoundTripMetrics:
        return DetectionMetrics(self.config.sensor)

    def sums_over_length(self, record: StepRecord, per_metre: FloatArray) -> FloatArray:
        """(N, COLUMNS) sums of ``per_metre`` (N, COLUMNS) over the length inspected in the period."""
        config, feed_speed = self.config, record.window.feed_speed
        length = record.after - record.before if config.growing else feed_speed * config.period
        return np.where(record.good, length, 0.0)[:, None] * per_metre

    def _detect(self, k: int, inspected: float, seconds: float, signal: FilteredSignal) -> None:
        """Add the signal-to-noise of a period with an inspected length [m] and a duration of motion [s]."""
        self.metrics[k].detection.add(inspected, signal)  # type: ignore[call-arg, arg-type]

    def complete(self, at_end: BoolArray, record: StepRecord) -> BoolArray:
        """(N,) whether the inspection is complete; ``at_end`` (N,) is whether the probe is at the end of the helix."""
        return at_end

    def uninspected(self, record: StepRecord) -> FloatArray:
        """(N,) length still to inspect [m], if the length grows."""
        # a period that diverged inspects nothing
        return record.helix_length - np.where(record.good, record.after, record.before)


class RoundTripScorer(Scorer):
    """Scores N round trips: insertion to the end of the helix and withdrawal to the initial length.

    Attributes:
        reached: (N,) greatest inserted length so far [m].
        withdrawn_to: (N,) least inserted length on withdrawal so far [m].
    """

    def __init__(self, count: int, config: TaskConfig) -> None:
        super().__init__(count, config)
        self.reached, self.withdrawn_to = np.zeros(count), np.full(count, np.inf)
        self._since_turn, self._piece = np.zeros(count), np.zeros((count, 2))  # [s]; ends of the last scored piece [m]
        self._on_insertion = np.ones(count, dtype=bool)  # pass of that piece
        self._insertion: list[FloatArray] = [np.zeros((0, COLUMNS)) for _ in range(count)]

    def fork(self, which: Sequence[int]) -> Self:
        """See ``Scorer.fork``."""
        new = super().fork(which)
        new._insertion = [self._insertion[k].copy() for k in which]
        return new

    def begin(self, k: int, start: float, helix_length: float) -> None:
        """See ``Scorer.begin``."""
        super().begin(k, start, helix_length)
        self.reached[k], self.withdrawn_to[k], self._since_turn[k] = start, np.inf, 0.0
        self._insertion[k] = np.zeros((math.ceil(helix_length / BIN) + 1, COLUMNS))  # a row a bin, sums over its length

    def still_to_pass(self) -> tuple[FloatArray, FloatArray]:
        """(N,) length [m] still to withdraw, and the sums of squares of insertion over it."""
        metres = np.maximum(np.minimum(self.withdrawn_to, self.reached) - self.start, 0.0)
        squares = np.zeros(len(metres))
        for k, (low, length) in enumerate(zip(self.start.tolist(), metres.tolist(), strict=True)):
            for bin_, piece in _bins(low, low + length):
                inspected, sum_of_squares = self._insertion[k][bin_, :2]
                squares[k] += piece * sum_of_squares / inspected if inspected > 0.0 else 0.0
        return metres, squares

    def _detection(self) -> DetectionMetrics | RoundTripMetrics:
        return RoundTripMetrics(self.config.sensor, self.config.inspects)

    def sums_over_length(self, record: StepRecord, per_metre: FloatArray) -> FloatArray:
        """See ``Scorer.sums_over_length``."""
        sums = np.zeros_like(per_metre)
        for k in np.flatnonzero(record.good).tolist():
            after, insertion, measured = record.after[k], self._insertion[k], per_metre[k]
            self._piece[k], self._on_insertion[k] = after, True
            if after > self.reached[k]:
                self._piece[k] = self.reached[k], after
                for bin_, length in _bins(self.reached[k], after):
                    insertion[bin_] += length * measured
                if self.config.inspects != "back":
                    sums[k] += (after - self.reached[k]) * measured
                self.reached[k] = after
            if self.direction[k] < 0.0:
                high, low = min(self.withdrawn_to[k], self.reached[k]), max(after, self.start[k])
                if low < high:
                    self._piece[k], self._on_insertion[k] = (low, high), False
                    for bin_, length in _bins(low, high):
                        sums[k] += self._withdrawal_sums(insertion[bin_], length, measured)
                    self.withdrawn_to[k] = low
        return sums

    def _withdrawal_sums(self, insertion: FloatArray, length: float, measured: FloatArray) -> FloatArray:
        """(COLUMNS,) change of the sums by a piece [m] of withdrawal in a bin with sums of ``insertion``."""
        if self.config.inspects == "back":
            return length * measured
        if self.config.inspects == "in" or insertion[0] == 0.0:
            return np.zeros_like(measured)
        before = insertion / insertion[0]
        better = measured[1] < before[1]
        gain = np.where(better, measured - before, 0.0)
        gain[2] = max(measured[2] - before[2], 0.0)
        return np.asarray(length * gain)

    def _detect(self, k: int, inspected: float, seconds: float, signal: FilteredSignal) -> None:
        (low, high), turning = self._piece[k].tolist(), self._since_turn[k] < TURN
        segment = "in" if self._on_insertion[k] else "turn" if turning else "back"
        self.metrics[k].detection.add(segment, low, high, signal)  # type: ignore[call-arg, arg-type]
        if self.direction[k] < 0.0:
            self._since_turn[k] += seconds

    def complete(self, at_end: BoolArray, record: StepRecord) -> BoolArray:
        """See ``Scorer.complete``; probes at the end of the helix turn to withdrawal."""
        self.direction[at_end] = -1.0
        is_back = (self.direction < 0.0) & (record.after <= self.start + END_TOLERANCE)
        return is_back & record.good

    def uninspected(self, record: StepRecord) -> FloatArray:
        """Length of both passes, whichever is scored: otherwise it would pay to lose the drive before the turn."""
        withdrawing = self.direction < 0.0
        to_pass = np.where(withdrawing, np.minimum(self.withdrawn_to, self.reached), record.helix_length) - self.start
        return np.asarray(record.helix_length - self.reached + to_pass)


def _bins(low: float, high: float) -> list[tuple[int, float]]:
    """Bins between two lengths, and the length in each [m]."""
    first, last = int(low / BIN), int(high / BIN)
    edges = [low, *(BIN * k for k in range(first + 1, last + 1)), high]
    pieces = zip(range(first, last + 1), edges[:-1], edges[1:], strict=True)
    return [(bin_, end - begin) for bin_, begin, end in pieces if end > begin]
