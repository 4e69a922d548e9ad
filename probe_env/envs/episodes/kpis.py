"""Figures of a whole episode, gathered period by period."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import numpy.typing as npt

from probe_env.arrays import FloatArray
from probe_env.envs.task import ENDINGS, slack_in_a_row
from probe_env.envs.task.safety import COSTS
from probe_env.inspection.either import EitherTally
from probe_env.inspection.tally import DetectionTally

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
