"""Both passes of an inspection: which way each probe goes, and what each metre counts for.

On the way in a metre counts as what was measured there. On the way back it counts again where the task says so: alone,
or where it is better than what the way in showed, so that at the end every metre counts as the better of both.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from probe_env.arrays import BoolArray, FloatArray
from probe_env.envs.task.config import TaskConfig
from probe_env.envs.task.rules import END_TOLERANCE

BIN: Final = 1.0
"""Length over which the way in is remembered [m]."""


class Counted(NamedTuple):
    """What a period adds, (N,) each: length inspected [m], sums over length of squares and of what is within the limit.

    ``measures`` (N, m) are sums over length of what else is averaged over it.
    """

    inspected: FloatArray
    squares: FloatArray
    within: FloatArray
    measures: FloatArray


class Passes:
    """Ways of N probes, and what the way in showed, bin by bin.

    Attributes:
        way: (N,) 1 on the way in, -1 on the way back.
        begun: (N,) inserted length at the start [m].
        reached: (N,) greatest inserted length so far [m].
        left: (N,) least inserted length on the way back so far [m].
    """

    def __init__(self, count: int, config: TaskConfig, measures: int) -> None:
        self.config, self.measures = config, measures
        self.way, self.begun, self.reached = np.ones(count), np.zeros(count), np.zeros(count)
        self.left = np.full(count, np.inf)
        self._shown: list[FloatArray] = [np.zeros((0, 3 + measures)) for _ in range(count)]

    def begin(self, k: int, start: float, helix_length: float) -> None:
        """An episode of probe ``k`` begins at an inserted length, on the way in."""
        self.way[k], self.begun[k], self.reached[k], self.left[k] = 1.0, start, start, np.inf
        # a row a bin, sums over its length: 1, squares, within the limit, measures
        self._shown[k] = np.zeros((math.ceil(helix_length / BIN) + 1, 3 + self.measures))

    def count(
        self, good: BoolArray, after: FloatArray, squares: FloatArray, within: BoolArray, measures: FloatArray
    ) -> Counted:
        """Add a period.

        Args:
            good: (N,) whose period counts.
            after: (N,) inserted length at its end [m].
            squares: (N,) capped square of the vibration over its limit.
            within: (N,) whether it was within the limit.
            measures: (N, m) what else is averaged over the length.
        """
        sums = np.zeros((len(self.way), 3 + self.measures))
        for k in np.flatnonzero(good).tolist():
            shown = np.concatenate([[1.0, squares[k], float(within[k])], measures[k]])
            if after[k] > self.reached[k]:
                for bin_, length in _bins(self.reached[k], after[k]):
                    self._shown[k][bin_] += length * shown
                if self.config.inspects != "back":
                    sums[k] += (after[k] - self.reached[k]) * shown
                self.reached[k] = after[k]
            if self.way[k] < 0.0:
                high, low = min(self.left[k], self.reached[k]), max(after[k], self.begun[k])
                if low < high:
                    for bin_, length in _bins(low, high):
                        sums[k] += self._back(k, bin_, length, shown)
                    self.left[k] = low
        return Counted(sums[:, 0], sums[:, 1], sums[:, 2], sums[:, 3:])

    def turn(self, which: BoolArray) -> None:
        """Send probes back."""
        self.way[which] = -1.0

    def is_back(self, inserted: FloatArray, start: FloatArray) -> BoolArray:
        """Whether probes (N,) are back where they began."""
        return np.asarray((self.way < 0.0) & (inserted <= start + END_TOLERANCE))

    def _back(self, k: int, bin_: int, length: float, shown: FloatArray) -> FloatArray:
        """What a piece of a bin adds on the way back."""
        if self.config.inspects == "back":
            return length * shown
        known = self._shown[k][bin_]
        if self.config.inspects == "in" or known[0] == 0.0:
            return np.zeros_like(shown)
        before = known / known[0]
        better = shown[1] < before[1]
        gain = np.where(better, shown - before, 0.0)
        gain[2] = max(shown[2] - before[2], 0.0)
        return np.asarray(length * gain)


def _bins(low: float, high: float) -> list[tuple[int, float]]:
    """Bins between two lengths, and how much of each."""
    first, last = int(low / BIN), int(high / BIN)
    edges = [low, *(BIN * k for k in range(first + 1, last + 1)), high]
    pieces = zip(range(first, last + 1), edges[:-1], edges[1:], strict=True)
    return [(bin_, end - begin) for bin_, begin, end in pieces if end > begin]
