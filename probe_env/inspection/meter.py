"""The signal-to-noise of N probes, a control period at a time: keeps a second of their motion and a mean spectrum."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from probe_env.arrays import FloatArray
from probe_env.inspection.matched import Heard, heard, unbiased
from probe_env.inspection.sensor import Sensor
from probe_env.inspection.spectrum import FREQUENCY, SPAN, density, inverse, kept, straightened


class Meter:
    """Last second of the radial motion of N sensors.

    Args:
        sensor: its constants.
        count: N.
        sample_period: of the motion [s], a divisor of 5 ms.

    ``spectrum`` (N, m) is the mean one-sided density of the motion at ``FREQUENCY`` [m2/Hz].
    """

    def __init__(self, sensor: Sensor, count: int, sample_period: float) -> None:
        self.sensor: Final = sensor
        self.sample_period: Final = sample_period
        self._kept = np.zeros((count, round(SPAN / sample_period)))
        self._known = np.zeros(count, dtype=np.int64)
        self.spectrum = np.zeros((count, len(FREQUENCY)))
        self._inverse = np.ones(count)
        self._last: dict[int, tuple[float, float, float, FloatArray]] = {}

    def fork(self, which: Sequence[int]) -> Meter:
        """A meter of copies of some of the probes, which has heard what this one has."""
        new, index = Meter(self.sensor, len(which), self.sample_period), list(which)
        new._kept, new._known, new.spectrum = self._kept[index], self._known[index], self.spectrum[index]
        new._inverse = self._inverse[index]
        new._last = {n: self._last[k] for n, k in enumerate(which) if k in self._last}
        return new

    def forget(self, k: int) -> None:
        """Another episode of probe k begins."""
        self._known[k], self.spectrum[k] = 0, 0.0

    def of(self, k: int) -> tuple[float, float, float, FloatArray]:
        """What was heard of probe k last, see ``Heard``: one row of each."""
        return self._last[k]

    def of_filter(self, k: int) -> FloatArray:
        """(m,) density of the motion of probe k as the matched filter weighs by it [m2/Hz]."""
        return unbiased(self.sensor, self.spectrum[k], float(self._inverse[k]))

    def last_second(self, k: int) -> FloatArray:
        """(m,) motion of probe k that is kept, the newest last [m]; less than a second where less is known."""
        known = min(int(self._known[k]), self._kept.shape[1])
        return self._kept[k, self._kept.shape[1] - known :].copy()

    def listen(self, which: npt.NDArray[np.integer[Any]], radial: FloatArray, feed: FloatArray) -> Heard:
        """A period of some probes.

        Args:
            which: (n,) their indices.
            radial: (samples, n) their motion [m].
            feed: (n,) feed speed [m/s].
        """
        motion = straightened(self._take(which, radial), self.sample_period)
        # until a second has passed the rest stands still: the same power in the part that is known
        known = self._known[which] * self.sample_period
        if known.min() < SPAN:
            motion *= np.sqrt(np.maximum(SPAN / known, 1.0))[:, None]
        passed = len(radial) * self.sample_period
        gain = np.maximum(1.0 - kept(passed), passed / known)[:, None]
        spectrum = self.spectrum[which]
        spectrum += np.minimum(gain, 1.0) * (density(motion) - spectrum)
        self.spectrum[which], self._inverse[which] = spectrum, inverse(passed)
        reading = heard(self.sensor, feed, motion, spectrum, inverse(passed))
        for row, k in enumerate(which.tolist()):
            self._last[k] = (*(float(values[row]) for values in reading[:3]), reading.excursions[row])
        return reading

    def _take(self, which: npt.NDArray[np.integer[Any]], radial: FloatArray) -> FloatArray:
        """Keep samples (samples, n) of some probes; gives the last second (n, m) of them."""
        size = self._kept.shape[1]
        new = radial[-size:].T
        fresh = self._known[which] == 0
        before = np.where(fresh[:, None], new[:, :1], self._kept[which, new.shape[1] :])
        self._kept[which] = last = np.concatenate([before, new], axis=1)
        self._known[which] += len(radial)
        return last
