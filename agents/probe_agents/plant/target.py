"""The fastest schedule that still finds a flaw: least time with a90 below a target in 95 % of the tubes of a plant.

The probability of detection of a pass is the mean over its metres. So for one depth of flaw the missed share is a sum
over metres, as the time is, and dynamic programming over feed and air finds the schedule with the least sum of time
and weighted missed share. The weight follows from the target. Signal-to-noise comes from a vibration map of the noise
in the band of a flaw, with its scatter. The map takes the noise for Gaussian and metres for independent, and its a90
is 10 to 30 % too low: schedules for several depths are simulated until one just meets the target.
"""

import math
import re
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
import pandas as pd
from scipy.stats import binom

from probe_agents.evaluation.plan import run_plan
from probe_agents.evaluation.run import plan_of
from probe_agents.evaluation.workers import HERE, Workers
from probe_agents.plant.recommendation import (
    CONFIDENCE,
    NAME,
    Confirmation,
    print_start_air,
    route_air,
    settings_of,
    write_description,
)
from probe_agents.policies.cases import map_of, read_case
from probe_agents.policies.fixed import Scheduled
from probe_agents.policies.policy import Domain, OutsideDomain
from probe_agents.records.atomic import write_atomically
from probe_agents.terminal.tables import print_line
from probe_env import Context, Plant
from probe_env.arrays import FloatArray
from probe_env.envs.task.config import TaskConfig
from probe_env.envs.vibration_map import CONTEXT, VibrationMap
from probe_env.inspection.detection import DEPTHS, depths_found, pod_gaussian, snr_at, threshold
from probe_env.schedule import Schedule

MIN_DEPTH, MAX_DEPTH = 2.0, 99.0
"""Accepted targets of a90 [% of the wall]; beyond 99 no flaw needs to be found."""
CHANGE_WEIGHT: Final = 5.0
"""Cost of a change of the feed by a factor of e, or of the air over its range, between two points [s]."""
MAX_SIMULATED: Final = 6
"""Number of simulated schedules."""
CLOSE: Final = 0.98
"""Share of the target that is close enough; the search aims between this and 1."""
CANDIDATES: Final = 3
"""One tube in three is simulated, those with the largest a90 on the map: the limit is the second largest of 96."""
POINTS: Final = 9
"""Number of depths in the table of time against a90."""
TIME_FRACTION: Final = 0.98
"""Largest time of a schedule over the time limit; the feed ramp takes the rest."""


class Candidate(NamedTuple):
    """A schedule of the map: a90 (tubes,) and its upper limit [% of the wall], time [s], least root tension [N]."""

    schedule: Schedule
    a90: FloatArray
    limit: float
    time: float
    tension: float


class TargetResult(NamedTuple):
    """The fastest schedule within the target, its simulated limit of a90 [% of the wall], and all schedules.

    ``table`` has a row per schedule: upper limit of a90 [% of the wall], time [s], and whether the limit is simulated;
    otherwise it is that of the map times the ratio of both for the schedule found. ``found`` is None if no schedule
    is within the target; ``limit`` is then the least that was simulated.
    """

    found: Candidate | None
    limit: float
    table: pd.DataFrame


def a90_target(text: str) -> float:
    """The target of ``--find a90=PERCENT`` [% of the wall]."""
    match = re.fullmatch(r"a90=(\d+(?:\.\d*)?)", text.strip())
    if not match or not MIN_DEPTH <= float(match[1]) <= MAX_DEPTH:
        raise ValueError(
            f"find = {text!r} is not a90=PERCENT with {MIN_DEPTH:g} to {MAX_DEPTH:g} percent of the wall,"
            " such as a90=20"
        )
    return float(match[1])


def upper_limit(values: FloatArray) -> float:
    """Value that 95 % of a distribution do not exceed, at 95 % confidence, from independent samples (n,).

    The r-th largest of n samples exceeds the 95th percentile unless fewer than r samples are above it, of which
    there are Binomial(n, 0.05): r is the largest with P(fewer than r) of at most 0.05. Fewer than 59 samples give no
    such confidence: their limit is the largest.
    """
    rank, outside = 0, 1.0 - CONFIDENCE
    while binom.cdf(rank, len(values), outside) <= outside:
        rank += 1
    return float(np.sort(values)[-max(rank, 1)])


class MapSearch:
    """Schedules on a vibration map of S/N; raises ValueError as ``settings_of``.

    Args:
        tubes: samples of the plant.
        vibration: the map, of ``measure`` "snr".
        config: the task, of the insertion alone.
        start_air: see ``route_air``.
    """

    def __init__(
        self, tubes: Sequence[Context], vibration: VibrationMap, config: TaskConfig, start_air: float = 0.0
    ) -> None:
        self.config = config
        self.settings = settings = settings_of(tubes, config, start_air)
        metres, shape = settings.metres, settings.tension.shape
        values = np.array([[getattr(tube, name) for name in CONTEXT] for tube in tubes])
        pairs = [
            vibration.predict(metres.length, metres.feed, metres.air, np.tile(row, (len(metres), 1)), config.scene)
            for row in values
        ]
        decades, self._deviation = (np.array(part).reshape(len(tubes), *shape) for part in zip(*pairs, strict=True))
        at_one = float(config.sensor.equivalent_rms(np.ones(())))  # radial rms at S/N 1
        self._snr = at_one / (1e-4 * 10.0**decades)
        self._z = threshold(config.sensor, config.scene.tube.helix_length)

    def pod(self, depth: float, where: tuple[slice | range | list[int], ...] = ()) -> FloatArray:
        """Expected POD of a flaw [fraction of the wall], (tubes, n, g), or of a part of these axes."""
        snr = snr_at(self.config.sensor, self._snr[where].ravel(), np.array([depth]))[:, 0]
        nodes, weights = np.polynomial.hermite_e.hermegauss(7)
        spread = self._deviation[where]
        terms = (
            weight * pod_gaussian(snr.reshape(spread.shape) * 10.0 ** (node * spread), self._z)
            for node, weight in zip(nodes, weights / weights.sum(), strict=True)
        )
        return np.asarray(sum(terms))

    def fastest(self, target: float) -> Candidate | None:
        """The fastest schedule with an upper limit of a90 on the map within a target [% of the wall]; None: none."""
        missed = np.quantile(1.0 - self.pod(target / 100.0), CONFIDENCE, axis=0)
        low, high = np.log((1e-2, 1e5))  # range of the weight of the missed share [s/m]
        best = None
        for _ in range(12):
            middle = 0.5 * (low + high)
            cost = 1.0 / self.settings.feed + math.exp(middle) * missed
            candidate = self._candidate(self.settings.cheapest(cost, CHANGE_WEIGHT))
            if candidate.limit > target:
                low = middle
                continue
            high = middle
            if candidate.time <= TIME_FRACTION * self.config.time_limit:
                best = candidate
        return best

    def minimum(self) -> Candidate:
        """The schedule with nearly the least limit of a90 that the time limit allows."""
        low, high = math.log(MIN_DEPTH), math.log(100.0)
        best = self.fastest(100.0)
        if best is None:
            raise ValueError(f"task.time_limit = {self.config.time_limit:g} s is too short for every schedule")
        while high - low > math.log(1.02):
            candidate = self.fastest(math.exp(0.5 * (low + high)))
            if candidate:
                best = candidate
            low, high = (low, 0.5 * (low + high)) if candidate else (0.5 * (low + high), high)
        return best

    def _candidate(self, path: list[int]) -> Candidate:
        settings, where = self.settings, (slice(None), range(len(path)), path)
        fraction = settings.spacing / settings.spacing.sum()
        curves = np.stack([(fraction * self.pod(depth, where)).sum(axis=1) for depth in DEPTHS], axis=1)
        a90 = 100.0 * depths_found(curves, 0.9)
        time = float((settings.spacing / settings.feed[path]).sum())
        tension = settings.min_tension(path, self.config)
        return Candidate(settings.schedule(path), a90, upper_limit(a90), time, tension)


def find_schedule(search: MapSearch, target: float, simulated_limit: Callable[[Candidate], float]) -> TargetResult:
    """The fastest schedule of a search whose simulated upper limit of a90 is within a target [% of the wall]."""
    minimum, loosest = search.minimum(), search.fastest(100.0)
    assert loosest
    goal, level = 0.5 * (1.0 + CLOSE) * target, target
    tried: list[tuple[Candidate, float]] = []
    within: list[tuple[Candidate, float]] = []  # fastest first
    while len(tried) < MAX_SIMULATED:
        candidate = minimum if level <= minimum.limit else search.fastest(min(level, 100.0)) or minimum
        if any(candidate.schedule == before.schedule for before, _ in tried):
            break
        tried.append((candidate, simulated_limit(candidate)))
        within = sorted((pair for pair in tried if pair[1] <= target), key=lambda pair: pair[0].time)
        beyond = sorted((pair for pair in tried if pair[1] > target), key=lambda pair: -pair[0].time)
        if within and within[0][1] >= CLOSE * target:
            break
        (candidate, limit), slope = tried[-1], 1.0
        if within and beyond:  # on the line through the nearest on both sides, of logarithms
            (candidate, limit), (other, limit_beyond) = within[0], beyond[0]
            slope = math.log(other.limit / candidate.limit) / math.log(limit_beyond / limit)
        level = candidate.limit * (goal / limit) ** max(slope, 0.0)
    if not within and all(minimum.schedule != before.schedule for before, _ in tried):
        tried.append((minimum, simulated_limit(minimum)))
        within = [pair for pair in tried if pair[1] <= target]
    found, limit = within[0] if within else (None, min(limit for _, limit in tried))
    ratio = limit / found.limit if found else tried[-1][1] / tried[-1][0].limit
    rows = [(limit, candidate.time, True) for candidate, limit in tried]
    for depth in np.geomspace(minimum.limit, loosest.limit, POINTS):
        candidate = search.fastest(float(depth)) or minimum
        rows.append((min(ratio * candidate.limit, 100.0), candidate.time, False))
    return TargetResult(found, limit, pd.DataFrame(sorted(rows), columns=["a90_percent_wall", "time_s", "simulated"]))


def recommend_for_target(
    target: float, tube: Path | None, output: Path, confirmation: Confirmation, workers: Workers = HERE
) -> TargetResult:
    """Search and write the fastest schedule for a target of a90, simulate it with others, print.

    Args:
        target: a90 that 95 % of the tubes keep [% of the wall].
        tube: file or name of the plant; None: table 2 with the shipped lists of tubes.
        output: schedule file (.csv); NAME.json and NAME-a90.csv, the time against a90, are written next to it, the
            latter also if no schedule is within the target, which is an error.
        confirmation: settings of the simulations.
        workers: workers of the simulations.
    """
    case = read_case(tube, "train")
    config, plant = case.config, case.plant
    if config.returns:
        raise ValueError("task.passes = 'both': --find is for the insertion alone; set passes = \"in\"")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        plan = plan_of(("constant",), case, 1, confirmation.fidelity)
    if not plan.fidelity.simulates:
        raise ValueError(
            f"fidelity = {confirmation.fidelity!r} has no signal; accepted: those that simulate the motion"
        )
    confirmation.check(plant)
    vibration = case.vibration if case.vibration.measure == "snr" else map_of(Path("snr"), Plant())
    for text in Domain.of_map(vibration).outside(config, case.contexts):
        warnings.warn(f"outside the range of the map of S/N: {text}", OutsideDomain, stacklevel=2)

    def simulated_limit(candidate: Candidate) -> float:
        loudest = np.argsort(-candidate.a90, kind="stable")[: len(candidate.a90) // CANDIDATES]
        policies, a90 = {NAME: Scheduled(plan.config, candidate.schedule)}, np.zeros(len(candidate.a90))
        tubes = [case.contexts[k] for k in loudest]
        table = run_plan(replace(plan, policies=policies, contexts=tubes), None, workers=workers)
        a90[: len(tubes)] = table["a90_percent_wall"]
        limit = upper_limit(a90)
        print(f"{candidate.time:.0f} s: a90 up to {limit:.1f} % of the wall")
        return limit

    start_air = route_air(plant, case.contexts)
    result = find_schedule(MapSearch(case.contexts, vibration, config, start_air), target, simulated_limit)
    table_file, found = output.with_name(f"{output.stem}-a90.csv"), result.found
    write_atomically(table_file, result.table.to_csv(index=False, float_format="%.5g"))
    if found is None:
        raise ValueError(
            f"find = a90={target:g}: no schedule is within it in {CONFIDENCE:.0%} of the tubes; the least a90 is"
            f" {result.limit:.1f} % of the wall, see {table_file}"
        )
    write_atomically(output, found.schedule.to_csv())
    figures = {
        "target_a90_percent_wall": target, "a90_limit_percent_wall": result.limit, "time_s": found.time,
        "least_root_tension_n": found.tension,
    }  # fmt: skip
    write_description(output, plant, len(case.contexts), figures)
    print_line(
        f"{output}: in your tubes about {found.time:.0f} s, a90 up to {result.limit:.1f} % of the wall in"
        f" {CONFIDENCE:.0%} of them ({len(case.contexts)} samples); drive safe: root tension above"
        f" {found.tension:.2g} N in {CONFIDENCE:.0%}; time against a90: {table_file}"
    )
    print_start_air(start_air, config)
    episodes = confirmation.run(plant, [f"{NAME}={output}"], workers)
    a90 = episodes.loc[episodes["policy"] == NAME, "a90_percent_wall"]
    print(f"a90 of {NAME} is within {target:g} % of the wall in {(a90 <= target).sum()} of {len(a90)} other tubes")
    return result
