"""Detection metrics of one episode, from the filtered signal of every control period.

In round trips the noise of both passes is independent: POD = 1 - (1 - POD_in) (1 - POD_back) at every position, with
half of the tube's false calls for each pass. When feed and air are reversed, the cable falls across the tube: this
segment has its own threshold, so that its vibration raises no threshold elsewhere.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Literal

import numpy as np
from scipy.stats import normaltest

from probe_env.arrays import BoolArray, FloatArray
from probe_env.inspection.detection import (
    DEPTHS,
    EDGES,
    depth_found,
    pod_empirical,
    pod_gaussian,
    snr_at,
    threshold,
    threshold_empirical,
)
from probe_env.inspection.sensor import Sensor
from probe_env.inspection.snr import COUNT, FilteredSignal

GOOD: Final = 3.0
"""Signal-to-noise ratio of the 20 % groove above which length counts as well inspected."""
SUSPECT: Final = 1e-3
"""Probability below which excursions count as not Gaussian (test of D'Agostino and Pearson)."""
MIN_TESTED: Final = 20
MIDDLE: Final = slice(3 * COUNT // 8, 5 * COUNT // 8)
"""Part of the last second in the histogram: the filter wraps around at the ends."""
POD_NAMES: Final = tuple(f"pod_at_{100.0 * depth:.3g}_percent_wall" for depth in DEPTHS)
"""Columns of tables: the probability of detection at each of ``DEPTHS``."""


@dataclass
class DetectionMetrics:
    """Detection metrics from the intervals of an episode, the length inspected in one control period each.

    Attributes:
        sensor: constants of the sensor.
        lengths: of the intervals [m].
        snr: signal-to-noise ratios of the 20 % groove.
        fractions: fractions of the noise variance that are motion.
        peaks: peak-to-peak motion signals [V].
        samples: one excursion of each interval, for the test of normality.
        counts: histogram of excursions between ``EDGES``.
    """

    sensor: Sensor = field(default_factory=Sensor)
    lengths: list[float] = field(default_factory=list)
    snr: list[float] = field(default_factory=list)
    fractions: list[float] = field(default_factory=list)
    peaks: list[float] = field(default_factory=list)
    samples: list[float] = field(default_factory=list)
    counts: FloatArray = field(default_factory=lambda: np.zeros(len(EDGES) - 1))

    def add(self, length: float, signal: FilteredSignal) -> None:
        """Add a control period: length inspected [m] and filtered signal of one probe."""
        self.lengths.append(length)
        self.snr.append(float(signal.snr))
        self.fractions.append(float(signal.fraction))
        self.peaks.append(float(signal.peak_to_peak))
        counted = signal.excursions[MIDDLE]
        self.samples.append(float(counted[len(counted) // 2]))
        index = ((counted - EDGES[0]) / (EDGES[1] - EDGES[0])).astype(int)
        self.counts += np.bincount(np.clip(index, 0, len(self.counts) - 1), minlength=len(self.counts))

    @property
    def gaussian(self) -> bool:
        """Whether the filtered motion, one sample per period, passes the test of normality."""
        if len(self.samples) < MIN_TESTED or np.ptp(self.samples) == 0.0:
            return True
        return bool(normaltest(self.samples).pvalue >= SUSPECT)

    def threshold(self, tube_length: float) -> float:
        """Threshold of calls, in standard deviations of the noise; higher if the motion is not Gaussian."""
        z, lengths = threshold(self.sensor, tube_length), np.array(self.lengths)
        if self.gaussian or lengths.sum() <= 0.0:
            return z
        return threshold_empirical(z, lengths, np.array(self.fractions), self.counts)

    def pod(self, z: float) -> FloatArray:
        """(n, d) POD of the intervals at ``DEPTHS``, for a threshold z."""
        snr = snr_at(self.sensor, np.array(self.snr))
        return pod_gaussian(snr, z) if self.gaussian else pod_empirical(snr, z, np.array(self.fractions), self.counts)

    def kpis(self, length: float, tube_length: float) -> dict[str, Any]:
        """Figures by name; ``length`` is all that was to be inspected [m], depths are in % of the wall.

        ``tube_length`` [m] is what false calls are counted over.
        """
        z, lengths = self.threshold(tube_length), np.array(self.lengths)
        return detection_kpis(lengths, np.array(self.snr), np.array(self.peaks), self.pod(z), length, z, self.gaussian)


def detection_kpis(
    lengths: FloatArray, snr: FloatArray, peaks: FloatArray, pod: FloatArray, length: float, z: float, gaussian: bool
) -> dict[str, Any]:
    """KPIs by name, of n places with their POD (n, d); ``length`` was to be inspected [m], z is the threshold.

    All are numbers but "pod": the probability of detection (d,) at ``DEPTHS``, mean over the length.
    """
    inspected, mean = float(lengths.sum()), np.zeros(len(DEPTHS))
    if len(lengths) and length > 0.0:  # the POD of length that was not inspected is 0
        # a plain sum: the rounding of a matrix product depends on the alignment of its arrays
        mean = (lengths[:, None] * pod).sum(axis=0) / max(length, sum(lengths))
    return {
        "a50_percent_wall": 100.0 * depth_found(mean, 0.5),
        "a90_percent_wall": 100.0 * depth_found(mean, 0.9),
        "length_with_snr_over_3_m": float(lengths[snr >= GOOD].sum()),
        "noise_peak_to_peak_v": float((lengths * peaks).sum()) / inspected if inspected > 0.0 else 0.0,
        "noise_gaussian": float(gaussian),
        "call_threshold": z,
        "pod": mean,
    }


def with_pod_columns(kpis: Mapping[str, Any]) -> dict[str, float]:
    """KPIs of an episode as numbers by column: the array "pod" becomes a column for each of ``POD_NAMES``."""
    numbers = {name: value for name, value in kpis.items() if name != "pod"}
    return numbers | dict(zip(POD_NAMES, kpis["pod"].tolist(), strict=True)) if "pod" in kpis else numbers


TURN: Final = 6.0
"""Duration of the turn [s]; the cable falls across the tube within two to six seconds of motion."""

Segment = Literal["in", "turn", "back"]
"""Parts of an inspection with a threshold each."""
SEGMENTS: Final[dict[str, tuple[Segment, ...]]] = {
    "insertion": ("in",), "withdrawal": ("turn", "back"), "best": ("in", "turn", "back")
}  # fmt: skip
"""Scored pass -> its segments."""


class RoundTripMetrics:
    """Detection metrics of a round trip; ``scored_pass`` is the pass that counts, or "best" for both."""

    def __init__(self, sensor: Sensor, scored_pass: Literal["insertion", "withdrawal", "best"]) -> None:
        fraction = 0.5 if scored_pass == "best" else 1.0
        self._sensor = sensor.model_copy(update={"false_calls": fraction * sensor.false_calls})
        self.segments: Final = {segment: DetectionMetrics(self._sensor) for segment in SEGMENTS[scored_pass]}
        self._ends: Final[dict[Segment, list[tuple[float, float]]]] = {segment: [] for segment in self.segments}

    def add(self, segment: Segment, low: float, high: float, signal: FilteredSignal) -> None:
        """Add a control period from ``low`` to ``high`` inserted length [m], if its segment is scored."""
        if segment in self.segments and high > low:
            self._ends[segment].append((low, high))
            self.segments[segment].add(high - low, signal)

    def kpis(self, length: float, tube_length: float) -> dict[str, Any]:
        """As ``DetectionMetrics.kpis``; of both passes S/N and peaks are those of the better one at each place."""
        inspected = {segment: metrics for segment, metrics in self.segments.items() if metrics.lengths}
        thresholds = {segment: metrics.threshold(tube_length) for segment, metrics in inspected.items()}
        passes = [self._intervals(SEGMENTS[direction], thresholds) for direction in ("insertion", "withdrawal")]
        edges = np.unique(np.concatenate([ends.ravel() for ends, _ in passes]))
        found = [_values_at(*intervals, 0.5 * (edges[1:] + edges[:-1])) for intervals in passes]
        covered, values = np.any([there for there, _ in found], axis=0), np.array([rows for _, rows in found])
        lengths, values = np.diff(edges)[covered], values[:, covered]
        snr, peaks, missed = values[..., 0], values[..., 1], np.prod(1.0 - values[..., 2:], axis=0)
        peaks = peaks[snr.argmax(axis=0), np.arange(len(lengths))]
        z = threshold(self._sensor, tube_length)
        if inspected:
            z = float(np.average(list(thresholds.values()), weights=[sum(m.lengths) for m in inspected.values()]))
        gaussian = all(metrics.gaussian for metrics in inspected.values())
        return detection_kpis(lengths, snr.max(axis=0), peaks, 1.0 - missed, length, z, gaussian)

    def _intervals(
        self, segments: tuple[Segment, ...], thresholds: Mapping[Segment, float]
    ) -> tuple[FloatArray, FloatArray]:
        """Ends (n, 2) [m] of the intervals of a pass, ascending, and S/N, peak to peak [V] and POD (n, 2 + d)."""
        ends, rows = [np.zeros((0, 2))], [np.zeros((0, 2 + len(DEPTHS)))]
        for segment in segments:
            if segment in thresholds:
                metrics = self.segments[segment]
                ends.append(np.array(self._ends[segment]))
                rows.append(np.column_stack([metrics.snr, metrics.peaks, metrics.pod(thresholds[segment])]))
        joined = np.concatenate(ends)
        order = np.argsort(joined[:, 0], kind="stable")
        return joined[order], np.concatenate(rows)[order]


def _values_at(ends: FloatArray, values: FloatArray, lengths: FloatArray) -> tuple[BoolArray, FloatArray]:
    """Whether lengths (m,) are in intervals with ends (n, 2), and values (m, c) of (n, c) there; 0 elsewhere."""
    if not len(ends):
        return np.zeros(len(lengths), dtype=bool), np.zeros((len(lengths), values.shape[1]))
    k = np.clip(np.searchsorted(ends[:, 0], lengths, side="right") - 1, 0, None)
    there = (ends[k, 0] <= lengths) & (lengths < ends[k, 1])
    return there, np.where(there[:, None], values[k], 0.0)
