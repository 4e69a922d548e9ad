"""Recommended schedules and feedback laws: least expected cost over draws of what is unknown of a plant's tubes.

The schedule has feed and air at every few metres, by dynamic programming. Every metre has its own cost; a price on
change makes the schedule smooth, and settings that leave the cable too slack in too many of the draws are excluded.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from agents.evaluation.run import evaluate_plan, plan_of
from agents.evaluation.workers import HERE, Workers
from agents.plant.prior import UNKNOWNS
from agents.plant.response import CHANNELS, Metres, Response, steady_tension
from agents.policies.catalogue import name_and_spec
from agents.policies.law import Law, OfDiameter
from agents.policies.maps.lookup import FIRST, SPACING
from agents.policies.places import place_of
from agents.policies.policy import OutsideDomain
from agents.records.atomic import write_atomically
from agents.records.manifest import origin, write_json
from probe_env import Context, Plant, Scene
from probe_env.arrays import FloatArray
from probe_env.envs.task import TaskConfig, drive_counts, metre_reward, share_between, slack
from probe_env.envs.vibration_map import expected_cost, feeds
from probe_env.schedule import Schedule

MEASURES: Final = {"displacement": "rf_noise_rms", "acceleration": "radial_acceleration_rms"}
"""Vibration measure of a task -> channel of the response."""
FEEDS, AIRS = 28, 12
"""Points of the grid of settings."""
STEP: Final = 0.02
FRICTIONS: Final = tuple(round(0.06 + STEP * k, 2) for k in range(15))
"""Of a law's rows, up to 0.34."""
OF_A_LAW: Final = 16
"""Draws of one helix diameter for a row of a law."""
SMOOTH: Final = 0.5
"""Cost of a change of the feed by a factor of e, or of the air over its range, from one knot to the next."""
MARGIN: Final = 1.5
"""Root tension over what the task needs that is kept ..."""
SURE: Final = 0.95
"""... in this share of the draws."""
NAME: Final = "recommended"
LAW: Final = "recommended-law"
OURS: Final = ("best-schedule", "tension-scheduled")
"""Policies that a recommendation is always compared with."""


class Optimum(NamedTuple):
    """A schedule and its expected result.

    Attributes:
        schedule: over inserted length.
        reward: mean expected reward of an insertion.
        tension: root tension that ``SURE`` of the draws exceed where lost drive counts [N].
    """

    schedule: Schedule
    reward: float
    tension: float


@dataclass(frozen=True)
class Confirmation:
    """How a recommendation is simulated.

    Attributes:
        folder: of the episodes and the report.
        own: schedules to compare with, as ``evaluate`` takes them.
        limit: number of tubes; 0: all.
        fidelity: of the simulation.
    """

    folder: Path
    own: tuple[str, ...] = ()
    limit: int = 24
    fidelity: str = "standard"


def recommend(
    plant: Plant | None,
    output: Path,
    confirmation: Confirmation | None,
    response: Response,
    law: Path | None = None,
    workers: Workers = HERE,
) -> Optimum:
    """Search, write the schedule and how it was found, simulate it against others, print.

    Args:
        plant: the tubes and what is known of them; None: table 2's in the shipped lists.
        output: the schedule (.csv); how it was found is written to NAME.json next to it.
        confirmation: how it is simulated; None: it is not.
        response: expected measurements.
        law: file (.json) of a feedback law; None: none is made.
        workers: of the simulation.

    Raises:
        ValueError: the plant, or a schedule to compare with, is not valid; nothing was written.
    """
    seen = place_of(plant, "train")
    unseen = place_of(plant, "test", confirmation.limit) if confirmation else seen
    for text in beyond(seen.contexts, response, seen.config):
        warnings.warn(f"recommended beyond what the response was learnt from: {text}", OutsideDomain, stacklevel=2)
    specs = (*(confirmation.own if confirmation else ()), *OURS)
    if seen.config.returns:
        print(
            f"{output.stem} is for the way in, and drawn back as fast as the device can;"
            " probe-env study best-round-trip searches feed and air of both ways"
        )
    if confirmation:
        with warnings.catch_warnings():  # what cannot be compared is refused before the search; warnings come with it
            warnings.simplefilter("ignore")
            plan_of(specs, unseen, 1, confirmation.fidelity)
    optimum = recommended(seen.contexts, response, seen.config)
    write_atomically(output, optimum.schedule.to_csv())
    record = {
        "tube": plant.model_dump(mode="json", exclude={"posterior"}) if plant else None,
        "calibrated": plant is not None and plant.posterior is not None,
        "draws": len(seen.contexts),
        "expected_reward": optimum.reward,
        "least_root_tension_n": optimum.tension,
    }
    write_json(output.with_suffix(".json"), record | origin())
    named = [f"{NAME}={output}"]
    if law:
        feedback = recommended_law(seen.contexts, response, seen.config)
        write_atomically(law, feedback.model_dump_json(indent=1))
        named.append(f"{LAW}={law}")
    print(
        f"{output}: expected reward {optimum.reward:.1f} over {len(seen.contexts)} draws of what is known,"
        f" root tension at least {optimum.tension:.2g} N in 95 % of them"
    )
    if confirmation:
        print(f"simulated on {len(unseen.contexts)} other draws at {confirmation.fidelity}:")
        plan = plan_of((*named, *specs), unseen, 1, confirmation.fidelity)
        own = [name_and_spec(spec)[0] for spec in confirmation.own] or [NAME]  # judged in the report's first line
        evaluate_plan(plan, confirmation.folder, against=NAME, workers=workers, own=own)
    return optimum


def recommended(tubes: Sequence[Context], response: Response, config: TaskConfig) -> Optimum:
    """The schedule with the best mean expected reward over some tubes.

    Args:
        tubes: equally likely.
        response: expected measurements.
        config: the task: ranges, steps, weights and limits.

    Raises:
        ValueError: the response does not have the task's vibration measure, or no air of the range keeps the drive.
    """
    if config.vibration_measure not in MEASURES:
        raise ValueError(
            f"task.vibration_measure = {config.vibration_measure!r}: recommendations know {' and '.join(MEASURES)}"
        )
    end = config.scene.tube.helix_length
    places = np.unique(np.append(np.arange(FIRST, end, SPACING), end))
    feed, air = _grid(config)
    shape = len(places), len(feed)
    metres = Metres(np.repeat(places, shape[1]), np.tile(feed, shape[0]), np.tile(air, shape[0]), {})
    stands_for = np.gradient(places)
    stands_for[[0, -1]] *= 0.5  # half a spacing at the ends
    cost = expected_costs(tubes, response, config, metres).mean(axis=0).reshape(shape)
    taut = np.quantile(tensions(tubes, config, metres), 1.0 - SURE, axis=0).reshape(shape)
    too_slack = slack(config, taut / MARGIN, places[:, None])
    hopeless = too_slack.all(axis=1)
    if hopeless.any():
        raise ValueError(
            f"air_supply_rates = {config.air_supply_rates!r} m3/s: even the most keeps only"
            f" {taut[hopeless][0].max():.3g} N of root tension at {places[hopeless][0]:g} m in {SURE:.0%} of the draws,"
            f" and {MARGIN * config.required_tension:g} N are needed ({MARGIN:g} times required_tension)"
        )
    logarithm, share = np.log(feed), share_between(air, config.air_supply_rates)
    change = SMOOTH * ((logarithm[:, None] - logarithm) ** 2 + (share[:, None] - share) ** 2)
    path = cheapest_path(np.where(too_slack, np.inf, cost * stands_for[:, None]), change)
    schedule = Schedule(
        "inserted_length", "linear", tuple(places.tolist()), tuple(feed[path].tolist()), tuple(air[path].tolist())
    )
    on_path = range(len(path)), path
    gained = float((metre_reward(config, cost) * stands_for[:, None])[on_path].sum())
    return Optimum(schedule, gained, float(taut[on_path][drive_counts(config, places)].min(initial=np.inf)))


def recommended_law(tubes: Sequence[Context], response: Response, config: TaskConfig) -> Law:
    """A feedback law: the recommended schedule for each of ``FRICTIONS`` in the range of the tubes.

    Args and errors as of ``recommended``.
    """
    values = {name: [getattr(tube, name) for tube in tubes] for name in Context.model_fields}
    ranges = {name: (min(v), max(v)) for name, v in values.items()}
    least, most = ranges["friction"]
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
        speeds, airs = tuple(row.feed_speed for row in rows), tuple(row.air_supply_rate for row in rows)
        tables.append(OfDiameter(helix_diameter=diameter, feed_speed=speeds, air_supply_rate=airs))
    return Law(scene=config.scene, ranges=ranges, friction=tuple(inside), inserted_length=places, tables=tuple(tables))


def expected_reward(schedule: Schedule, tubes: Sequence[Context], response: Response, config: TaskConfig) -> float:
    """Mean expected reward of an insertion by a schedule over inserted length, without jerk and lost drive."""
    lengths = np.arange(FIRST + 0.5, config.scene.tube.helix_length, 1.0)
    feed, air = (np.asarray(values, dtype=float) for values in schedule.at(lengths))
    cost = expected_costs(tubes, response, config, Metres(lengths, feed, air, {}))
    return float(len(lengths) * metre_reward(config, cost.mean()))


def expected_costs(tubes: Sequence[Context], response: Response, config: TaskConfig, metres: Metres) -> FloatArray:
    """(tubes, m) expected cost of each metre in each tube: vibration, time and air by the task's weights."""
    column = CHANNELS.index(MEASURES[config.vibration_measure])
    plain = config.model_copy(update={"vibration_measure": "displacement", "vibration_limit": 1e-4})
    costs = []
    for tube in tubes:
        scene = config.scene.model_copy(update={"tube": {"helix_diameter": tube.helix_diameter}})
        mean, spread = response.tells(_table(tube, config.scene), metres, scene)
        louder = mean[0, :, column] - np.log10(config.limit)
        costs.append(expected_cost(louder, spread[0, :, column], metres.feed, metres.air, plain))
    return np.array(costs)


def tensions(tubes: Sequence[Context], config: TaskConfig, metres: Metres) -> FloatArray:
    """(tubes, m) root tension of steady sliding [N]."""
    rows = []
    for tube in tubes:
        friction = np.full((1, 1), max(tube.friction, 1e-6))
        rows.append(tube.drag_factor * steady_tension(friction, metres, config.scene, tube.helix_diameter)[0])
    return np.array(rows)


def beyond(tubes: Sequence[Context], response: Response, config: TaskConfig) -> list[str]:
    """What of a task's tubes is outside the training ranges of the response, one text each."""
    nothing, lines = np.zeros(0), dict[str, None]()
    for diameter in dict.fromkeys(tube.helix_diameter for tube in tubes):
        scene = config.scene.model_copy(update={"tube": {"helix_diameter": diameter}})
        lines |= dict.fromkeys(response.outside(Metres(nothing, nothing, nothing, {}), scene))
    table = np.concatenate([_table(tube, config.scene) for tube in tubes])
    for values, unknown in zip(table.T, UNKNOWNS.values(), strict=True):
        if values.min() < unknown.low or values.max() > unknown.high:
            span = f"{values.min():.4g} to {values.max():.4g}"
            lines[f"{unknown.text} {span}, beyond {unknown.low:g} to {unknown.high:g} {unknown.unit}".strip()] = None
    return list(lines)


def _table(tube: Context, scene: Scene) -> FloatArray:
    """(1, 4) unknowns of a tube."""
    drag = scene.air.drag_coefficient * tube.drag_factor
    return np.array([[max(tube.friction, 1e-6), tube.contact_stiffness, drag, scene.probe.damping_time]])


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


def cheapest_path(staged: FloatArray, change: FloatArray) -> list[int]:
    """Points of the grid, one per place, with the smallest sum of costs (places, g) and of changes (g, g): Bellman."""
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
