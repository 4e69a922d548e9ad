"""What a batch shows of a window of time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from probe_env.arrays import FloatArray

MOST_SHOWN: Final = 8
"""Probes of a window in its short form."""


@dataclass(frozen=True)
class Window:
    """What a window of time showed at the sensor of each of N probes.

    Attributes:
        statistics: name -> (N,) in SI units, see ``signals.window_statistics``; NaN-free, zero for probes that
            were not advanced or have diverged.
        inserted_length: (N,) at the end of the window [m].
        feed_speed, air_supply_rate: (N,) at the end of the window [m/s], [m3/s].
        diverged: (N,) bool.
        time, axial, radial, tension: samples (k,), (k, N) if asked for: displacements of the sensor [m] and
            root tension [N].
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

    def __repr__(self) -> str:
        rms = ", ".join(f"{1e3 * value:.3g}" for value in self.statistics["radial_rms_m"][:MOST_SHOWN])
        more = ", ..." if len(self.diverged) > MOST_SHOWN else ""
        kept = "" if self.time is None else f", {len(self.time)} samples"
        counts = f"{len(self.diverged)} probes, {self.diverged.sum()} diverged{kept}"
        return f"<Window of {counts}; radial rms [mm]: {rms}{more}>"
