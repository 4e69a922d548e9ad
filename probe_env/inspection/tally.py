"""Detection in one episode: places are added period by period, figures leave.

In round trips each pass is judged by its own noise, which is independent: at a place POD = 1 - (1 - POD_in)
(1 - POD_back), with half of the tube's false calls each. Where feed and air turn round, the cable falls across the
tube: those metres are judged by themselves, so that what they shake raises no threshold elsewhere.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, Literal, NamedTuple, get_args

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
from probe_env.inspection.meter import COUNT
from probe_env.inspection.sensor import Sensor

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
"""What is heard of one probe in a period, see ``meter.Heard``: one row of each."""


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
        """A period: metres inspected, and the ``Reading`` of it."""
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
    """KPIs by name, of n places as in a ``Pass``; ``length`` is all that was to be inspected [m], z the threshold."""
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


TURN: Final = 6.0
"""Seconds of motion after the turn in which the cable falls across the tube; it takes two to six."""

Stretch = Literal["in", "turn", "back"]
"""What is judged by one noise."""
WAY_BACK: Final[tuple[Stretch, ...]] = ("turn", "back")


class Pass(NamedTuple):
    """Places (n,) of one pass in the order of their lengths, which do not overlap."""

    low: FloatArray  # inserted length at their ends [m]
    high: FloatArray
    snr: FloatArray  # of the 20 % groove
    peak_to_peak: FloatArray  # of the motion signal [V]
    pod: FloatArray  # (n, d) probability of detection at ``DEPTHS``

    def at(self, lengths: FloatArray) -> Pass:
        """The places in which lengths (m,) lie; nothing is found and S/N is 0 where there is none."""
        k = np.clip(np.searchsorted(self.low, lengths, side="right") - 1, 0, None)
        if not len(self.low):
            nothing = np.zeros(len(lengths))
            return Pass(nothing, nothing, nothing, nothing, np.zeros((len(lengths), len(DEPTHS))))
        there = (self.low[k] <= lengths) & (lengths < self.high[k])
        return Pass(*(np.where(there if v.ndim == 1 else there[:, None], v[k], 0.0) for v in self))


class EitherTally:
    """Places of one inspection; ``inspects`` is the pass that is looked at, or ``best``: both."""

    def __init__(self, sensor: Sensor, inspects: Literal["in", "back", "best"]) -> None:
        stretches: dict[str, tuple[Stretch, ...]] = {"in": ("in",), "back": WAY_BACK, "best": get_args(Stretch)}
        share = 0.5 if inspects == "best" else 1.0
        self._sensor = sensor.model_copy(update={"false_calls": share * sensor.false_calls})
        self.tallies: Final = {stretch: DetectionTally(self._sensor) for stretch in stretches[inspects]}
        self._ends: Final[dict[Stretch, list[tuple[float, float]]]] = {stretch: [] for stretch in self.tallies}

    def add(self, stretch: Stretch, low: float, high: float, heard: Reading) -> None:
        """A period: inserted length at its ends [m], and what was ``Meter.of`` the probe; left out where not looked."""
        if stretch in self.tallies and high > low:
            self._ends[stretch].append((low, high))
            self.tallies[stretch].add(high - low, *heard)

    def kpis(self, length: float, tube_length: float) -> dict[str, float]:
        """As ``DetectionTally.kpis``; of both passes S/N and peaks are those of the better one at each place."""
        heard = {stretch: tally for stretch, tally in self.tallies.items() if tally.lengths}
        thresholds = {stretch: tally.threshold(tube_length) for stretch, tally in heard.items()}
        passes = [self._pass(stretches, thresholds) for stretches in (("in",), WAY_BACK)]
        ends = np.unique(np.concatenate([values for one in passes for values in (one.low, one.high)]))
        there = [one.at(0.5 * (ends[1:] + ends[:-1])) for one in passes]
        shown = np.any([one.high > 0.0 for one in there], axis=0)
        lengths = np.diff(ends)[shown]
        missed = np.prod([1.0 - one.pod[shown] for one in there], axis=0)
        snr = np.array([one.snr[shown] for one in there])
        peaks = np.array([one.peak_to_peak[shown] for one in there])[snr.argmax(axis=0), np.arange(len(lengths))]
        z = threshold(self._sensor, tube_length)
        if heard:
            z = float(np.average(list(thresholds.values()), weights=[sum(t.lengths) for t in heard.values()]))
        gaussian = all(tally.gaussian for tally in heard.values())
        return figures(lengths, snr.max(axis=0), peaks, 1.0 - missed, length, z, gaussian)

    def _pass(self, stretches: tuple[Stretch, ...], thresholds: Mapping[Stretch, float]) -> Pass:
        used = [stretch for stretch in stretches if stretch in thresholds]
        tallies = [self.tallies[stretch] for stretch in used]
        ends = np.array([end for stretch in used for end in self._ends[stretch]]).reshape(-1, 2)
        order = np.argsort(ends[:, 0], kind="stable")
        columns = (
            np.array([value for tally in tallies for value in tally.snr]),
            np.array([value for tally in tallies for value in tally.peaks]),
            np.concatenate(
                [np.zeros((0, len(DEPTHS))), *(t.pod(thresholds[s]) for s, t in zip(used, tallies, strict=True))]
            ),
        )
        return Pass(*ends[order].T, *(column[order] for column in columns))
