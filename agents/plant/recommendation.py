"""Recommended schedules, feedback laws and safe air: least expected cost over draws of a plant's unknowns.

The schedule has feed and air at every few metres, by dynamic programming. Every metre has its own cost; a price on
change makes the schedule smooth, and settings that leave the cable too slack in too many of the draws are excluded.
"""

from __future__ import annotations

import math
import warnings
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from agents.evaluation.run import evaluate_plan, plan_of
from agents.evaluation.workers import HERE, Workers
from agents.plant.prior import UNKNOWNS
from agents.plant.response import CHANNELS, Metres, Response, steady_tension
from agents.policies.cases import case_of
from agents.policies.catalogue import name_and_spec
from agents.policies.law import Law, OfDiameter
from agents.policies.on_map import FIRST, SPACING
from agents.policies.policy import OutsideDomain
from agents.records.atomic import write_atomically
from agents.records.manifest import origin, write_json
from probe_env import Context, Plant, Scene
from probe_env.arrays import FloatArray
from probe_env.envs.task import TaskConfig, drive_counts, metre_reward, share_between, slack
from probe_env.envs.vibration_map import expected_cost, feeds
from probe_env.physics.closed_forms import buckling_load, steady_root_tension
from probe_env.schedule import Schedule

MEASURES: Final = {"displacement": "rf_noise_rms", "acceleration": "radial_acceleration_rms"}
"""Vibration measure of a task -> channel of the response."""
FEEDS, AIRS = 28, 12
"""Points of the grid of settings."""
SAFE_PLACES: Final = 23
"""Lengths of an insertion at which ``safe_air`` computes the root tension."""
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
    """A schedule over inserted length, and its expected result."""

    schedule: Schedule
    reward: float  # mean of an insertion
    tension: float  # of the root, which SURE of the draws exceed where lost drive counts [N]


@dataclass(frozen=True)
class Confirmation:
    """How a recommendation is simulated."""

    folder: Path  # of the episodes and the report
    own: tuple[str, ...] = ()  # schedules to compare with, as evaluate takes them
    limit: int = 24  # tubes; 0: all
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
    seen = case_of(plant, "train")
    unseen = case_of(plant, "test", confirmation.limit) if confirmation else seen
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
    """The schedule with the best mean expected reward over some tubes, which are equally likely.

    Raises:
        ValueError: the response does not have the task's vibration measure, or no air of the range keeps the drive.
    """
    if config.vibration_measure not in MEASURES:
        problem = f"task.vibration_measure = {config.vibration_measure!r}"
        raise ValueError(f"{problem}: recommendations know {' and '.join(MEASURES)}")
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
        at = f"{taut[hopeless][0].max():.3g} N of root tension at {places[hopeless][0]:g} m in {SURE:.0%} of the draws"
        needed = f"{MARGIN * config.required_tension:g} N are needed ({MARGIN:g} times required_tension)"
        problem = f"air_supply_rates = {config.air_supply_rates!r} m3/s: even the most keeps only"
        raise ValueError(f"{problem} {at}, and {needed}")
    logarithm, share = np.log(feed), share_between(air, config.air_supply_rates)
    change = SMOOTH * ((logarithm[:, None] - logarithm) ** 2 + (share[:, None] - share) ** 2)
    path = cheapest_path(np.where(too_slack, np.inf, cost * stands_for[:, None]), change)
    position, feeds_of, airs_of = (tuple(values.tolist()) for values in (places, feed[path], air[path]))
    schedule = Schedule("inserted_length", "linear", position, feeds_of, airs_of)
    on_path = range(len(path)), path
    gained = float((metre_reward(config, cost) * stands_for[:, None])[on_path].sum())
    return Optimum(schedule, gained, float(taut[on_path][drive_counts(config, places)].min(initial=np.inf)))


def recommended_law(tubes: Sequence[Context], response: Response, config: TaskConfig) -> Law:
    """A feedback law: the recommended schedule for each of ``FRICTIONS`` in the range of the tubes; same errors."""
    values = {name: [getattr(tube, name) for tube in tubes] for name in Context.model_fields}
    ranges = {name: (min(v), max(v)) for name, v in values.items()}
    least, most = ranges["friction"]
    inside = [mu for mu in FRICTIONS if least - STEP < mu < most + STEP]
    tables: list[OfDiameter] = []
    places: tuple[float, ...] = ()
    for diameter in dict.fromkeys(tube.helix_diameter for tube in tubes):
        alike = [tube for tube in tubes if tube.helix_diameter == diameter][:OF_A_LAW]
        drawn = ([tube.model_copy(update={"friction": mu}) for tube in alike] for mu in inside)
        rows = [recommended(contexts, response, config).schedule for contexts in drawn]
        places = rows[0].position
        columns = {name: tuple(getattr(row, name) for row in rows) for name in ("feed_speed", "air_supply_rate")}
        tables.append(OfDiameter(helix_diameter=diameter, **columns))
    return Law(scene=config.scene, ranges=ranges, friction=tuple(inside), inserted_length=places, tables=tuple(tables))


def expected_costs(tubes: Sequence[Context], response: Response, config: TaskConfig, metres: Metres) -> FloatArray:
    """(tubes, m) expected cost of each metre in each tube: vibration, time and air by the task's weights."""
    column = CHANNELS.index(MEASURES[config.vibration_measure])
    plain = config.model_copy(update={"vibration_measure": "displacement", "vibration_limit": 1e-4})
    costs = []
    for tube in tubes:
        mean, spread = response.predict(_table(tube, config.scene), metres, _scene_in(tube, config))
        louder = mean[0, :, column] - np.log10(config.limit)
        costs.append(expected_cost(louder, spread[0, :, column], metres.feed, metres.air, plain))
    return np.array(costs)


def tensions(tubes: Sequence[Context], config: TaskConfig, metres: Metres) -> FloatArray:
    """(tubes, m) root tension of steady sliding [N]."""
    rows = []
    for tube in tubes:
        friction = np.full((1, 1), max(tube.friction, 1e-6))
        rows.append(tube.drag_factor * steady_tension(friction, metres, _scene_in(tube, config))[0])
    return np.array(rows)


def beyond(tubes: Sequence[Context], response: Response, config: TaskConfig) -> list[str]:
    """What of a task's tubes is outside the training ranges of the response, one text each."""
    nothing, lines = np.zeros(0), dict[str, None]()
    for tube in {tube.helix_diameter: tube for tube in tubes}.values():
        lines |= dict.fromkeys(response.outside(Metres(nothing, nothing, nothing, {}), _scene_in(tube, config)))
    table = np.concatenate([_table(tube, config.scene) for tube in tubes])
    for values, unknown in zip(table.T, UNKNOWNS.values(), strict=True):
        if values.min() < unknown.low or values.max() > unknown.high:
            span = f"{values.min():.4g} to {values.max():.4g}"
            lines[f"{unknown.text} {span}, beyond {unknown.low:g} to {unknown.high:g} {unknown.unit}".strip()] = None
    return list(lines)


def _scene_in(tube: Context, config: TaskConfig) -> Scene:
    return config.scene.model_copy(update={"tube": {"helix_diameter": tube.helix_diameter}})


def _table(tube: Context, scene: Scene) -> FloatArray:
    """(1, 4) unknowns of a tube."""
    drag = scene.air.drag_coefficient * tube.drag_factor
    return np.array([[max(tube.friction, 1e-6), tube.contact_stiffness, drag, scene.probe.damping_time]])


def _grid(config: TaskConfig) -> tuple[FloatArray, FloatArray]:
    """(g,) feeds and airs that the device can be set to."""
    targets = []
    for values, step, (low, high) in (
        (np.geomspace(*feeds(config), FEEDS), config.feed_speed_step, config.feed_speeds),
        (np.linspace(*config.air_supply_rates, AIRS), config.air_supply_step, config.air_supply_rates),
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


def safe_air(config: TaskConfig, tubes: Sequence[Context], feeds: tuple[float, float]) -> tuple[float, float]:
    """The least air for insertion and the most for withdrawal [m3/h]: whole ones, or the device's own steps.

    Enough air pulls the probe in; too much buckles the cable on withdrawal. The closed forms of steady sliding know
    neither vibration nor changes of feed and air, hence ``MARGIN``.

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
        problem = f"air_supply_rates up to {most:.4g} m3/h: even the most pulls with {pulls.max():.3g} N only"
        needed = f"{enough:.3g} N are needed ({MARGIN:g} times required_tension)"
        raise ValueError(f"{problem} where it pulls least, and {needed}")
    bearable = buckling_load(config.scene.probe) / MARGIN
    borne = min(bisect_right(airs, bearable, key=partial(pressed, config, tube, feed=slowest)) for tube in tubes)
    if borne == 0:
        greatest = max(pressed(config, tube, airs[0], slowest) for tube in tubes)
        problem = (
            f"air_supply_rates from {least:.4g} m3/h: even the least presses with {greatest:.3g} N on the way back"
        )
        limit = f"{bearable:.3g} N between two floats (its buckling load over {MARGIN:g})"
        raise ValueError(f"{problem}, and the cable bears {limit}")
    return float(airs[pulls >= enough].min()), float(airs[borne - 1])


def pulled(config: TaskConfig, tubes: Sequence[Context], airs: FloatArray, feed: float) -> FloatArray:
    """(a,) smallest root tension of the insertion [N] over tubes and lengths at which the drive counts, by air."""
    lengths = np.linspace(FIRST, config.scene.tube.helix_length, SAFE_PLACES)
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
