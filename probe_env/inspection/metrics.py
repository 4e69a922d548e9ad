"""Detection in one episode: places are added period by period, figures leave.

In round trips each pass is judged by its own noise, which is independent: at a place POD = 1 - (1 - POD_in)
(1 - POD_back), with half of the tube's false calls each. Where feed and air turn round, the cable falls across the
tube: those metres are judged by themselves, so that what they shake raises no threshold elsewhere.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, Literal

import numpy as np
from scipy.stats import normaltest

from probe_env.arrays import BoolArray, FloatArray
from probe_env.inspection.detection import (
    DEPTHS,
    EDGES,
    depth_found,
    pod_as_seen,
    pod_gaussian,
    snr_at,
    threshold,
    threshold_as_seen,
)
from probe_env.inspection.sensor import Sensor
from probe_env.inspection.snr import COUNT, FilteredSignal

GOOD: Final = 3.0
"""Signal-to-noise of a 20 % groove above which length counts as well inspected."""
SUSPECT: Final = 1e-3
"""Probability below which excursions are not taken for Gaussian (D'Agostino and Pearson)."""
LEAST_TESTED: Final = 20
MIDDLE: Final = slice(3 * COUNT // 8, 5 * COUNT // 8)
"""Of the last second, what is counted: its ends wrap around in the filter."""
POD_NAMES: Final = tuple(f"pod_at_{100.0 * depth:.3g}_percent_wall" for depth in DEPTHS)
"""KPIs: the probability of detection at each of ``DEPTHS``."""


@dataclass
class DetectionMetrics:
    """Places of one episode: length [m], signal-to-noise of the 20 % groove, share of motion in the noise."""

    sensor: Sensor = field(default_factory=Sensor)
    lengths: list[float] = field(default_factory=list)
    snr: list[float] = field(default_factory=list)
    shares: list[float] = field(default_factory=list)
    peaks: list[float] = field(default_factory=list)
    singles: list[float] = field(default_factory=list)
    counts: FloatArray = field(default_factory=lambda: np.zeros(len(EDGES) - 1))

    def add(self, length: float, signal: FilteredSignal) -> None:
        """Add a period of one probe: metres inspected, and its signal."""
        self.lengths.append(length)
        self.snr.append(float(signal.snr))
        self.shares.append(float(signal.share))
        self.peaks.append(float(signal.peak_to_peak))
        counted = signal.excursions[MIDDLE]
        self.singles.append(float(counted[len(counted) // 2]))
        place = ((counted - EDGES[0]) / (EDGES[1] - EDGES[0])).astype(int)
        self.counts += np.bincount(np.clip(place, 0, len(self.counts) - 1), minlength=len(self.counts))

    @property
    def gaussian(self) -> bool:
        """Whether the filtered motion, one sample a period, can be taken for Gaussian."""
        if len(self.singles) < LEAST_TESTED or np.ptp(self.singles) == 0.0:
            return True
        return bool(normaltest(self.singles).pvalue >= SUSPECT)

    def threshold(self, tube_length: float) -> float:
        """Above which a flaw is called, in deviations of the noise; higher where the motion is spiky."""
        z, lengths = threshold(self.sensor, tube_length), np.array(self.lengths)
        if self.gaussian or lengths.sum() <= 0.0:
            return z
        return threshold_as_seen(z, lengths, np.array(self.shares), self.counts)

    def pod(self, z: float) -> FloatArray:
        """(n, d) probability of detection at the places and ``DEPTHS``, for a threshold."""
        snr = snr_at(self.sensor, np.array(self.snr))
        return pod_gaussian(snr, z) if self.gaussian else pod_as_seen(snr, z, np.array(self.shares), self.counts)

    def kpis(self, length: float, tube_length: float) -> dict[str, float]:
        """Figures by name; ``length`` is all that was to be inspected [m], depths are in % of the wall.

        ``tube_length`` [m] is what false calls are counted over.
        """
        z, lengths = self.threshold(tube_length), np.array(self.lengths)
        return figures(lengths, np.array(self.snr), np.array(self.peaks), self.pod(z), length, z, self.gaussian)


def figures(
    lengths: FloatArray, snr: FloatArray, peaks: FloatArray, pod: FloatArray, length: float, z: float, gaussian: bool
) -> dict[str, float]:
    """KPIs by name, of n places with their POD (n, d); ``length`` was to be inspected [m], z is the threshold."""
    inspected, mean = float(lengths.sum()), np.zeros(len(DEPTHS))
    if len(lengths) and length > 0.0:  # nothing is found where no sensor was
        # a plain sum: a matrix product rounds by where its arrays lie
        mean = (lengths[:, None] * pod).sum(axis=0) / max(length, sum(lengths))
    return {
        "a50_percent_wall": 100.0 * depth_found(mean, 0.5),
        "a90_percent_wall": 100.0 * depth_found(mean, 0.9),
        "length_with_snr_over_3_m": float(lengths[snr >= GOOD].sum()),
        "noise_peak_to_peak_v": float((lengths * peaks).sum()) / inspected if inspected > 0.0 else 0.0,
        "noise_gaussian": float(gaussian),
        "call_threshold": z,
        **dict(zip(POD_NAMES, map(float, mean), strict=True)),
    }


TURN: Final = 6.0
"""Seconds of motion after the turn in which the cable falls across the tube; it takes two to six."""

Segment = Literal["in", "turn", "back"]
"""What is judged by one noise."""
SEGMENTS: Final[dict[str, tuple[Segment, ...]]] = {
    "in": ("in",), "back": ("turn", "back"), "best": ("in", "turn", "back")
}  # fmt: skip
"""Scored pass -> its segments."""


class RoundTripMetrics:
    """Places of one inspection; ``scored_pass`` is the pass that is looked at, or ``best``: both."""

    def __init__(self, sensor: Sensor, scored_pass: Literal["in", "back", "best"]) -> None:
        share = 0.5 if scored_pass == "best" else 1.0
        self._sensor = sensor.model_copy(update={"false_calls": share * sensor.false_calls})
        self.segments: Final = {segment: DetectionMetrics(self._sensor) for segment in SEGMENTS[scored_pass]}
        self._ends: Final[dict[Segment, list[tuple[float, float]]]] = {segment: [] for segment in self.segments}

    def add(self, segment: Segment, low: float, high: float, signal: FilteredSignal) -> None:
        """A period: inserted length at its ends [m], and the signal of the probe; left out where not looked."""
        if segment in self.segments and high > low:
            self._ends[segment].append((low, high))
            self.segments[segment].add(high - low, signal)

    def kpis(self, length: float, tube_length: float) -> dict[str, float]:
        """As ``DetectionMetrics.kpis``; of both passes S/N and peaks are those of the better one at each place."""
        inspected = {segment: metrics for segment, metrics in self.segments.items() if metrics.lengths}
        thresholds = {segment: metrics.threshold(tube_length) for segment, metrics in inspected.items()}
        passes = [self._places(SEGMENTS[direction], thresholds) for direction in ("in", "back")]
        edges = np.unique(np.concatenate([ends.ravel() for ends, _ in passes]))
        found = [_at(*places, 0.5 * (edges[1:] + edges[:-1])) for places in passes]
        covered, values = np.any([there for there, _ in found], axis=0), np.array([rows for _, rows in found])
        lengths, values = np.diff(edges)[covered], values[:, covered]
        snr, peaks, missed = values[..., 0], values[..., 1], np.prod(1.0 - values[..., 2:], axis=0)
        peaks = peaks[snr.argmax(axis=0), np.arange(len(lengths))]
        z = threshold(self._sensor, tube_length)
        if inspected:
            z = float(np.average(list(thresholds.values()), weights=[sum(m.lengths) for m in inspected.values()]))
        gaussian = all(metrics.gaussian for metrics in inspected.values())
        return figures(lengths, snr.max(axis=0), peaks, 1.0 - missed, length, z, gaussian)

    def _places(
        self, segments: tuple[Segment, ...], thresholds: Mapping[Segment, float]
    ) -> tuple[FloatArray, FloatArray]:
        """Ends (n, 2) [m] of the places of one pass in their order, and S/N, peak to peak [V] and POD (n, 2 + d)."""
        ends, rows = [np.zeros((0, 2))], [np.zeros((0, 2 + len(DEPTHS)))]
        for segment in segments:
            if segment in thresholds:
                metrics = self.segments[segment]
                ends.append(np.array(self._ends[segment]))
                rows.append(np.column_stack([metrics.snr, metrics.peaks, metrics.pod(thresholds[segment])]))
        joined = np.concatenate(ends)
        order = np.argsort(joined[:, 0], kind="stable")
        return joined[order], np.concatenate(rows)[order]


def _at(ends: FloatArray, values: FloatArray, lengths: FloatArray) -> tuple[BoolArray, FloatArray]:
    """Whether lengths (m,) lie in places with ends (n, 2), and the values (n, c) there, (m, c); 0 elsewhere."""
    if not len(ends):
        return np.zeros(len(lengths), dtype=bool), np.zeros((len(lengths), values.shape[1]))
    k = np.clip(np.searchsorted(ends[:, 0], lengths, side="right") - 1, 0, None)
    there = (ends[k, 0] <= lengths) & (lengths < ends[k, 1])
    return there, np.where(there[:, None], values[k], 0.0)
