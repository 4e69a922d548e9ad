"""Scores control periods of N probes: what counts, rewards, costs, endings, and the figures of an episode."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from probe_env.arrays import BoolArray, FloatArray
from probe_env.envs.task import COSTS, Outcome, TaskConfig, cost_terms, ending, reward_terms, slack
from probe_env.envs.task.passes import Counted, StepRecord, passes_of
from probe_env.envs.task.rules import Ending
from probe_env.inspection.metrics import DetectionMetrics, RoundTripMetrics
from probe_env.inspection.snr import SnrEstimator
from probe_env.physics.simulation.signals import SAMPLE_PERIOD
from probe_env.physics.simulation.window import Window

LOWEST, HIGHEST, PER_DECADE = 1e-9, 1e6, 200
BINS = round(np.log10(HIGHEST / LOWEST) * PER_DECADE)
SIGNALS = {"radial": "m", "radial_acceleration": "m_per_s2"}
"""Signals of the figures and their units; rms is over the length inspected, p99 and max over the magnitude in time."""


class Percentiles:
    """Percentiles of the magnitude of many samples, to 1.2 %, in a histogram of logarithmic bins."""

    def __init__(self) -> None:
        self.counts = np.zeros(BINS, dtype=np.int64)

    def add(self, samples: FloatArray) -> None:
        """Count samples of any sign, unit and shape."""
        place = np.log10(np.clip(np.abs(samples), LOWEST, HIGHEST * 0.999) / LOWEST) * PER_DECADE
        self.counts += np.bincount(place.astype(np.int64).ravel(), minlength=BINS)

    def percentile(self, percent: float) -> float:
        """Upper edge of the bin that holds the percentile; 0 without samples."""
        total = int(self.counts.sum())
        if total == 0:
            return 0.0
        bin_ = int(np.searchsorted(np.cumsum(self.counts), percent / 100.0 * total))
        return float(LOWEST * 10.0 ** ((bin_ + 1) / PER_DECADE))


@dataclass
class Tally:
    """What one episode has come to; lengths in m, times in s, air in m3, costs in periods."""

    time: float = 0.0
    inspected: float = 0.0
    within_limit: float = 0.0
    air: float = 0.0
    reward: float = 0.0
    lost_drive_events: int = 0
    slack_periods: int = 0
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
        """Figures that need no samples; ``length`` was to be inspected [m], ``ended`` as from ``Ending.kpis``."""
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


class Score(NamedTuple):
    """What a period is worth: named terms (N,) of reward and cost, their sum, and which episodes end."""

    rewards: dict[str, FloatArray]
    costs: dict[str, FloatArray]
    reward: FloatArray
    end: Ending


class Judge:
    """Scores the control periods of N episodes and keeps their figures.

    Args:
        count: N.
        config: the task.

    Attributes:
        passes: which way each probe goes, and what was found.
        tally: of each, up to now.
    """

    def __init__(self, count: int, config: TaskConfig) -> None:
        self.config: Final = config
        self.passes: Final = passes_of(count, config, len(SIGNALS))
        self.tally: Final = [Tally() for _ in range(count)]
        self._start = np.zeros(count)

    def fork(self, which: Sequence[int]) -> Judge:
        """A judge of copies of some episodes, which rewards and ends them as this one; figures count from here on."""
        new, passes = copy.copy(self), self.passes.fork(which)
        tallies = [Tally(detection=detection) for detection in passes.detection]
        for tally, of in zip(tallies, (self.tally[k] for k in which), strict=True):
            tally.time, tally.slack_periods, tally.last_radial = of.time, of.slack_periods, of.last_radial
        vars(new).update(passes=passes, tally=tallies, _start=self._start[list(which)])
        return new

    def begin(self, k: int, start: float, helix_length: float) -> None:
        """An episode of probe ``k`` begins at an inserted length [m]."""
        self._start[k] = start
        self.passes.begin(k, start, helix_length)
        self.tally[k] = Tally(detection=self.passes.detection[k])

    def judge(self, record: StepRecord, window: Window, meter: SnrEstimator, buckling: FloatArray) -> Score:
        """Count a period.

        Args:
            record: what happened.
            window: the motion.
            meter: that has read it.
            buckling: (N,) load of the cables between two floats [N].
        """
        assert window.tension is not None
        counted, mean = self.passes.count(record), window.statistics["tension_mean_n"]
        hanging = slack(self.config, mean, record.after) & (self.passes.way > 0.0)
        terms = cost_terms(self.config, hanging, mean, np.nanmax(window.tension, axis=0), buckling)
        costs = {name: np.where(record.good, cost, 0.0) for name, cost in terms.items()}
        for k in np.flatnonzero(record.stepped).tolist():
            tally = self.tally[k]
            tally.time += self.config.period
            if not record.good[k]:
                continue
            for name, values in costs.items():
                tally.costs[name] += float(values[k])
            inspected, radial = float(counted.inspected[k]), window.radial_of(k)
            tally.inspected += inspected
            tally.within_limit += float(counted.within[k])
            tally.air += float(record.air[k])
            tally.slack_periods = tally.slack_periods + 1 if hanging[k] else 0
            tally.lost_drive_events += tally.slack_periods == self.config.lost_drive_periods
            rest = float(radial.mean()) if self.passes.way[k] < 0.0 else 0.0  # on the outer wall, or on its way there
            tally.add_signals(counted.measures[k].tolist(), radial, SAMPLE_PERIOD, rest)
            self.passes.hear(k, inspected, float(record.seconds[k]), meter.last(k))
        return self._score(record, counted, costs, window.diverged)

    def _score(self, record: StepRecord, counted: Counted, costs: dict[str, FloatArray], diverged: BoolArray) -> Score:
        slack_periods, time, inspected = (
            np.array([getattr(tally, name) for tally in self.tally]) for name in ("slack_periods", "time", "inspected")
        )
        end = ending(self.config, record.after, record.helix_length, slack_periods, time, record.stepped, diverged)
        end = self.passes.ended(end, record)
        left = np.where(end.over & self.config.growing, self.passes.uninspected(record, inspected), 0.0)
        seconds = np.full(len(self.tally), self.config.period)
        outcome = Outcome(counted.inspected, counted.squares, seconds, record.air, left, end.diverged)
        rewards = reward_terms(self.config, outcome, record.action_change)
        reward = np.where(record.stepped, sum(rewards.values()), 0.0)
        for k in np.flatnonzero(record.stepped):
            self.tally[k].reward += float(reward[k])
        return Score(rewards, costs, reward, end)

    def kpis(self, k: int, tube_length: float, end: Ending) -> dict[str, float]:
        """Figures of an episode that has ended, in a tube of a length [m]."""
        tally = self.tally[k]
        length = tube_length - self._start[k] if self.config.growing else tally.inspected
        return tally.kpis(float(length), tube_length, end.kpis(k))
