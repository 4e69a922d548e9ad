"""The schedule of least expected cost: feed and air at every few metres, by dynamic programming.

Every metre costs for itself, so the best of a grid at each length would do; a price on change makes it smooth, and what
leaves the cable too slack in too many of the draws is not taken.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from agents.calibration.metres import Metres
from agents.calibration.response import Response
from agents.policies.law import Law, OfDiameter
from agents.policies.maps.lookup import FIRST, SPACING
from agents.recommendation.expectation import check_measure, expected_costs, tensions
from probe_env import Context
from probe_env.arrays import FloatArray
from probe_env.envs.surrogate.vibration_map import feeds
from probe_env.envs.task import TaskConfig, drive_counts, metre_reward, share_between, slack
from probe_env.schedule import Schedule

FEEDS, AIRS = 28, 12
STEP: Final = 0.02
FRICTIONS: Final = tuple(round(0.06 + STEP * k, 2) for k in range(15))
"""Of a law's rows, up to 0.34."""
OF_A_LAW: Final = 16
"""Draws of one helix diameter that a row of a law goes by."""
SMOOTH: Final = 0.5
"""Cost of a change of the feed by a factor of e, or of the air over its range, from one knot to the next."""
MARGIN: Final = 1.5
"""Root tension over what the task needs that is kept ..."""
SURE: Final = 0.95
"""... in so many of the draws."""


class Optimum(NamedTuple):
    """A schedule and what is expected of it.

    Attributes:
        schedule: over inserted length.
        reward: mean expected reward of an insertion.
        tension: least root tension that ``SURE`` of the draws keep where lost drive counts [N].
    """

    schedule: Schedule
    reward: float
    tension: float


def recommended(tubes: Sequence[Context], response: Response, config: TaskConfig) -> Optimum:
    """The schedule with the best expected reward over some tubes, which stand for what is known of one or of many.

    Args:
        tubes: equally likely.
        response: what is felt.
        config: the task: ranges, steps, weights and limits.

    Raises:
        ValueError: the task's vibration measure is not known to the response, or no air of the range keeps the drive.
    """
    check_measure(config)
    end = config.scene.tube.helix_length
    places = np.unique(np.append(np.arange(FIRST, end, SPACING), end))
    feed, air = _grid(config)
    count = len(feed)
    metres = Metres(np.repeat(places, count), np.tile(feed, len(places)), np.tile(air, len(places)), {})
    stands_for = np.gradient(places)
    stands_for[[0, -1]] *= 0.5  # half a spacing at the ends
    cost = expected_costs(tubes, response, config, metres).mean(axis=0).reshape(len(places), count)
    taut = np.quantile(tensions(tubes, config, metres), 1.0 - SURE, axis=0).reshape(len(places), count)
    hanging = slack(config, taut / MARGIN, places[:, None])
    if hanging.all(axis=1).any():
        where = places[hanging.all(axis=1)][0]
        raise ValueError(
            f"air_supply_rates = {config.air_supply_rates!r} m3/s: even the most keeps only"
            f" {taut[hanging.all(axis=1)][0].max():.3g} N of root tension at {where:g} m in {SURE:.0%} of the draws,"
            f" and {MARGIN * config.required_tension:g} N are needed ({MARGIN:g} times required_tension)"
        )
    staged = np.where(hanging, np.inf, cost * stands_for[:, None])
    path = _cheapest(staged, _changes(feed, air, config))
    schedule = Schedule(
        "inserted_length", "linear", tuple(places.tolist()), tuple(feed[path].tolist()), tuple(air[path].tolist())
    )
    gained = float((metre_reward(config, cost) * stands_for[:, None])[range(len(path)), path].sum())
    deep = drive_counts(config, places)
    return Optimum(schedule, gained, float(taut[range(len(path)), path][deep].min()) if deep.any() else float("inf"))


def recommended_law(tubes: Sequence[Context], response: Response, config: TaskConfig) -> Law:
    """A feedback law: the recommended schedule for each of ``FRICTIONS`` that tubes have, all else as it is drawn.

    Args and errors as of ``recommended``.
    """
    least, most = min(tube.friction for tube in tubes), max(tube.friction for tube in tubes)
    inside = [mu for mu in FRICTIONS if least - STEP < mu < most + STEP]
    tables: list[OfDiameter] = []
    places: tuple[float, ...] = ()
    for diameter in dict.fromkeys(tube.helix_diameter for tube in tubes):
        alike = [tube for tube in tubes if tube.helix_diameter == diameter][:OF_A_LAW]
        rows = []
        for mu in inside:
            drawn = [tube.model_copy(update={"friction": mu}) for tube in alike]
            rows.append(recommended(drawn, response, config).schedule)
        places = rows[0].position
        tables.append(
            OfDiameter(
                helix_diameter=diameter,
                feed_speed=tuple(row.feed_speed for row in rows),
                air_supply_rate=tuple(row.air_supply_rate for row in rows),
            )
        )
    values = {name: [getattr(tube, name) for tube in tubes] for name in Context.model_fields}
    ranges = {name: (min(v), max(v)) for name, v in values.items()}
    return Law(scene=config.scene, ranges=ranges, friction=tuple(inside), inserted_length=places, tables=tuple(tables))


def expected_reward(schedule: Schedule, tubes: Sequence[Context], response: Response, config: TaskConfig) -> float:
    """Mean expected reward of an insertion by a schedule over inserted length; jerk and lost drive are left out."""
    lengths = np.arange(FIRST + 0.5, config.scene.tube.helix_length, 1.0)
    feed, air = (np.asarray(values, dtype=float) for values in schedule.at(lengths))
    cost = expected_costs(tubes, response, config, Metres(lengths, feed, air, {}))
    return float(len(lengths) * metre_reward(config, cost.mean()))


def _grid(config: TaskConfig) -> tuple[FloatArray, FloatArray]:
    """(g,) feeds and airs that the device can be set to."""
    feed = np.geomspace(*feeds(config), FEEDS)
    air = np.linspace(*config.air_supply_rates, AIRS)
    targets = []
    for values, step, (low, high) in (
        (feed, config.feed_speed_step, config.feed_speeds),
        (air, config.air_supply_step, config.air_supply_rates),
    ):
        set_to = np.round(step * np.round(values / step), 12) if step > 0.0 else values
        within = set_to[(set_to >= low - 1e-12) & (set_to <= high + 1e-12)]
        targets.append(np.unique(within if len(within) else values))
    fed, blown = np.meshgrid(*targets, indexing="ij")
    return fed.ravel(), blown.ravel()


def _changes(feed: FloatArray, air: FloatArray, config: TaskConfig) -> FloatArray:
    """(g, g) cost of going from one point of the grid to another over a knot's spacing."""
    logarithm, share = np.log(feed), share_between(air, config.air_supply_rates)
    return np.asarray(SMOOTH * ((logarithm[:, None] - logarithm) ** 2 + (share[:, None] - share) ** 2))


def _cheapest(staged: FloatArray, change: FloatArray) -> list[int]:
    """Points of the grid, one a place, with the least sum of costs (places, g) and of changes (g, g): Bellman."""
    total, came_from = staged[0], []
    for costs in staged[1:]:
        through = total[:, None] + change
        best = through.argmin(axis=0)
        came_from.append(best)
        total = through[best, np.arange(len(best))] + costs
    path = [int(total.argmin())]
    for best in reversed(came_from):
        path.append(int(best[path[-1]]))
    return path[::-1]
