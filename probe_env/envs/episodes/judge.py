"""Scores control periods of N probes: what counts, rewards, costs, endings, and the figures of an episode.

One motion may have several judges, such as one that counts what the way in alone would have found.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from probe_env.arrays import BoolArray, FloatArray
from probe_env.envs.task import (
    COSTS,
    ENDINGS,
    MEASURES,
    Ending,
    Outcome,
    TaskConfig,
    air_used,
    capped_square,
    cost_terms,
    ending,
    passes_of,
    reward_terms,
    slack,
    slack_in_a_row,
)
from probe_env.envs.task.passes import Counted, Period
from probe_env.inspection.meter import Meter
from probe_env.inspection.tally import DetectionTally, EitherTally
from probe_env.physics.simulation.signals import SAMPLE_PERIOD
from probe_env.physics.simulation.window import Window

LOWEST, HIGHEST, PER_DECADE = 1e-9, 1e6, 200
BINS = round(np.log10(HIGHEST / LOWEST) * PER_DECADE)
SIGNALS = {"radial": "m", "radial_acceleration": "m_per_s2"}
"""Signals of the figures and their units; rms is over the length inspected, p99 and max over the magnitude in time."""

OF_MOTION: Final = frozenset(
    {"inspection_time_s", "air_m3", "lost_drive_events", *ENDINGS, "cost", *(f"cost_{name}" for name in COSTS)}
    | {f"{name}_{figure}_{unit}" for name, unit in SIGNALS.items() for figure in ("p99", "max")}
)
"""KPIs that do not hang on what counts: they are those of the motion."""


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
    detection: DetectionTally | EitherTally = field(default_factory=DetectionTally)

    def add_period(self, inspected: float, within_limit: float, air: float) -> None:
        """Length inspected [m], how much of it within the limit [m], and air [m3] of a period."""
        self.inspected += inspected
        self.within_limit += within_limit
        self.air += air

    def add_drive(self, hanging: bool, patience: int) -> None:
        """Whether too little tension drove the probe in a period; drive is lost after ``patience`` of them in a row."""
        self.slack_periods = int(slack_in_a_row(np.array(self.slack_periods), np.array(hanging)))
        self.lost_drive_events += self.slack_periods == patience

    def add_signals(self, squares: Sequence[float], radial: FloatArray, sample_period: float, rest: float) -> None:
        """Radial displacement samples (k,) [m] of a period, and what it adds to the sums over length of each square.

        ``rest`` is the displacement of a sensor that does not vibrate [m].
        """
        acceleration = np.diff(np.concatenate([self.last_radial, radial]), n=2) / sample_period**2
        self.last_radial = radial[-2:].copy()
        for name, square, values in zip(SIGNALS, squares, (radial - rest, acceleration), strict=True):
            self.squares[name] += square
            self.greatest[name] = max(self.greatest[name], float(np.abs(values).max()))
            self.samples[name].add(values)

    def kpis(self, length: float, tube_length: float, ended: Mapping[str, float]) -> dict[str, float]:
        """The episode's figures.

        Args:
            length: all that was to be inspected [m].
            tube_length: of the tube that it is in [m].
            ended: how it ended, see ``Ending.kpis``.
        """
        values: dict[str, float] = {
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
        for name, unit in SIGNALS.items():
            mean_square = max(self.squares[name] / self.inspected, 0.0) if self.inspected > 0.0 else 0.0
            values[f"{name}_rms_{unit}"] = float(np.sqrt(mean_square))
            values[f"{name}_p99_{unit}"] = self.samples[name].percentile(99.0)
            values[f"{name}_max_{unit}"] = self.greatest[name]
        return values | self.detection.kpis(length, tube_length)


class Motion(NamedTuple):
    """A control period of N probes as it was simulated, whatever it counts for.

    Attributes:
        chosen: (N,) that were stepped.
        good: (N,) of them those that did not diverge.
        before, after: (N,) inserted length around it [m].
        helix_length: (N,) [m].
        air_before: (N,) supply rate at its start [m3/s].
        seconds: (N,) of motion.
        change: (N, 2) action less the one before.
        buckling: (N,) load [N].
        window: of the motion.
        meter: that has heard it.
    """

    chosen: BoolArray
    good: BoolArray
    before: FloatArray
    after: FloatArray
    helix_length: FloatArray
    air_before: FloatArray
    seconds: FloatArray
    change: FloatArray
    buckling: FloatArray
    window: Window
    meter: Meter


class Verdict(NamedTuple):
    """What a period came to: named terms (N,) of reward and cost, and which episodes end."""

    rewards: dict[str, FloatArray]
    costs: dict[str, FloatArray]
    reward: FloatArray
    end: Ending


class Judge:
    """Keeps the tallies of N episodes.

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
        """A judge of copies of some episodes, who rewards and ends them as this one; figures count from here on."""
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

    def settled(self, k: int, radial: npt.NDArray[np.floating]) -> None:
        """The last two radial displacements [m] before an episode's first period."""
        self.tally[k].last_radial = radial.copy()

    def judge(self, motion: Motion) -> Verdict:
        """Count a period, and say what it came to."""
        period = self._period(motion)
        counted = self.passes.count(period)
        air = np.where(motion.good, air_used(self.config, motion.air_before, motion.window.air_supply_rate), 0.0)
        hanging = slack(self.config, motion.window.statistics["tension_mean_n"], motion.after) & (self.passes.way > 0.0)
        costs = self._costs(motion, hanging)
        self._count(motion, counted, air, hanging)
        end = self._ending(motion, period)
        rewards = reward_terms(self.config, self._outcome(motion, period, counted, air, end), motion.change)
        reward = np.where(motion.chosen, sum(rewards.values()), 0.0)
        for k in np.flatnonzero(motion.chosen):
            self.tally[k].reward += float(reward[k])
        return Verdict(rewards, costs, reward, end)

    def kpis(self, k: int, tube_length: float, end: Ending) -> dict[str, float]:
        """Figures of an episode that has ended, in a tube of a length [m]."""
        tally = self.tally[k]
        length = tube_length - self._start[k] if self.config.growing else tally.inspected
        return tally.kpis(float(length), tube_length, end.kpis(k))

    def _period(self, motion: Motion) -> Period:
        """What a period of the simulation is to the task."""
        statistics = motion.window.statistics
        ratio = statistics[MEASURES[self.config.vibration_measure][0]] / self.config.limit
        rms = np.column_stack([statistics["radial_rms_m"], statistics["radial_acceleration_rms_m_per_s2"]])
        squares = capped_square(self.config, ratio)
        feed_speed = motion.window.feed_speed
        return Period(motion.good, motion.before, motion.after, feed_speed, squares, ratio <= 1.0, rms**2)

    def _costs(self, motion: Motion, hanging: BoolArray) -> dict[str, FloatArray]:
        """Parts (N,) of the period's cost, which are tallied as well; 0 for probes that were not advanced."""
        assert motion.window.tension is not None
        mean, greatest = motion.window.statistics["tension_mean_n"], np.nanmax(motion.window.tension, axis=0)
        terms = cost_terms(self.config, hanging, mean, greatest, motion.buckling)
        costs = {name: np.where(motion.good, cost, 0.0) for name, cost in terms.items()}
        for k in np.flatnonzero(motion.good):
            for name, values in costs.items():
                self.tally[k].costs[name] += float(values[k])
        return costs

    def _count(self, motion: Motion, counted: Counted, air: FloatArray, hanging: BoolArray) -> None:
        """Add a period to the tallies."""
        for k in np.flatnonzero(motion.chosen).tolist():
            tally = self.tally[k]
            tally.time += self.config.period
            if not motion.good[k]:
                continue
            inspected, radial = float(counted.inspected[k]), motion.window.radial_of(k)
            tally.add_period(inspected, float(counted.within[k]), float(air[k]))
            tally.add_drive(bool(hanging[k]), self.config.lost_drive_periods)
            rest = float(radial.mean()) if self.passes.way[k] < 0.0 else 0.0  # on the outer wall, or on its way there
            tally.add_signals(counted.measures[k].tolist(), radial, SAMPLE_PERIOD, rest)
            self.passes.hear(k, inspected, float(motion.seconds[k]), motion.meter.of(k))

    def _ending(self, motion: Motion, period: Period) -> Ending:
        """How episodes end with a period."""
        slack_periods, time = (np.array([getattr(t, name) for t in self.tally]) for name in ("slack_periods", "time"))
        end = ending(
            self.config, motion.after, motion.helix_length, slack_periods, time, motion.chosen, motion.window.diverged
        )
        return self.passes.ended(end, period)

    def _outcome(self, motion: Motion, period: Period, counted: Counted, air: FloatArray, end: Ending) -> Outcome:
        """What a period came to."""
        inspected = np.array([tally.inspected for tally in self.tally])
        left = self.passes.uninspected(period, motion.helix_length, inspected)
        left = np.where(end.over & self.config.growing, left, 0.0)
        seconds = np.full(len(self.tally), self.config.period)
        return Outcome(counted.inspected, counted.squares, seconds, air, left, end.diverged)


def judged_beside(look: str, kpis: dict[str, float]) -> dict[str, float]:
    """Figures of an episode by another judge that differ with what counts, by name: "back_reward"."""
    return {f"{look}_{name}": value for name, value in kpis.items() if name not in OF_MOTION}


def judges_of(count: int, config: TaskConfig, looks: Sequence[str]) -> dict[str, Judge]:
    """Judges of a task's other looks, by what counts; none where probes go one way."""
    others = [look for look in looks if config.returns and look != config.inspects]
    return {look: Judge(count, config.model_copy(update={"inspects": look})) for look in others}
