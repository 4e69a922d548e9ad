"""Passes of an inspection: which way each probe goes, what each metre counts for, and when an inspection is complete.

On the way in a metre counts as what was measured there. On the way back it counts again where the task says so: alone,
or where it is better than what the way in showed, so that at the end every metre counts as the better of both.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from probe_env.arrays import BoolArray, FloatArray
from probe_env.envs.task.config import TaskConfig
from probe_env.envs.task.rules import END_TOLERANCE, Ending, travel
from probe_env.inspection.metrics import TURN, DetectionMetrics, RoundTripMetrics
from probe_env.inspection.snr import FilteredSignal

BIN: Final = 1.0
"""Length over which the way in is remembered [m]."""


class StepRecord(NamedTuple):
    """What happened to N probes in a control period, (N,) each; SI units."""

    stepped: BoolArray
    good: BoolArray  # stepped, and did not diverge
    before: FloatArray  # inserted length at its beginning
    after: FloatArray  # and at its end
    helix_length: FloatArray
    feed_speed: FloatArray  # at its end
    air: FloatArray  # used [m3]
    seconds: FloatArray  # of motion
    action_change: FloatArray  # (N, 2) action less the one before
    squares: FloatArray  # capped square of the vibration over its limit
    within: BoolArray  # whether the vibration was within the limit
    measures: FloatArray  # (N, m) what else is averaged over the length


class Counted(NamedTuple):
    """What a period adds, (N,) each: the length inspected [m] and sums over it."""

    inspected: FloatArray
    squares: FloatArray
    within: FloatArray
    measures: FloatArray  # (N, m)


class WayIn:
    """One pass: probes are fed in, or stay where they are, and every metre counts as what was measured there.

    Attributes:
        way: (N,) 1, the way in.
        detection: (N,) what was found so far.
    """

    def __init__(self, count: int, config: TaskConfig) -> None:
        self.config = config
        self.way = np.ones(count)
        self.detection = [DetectionMetrics(config.sensor) for _ in range(count)]

    def fork(self, which: Sequence[int]) -> WayIn:
        """Passes of copies of some probes; what is found counts from here on."""
        return WayIn(len(which), self.config)

    def begin(self, k: int, start: float, helix_length: float) -> None:
        """An episode of probe ``k`` begins at an inserted length."""
        self.detection[k] = DetectionMetrics(self.config.sensor)

    def hear(self, k: int, inspected: float, passed: float, signal: FilteredSignal) -> None:
        """Add the last signal of probe ``k``: of the length inspected [m], in seconds of motion."""
        self.detection[k].add(inspected, signal)

    def count(self, period: StepRecord) -> Counted:
        """Add a period."""
        length = travel(self.config, period.before, period.after, period.feed_speed)
        inspected = np.where(period.good, length, 0.0)
        within = np.where(period.within, inspected, 0.0)
        return Counted(inspected, inspected * period.squares, within, inspected[:, None] * period.measures)

    def ended(self, end: Ending, period: StepRecord) -> Ending:
        """How episodes end, where ``end`` tells who is at the helix's end."""
        return end

    def uninspected(self, period: StepRecord, inspected: FloatArray) -> FloatArray:
        """(N,) what is left to inspect [m], where the length grows; ``inspected`` so far."""
        # what passed in a period that diverged was not inspected
        return period.helix_length - np.where(period.good, period.after, period.before)


class BothWays:
    """Two passes: probes are fed in to the helix's end and drawn back to where they began.

    Attributes:
        way: (N,) 1 on the way in, -1 on the way back.
        begun: (N,) inserted length at the start [m].
        reached: (N,) greatest inserted length so far [m].
        left: (N,) least inserted length on the way back so far [m].
        detection: (N,) what was found so far.
    """

    def __init__(self, count: int, config: TaskConfig, measures: int) -> None:
        self.config, self._columns = config, 3 + measures
        self.detection = [RoundTripMetrics(config.sensor, config.inspects) for _ in range(count)]
        self.way, self.begun, self.reached = np.ones(count), np.zeros(count), np.zeros(count)
        self.left = np.full(count, np.inf)
        self._shown: list[FloatArray] = [np.zeros((0, self._columns)) for _ in range(count)]
        self._new, self._since_turn = [(0.0, 0.0, True)] * count, np.zeros(count)  # low, high [m], on the way in

    def fork(self, which: Sequence[int]) -> BothWays:
        """Passes of copies of some probes, which are where these are; what is found counts from here on."""
        new, index = BothWays(len(which), self.config, self._columns - 3), list(which)
        for name in ("way", "begun", "reached", "left", "_since_turn"):
            setattr(new, name, getattr(self, name)[index])
        new._shown, new._new = [self._shown[k].copy() for k in which], [self._new[k] for k in which]
        return new

    def begin(self, k: int, start: float, helix_length: float) -> None:
        """An episode of probe ``k`` begins at an inserted length, on the way in."""
        self.way[k], self.begun[k], self.reached[k], self.left[k] = 1.0, start, start, np.inf
        # a row a bin, sums over its length: 1, squares, within the limit, measures
        self._shown[k] = np.zeros((math.ceil(helix_length / BIN) + 1, self._columns))
        self._since_turn[k] = 0.0
        self.detection[k] = RoundTripMetrics(self.config.sensor, self.config.inspects)

    def count(self, period: StepRecord) -> Counted:
        """Add a period."""
        sums = np.zeros((len(self.way), self._columns))
        for k in np.flatnonzero(period.good).tolist():
            shown = np.concatenate([[1.0, period.squares[k], float(period.within[k])], period.measures[k]])
            after, remembered = period.after[k], self._shown[k]
            self._new[k] = float(after), float(after), True
            if after > self.reached[k]:
                self._new[k] = float(self.reached[k]), float(after), True
                for bin_, length in _bins(self.reached[k], after):
                    remembered[bin_] += length * shown
                if self.config.inspects != "back":
                    sums[k] += (after - self.reached[k]) * shown
                self.reached[k] = after
            if self.way[k] < 0.0:
                high, low = min(self.left[k], self.reached[k]), max(after, self.begun[k])
                if low < high:
                    self._new[k] = float(low), float(high), False
                    for bin_, length in _bins(low, high):
                        sums[k] += self._back(remembered[bin_], length, shown)
                    self.left[k] = low
        return Counted(sums[:, 0], sums[:, 1], sums[:, 2], sums[:, 3:])

    def hear(self, k: int, inspected: float, passed: float, signal: FilteredSignal) -> None:
        """Add the last signal of probe ``k``, of the period counted last, which is ``passed`` seconds of motion."""
        low, high, way_in = self._new[k]
        turning = self._since_turn[k] < TURN
        self.detection[k].add("in" if way_in else "turn" if turning else "back", low, high, signal)
        if self.way[k] < 0.0:
            self._since_turn[k] += passed

    def ended(self, end: Ending, period: StepRecord) -> Ending:
        """How episodes end, where ``end`` tells who is at the helix's end: those are sent back."""
        self.way[end.complete] = -1.0
        is_back = (self.way < 0.0) & (period.after <= self.begun + END_TOLERANCE)
        return end._replace(complete=is_back & period.good)

    def uninspected(self, period: StepRecord, inspected: FloatArray) -> FloatArray:
        """(N,) what is left of both ways [m], whatever counts: else losing the drive before the turn would pay."""
        to_draw_back = np.where(self.way < 0.0, np.minimum(self.left, self.reached), period.helix_length) - self.begun
        return np.asarray(period.helix_length - self.reached + to_draw_back)

    def still_to_pass(self) -> tuple[FloatArray, FloatArray]:
        """(N,) length [m] that the way back is still to pass, and the sums of squares that the way in had there."""
        metres = np.maximum(np.minimum(self.left, self.reached) - self.begun, 0.0)
        squares = np.zeros(len(metres))
        for k, (low, length) in enumerate(zip(self.begun.tolist(), metres.tolist(), strict=True)):
            for bin_, piece in _bins(low, low + length):
                known, sum_of_squares = self._shown[k][bin_, :2]
                squares[k] += piece * sum_of_squares / known if known > 0.0 else 0.0
        return metres, squares

    def _back(self, known: FloatArray, length: float, shown: FloatArray) -> FloatArray:
        """What a piece of a bin adds on the way back."""
        if self.config.inspects == "back":
            return length * shown
        if self.config.inspects == "in" or known[0] == 0.0:
            return np.zeros_like(shown)
        before = known / known[0]
        better = shown[1] < before[1]
        gain = np.where(better, shown - before, 0.0)
        gain[2] = max(shown[2] - before[2], 0.0)
        return np.asarray(length * gain)


def passes_of(count: int, config: TaskConfig, measures: int) -> WayIn | BothWays:
    """The passes of N probes in a task; ``measures`` is how many columns those of a period have."""
    return BothWays(count, config, measures) if config.returns else WayIn(count, config)


def _bins(low: float, high: float) -> list[tuple[int, float]]:
    """Bins between two lengths, and how much of each."""
    first, last = int(low / BIN), int(high / BIN)
    edges = [low, *(BIN * k for k in range(first + 1, last + 1)), high]
    pieces = zip(range(first, last + 1), edges[:-1], edges[1:], strict=True)
    return [(bin_, end - begin) for bin_, begin, end in pieces if end > begin]
