"""Searches of the shipped schedules and of the constants of the PLC laws.

Searches on the vibration map are deterministic and take minutes; an interrupted one starts again. Simulated episodes
are stored and not run again.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import count
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from cmaes import CMA
from tqdm import tqdm

from probe_agents.evaluation.plan import Plan, run_plan
from probe_agents.evaluation.statistics import paired_difference
from probe_agents.evaluation.workers import HERE, Workers
from probe_agents.policies.cases import EvaluationCase, load_case, map_of, plant_at
from probe_agents.policies.fixed import Scheduled
from probe_agents.policies.on_map import FIRST, min_air
from probe_agents.policies.plc_law import STORED_INTEGRAL, Constants, PlcIntegral, read_constants
from probe_agents.policies.policy import Policy
from probe_agents.records.atomic import write_atomically
from probe_agents.records.manifest import commit, origin, write_json
from probe_agents.records.shipped import file_or_shipped
from probe_agents.records.store import write_tables
from probe_agents.studies.builtin import print_frame
from probe_agents.terminal.tables import print_line
from probe_env import Context, Plant
from probe_env.arrays import FloatArray
from probe_env.envs.contexts import HELIX_DIAMETERS, SPLIT_SIZES
from probe_env.envs.task.config import TaskConfig
from probe_env.envs.task.rules import metre_reward
from probe_env.envs.task.scales import fraction_between, geometric_at, geometric_fraction, value_at
from probe_env.envs.vibration_map import CONTEXT, VibrationMap, check_measure, expected_cost, feeds, stored_map
from probe_env.fidelity import resolve_fidelity
from probe_env.schedule import Schedule
from probe_env.settings import range_of


def plan_of(policies: Mapping[str, Policy], case: EvaluationCase, seeds: Sequence[int] = (0,)) -> Plan:
    """The plan of policies on the tubes of a case, at ``fast``."""
    config = case.config.full_observation
    fidelity = resolve_fidelity("fast", config.scene, round_trip=config.returns)
    return Plan(policies, case.contexts, seeds, config, fidelity)


def write_search(output: Path, name: str, trials: pd.DataFrame, record: Mapping[str, Any], digits: int = 6) -> None:
    """Write the trials of a search, NAME-trials.csv, and what it found, NAME.json."""
    write_tables(output, {f"{name}-trials": trials}, digits)
    write_json(output / f"{name}.json", record)


def search(
    rewards_of: Callable[[FloatArray], Sequence[float]], start: Sequence[float] | FloatArray, generations: int,
    name: str, spread: float = 0.2, population: int = 16,
) -> tuple[FloatArray, FloatArray, FloatArray]:  # fmt: skip
    """CMA-ES in the unit cube: points (n, d), their rewards (n,) and the mean after each generation (generations, d).

    The search stops when it has converged. A longer search starts with the points of a shorter one.

    Args:
        rewards_of: rewards (population,) of the points (population, d) of a generation.
        start: start of the search (d,).
        generations: maximum number of generations.
        name: name in the progress bar.
        spread: first standard deviation of the points, as a fraction of the ranges.
        population: points per generation.
    """
    bounds = np.tile([0.0, 1.0], (len(start), 1))
    optimizer = CMA(np.array(start), sigma=spread, bounds=bounds, seed=0, population_size=population)
    points: list[FloatArray] = []
    rewards: list[float] = []
    means: list[FloatArray] = []
    for _ in tqdm(range(generations), desc=name, unit="generation"):
        if optimizer.should_stop():
            break
        generation = np.array([optimizer.ask() for _ in range(population)])
        gained = rewards_of(generation)
        optimizer.tell([(point, -value) for point, value in zip(generation, gained, strict=True)])
        points += [*generation]
        rewards += gained
        means.append(np.clip(optimizer.mean, 0.0, 1.0))
    return np.array(points), np.array(rewards), np.array(means)


# Schedules over length, on the vibration map

KNOTS: Final = (5.0, 12.0, 19.0, 26.0, 33.0, 42.0, 60.0)  # [m] inserted length
AIR_KNOTS: Final = (5.0, 19.0, 26.0, 33.0, 60.0)
POPULATION: Final = 16


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

    def schedule(self, x: Sequence[float] | FloatArray, config: TaskConfig) -> Schedule:
        """The schedule of a point of the search space."""
        low, high = np.log(feeds(config))
        feed = np.exp(value_at(np.array(x[: len(self.knots)]), (low, high)))
        air = value_at(np.array(x[len(self.knots) :]), (min_air(config), config.air_supply_rates[1]))
        ratio = (config.scene.tube.helix_length - FIRST) / (KNOTS[-1] - FIRST)
        knots, air_knots = ([FIRST + (knot - FIRST) * ratio for knot in part] for part in (self.knots, self.air_knots))
        lengths = sorted({*knots, *air_knots})
        feeds_at, air_at = (tuple(map(float, np.interp(lengths, *pair))) for pair in ((knots, feed), (air_knots, air)))
        return Schedule("inserted_length", "linear", tuple(lengths), feeds_at, air_at)

    def tubes(self, case: EvaluationCase) -> EvaluationCase:
        """The case with the tubes of its helix diameter."""
        return case._replace(
            contexts=tuple(c for c in case.contexts if self.helix_diameter in (None, c.helix_diameter))
        )


_START: Final = (0.95, 0.9, 0.6, 0.6, 0.55, 0.45, 0.35, 0.2, 0.5, 0.9, 0.95, 0.95)
OF_A_PLANT: Final = {
    "best-constant": Family((5.0,), (5.0,), (0.45, 0.7)),
    "best-schedule": Family(KNOTS, AIR_KNOTS, _START),
}
"""Families that are searched for a plant."""
FAMILIES: Final = OF_A_PLANT | {f"best-schedule-d{d:g}": Family(KNOTS, AIR_KNOTS, _START, d) for d in HELIX_DIAMETERS}


class MapCost:
    """Expected reward of schedules in tubes by a vibration map."""

    def __init__(self, tubes: tuple[Context, ...], config: TaskConfig, vibration: VibrationMap) -> None:
        self.config, self.vibration = config, vibration
        middles = np.arange(FIRST + 0.5, config.scene.tube.helix_length, 1.0)  # of metres [m]
        self.count, self.lengths = len(middles), np.tile(middles, len(tubes))
        self.tubes = np.repeat(_values(tubes), len(middles), axis=0)

    def reward(self, schedule: Schedule) -> float:
        """Mean reward of an insertion, without the terms that the map lacks (jerk, lost drive)."""
        feed, air = schedule.at(self.lengths)
        predicted = self.vibration.predict(self.lengths, feed, air, self.tubes, self.config.scene)
        cost = expected_cost(*predicted, feed, air, self.config)
        return float(self.count * metre_reward(self.config, cost.mean()))


def _values(tubes: Sequence[Context]) -> FloatArray:
    return np.array([[getattr(tube, name) for name in CONTEXT] for tube in tubes])


def search_schedules(output: Path, trials: int = 1200, tube: Path | None = None, workers: Workers = HERE) -> None:
    """Search best-constant and best-schedule (and one per helix diameter, without a plant) on the training tubes.

    ``trials`` is the number of schedules in each search. Each best schedule is simulated in the validation tubes.

    Raises:
        ValueError: the map has another vibration measure.
        FileError: a stored episode is damaged, or of another task; nothing was run.
    """
    plant = plant_at(tube)
    vibration = map_of(tube, plant)
    if plant is not None and vibration is stored_map():
        print_line(f"{tube} has no map: the shipped map is used, with table 2's bore and air")
    families = FAMILIES if plant is None else OF_A_PLANT
    for name in families:
        search_schedule(name, output, trials, vibration, plant, workers)
    files = ", ".join(f"{name}.csv" for name in families)
    print_line(f"written: {output}/ ({files}: schedules to evaluate; NAME-trials.csv, NAME.json)")


def search_schedule(
    name: str, output: Path, trials: int, vibration: VibrationMap, plant: Plant | None, workers: Workers = HERE
) -> Schedule:
    """Search a family; writes NAME.csv (the schedule), NAME-trials.csv and NAME.json."""
    family = FAMILIES[name]
    train, validation = (family.tubes(load_case(plant, split)) for split in ("train", "validation"))
    config, folder = train.config.full_observation, output / "simulated" / name
    check_measure(vibration, config)
    first = plan_of({name: Scheduled(config, family.schedule(family.start, config))}, validation)
    first.folder(folder).check("episodes.jsonl")
    cost = MapCost(train.contexts, config, vibration)
    points, rewards, _ = search(
        lambda points: [cost.reward(family.schedule(point, config)) for point in points],
        family.start, -(-trials // POPULATION), name,
    )  # fmt: skip
    best = family.schedule(points[int(rewards.argmax())], config)
    table = pd.DataFrame(points, columns=[f"x{k}" for k in range(len(family.start))]).assign(reward=rewards)
    simulated = run_plan(plan_of({name: Scheduled(config, best)}, validation), folder, workers=workers)
    setting = {"training_tubes": len(train.contexts), "trials": len(table), "reward_by_map": float(rewards.max())}
    setting |= {"validation_tubes": len(validation.contexts), "reward_simulated": float(simulated["reward"].mean())}
    write_atomically(output / f"{name}.csv", best.to_csv())
    write_search(output, name, table, origin(commits=[*simulated["commit"], commit()]) | setting, digits=4)
    print(f"{name}: " + ", ".join(f"{key} {value:.4g}" for key, value in setting.items()))
    print(best.to_csv())
    return best


# Constants of plc-integral, in simulation

SEARCH_RANGES: Final[dict[str, tuple[float, float]]] = {
    "average": (3.0, 40.0), "noise_average": (3.0, 40.0), "fast_feed": (0.5, 1.2), "fast_air": (-0.3, 1.0),
    "slow_air": (0.0, 1.3), "onset_length": (10.0, 60.0), "onset_friction": (0.0, 3.0), "onset_diameter": (0.0, 3.0),
    "slow_feed": (0.05, 0.4), "slow_length": (0.0, 2.0), "slow_friction": (0.0, 2.0), "slow_diameter": (0.0, 2.0),
    "quiet": (1e-6, 2e-4), "shift": (0.0, 0.6), "max_shift": (0.0, 1.5), "margin": (1.1, 3.0), "aim": (1e-5, 1e-4),
    "trim_time": (20.0, 320.0), "trim_average": (1.0, 16.0), "max_excess": (0.2, 4.0), "max_deficit": (0.1, 2.0),
    "max_decrease": (0.0, 1.5), "max_increase": (0.0, 1.5),
}  # fmt: skip
"""Search range of each constant, clipped to its accepted range: a bound that is searched lies inside."""
GEOMETRIC: Final = (
    "average", "noise_average", "onset_length", "slow_feed", "quiet", "margin", "aim", "trim_time", "trim_average",
    "max_excess", "max_deficit",
)  # fmt: skip
"""Constants that are searched on a logarithmic scale."""
LAWS: Final = 16
"""Laws per generation."""
SPREAD: Final = 0.08
"""First standard deviation as a fraction of the ranges."""
FINALISTS: Final = 5
"""Last generations whose means are compared in the validation tubes."""
COMPARED: Final = 4
"""Seeds with which the laws of single tubes are compared."""


def constants_at(x: FloatArray) -> Constants:
    """Constants of a point (23,) in the unit cube, with four digits."""
    values = {}
    for fraction, (name, range_) in zip(x, SEARCH_RANGES.items(), strict=True):
        value = float((geometric_at if name in GEOMETRIC else value_at)(fraction, range_))
        accepted = range_of(Constants, name)
        assert accepted
        values[name] = min(max(float(f"{value:.4g}"), accepted.low), accepted.high)
    return Constants.model_validate(values)


def point_of(constants: Constants) -> FloatArray:
    """The inverse of ``constants_at``, within the cube."""
    fractions = [
        (geometric_fraction if name in GEOMETRIC else fraction_between)(getattr(constants, name), range_)
        for name, range_ in SEARCH_RANGES.items()
    ]
    return np.asarray(np.clip(fractions, 0.0, 1.0))


def search_plc(output: Path, limit: int = 6, trials: int = 8000, workers: Workers = HERE) -> Constants:
    """Search all constants of plc-integral by CMA-ES in simulation; stored insertions are not run again.

    The ``LAWS`` laws of a generation are simulated in the same ``limit`` tubes, and each generation in others: random
    ones, in which the helix diameters take turns. The start, which is the stored law, and the means of the last
    generations are compared in the validation tubes. Writes plc-integral.json and every law.

    Args:
        output: folder of the results and of the insertions.
        limit: number of tubes of a generation.
        trials: number of insertions, without those of the comparison.
        workers: processes that simulate.
    """
    case, start = load_case(None, "validation"), read_constants(STORED_INTEGRAL)
    source = Plant.from_toml(file_or_shipped("tubes", "fresh"))
    rows: list[dict[str, Any]] = []
    commits: list[str] = []

    def simulate(laws: Mapping[str, Constants], tubes: tuple[Context, ...], folder: str) -> pd.DataFrame:
        table = simulate_laws(laws, case._replace(contexts=tubes), output / "episodes" / folder, workers)
        commits.extend(table["commit"])
        return table

    def rewards_of(points: FloatArray) -> list[float]:
        generation = len(rows) // LAWS
        laws = {f"law-{len(rows) + k}": constants_at(point) for k, point in enumerate(points)}
        tubes = source.contexts(limit, len(SPLIT_SIZES) + generation)  # the first seeds are those of the lists
        means = simulate(laws, tubes, f"{generation:04d}").groupby("policy")["reward"].mean()
        rows.extend({"generation": generation, "reward": means[n], **law.model_dump()} for n, law in laws.items())
        return [float(means[name]) for name in laws]

    generations = max(trials // (LAWS * limit), 1)
    *_, means = search(rewards_of, point_of(start), generations, "plc-integral", SPREAD, LAWS)
    laws = {"start": start} | {f"mean-{k}": constants_at(x) for k, x in list(enumerate(means))[-FINALISTS:]}
    table = simulate(laws, case.contexts, "validation")
    gains = [asdict(paired_difference(table, name, "start", "reward")) for name in laws]
    rewards = table.groupby("policy")["reward"].mean()[[*laws]]
    best = str(rewards.idxmax())
    record = {"constants": laws[best].model_dump(), "law": best, "rewards": rewards.to_dict(), "tubes": limit}
    write_search(output, "plc-integral", pd.DataFrame(rows), record | {"provenance": origin(commits=commits)})
    compared = pd.DataFrame(gains).add_prefix("gain_").assign(reward=rewards.to_numpy())
    compared.insert(0, "law", [*laws])
    print_frame(f"In {len(case.contexts)} validation tubes", compared)
    print_line(f"written: {output}/ (plc-integral.json: a policy to evaluate; plc-integral-trials.csv)")
    return laws[best]


def search_plc_by_tube(output: Path, limit: int = 12, trials: int = 160, workers: Workers = HERE) -> pd.DataFrame:
    """Search constants for single test tubes: what would plc-integral earn if it knew the tube?

    Compares the laws "own" and "start", the stored one, at seeds that were not searched; writes their insertions.

    Args:
        output: folder of the results and of the insertions.
        limit: number of tubes.
        trials: number of insertions in each tube, without those of the comparison.
        workers: processes that simulate.
    """
    case, start = load_case(None, "test", limit), read_constants(STORED_INTEGRAL)
    generations, tables = max(trials // LAWS, 1), []
    for number, tube in enumerate(case.contexts):
        single, folder = case._replace(contexts=(tube,)), output / "episodes" / f"{number:02d}"
        name = f"tube {number + 1} of {len(case.contexts)}"
        laws = {"start": start, "own": _search_in(single, start, generations, name, folder, workers)}
        unseen = range(generations, generations + COMPARED)
        tables.append(simulate_laws(laws, single, folder / "compared", workers, unseen).assign(context=number))
    table = pd.concat(tables, ignore_index=True)
    gain = paired_difference(table, "own", "start", "reward")
    compared, record = table[["policy", "context", "seed", "reward"]], origin(commits=table["commit"])
    write_search(output, "plc-by-tube", compared, {"gain": asdict(gain), "provenance": record})
    print_line(f"own constants minus the stored ones, in {len(tables)} test tubes: reward {gain.text()}")
    return compared


def _search_in(
    tube: EvaluationCase, start: Constants, generations: int, name: str, folder: Path, workers: Workers
) -> Constants:
    """Mean of the last generation in a single tube. Each has another seed: a seed's motion is chaotic, not typical."""
    seeds = count()

    def rewards_of(points: FloatArray) -> list[float]:
        laws, seed = {f"law-{k}": constants_at(point) for k, point in enumerate(points)}, next(seeds)
        table = simulate_laws(laws, tube, folder / f"{seed:04d}", workers, [seed])
        return [float(reward) for reward in table.set_index("policy")["reward"][[*laws]]]

    *_, means = search(rewards_of, point_of(start), generations, name, SPREAD, LAWS)
    return constants_at(means[-1])


def simulate_laws(
    laws: Mapping[str, Constants], case: EvaluationCase, folder: Path, workers: Workers, seeds: Sequence[int] = (0,)
) -> pd.DataFrame:
    """Insertions of laws in the tubes of a case; those that are stored in the folder are not run again."""
    config = case.config.full_observation
    plan = plan_of({name: PlcIntegral(config, law) for name, law in laws.items()}, case, seeds)
    return run_plan(plan, folder, progress=False, workers=workers)
