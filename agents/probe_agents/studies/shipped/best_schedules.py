"""Optimises the constant feed and the schedules for the training tubes, by CMA-ES on the vibration map."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import pandas as pd
from cmaes import CMA
from tqdm import tqdm

from probe_agents.evaluation.plan import Plan, run_plan
from probe_agents.policies.cases import load_case, map_of, plant_at
from probe_agents.policies.fixed import Scheduled
from probe_agents.policies.on_map import FIRST, least_air
from probe_agents.records.atomic import write_atomically
from probe_agents.records.manifest import commit, origin, write_json
from probe_agents.studies.builtin import Request
from probe_agents.terminal.tables import print_line
from probe_env import Context, Plant
from probe_env.arrays import FloatArray
from probe_env.envs.contexts import HELIX_DIAMETERS
from probe_env.envs.task import TaskConfig, metre_reward, value_at
from probe_env.envs.vibration_map import CONTEXT, VibrationMap, check_measure, expected_cost, feeds, stored_map
from probe_env.fidelity import resolve_fidelity
from probe_env.schedule import Schedule

KNOTS: Final = (5.0, 12.0, 19.0, 26.0, 33.0, 42.0, 60.0)  # [m] inserted length
AIR_KNOTS: Final = (5.0, 19.0, 26.0, 33.0, 60.0)
POPULATION, SPREAD = 16, 0.2
"""Points per generation, and their first standard deviation as a share of the ranges."""
TRIALS: Final = 1200
"""Number of schedules in a search."""


@dataclass(frozen=True)
class Family:
    """A family of schedules: feed speeds (logarithmic) and air supplies at knots, each scaled to [0, 1].

    Attributes:
        knots, air_knots: lengths [m] in a helix of 60 m, scaled for others; a single knot is a constant.
        start: start of the search.
        helix_diameter: helix diameter of its tubes [m]; None: all.
    """

    knots: tuple[float, ...]
    air_knots: tuple[float, ...]
    start: tuple[float, ...]
    helix_diameter: float | None = None

    def schedule(self, x: list[float], config: TaskConfig) -> Schedule:
        """The schedule of a point of the search space."""
        low, high = np.log(feeds(config))
        feed = np.exp(value_at(np.array(x[: len(self.knots)]), (low, high)))
        air = value_at(np.array(x[len(self.knots) :]), (least_air(config), config.air_supply_rates[1]))
        ratio = (config.scene.tube.helix_length - FIRST) / (KNOTS[-1] - FIRST)
        knots, air_knots = ([FIRST + (knot - FIRST) * ratio for knot in part] for part in (self.knots, self.air_knots))
        lengths = sorted({*knots, *air_knots})
        feeds_at, air_at = (tuple(map(float, np.interp(lengths, *pair))) for pair in ((knots, feed), (air_knots, air)))
        return Schedule("inserted_length", "linear", tuple(lengths), feeds_at, air_at)

    def tubes(self, contexts: tuple[Context, ...]) -> tuple[Context, ...]:
        """The contexts with its helix diameter."""
        return tuple(c for c in contexts if self.helix_diameter in (None, c.helix_diameter))


_START: Final = (0.95, 0.9, 0.6, 0.6, 0.55, 0.45, 0.35, 0.2, 0.5, 0.9, 0.95, 0.95)
FAMILIES: Final[dict[str, Family]] = {
    "best-constant": Family((5.0,), (5.0,), (0.45, 0.7)),
    "best-schedule": Family(KNOTS, AIR_KNOTS, _START),
    **{f"best-schedule-d{d:g}": Family(KNOTS, AIR_KNOTS, _START, d) for d in HELIX_DIAMETERS},
}

OF_A_PLANT: Final = ("best-constant", "best-schedule")
"""Families that are searched for a plant."""


class MapCost:
    """Expected reward of schedules in tubes by a vibration map."""

    def __init__(self, tubes: tuple[Context, ...], config: TaskConfig, vibration: VibrationMap) -> None:
        self.config, self.vibration = config, vibration
        middles = np.arange(FIRST + 0.5, config.scene.tube.helix_length, 1.0)  # of metres [m]
        values = np.array([[getattr(tube, name) for name in CONTEXT] for tube in tubes])
        self.count, self.lengths = len(middles), np.tile(middles, len(tubes))
        self.tubes = np.repeat(values, len(middles), axis=0)

    def reward(self, schedule: Schedule) -> float:
        """Mean reward of an insertion, without the terms that the map lacks (jerk, lost drive)."""
        feed, air = schedule.at(self.lengths)
        predicted = self.vibration.predict(self.lengths, feed, air, self.tubes, self.config.scene)
        cost = expected_cost(*predicted, feed, air, self.config)
        return float(self.count * metre_reward(self.config, cost.mean()))


def run(request: Request) -> None:
    """Search all families, or ``OF_A_PLANT`` for a custom plant; store and print.

    Searches are deterministic and take less than a minute; an interrupted search starts again. Episodes in the
    validation tubes are stored. ``trials`` is the number of schedules in each search.

    Raises:
        ValueError: a budget is out of range, or the map has another vibration measure.
        FileError: a stored episode is damaged, or of another task; nothing was run.
    """
    request.reject("limit")
    trials = request.budget("trials", TRIALS)
    plant = plant_at(request.tube)
    vibration = map_of(request.tube, plant)
    if plant is not None and vibration is stored_map():
        print_line(f"{request.tube} has no map: the shipped map is used, with table 2's bore and air")
    families = FAMILIES if plant is None else {name: FAMILIES[name] for name in OF_A_PLANT}
    for name in families:
        run_search(name, trials, request, vibration, plant)
    files = ", ".join(f"{name}.csv" for name in families)
    print_line(f"written: {request.output}/ ({files}: schedules to evaluate; NAME-trials.csv, NAME.json)")


def run_search(name: str, trials: int, request: Request, vibration: VibrationMap, plant: Plant | None) -> Schedule:
    """Search a family; writes NAME.csv (the schedule), NAME-trials.csv and NAME.json; raises as ``run``."""
    family, output = FAMILIES[name], request.output
    train, validation = (load_case(plant, split) for split in ("train", "validation"))
    config, tubes = train.config, family.tubes(validation.contexts)
    check_measure(vibration, config)

    def plan_of(schedule: Schedule) -> Plan:
        fast = resolve_fidelity("fast", config.scene)
        return Plan({name: Scheduled(config, schedule)}, tubes, config=config, fidelity=fast)

    plan_of(family.schedule(list(family.start), config)).folder(output / "simulated" / name).check("episodes.jsonl")
    training = family.tubes(train.contexts)
    cost = MapCost(training, config, vibration)

    def rewards_of(points: FloatArray) -> list[float]:
        return [cost.reward(family.schedule(point.tolist(), config)) for point in points]

    points, rewards, _ = search(rewards_of, family.start, -(-trials // POPULATION), name)
    best = family.schedule(points[int(rewards.argmax())].tolist(), config)
    table = pd.DataFrame(points, columns=[f"x{k}" for k in range(len(family.start))]).assign(reward=rewards)
    simulated = run_plan(plan_of(best), output / "simulated" / name, workers=request.workers)
    setting = {"training_tubes": len(training), "trials": len(table), "reward_by_map": float(rewards.max())}
    setting |= {"validation_tubes": len(tubes), "reward_simulated": float(simulated["reward"].mean())}
    write_atomically(output / f"{name}-trials.csv", table.to_csv(index=False, float_format="%.4g"))
    write_atomically(output / f"{name}.csv", best.to_csv())
    write_json(output / f"{name}.json", origin(commits=[*simulated["commit"], commit()]) | setting)
    print(f"{name}: " + ", ".join(f"{key} {value:.4g}" for key, value in setting.items()))
    print(best.to_csv())
    return best


def search(
    rewards_of: Callable[[FloatArray], Sequence[float]], start: Sequence[float] | FloatArray, generations: int,
    name: str, spread: float = SPREAD, population: int = POPULATION,
) -> tuple[FloatArray, FloatArray, FloatArray]:  # fmt: skip
    """CMA-ES in the unit cube: points (n, d), their rewards (n,) and the final mean (d,).

    The search stops when it has converged. A longer search starts with the points of a shorter one.

    Args:
        rewards_of: rewards (population,) of the points (population, d) of a generation.
        start: start of the search (d,).
        generations: maximum number of generations.
        name: name in the progress bar.
        spread: first standard deviation of the points.
        population: points per generation.
    """
    bounds = np.tile([0.0, 1.0], (len(start), 1))
    optimizer = CMA(np.array(start), sigma=spread, bounds=bounds, seed=0, population_size=population)
    points: list[FloatArray] = []
    rewards: list[float] = []
    for _ in tqdm(range(generations), desc=name, unit="generation"):
        if optimizer.should_stop():
            break
        generation = np.array([optimizer.ask() for _ in range(population)])
        gained = rewards_of(generation)
        optimizer.tell([(point, -value) for point, value in zip(generation, gained, strict=True)])
        points += [*generation]
        rewards += gained
    return np.array(points), np.array(rewards), optimizer.mean
