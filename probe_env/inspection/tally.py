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

    def curve(self, length: float, tube_length: float) -> FloatArray:
        """Probability of detection (d,) at ``DEPTHS``, mean over ``length`` [m]; nothing is found where no sensor was.

        ``tube_length`` [m] is what false calls are counted over.
        """
        return self._curve(length, self.threshold(tube_length))

    def _curve(self, length: float, z: float) -> FloatArray:
        if not self.lengths or length <= 0.0:
            return np.zeros(len(DEPTHS))
        snr = snr_at(self.sensor, np.array(self.snr))
        pod = pod_gaussian(snr, z) if self.gaussian else pod_as_seen(snr, z, np.array(self.shares), self.counts)
        # a plain sum: a matrix product rounds by where its arrays lie
        return np.asarray((np.array(self.lengths)[:, None] * pod).sum(axis=0) / max(length, sum(self.lengths)))

    def kpis(self, length: float, tube_length: float) -> dict[str, float]:
        """Figures by name; ``length`` is all that was to be inspected [m]. Depths are in % of the wall."""
        z, metres = self.threshold(tube_length), np.array(self.lengths)
        pod = self._curve(length, z)
        inspected = float(metres.sum()) if len(metres) else 0.0
        over = float(metres[np.array(self.snr) >= GOOD].sum()) if inspected else 0.0
        peaks = float((metres * self.peaks).sum()) / inspected if inspected > 0.0 else 0.0
        return {
            "a50_percent_wall": 100.0 * depth_found(pod, 0.5),
            "a90_percent_wall": 100.0 * depth_found(pod, 0.9),
            "length_with_snr_over_3_m": over,
            "noise_peak_to_peak_v": peaks,
            "noise_gaussian": float(self.gaussian),
            "call_threshold": z,
            **dict(zip(POD_NAMES, map(float, pod), strict=True)),
        }
