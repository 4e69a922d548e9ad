"""What both passes of an inspection find: each is judged by its own noise, and a flaw is called where either calls it.

The noise of the passes is independent: at a place POD = 1 - (1 - POD_in) (1 - POD_back), with half of the tube's false
calls each. Where feed and air turn round, the cable falls across the tube: those metres are judged by themselves, so
that what they shake raises no threshold elsewhere.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, Literal, NamedTuple, get_args

import numpy as np

from probe_env.arrays import FloatArray
from probe_env.inspection.detection import DEPTHS, threshold
from probe_env.inspection.sensor import Sensor
from probe_env.inspection.tally import DetectionTally, Reading, figures

TURN: Final = 6.0
"""Seconds of motion after the turn in which the cable falls across the tube; it takes two to six."""

Stretch = Literal["in", "turn", "back"]
"""What is judged by one noise."""
WAY_BACK: Final[tuple[Stretch, ...]] = ("turn", "back")


class Pass(NamedTuple):
    """Places (n,) of one pass in the order of their lengths, which do not overlap.

    Attributes:
        low, high: inserted length at their ends [m].
        snr: of the 20 % groove.
        peak_to_peak: of the motion signal [V].
        pod: (n, d) probability of detection at ``DEPTHS``.
    """

    low: FloatArray
    high: FloatArray
    snr: FloatArray
    peak_to_peak: FloatArray
    pod: FloatArray

    def at(self, lengths: FloatArray) -> Pass:
        """The places in which lengths (m,) lie; nothing is found and S/N is 0 where there is none."""
        k = np.clip(np.searchsorted(self.low, lengths, side="right") - 1, 0, None)
        if not len(self.low):
            nothing = np.zeros(len(lengths))
            return Pass(nothing, nothing, nothing, nothing, np.zeros((len(lengths), len(DEPTHS))))
        there = (self.low[k] <= lengths) & (lengths < self.high[k])
        return Pass(*(np.where(there if v.ndim == 1 else there[:, None], v[k], 0.0) for v in self))


class EitherTally:
    """Places of one inspection.

    Args:
        sensor: its constants.
        inspects: the pass that is looked at, or ``best``: both.
    """

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
