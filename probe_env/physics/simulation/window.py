"""Result of one advance of a batch."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from probe_env.arrays import FloatArray

MAX_PRINTED: Final = 8
"""Probes in the ``repr`` of a window."""


@dataclass(frozen=True)
class Window:
    """Statistics and samples at the sensor of each of N probes over a window of time.

    Attributes:
        statistics: name -> (N,) in SI units, see ``signals.window_statistics``; never NaN, zero for probes that were
            not advanced or have diverged.
        inserted_length: (N,) at the end of the window [m].
        feed_speed, air_supply_rate: (N,) at the end of the window [m/s], [m3/s].
        diverged: (N,) bool.
        time, axial, radial, tension: samples (k,), (k, N) if requested: displacements of the sensor [m] and root
            tension [N]; NaN after the end of a probe that was advanced for a shorter time, see ``joined``.
    """

    statistics: dict[str, FloatArray]
    inserted_length: FloatArray
    feed_speed: FloatArray
    air_supply_rate: FloatArray
    diverged: npt.NDArray[np.bool_]
    time: FloatArray | None = None
    axial: FloatArray | None = None
    radial: FloatArray | None = None
    tension: FloatArray | None = None

    def radial_of(self, k: int) -> FloatArray:
        """(k,) radial displacement of the sensor of probe k [m], without NaN; samples must have been requested."""
        assert self.radial is not None
        samples = self.radial[:, k]
        return samples[~np.isnan(samples)]

    def __repr__(self) -> str:
        rms = ", ".join(f"{1e3 * value:.3g}" for value in self.statistics["radial_rms_m"][:MAX_PRINTED])
        more = ", ..." if len(self.diverged) > MAX_PRINTED else ""
        samples = "" if self.time is None else f", {len(self.time)} samples"
        counts = f"{len(self.diverged)} probes, {self.diverged.sum()} diverged{samples}"
        return f"<Window of {counts}; radial rms [mm]: {rms}{more}>"


def joined(parts: Sequence[tuple[npt.NDArray[np.bool_], Window]]) -> Window:
    """One window of N probes from the windows of groups that were advanced for different times.

    Args:
        parts: mask (N,) of a group and its window with samples, in the order in which they were advanced.
    """
    if len(parts) == 1:
        return parts[0][1]
    last, longest = parts[-1][1], max((window for _, window in parts), key=_count)
    count = len(last.diverged)
    axial, radial, tension = (np.zeros((_count(longest), count)) for _ in range(3))
    statistics: dict[str, FloatArray] = {name: np.zeros(count) for name in last.statistics}
    for which, window in parts:
        for name, values in statistics.items():
            values[which] = window.statistics[name][which]
        for signal, samples in ((axial, window.axial), (radial, window.radial), (tension, window.tension)):
            assert samples is not None
            signal[: len(samples), which] = samples[:, which]
            signal[len(samples) :, which] = np.nan
    return replace(last, statistics=statistics, time=longest.time, axial=axial, radial=radial, tension=tension)


def _count(window: Window) -> int:
    assert window.time is not None
    return len(window.time)
