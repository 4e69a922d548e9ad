"""What would have been found in one episode: places are added period by period, curve and figures leave."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from scipy.stats import normaltest

from probe_env.arrays import FloatArray
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
from probe_env.inspection.spectrum import COUNT

GOOD: Final = 3.0
"""Signal-to-noise of a 20 % groove above which length counts as well inspected."""
SUSPECT: Final = 1e-3
"""Probability below which excursions are not taken for Gaussian (D'Agostino and Pearson)."""
LEAST_TESTED: Final = 20
MIDDLE: Final = slice(3 * COUNT // 8, 5 * COUNT // 8)
"""Of the last second, what is counted: its ends wrap around in the filter."""
POD_NAMES: Final = tuple(f"pod_at_{100.0 * depth:.3g}_percent_wall" for depth in DEPTHS)
"""KPIs: the probability of detection at each of ``DEPTHS``."""
Reading = tuple[float, float, float, FloatArray]
"""What is heard of one probe in a period, see ``matched.Heard``: one row of each."""


@dataclass
class DetectionTally:
    """Places of one episode: length [m], signal-to-noise of the 20 % groove, share of motion in the noise."""

    sensor: Sensor = field(default_factory=Sensor)
    lengths: list[float] = field(default_factory=list)
    snr: list[float] = field(default_factory=list)
    shares: list[float] = field(default_factory=list)
    peaks: list[float] = field(default_factory=list)
    singles: list[float] = field(default_factory=list)
    counts: FloatArray = field(default_factory=lambda: np.zeros(len(EDGES) - 1))

    def add(self, length: float, snr: float, share: float, peak_to_peak: float, excursions: FloatArray) -> None:
        """A period: metres inspected, and what was ``matched.heard`` in it."""
        self.lengths.append(length)
        self.snr.append(snr)
        self.shares.append(share)
        self.peaks.append(peak_to_peak)
        counted = excursions[MIDDLE]
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

    def curve(self, length: float, tube_length: float) -> FloatArray:
        """Probability of detection (d,) at ``DEPTHS``, mean over ``length`` [m]; nothing is found where no sensor was.

        ``tube_length`` [m] is what false calls are counted over.
        """
        return curve(np.array(self.lengths), self.pod(self.threshold(tube_length)), length)

    def kpis(self, length: float, tube_length: float) -> dict[str, float]:
        """Figures by name; ``length`` is all that was to be inspected [m]. Depths are in % of the wall."""
        z, lengths = self.threshold(tube_length), np.array(self.lengths)
        return figures(lengths, np.array(self.snr), np.array(self.peaks), self.pod(z), length, z, self.gaussian)


def curve(lengths: FloatArray, pod: FloatArray, length: float) -> FloatArray:
    """Mean (d,) over ``length`` [m] of the probability (n, d) at places of lengths (n,) [m]; elsewhere it is 0."""
    if not len(lengths) or length <= 0.0:
        return np.zeros(len(DEPTHS))
    # a plain sum: a matrix product rounds by where its arrays lie
    return np.asarray((lengths[:, None] * pod).sum(axis=0) / max(length, sum(lengths)))


def figures(
    lengths: FloatArray, snr: FloatArray, peaks: FloatArray, pod: FloatArray, length: float, z: float, gaussian: bool
) -> dict[str, float]:
    """KPIs by name.

    Args:
        lengths: (n,) of the places [m].
        snr: (n,) of the 20 % groove.
        peaks: (n,) peak to peak of the motion signal [V].
        pod: (n, d) probability of detection at ``DEPTHS``.
        length: all that was to be inspected [m].
        z: threshold, deviations of the noise.
        gaussian: whether the motion passed for Gaussian.
    """
    mean = curve(lengths, pod, length)
    inspected = float(lengths.sum())
    return {
        "a50_percent_wall": 100.0 * depth_found(mean, 0.5),
        "a90_percent_wall": 100.0 * depth_found(mean, 0.9),
        "length_with_snr_over_3_m": float(lengths[snr >= GOOD].sum()),
        "noise_peak_to_peak_v": float((lengths * peaks).sum()) / inspected if inspected > 0.0 else 0.0,
        "noise_gaussian": float(gaussian),
        "call_threshold": z,
        **dict(zip(POD_NAMES, map(float, mean), strict=True)),
    }
