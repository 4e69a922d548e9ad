"""The best schedule for a tube by the vibration map, on a grid of feed and air at every few metres."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Final

import numpy as np

from probe_env import Context, Scene
from probe_env.arrays import FloatArray
from probe_env.envs.task import TaskConfig
from probe_env.envs.vibration_map import (
    CONTEXT,
    VibrationMap,
    check_measure,
    equivalent_air,
    expected_cost,
    feeds,
    stored_map,
)
from probe_env.schedule import Schedule

SPACING: Final = 2.5  # [m] between knots
FIRST: Final = 5.0  # [m], the length at which an insertion begins
LEAST_AIR: Final = 45.0 / 3600.0
"""[m3/s] on table 2; below it the root tension of a training tube came near the 0.8 N that the rising straight part
needs."""
USUAL: Final = Scene()


def knots(config: TaskConfig) -> FloatArray:
    """(k,) inserted lengths [m] at which a schedule is picked."""
    return np.arange(FIRST, config.scene.tube.helix_length + 1.0, SPACING)


def least_air(config: TaskConfig) -> float:
    """The least air [m3/s] that schedules blow: what pulls a still probe as ``LEAST_AIR`` does on table 2."""
    equal = float(equivalent_air(np.array([LEAST_AIR]), np.zeros(1), USUAL, config.scene)[0])
    return float(np.clip(equal, *config.air_supply_rates))


@lru_cache(maxsize=64)
def grid(config: TaskConfig) -> tuple[FloatArray, FloatArray]:
    """(g,) feed speeds [m/s] and air supplies [m3/s] that a best schedule is picked from."""
    air = np.linspace(least_air(config), config.air_supply_rates[1], 12)
    feed, blown = np.meshgrid(np.geomspace(*feeds(config), 32), air, indexing="ij")
    return feed.ravel(), blown.ravel()


def expected_costs(
    contexts: FloatArray, config: TaskConfig, shift: float = 0.0, vibration: VibrationMap | None = None
) -> FloatArray:
    """(contexts, knots, g) expected cost of a metre at every knot, for every feed and air of the grid.

    ``shift`` [decades] is by how much more the probe vibrates than the map says; default: the shipped map.
    """
    count, known = len(knots(config)), vibration or stored_map()
    check_measure(known, config)
    feed, air = (np.tile(column, count) for column in grid(config))
    costs = []
    for context in contexts:
        mean, deviation = _grid_vibration(tuple(map(float, context)), config, known)
        costs.append(expected_cost(mean + shift, deviation, feed, air, config).reshape(count, -1))
    return np.array(costs)


@lru_cache(maxsize=256)
def _grid_vibration(
    context: tuple[float, ...], config: TaskConfig, vibration: VibrationMap
) -> tuple[FloatArray, FloatArray]:
    """Mean and deviation (knots * g,) of the decadic logarithm of the vibration in one tube."""
    feed, air = grid(config)
    places = knots(config)
    lengths, count = np.repeat(places, len(feed)), len(places)
    tube = np.tile(context, (len(lengths), 1))
    return vibration.predict(lengths, np.tile(feed, count), np.tile(air, count), tube, config.scene)


@lru_cache(maxsize=4096)
def best_schedule_for(
    context: Context, config: TaskConfig, shift: float = 0.0, vibration: VibrationMap | None = None
) -> Schedule:
    """Schedule over inserted length with the least expected cost on one tube: the best of the grid at every knot.

    ``shift`` [decades] is by how much more the probe vibrates than the map says; default: the shipped map.
    """
    values = np.array([[getattr(context, name) for name in CONTEXT]])
    best = expected_costs(values, config, shift, vibration)[0].argmin(axis=1)
    feed, air = (column[best] for column in grid(config))
    places = tuple(map(float, knots(config)))
    return Schedule("inserted_length", "linear", places, tuple(map(float, feed)), tuple(map(float, air)))


def looked_up(
    tubes: Sequence[Context],
    length: FloatArray,
    config: TaskConfig,
    vibration: VibrationMap,
    shifts: Sequence[float] | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Feed speed [m/s] and air supply [m3/s], (N,) each, of the best schedules for tubes at inserted lengths [m]."""
    louder = shifts or [0.0] * len(tubes)
    known = zip(tubes, louder, length, strict=True)
    pairs = [best_schedule_for(tube, config, decades, vibration).at(place) for tube, decades, place in known]
    return np.array([float(feed) for feed, _ in pairs]), np.array([float(air) for _, air in pairs])
