"""Recommended schedules, feedback laws and safe air: least expected hours or cost over samples of a plant's unknowns.

Feed and air at every few metres follow from dynamic programming over the cost per metre. A cost of changes makes the
schedule smooth; settings with too little tension in too many samples are excluded.
"""

import itertools
import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import pandas as pd
from scipy.special import ndtr

from probe_agents.evaluation.advice import Rows
from probe_agents.evaluation.run import evaluate_plan, plan_of
from probe_agents.evaluation.statistics import MAX_SECOND
from probe_agents.evaluation.workers import HERE, Workers
from probe_agents.plant.prior import UNKNOWNS
from probe_agents.plant.response import CHANNELS, Metres, Response
from probe_agents.policies.cases import load_case
from probe_agents.policies.catalogue import name_and_spec
from probe_agents.policies.law import Law, OfDiameter
from probe_agents.policies.on_map import FIRST, MARGIN, SPACING, root_tensions
from probe_agents.policies.policy import OutsideDomain
from probe_agents.records.atomic import write_atomically
from probe_agents.records.manifest import origin, write_json
from probe_agents.records.quantities import HOUR
from probe_agents.terminal.tables import print_line, print_table
from probe_env import Context, Plant, Scene
from probe_env.arrays import BoolArray, FloatArray
from probe_env.envs.plants import Bundle
from probe_env.envs.task.config import TaskConfig
from probe_env.envs.task.rules import drive_counts, metre_reward, slack
from probe_env.envs.task.scales import fraction_between
from probe_env.envs.vibration_map import expected_cost, feeds
from probe_env.schedule import Schedule

MEASURES: Final = {"displacement": "rf_noise_rms", "acceleration": "radial_acceleration_rms"}
"""Vibration measure of a task -> channel of the response."""
FEEDS, AIRS = 28, 12
"""Points of the grid of settings."""
STEP: Final = 0.02
FRICTIONS: Final = tuple(round(0.06 + STEP * k, 2) for k in range(15))
"""Frictions of the rows of a law, up to 0.34."""
DRAWS_PER_ROW: Final = 16
"""Samples of one helix diameter for a row of a law."""
SPEED_WEIGHTS: Final = (0.0, *np.geomspace(0.03, 3.0, 6).tolist())
"""Costs of a second per metre, added to those of the reward in a search by time or hours."""
LIMIT_WEIGHTS: Final = (0.0, *np.geomspace(1.0, 1e4, 9).tolist())
"""Costs of a metre that is surely above the vibration limit, added likewise."""
CHANGE_WEIGHT: Final = 0.5
"""Cost of a change of the feed by a factor of e, or of the air over its range, between two points."""
CONFIDENCE: Final = 0.95
"""Share of the samples in which the tension has its ``MARGIN``."""
INTERVAL: Final = 0.05, 0.95
"""Quantiles of the samples' expected rewards."""
AT: Final = 30.0
"""Inserted length at which ``sensitivity`` gives the vibration [m], or the end of the helix."""
NAME: Final = "recommended"
LAW: Final = "recommended-law"
BASELINES: Final = ("best-schedule", "tension-scheduled")
"""Policies that a recommendation is always compared with."""


class Optimum(NamedTuple):
    """A schedule over inserted length, and its expected result."""

    schedule: Schedule
    reward: float  # mean expected reward of an insertion
    interval: tuple[float, float]  # quantiles INTERVAL of the expected reward over the samples
    tension: float  # root tension that CONFIDENCE of the samples exceed where lost drive is scored [N]
    total: float = math.nan  # time of a tube as ``with_goal`` counts it [s]; NaN: searched by reward
    again: float = math.nan  # fraction of tubes with a second pass; NaN: searched by reward


@dataclass(frozen=True)
class Confirmation:
    """Settings of the simulation of a recommendation."""

    folder: Path  # folder of episodes and report
    schedules: tuple[str, ...] = ()  # schedules to compare with, specs as for evaluate
    limit: int = 12  # number of tubes; 0: all
    fidelity: str = "fast"
    plant: str | None = None  # name for the report

    def check(self, plant: Plant | None) -> None:
        """Raise ValueError if a setting is not valid; warnings follow in ``run``."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            plan_of((*self.schedules, *BASELINES), load_case(plant, "test", self.limit), 1, self.fidelity)

    def run(self, plant: Plant | None, named: Sequence[str], workers: Workers, unsure: Rows = ()) -> pd.DataFrame:
        """Simulate recommendations ``named`` (NAME=FILE) with others in other samples, and print; the episodes."""
        case = load_case(plant, "test", self.limit)
        print(f"simulated in {len(case.contexts)} other samples at {self.fidelity}:")
        plan = plan_of((*named, *self.schedules, *BASELINES), case, 1, self.fidelity)
        users = [name_and_spec(spec)[0] for spec in self.schedules]
        plan = replace(plan, plant=self.plant)
        return evaluate_plan(plan, self.folder, against=NAME, workers=workers, users=users, sensitivity=unsure)


def recommend(
    plant: Plant | None,
    output: Path,
    confirmation: Confirmation | None,
    response: Response,
    law: Path | None = None,
    workers: Workers = HERE,
) -> Optimum:
    """Search a schedule, write it, simulate it with others, print.

    Args:
        plant: plant; None: table 2 with the shipped lists of tubes.
        output: schedule file (.csv); a description is written to NAME.json next to it.
        confirmation: settings of the simulation; None: no simulation.
        response: expected measurements.
        law: file of a feedback law (.json); None: no law.
        workers: workers of the simulation.
    """
    case = load_case(plant, "train")
    if confirmation:
        confirmation.check(plant)
    for text in outside_training(case.contexts, response, case.config):
        warnings.warn(f"outside the training range of the response: {text}", OutsideDomain, stacklevel=2)
    if case.config.returns:
        print_line(f"{output.stem} is for the insertion; the withdrawal is at the fastest feed")
    start_air = route_air(plant, case.contexts)
    bundle = plant.bundle_for(case.config) if plant else None
    optimum = optimal_schedule(case.contexts, response, case.config, start_air, bundle)
    write_atomically(output, optimum.schedule.to_csv())
    low, high = optimum.interval
    figures = {"expected_reward": optimum.reward, "expected_reward_low": low, "expected_reward_high": high}
    goal = "searched by reward"
    if math.isfinite(optimum.total):
        figures |= {"expected_total_time_s": optimum.total, "expected_second_pass_share": optimum.again}
        total = f"{bundle.tubes * optimum.total / HOUR:.3g} h for the bundle" if bundle else f"{optimum.total:.0f} s"
        goal = f"with second passes {total}, these in {optimum.again:.0%} of the tubes"
    figures["least_root_tension_n"] = optimum.tension
    write_description(output, plant, len(case.contexts), figures)
    named = [f"{NAME}={output}"]
    if law:
        feedback = optimal_law(case.contexts, response, case.config, start_air, bundle)
        write_atomically(law, feedback.model_dump_json(indent=1))
        named.append(f"{LAW}={law}")
    seconds = np.trapezoid(1.0 / np.array(optimum.schedule.feed_speed), optimum.schedule.position)
    print_line(
        f"{output}: in your tubes about {seconds:.0f} s, expected reward {optimum.reward:.1f}"
        f" (90 % of {len(case.contexts)} samples: {low:.1f} to {high:.1f}); {goal}; drive safe: root tension above"
        f" {optimum.tension:.2g} N in {CONFIDENCE:.0%}"
    )
    print_start_air(start_air, case.config)
    rows = sensitivity(plant, case.contexts, optimum.schedule, response, case.config)
    if rows:
        print_table("Values that are not measured, and what they change", rows[0], rows[1:])
    if confirmation:
        confirmation.run(plant, named, workers, rows)
    return optimum


def sensitivity(
    plant: Plant | None, tubes: Sequence[Context], schedule: Schedule, response: Response, config: TaskConfig
) -> Rows:
    """Expected vibration of a schedule with other values of the quantities that have their defaults.

    Each row has the geometric mean over the tubes at ``AT``, over the limit, and the expected length above the limit,
    for both ends of a change of all tubes. Empty if friction and stiffness are in the tube file or calibrated.
    """
    plant = plant or Plant()
    posterior = plant.posterior.draws if plant.posterior else {}
    end = config.scene.tube.helix_length
    lengths = np.append(np.arange(FIRST + 0.5, end), min(AT, end))  # every metre, and one place
    metres = Metres(lengths, *schedule.at(lengths), {})
    rows: list[tuple[str, ...]] = []
    for text, field, name, changes in (
        ("friction -0.01 to +0.01", "friction", "friction", ((1.0, -0.01), (1.0, 0.01))),
        ("contact stiffness x2 to /2", "stiffness", "contact_stiffness", ((2.0, 0.0), (0.5, 0.0))),
    ):
        if field in plant.contact.model_fields_set or name in posterior:
            continue
        ends = []
        for factor, offset in changes:
            values = [max(factor * getattr(tube, name) + offset, 0.0) for tube in tubes]
            changed = [tube.model_copy(update={name: value}) for tube, value in zip(tubes, values, strict=True)]
            louder, spread = map(np.array, zip(*vibrations(changed, response, config, metres), strict=True))
            above = ndtr(louder / spread)[:, :-1].mean(axis=0).sum()
            ends.append((10.0 ** louder[:, -1].mean(), above))
        rows.append((text, *(f"{low:.2g} to {high:.2g}" for low, high in zip(*ends, strict=True))))
    header = "not measured", f"vibration at {lengths[-1]:g} m over its limit", "length above the limit [m]"
    return (header, *rows) if rows else ()


def write_description(output: Path, plant: Plant | None, draws: int, figures: Mapping[str, float]) -> None:
    """Write NAME.json next to a schedule file: the plant, the number of samples, and figures of the search."""
    record = {
        "tube": plant.model_dump(mode="json", exclude={"posterior"}) if plant else None,
        "calibrated": plant is not None and plant.posterior is not None,
        "draws": draws,
    }
    write_json(output.with_suffix(".json"), record | dict(figures) | origin())


def print_start_air(start_air: float, config: TaskConfig) -> None:
    """Print the least air before the helix, see ``route_air``; nothing if it is 0."""
    if start_air:
        print_line(
            f"route: the helix must pull with {config.required_tension:.3g} N; before the helix and up to"
            f" {config.lost_drive_from:g} m in it blow at least {3600.0 * start_air:.0f} m3/h"
        )


def is_misspecified(plant: Plant | None) -> bool:
    """Whether a plant's calibration does not fit its logs: nothing should be computed from it."""
    return plant is not None and plant.posterior is not None and plant.posterior.misspecified


def route_air(plant: Plant | None, tubes: Sequence[Context]) -> float:
    """Least air before the helix and at its start [m3/s], with ``MARGIN`` of drag if the plant has it; 0: no route.

    Raises ValueError if the probe does not get through the route in ``CONFIDENCE`` of the tubes.
    """
    if plant is None:
        return 0.0
    return min(math.sqrt(MARGIN) * plant.check_route(tubes, CONFIDENCE), plant.config.air_supply_rates[1])


def optimal_schedule(
    tubes: Sequence[Context],
    response: Response,
    config: TaskConfig,
    start_air: float = 0.0,
    bundle: Bundle | None = None,
) -> Optimum:
    """The schedule with the least expected total time, or without bundle and instrument the best mean expected reward.

    The total time is that of ``with_goal``, among schedules that need a second pass in at most ``MAX_SECOND`` of the
    tubes, if there are any. A tube needs one unless every metre is within the vibration limit; metres are taken for
    independent. Candidates are the cheapest paths with weights on time and on the limit in addition to the reward's.

    Args:
        tubes: samples of the plant, equally likely.
        response: expected measurements.
        config: the task.
        start_air: least air [m3/s] at the lengths at which lost drive is not scored yet, see ``route_air``.
        bundle: with its withdrawal as a time, see ``Plant.bundle_for``.
    """
    if config.vibration_measure not in MEASURES:
        problem = f"task.vibration_measure = {config.vibration_measure!r}"
        raise ValueError(f"{problem}: recommendations support {' and '.join(MEASURES)}")
    settings = settings_of(tubes, config, start_air)
    costs = expected_costs(tubes, response, config, settings.metres).reshape(-1, *settings.tension.shape)
    by_reward, total, again = costs.mean(axis=0), math.nan, math.nan
    path = settings.cheapest(by_reward, CHANGE_WEIGHT)
    if bundle or config.instrument:
        added = bundle.setup_time + (bundle.withdrawal_time or 0.0) if bundle else 0.0
        levels = vibrations(tubes, response, config, settings.metres)
        above = np.array([ndtr(louder / spread) for louder, spread in levels]).reshape(costs.shape)
        found: list[tuple[float, float, float, list[int]]] = []
        for speed, limit in itertools.product(SPEED_WEIGHTS, LIMIT_WEIGHTS):
            cost = by_reward + speed / settings.feed + limit * above.mean(axis=0)
            tried = settings.cheapest(cost, CHANGE_WEIGHT)
            within = (1.0 - above[:, range(len(tried)), tried]) ** settings.spacing
            second = 1.0 - float(within.prod(axis=1).mean())
            time = added + float((settings.spacing / settings.feed[tried]).sum())
            found.append((max(second, MAX_SECOND), (1.0 + second) * time, second, tried))
        _, total, again, path = min(found)
    rewards = metre_reward(config, costs[:, range(len(path)), path]) @ settings.spacing
    low, high = np.quantile(rewards, INTERVAL)
    tension = settings.min_tension(path, config)
    return Optimum(settings.schedule(path), float(rewards.mean()), (low, high), tension, total, again)


class Settings(NamedTuple):
    """A grid of g settings of feed and air at n inserted lengths; those with too little tension are excluded."""

    lengths: FloatArray  # (n,) [m]
    spacing: FloatArray  # (n,) length that each stands for [m]
    feed: FloatArray  # (g,) [m/s]
    air: FloatArray  # (g,) [m3/s]
    change: FloatArray  # (g, g) squared change of log feed and of the air over its range; infinite beyond its ramp
    tension: FloatArray  # (n, g) root tension that CONFIDENCE of the samples exceed [N]
    excluded: BoolArray  # (n, g)

    @property
    def metres(self) -> Metres:
        """All settings at all lengths (n g,), lengths first."""
        n, g = self.tension.shape
        return Metres(np.repeat(self.lengths, g), np.tile(self.feed, n), np.tile(self.air, n), {})

    def cheapest(self, cost: FloatArray, change_weight: float) -> list[int]:
        """Setting at each length with the smallest sum of costs per metre (n, g) and of changes."""
        staged = np.where(self.excluded, np.inf, cost * self.spacing[:, None])
        return cheapest_path(staged, change_weight * self.change)

    def schedule(self, path: list[int]) -> Schedule:
        """The schedule of a setting at each length."""
        position, feed, air = (tuple(v.tolist()) for v in (self.lengths, self.feed[path], self.air[path]))
        return Schedule("inserted_length", "linear", position, feed, air)

    def min_tension(self, path: list[int], config: TaskConfig) -> float:
        """Least tension of a schedule where lost drive is scored [N]."""
        scored = drive_counts(config, self.lengths)
        return float(self.tension[range(len(path)), path][scored].min(initial=np.inf))


def settings_of(tubes: Sequence[Context], config: TaskConfig, start_air: float = 0.0) -> Settings:
    """The settings of a task, those excluded that have too little tension in the tubes."""
    end = config.scene.tube.helix_length
    lengths = np.unique(np.append(np.arange(FIRST, end, SPACING), end))
    feed, air = _grid(config)
    shape = len(lengths), len(feed)
    spacing = np.gradient(lengths)
    spacing[[0, -1]] *= 0.5  # half a spacing at the ends
    logarithm, fraction = np.log(feed), fraction_between(air, config.air_supply_rates)
    change = (logarithm[:, None] - logarithm) ** 2 + (fraction[:, None] - fraction) ** 2
    if config.air_ramp is not None:  # in the time between two points at the faster of both feeds
        seconds = SPACING / np.maximum(feed[:, None], feed)
        change[np.abs(air[:, None] - air) > config.air_ramp * seconds + 1e-12] = np.inf
    settings = Settings(lengths, spacing, feed, air, change, np.zeros(shape), np.zeros(shape, dtype=bool))
    metres = settings.metres
    pulls = root_tensions(tubes, config, metres.length, metres.feed, metres.air)
    tension = np.quantile(pulls, 1.0 - CONFIDENCE, axis=0).reshape(shape)
    too_slack = slack(config, tension / MARGIN, lengths[:, None])
    hopeless = too_slack.all(axis=1)
    if hopeless.any():
        at = f"{tension[hopeless][0].max():.3g} N at {lengths[hopeless][0]:g} m in {CONFIDENCE:.0%} of the samples"
        needed = f"{MARGIN * config.required_tension:.3g} N are needed ({MARGIN:g} times required_tension)"
        maximum = HOUR * config.air_supply_rates[1]
        problem = f"air_supply_rates: the max, {maximum:.4g} m3/h, gives a root tension of only"
        raise ValueError(f"{problem} {at}, and {needed}")
    too_slack |= (air < start_air - 1e-12) & ~drive_counts(config, lengths[:, None])
    return settings._replace(tension=tension, excluded=too_slack)


def optimal_law(
    tubes: Sequence[Context],
    response: Response,
    config: TaskConfig,
    start_air: float = 0.0,
    bundle: Bundle | None = None,
) -> Law:
    """A feedback law: ``optimal_schedule`` for each of ``FRICTIONS`` in the range of the tubes; same errors."""
    values = {name: [getattr(tube, name) for tube in tubes] for name in Context.model_fields}
    ranges = {name: (min(v), max(v)) for name, v in values.items()}
    minimum, maximum = ranges["friction"]
    inside = [mu for mu in FRICTIONS if minimum - STEP < mu < maximum + STEP]
    tables: list[OfDiameter] = []
    lengths: tuple[float, ...] = ()
    for diameter in dict.fromkeys(tube.helix_diameter for tube in tubes):
        samples = [tube for tube in tubes if tube.helix_diameter == diameter][:DRAWS_PER_ROW]
        by_friction = ([tube.model_copy(update={"friction": mu}) for tube in samples] for mu in inside)
        rows = [optimal_schedule(alike, response, config, start_air, bundle).schedule for alike in by_friction]
        lengths = rows[0].position
        columns = {name: tuple(getattr(row, name) for row in rows) for name in ("feed_speed", "air_supply_rate")}
        tables.append(OfDiameter(helix_diameter=diameter, **columns))
    return Law(scene=config.scene, ranges=ranges, friction=tuple(inside), inserted_length=lengths, tables=tuple(tables))


def expected_costs(tubes: Sequence[Context], response: Response, config: TaskConfig, metres: Metres) -> FloatArray:
    """(tubes, m) expected cost of each metre in each tube: vibration, time and air, weighted as in the task."""
    plain = config.model_copy(update={"vibration_measure": "displacement", "vibration_limit": 1e-4})
    louder = vibrations(tubes, response, config, metres)
    return np.array([expected_cost(*pair, metres.feed, metres.air, plain) for pair in louder])


def vibrations(
    tubes: Sequence[Context], response: Response, config: TaskConfig, metres: Metres
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Mean and deviation (m,) of log10 of the vibration over its limit, in each tube."""
    column = CHANNELS.index(MEASURES[config.vibration_measure])
    for tube in tubes:
        mean, spread = response.predict(_table(tube, config.scene), metres, _scene_in(tube, config))
        yield mean[0, :, column] - np.log10(config.limit), spread[0, :, column]


def outside_training(tubes: Sequence[Context], response: Response, config: TaskConfig) -> list[str]:
    """Texts for everything in a task and its tubes that is outside the training ranges of the response."""
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
    """(g,) settings of feed and air, in steps of the device."""
    targets = []
    for values, step, (low, high) in (
        (np.geomspace(*feeds(config), FEEDS), config.feed_speed_step, (config.feed_speeds[0], config.permitted_feed)),
        (np.linspace(*config.air_supply_rates, AIRS), config.air_supply_step, config.air_supply_rates),
    ):
        set_to = np.round(step * np.round(values / step), 12) if step > 0.0 else values
        within = set_to[(set_to >= low - 1e-12) & (set_to <= high + 1e-12)]
        targets.append(np.unique(within if len(within) else values))
    fed, blown = np.meshgrid(*targets, indexing="ij")
    return fed.ravel(), blown.ravel()


def cheapest_path(staged: FloatArray, change: FloatArray) -> list[int]:
    """Grid points, one per length, with the smallest sum of costs (lengths, g) and of changes (g, g): Bellman."""
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
