"""A log by metres of inserted length: what was fed, blown and felt there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from agents.logs.log import Log
from agents.logs.quantities import QUANTITIES
from probe_env.arrays import FloatArray

CHANNELS: Final = ("root_tension", "radial_acceleration_rms", "axial_acceleration_rms", "rf_noise_rms")
RESTART: Final = 3.0
"""[s] behind a standstill that are left out: the probe sets off there, it does not slide."""
LEAST_FED: Final = 0.5
"""Of a metre that must have been fed to count."""


@dataclass(frozen=True, eq=False)
class Metres:
    """Metres of a log in which the probe was fed.

    Attributes:
        length: (m,) inserted length at their middle [m].
        feed: (m,) feed speed [m/s].
        air: (m,) air supply [m3/s].
        felt: channel -> (m,) mean tension [N], rms of accelerations [m/s2] and noise [m]; some of ``CHANNELS``.
    """

    length: FloatArray
    feed: FloatArray
    air: FloatArray
    felt: dict[str, FloatArray]

    def __len__(self) -> int:
        return len(self.length)

    def where(self, chosen: np.ndarray) -> Metres:
        """Some of them."""
        felt = {name: values[chosen] for name, values in self.felt.items()}
        return Metres(self.length[chosen], self.feed[chosen], self.air[chosen], felt)


def metres_of(log: Log) -> Metres:
    """Metres of a log; means over time, of rms channels root mean squares.

    Standstills and what follows within ``RESTART`` are left out, and metres of which less than half was fed.
    """
    lasts = np.diff(log.time, append=log.time[-1] + (log.time[-1] - log.time[-2] if len(log.time) > 1 else 1.0))
    stood = np.where(log.feed_speed <= 0.0, log.time + lasts, -np.inf)
    since = log.time - np.maximum.accumulate(stood)
    fed = log.feed_speed * lasts
    good = (log.feed_speed > 0.0) & (since >= RESTART)
    metre = np.floor(log.inserted_length + 0.5 * fed).astype(int)[good]
    if not len(metre):
        nothing = np.zeros(0)
        return Metres(nothing, nothing, nothing, dict.fromkeys(_felt(log), nothing))
    first = int(metre.min())
    seconds = np.bincount(metre - first, lasts[good])
    through = np.bincount(metre - first, fed[good])
    kept = through >= LEAST_FED

    def mean(values: FloatArray, rms: bool = False) -> FloatArray:
        weighed = np.bincount(metre - first, lasts[good] * values[good] ** (2 if rms else 1))[kept] / seconds[kept]
        return np.asarray(np.sqrt(weighed) if rms else weighed)

    felt = {name: mean(log.measured[name], QUANTITIES[name].rms) for name in _felt(log)}
    return Metres(
        np.arange(first, first + len(kept))[kept] + 0.5,
        through[kept] / seconds[kept],
        mean(log.air_supply_rate),
        felt,
    )


def _felt(log: Log) -> list[str]:
    return [name for name in CHANNELS if name in log.measured]
