"""Range of the air supply that is safe in every tube of a round trip, by the closed forms of steady sliding.

Enough air pulls the probe in; too much buckles the cable on withdrawal. The closed forms know neither vibration nor
changes of feed and air, hence the margin.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from functools import partial
from typing import Final

import numpy as np

from agents.plant.recommendation import MARGIN, tensions
from agents.plant.response import Metres
from agents.policies.lookup import FIRST
from probe_env import Context
from probe_env.arrays import FloatArray
from probe_env.envs.task import TaskConfig, drive_counts
from probe_env.physics.closed_forms import buckling_load, steady_root_tension

PLACES: Final = 23
"""Number of lengths at which the root tension of the insertion is computed."""


def safe_air(config: TaskConfig, tubes: Sequence[Context], feeds: tuple[float, float]) -> tuple[float, float]:
    """The least air for insertion and the most for withdrawal [m3/h]: whole ones, or the device's own steps.

    Args:
        config: the task: range of the air, required tension, probe and bore.
        tubes: all of them.
        feeds: slowest and fastest feed [m/s]; the fastest is pulled least, the slowest compressed most.

    Raises:
        ValueError: no air of the range is safe.
    """
    slowest, fastest = feeds
    least, most = (3600.0 * air for air in config.air_supply_rates)
    whole = np.append(np.arange(math.ceil(least), most), (least, most)) / 3600.0
    # bounds are what the device gives, so that no air between them is rounded beyond them
    airs = np.unique(np.round(3600.0 * config.given(np.full_like(whole, fastest), whole)[:, 1], 9))
    pulls, enough = pulled(config, tubes, airs, fastest), MARGIN * config.required_tension
    if not (pulls >= enough).any():
        raise ValueError(
            f"air_supply_rates up to {most:.4g} m3/h: even the most pulls with {pulls.max():.3g} N only where it pulls"
            f" least, and {enough:.3g} N are needed ({MARGIN:g} times required_tension)"
        )
    bearable = buckling_load(config.scene.probe) / MARGIN
    borne = min(bisect_right(airs, bearable, key=partial(pressed, config, tube, feed=slowest)) for tube in tubes)
    if borne == 0:
        greatest = max(pressed(config, tube, airs[0], slowest) for tube in tubes)
        raise ValueError(
            f"air_supply_rates from {least:.4g} m3/h: even the least presses with {greatest:.3g} N on the way back, and"
            f" the cable bears {bearable:.3g} N between two floats (its buckling load over {MARGIN:g})"
        )
    return float(airs[pulls >= enough].min()), float(airs[borne - 1])


def pulled(config: TaskConfig, tubes: Sequence[Context], airs: FloatArray, feed: float) -> FloatArray:
    """(a,) smallest root tension of the insertion [N] over tubes and lengths at which the drive counts, by air."""
    lengths = np.linspace(FIRST, config.scene.tube.helix_length, PLACES)
    lengths = lengths[drive_counts(config, lengths)]
    air, length = np.repeat(airs / 3600.0, len(lengths)), np.tile(lengths, len(airs))
    tension = tensions(tubes, config, Metres(length, np.full(len(length), feed), air, {}))
    return np.asarray(tension.min(axis=0).reshape(len(airs), -1).min(axis=1, initial=np.inf))


def pressed(config: TaskConfig, tube: Context, air: float, feed: float) -> float:
    """Root compression on withdrawal [N] with all of the cable inserted; it grows with the air [m3/h]."""
    scene = config.scene
    drawn = {
        "tube": {"helix_diameter": tube.helix_diameter},
        "contact": {"friction": tube.friction},
        "air": {"drag_coefficient": scene.air.drag_coefficient * tube.drag_factor},
        "carrier_length": scene.tube.helix_length - scene.probe.guide_length,
        "feed_speed": -feed,
        "air_supply_rate": -air / 3600.0,
    }
    return -steady_root_tension(scene.model_copy(update=drawn))
