"""The stretch of tube over which all probes are compared: where the sensor gets with the longest guide.

It follows from the length of the helix. What a long guide cannot inspect beyond it counts as lost progress.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise
from typing import Final, NamedTuple

from probe_env.design import RANGES
from probe_env.envs.task import TaskConfig

SENSOR_START: Final = 2.5
"""[m] of the sensor from the entrance, where an insertion begins."""
SPACING: Final = 10.0
"""[m] between sections, or the nearest that divides the stretch."""
LEAST_SECTIONS: Final = 3


class Stretch(NamedTuple):
    """Where probes are compared.

    Attributes:
        end: greatest distance of the sensor from the entrance [m].
        positions: of the sensor [m], simulated at constant length.
        widths: of the tube that each position stands for [m].
    """

    end: float
    positions: tuple[float, ...]
    widths: tuple[float, ...]

    @property
    def span(self) -> float:
        """Length of the stretch [m]."""
        return self.end - SENSOR_START


def stretch_of(config: TaskConfig) -> Stretch:
    """The stretch of a task's helix.

    Raises:
        ValueError: the helix is too short to compare the probes of the design space.
    """
    return _stretch(config.scene.tube.helix_length, config.lost_drive_from)


@lru_cache
def _stretch(helix_length: float, lost_drive_from: float) -> Stretch:
    shortest, longest, _ = RANGES["guide_length"]
    end = helix_length - longest
    least = longest + max(lost_drive_from - shortest, SENSOR_START + SPACING)  # so that every probe has a drive margin
    if helix_length < least:
        raise ValueError(
            f"helix_length = {helix_length:g} m: designs are compared as far as the sensor gets with a guide of"
            f" {longest:g} m, and where drive may be lost (lost_drive_from = {lost_drive_from:g} m): it must be at"
            f" least {least:g} m"
        )
    count = max(round(end / SPACING), LEAST_SECTIONS)
    positions = tuple(end * k / count for k in range(1, count + 1))
    middles = [0.5 * (one + other) for one, other in pairwise(positions)]
    edges = (SENSOR_START, *middles, end)
    widths = tuple(high - low for low, high in pairwise(edges))
    return Stretch(end, positions, widths)
