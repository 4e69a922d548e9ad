"""Scores control periods of N probes: reward, costs, endings and episode metrics.

On insertion a metre is scored by its measured vibration. In a round trip ``config.scored_pass`` selects insertion,
withdrawal, or the better of both in each metre.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Self

import numpy as np

from probe_env.arrays import BoolArray, FloatArray, rows_of
from probe_env.envs.episodes.backend import StepRecord
from probe_env.envs.task import rules
from probe_env.envs.task.config import MEASURES, TaskConfig
from probe_env.envs.task.rules import COSTS, END_TOLERANCE, Score
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
TOTALS: Final = ("time", "inspected", "within_limit", "air", "reward", "lost_drive_events", *COSTS, *SIGNALS)
"""Sums over an episode; of a signal the squared rms over the length."""
BIN: Final = 1.0
"""Bin length of the stored insertion [m]."""


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
class SignalMetrics:
    """Figures of one episode that need samples of the motion: magnitudes in time, and detection."""

    detection: DetectionMetrics | RoundTripMetrics
    last_radial: FloatArray
    max: dict[str, float] = field(default_factory=lambda: dict.fromkeys(SIGNALS, 0.0))
    percentiles: dict[str, Percentiles] = field(default_factory=lambda: {name: Percentiles() for name in SIGNALS})

    def add(self, radial: FloatArray, sample_period: float, rest: float) -> None:
        """Add radial displacements (k,) [m] of a period around ``rest``."""
        acceleration = np.diff(np.concatenate([self.last_radial, radial]), n=2) / sample_period**2
        self.last_radial = radial[-2:].copy()
        for name, values in zip(SIGNALS, (radial - rest, acceleration), strict=True):
            self.max[name] = max(self.max[name], float(np.abs(values).max()))
            self.percentiles[name].add(values)


class Scorer:
    """Scores N episodes of one pass, or at constant length.

    Args:
        count: N.
        config: the task.
        samples: whether the motion has samples; without them KPIs of ``SignalMetrics`` are left out.

    Attributes:
        direction: (N,) 1 on insertion, -1 on withdrawal.
        start: (N,) inserted length at the start [m].
        slack_periods: (N,) number of consecutive slack periods up to now.
        totals: name -> (N,) sums over the episode so far: lengths in m, times in s, air in m3, costs in periods.
        signals: ``SignalMetrics`` of each episode, with samples.
    """

    def __init__(self, count: int, config: TaskConfig, samples: bool = True) -> None:
        self.config: Final = config
        self.direction, self.start, self.helix_length = np.ones(count), np.zeros(count), np.zeros(count)
        self.slack_periods = np.zeros(count, dtype=int)
        self.totals = {name: np.zeros(count) for name in TOTALS}
        self.signals = [self._signals(np.zeros(2)) for _ in range(count)] if samples else []

    def branch(self, which: Sequence[int]) -> Self:
        """Scorer of copies of the episodes ``which``: same rewards and endings; totals but the time start from zero."""
        new = rows_of(self, which)
        new.totals = {name: np.zeros(len(which)) for name in TOTALS} | {"time": new.totals["time"]}
        new.signals = [self._signals(self.signals[k].last_radial) for k in which] if self.signals else []
        return new

    def begin(self, k: int, start: float, helix_length: float, window: Window) -> None:
        """Start the episode of probe ``k`` at an inserted length ``start`` [m]; it settled in ``window``."""
        self.direction[k], self.start[k], self.helix_length[k], self.slack_periods[k] = 1.0, start, helix_length, 0
        for values in self.totals.values():
            values[k] = 0.0
        if self.signals:
            self.signals[k] = self._signals(window.radial_of(k)[-2:].copy())

    def score(self, record: StepRecord, action_change: FloatArray) -> Score:
        """Score a control period with a change (N, 2) of the action, and add it to the totals."""
        config, window, finite = self.config, record.window, record.finite
        ratio = window.statistics[MEASURES[config.vibration_measure][0]] / config.limit
        squares = [window.statistics[f"{name}_rms_{unit}"] ** 2 for name, unit in SIGNALS.items()]
        per_metre = np.column_stack([np.ones(len(ratio)), rules.capped_square(config, ratio), ratio <= 1.0, *squares])
        sums = self.sums_over_length(record, per_metre)
        tension = window.statistics["tension_mean_n"]
        is_slack = rules.slack(config, tension, record.length_after) & (self.direction > 0.0)
        terms = rules.cost_terms(config, is_slack, tension, record.max_tension, record.buckling_load)
        costs = {name: np.where(finite, cost, 0.0) for name, cost in terms.items()}
        self.slack_periods = np.where(finite, rules.consecutive_slack(self.slack_periods, is_slack), self.slack_periods)
        self._add(
            time=np.where(record.stepped, config.period, 0.0),
            inspected=sums[:, 0],
            within_limit=sums[:, 2],
            air=record.air,
            lost_drive_events=finite & (self.slack_periods == config.lost_drive_periods),
            **costs,
            **dict(zip(SIGNALS, sums.T[3:], strict=True)),
        )
        for k in np.flatnonzero(finite).tolist() if self.signals else ():
            radial = window.radial_of(k)
            rest = float(radial.mean()) if self.direction[k] < 0.0 else 0.0  # on the outer wall, or moving towards it
            self.signals[k].add(radial, SAMPLE_PERIOD, rest)
            self._detect(k, float(sums[k, 0]), float(record.seconds[k]), record.signals[k])
        now = rules.Situation(
            record.length_after, record.helix_length, self.slack_periods, record.stepped, window.diverged
        )
        ends = rules.ending(config, now, self.totals["time"])
        ends["complete"] = self.complete(ends["complete"], record)
        uninspected = np.where(rules.any_ending(ends) & config.growing, self.uninspected(record), 0.0)
        rewards = rules.reward_terms(
            config,
            inspected=sums[:, 0],
            squares=sums[:, 1],
            seconds=np.full(len(sums), config.period),
            air=record.air,
            action_change=action_change,
            uninspected=uninspected,
            diverged=ends["diverged"],
        )
        scored = Score(rewards, costs, ends, np.where(record.stepped, sum(rewards.values()), 0.0))
        self._add(reward=scored.reward)
        return scored

    def kpis(self, k: int, scored: Score) -> dict[str, Any]:
        """KPIs of a finished episode."""
        total = {name: float(values[k]) for name, values in self.totals.items()}
        helix_length, inspected = float(self.helix_length[k]), total["inspected"]
        length = helix_length - float(self.start[k]) if self.config.growing else inspected
        values: dict[str, Any] = {
            "inspection_time_s": total["time"],
            "inspected_m": inspected,
            "inspected_share": inspected / length if length > 0.0 else 0.0,
            "share_within_limit": total["within_limit"] / length if length > 0.0 else 0.0,
            "air_m3": total["air"],
            "reward": total["reward"],
            "lost_drive_events": total["lost_drive_events"],
            **scored.kpis(k),
            "cost": sum(total[name] for name in COSTS),
            **{f"cost_{name}": total[name] for name in COSTS},
        }
        for name, unit in SIGNALS.items():
            mean_square = max(total[name] / inspected, 0.0) if inspected > 0.0 else 0.0
            values[f"{name}_rms_{unit}"] = float(np.sqrt(mean_square))
            if self.signals:
                values[f"{name}_p99_{unit}"] = self.signals[k].percentiles[name].percentile(99.0)
                values[f"{name}_max_{unit}"] = self.signals[k].max[name]
        return values | (self.signals[k].detection.kpis(length, helix_length) if self.signals else {})

    def _add(self, **values: FloatArray | BoolArray) -> None:
        """Add values (N,) of a period to the totals."""
        for name, added in values.items():
            self.totals[name] += added

    def _signals(self, last_radial: FloatArray) -> SignalMetrics:
        return SignalMetrics(self._detection(), last_radial)

    def _detection(self) -> DetectionMetrics | RoundTripMetrics:
        return DetectionMetrics(self.config.sensor)

    def sums_over_length(self, record: StepRecord, per_metre: FloatArray) -> FloatArray:
        """(N, COLUMNS) sums of ``per_metre`` (N, COLUMNS) over the length inspected in the period."""
        config, feed_speed = self.config, record.window.feed_speed
        length = record.length_after - record.length_before if config.growing else feed_speed * config.period
        return np.where(record.finite, length, 0.0)[:, None] * per_metre

    def _detect(self, k: int, inspected: float, seconds: float, signal: FilteredSignal) -> None:
        """Add the signal-to-noise of a period with an inspected length [m] and a duration of motion [s]."""
        self.signals[k].detection.add(inspected, signal)  # type: ignore[call-arg, arg-type]

    def complete(self, at_end: BoolArray, record: StepRecord) -> BoolArray:
        """(N,) whether the inspection is complete; ``at_end`` (N,) is whether the probe is at the end of the helix."""
        return at_end

    def uninspected(self, record: StepRecord) -> FloatArray:
        """(N,) length still to inspect [m], if the length grows."""
        # a period that diverged inspects nothing
        return record.helix_length - np.where(record.finite, record.length_after, record.length_before)


class RoundTripScorer(Scorer):
    """Scores N round trips: insertion to the end of the helix and withdrawal to the initial length.

    Attributes:
        reached: (N,) greatest inserted length so far [m].
        withdrawn_to: (N,) least inserted length on withdrawal so far [m].
    """

    def __init__(self, count: int, config: TaskConfig, samples: bool = True) -> None:
        super().__init__(count, config, samples)
        self.reached, self.withdrawn_to = np.zeros(count), np.full(count, np.inf)
        self._since_turn, self._piece = np.zeros(count), np.zeros((count, 2))  # [s]; ends of the last scored piece [m]
        self._on_insertion = np.ones(count, dtype=bool)  # pass of that piece
        self._insertion: list[FloatArray] = [np.zeros((0, COLUMNS)) for _ in range(count)]

    def branch(self, which: Sequence[int]) -> Self:
        """See ``Scorer.branch``."""
        new = super().branch(which)
        new._insertion = [self._insertion[k].copy() for k in which]
        return new

    def begin(self, k: int, start: float, helix_length: float, window: Window) -> None:
        """See ``Scorer.begin``."""
        super().begin(k, start, helix_length, window)
        self.reached[k], self.withdrawn_to[k], self._since_turn[k] = start, np.inf, 0.0
        self._insertion[k] = np.zeros((math.ceil(helix_length / BIN) + 1, COLUMNS))  # a row a bin, sums over its length

    def _detection(self) -> DetectionMetrics | RoundTripMetrics:
        return RoundTripMetrics(self.config.sensor, self.config.scored_pass)

    def sums_over_length(self, record: StepRecord, per_metre: FloatArray) -> FloatArray:
        """See ``Scorer.sums_over_length``."""
        sums = np.zeros_like(per_metre)
        for k in np.flatnonzero(record.finite).tolist():
            after, insertion, measured = record.length_after[k], self._insertion[k], per_metre[k]
            self._piece[k], self._on_insertion[k] = after, True
            if after > self.reached[k]:
                self._piece[k] = self.reached[k], after
                for bin_, length in _bins(self.reached[k], after):
                    insertion[bin_] += length * measured
                if self.config.scored_pass != "withdrawal":
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
        if self.config.scored_pass == "withdrawal":
            return length * measured
        if self.config.scored_pass == "insertion" or insertion[0] == 0.0:
            return np.zeros_like(measured)
        before = insertion / insertion[0]
        better = measured[1] < before[1]
        gain = np.where(better, measured - before, 0.0)
        gain[2] = max(measured[2] - before[2], 0.0)
        return np.asarray(length * gain)

    def _detect(self, k: int, inspected: float, seconds: float, signal: FilteredSignal) -> None:
        (low, high), turning = self._piece[k].tolist(), self._since_turn[k] < TURN
        segment = "in" if self._on_insertion[k] else "turn" if turning else "back"
        self.signals[k].detection.add(segment, low, high, signal)  # type: ignore[call-arg, arg-type]
        if self.direction[k] < 0.0:
            self._since_turn[k] += seconds

    def complete(self, at_end: BoolArray, record: StepRecord) -> BoolArray:
        """See ``Scorer.complete``; probes at the end of the helix turn to withdrawal."""
        self.direction[at_end] = -1.0
        is_back = (self.direction < 0.0) & (record.length_after <= self.start + END_TOLERANCE)
        return is_back & record.finite

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
