"""Makes the best feed and air in and back: four numbers, by a Gaussian process over simulated round trips.

The vibration map knows no way back, so every trial is simulated; what is stored is not simulated again. Air is tried
only where steady sliding keeps a margin of drive and of buckling in every tube, see ``safe_air``.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import numpy as np
import optuna
import pandas as pd
from tqdm import tqdm

from agents.evaluation.plan import Plan, run_plan
from agents.evaluation.statistics import a90_95, paired_difference
from agents.evaluation.workers import Workers
from agents.plant.recommendation import safe_air
from agents.policies.cases import EvaluationCase, load_case
from agents.policies.fixed import STUDY_AIR, Scheduled
from agents.policies.on_map import FIRST
from agents.policies.policy import Policy
from agents.policies.wrappers import BothWays, way_in
from agents.records.atomic import write_atomically
from agents.records.manifest import origin, write_json
from agents.studies.builtin import Request, print_frame
from probe_env import Context
from probe_env.envs.contexts import SPLIT_SIZES
from probe_env.envs.task import TaskConfig
from probe_env.fidelity import resolve_fidelity
from probe_env.schedule import AIR, BACK, CSV_COMMENT, FEED, FORTH, Schedule

FIDELITY: Final = "fast"
NAME: Final = "best-both-ways"
TRIALS, LIMIT = 40, 12
"""Schedules tried, and training tubes of each."""
COLUMNS: Final = (*FORTH.values(), *BACK.values())
"""What is searched: the columns of a schedule file."""
DRAWN: Final = 5
"""Trials that are drawn over the ranges before the process leads, those of ``starts`` among them."""
KPIS: Final = ("reward", "inspection_time_s", "a90_percent_wall")
BESIDE: Final = "fastest"

SLOWEST: Final = 0.25
"""Share of the greatest feed: both ways slower than that take most of a shift's time limit."""

Numbers = Mapping[str, float]  # column of ``COLUMNS`` -> value [m/s], [m3/h]
Space = Mapping[str, tuple[float, float]]  # column of ``COLUMNS`` -> range in which it is looked for


def ranges(config: TaskConfig, tubes: Sequence[Context]) -> Space:
    """Where each number is looked for, with air that is safe in all of the tubes, see ``safe_air``."""
    least, most = (3600.0 * air for air in config.air_supply_rates)
    feeds = max(SLOWEST * config.feed_speeds[1], config.feed_speeds[0]), config.feed_speeds[1]
    air_in, air_back = safe_air(config, tubes, feeds)
    return dict(zip(COLUMNS, (feeds, (air_in, most), feeds, (least, air_back)), strict=True))


def starts(config: TaskConfig, space: Space) -> list[Numbers]:
    """What is tried first: as fast as the device goes both ways, and back at half of that, with the study's air."""
    fast, air = config.feed_speeds[1], 3600.0 * STUDY_AIR
    low, high = np.array(list(space.values())).T
    rows = np.clip([(fast, air, fast, air), (fast, air, 0.5 * fast, air)], low, high).tolist()
    return [as_given(config, dict(zip(COLUMNS, row, strict=True))) for row in rows]


def as_given(config: TaskConfig, numbers: Numbers) -> dict[str, float]:
    """To three digits of the feed and whole cubic metres an hour, as near as the device comes to that."""
    given: dict[str, float] = {}
    for columns in (FORTH, BACK):
        wanted = round(numbers[columns[FEED]], 3), round(numbers[columns[AIR]]) / 3600.0
        feed, air = (float(value) for value in config.given(*wanted)[0])
        given |= {columns[FEED]: round(feed, 9), columns[AIR]: round(3600.0 * air, 9)}
    return given


def policy_of(config: TaskConfig, numbers: Numbers) -> BothWays:
    """A schedule of one feed and air each way."""
    ways = [
        Schedule("inserted_length", "linear", (FIRST,), (numbers[columns[FEED]],), (numbers[columns[AIR]] / 3600.0,))
        for columns in (FORTH, BACK)
    ]
    return BothWays(config, Scheduled(way_in(config), ways[0]), ways[1])


def csv_of(config: TaskConfig, numbers: Numbers) -> str:
    """The file of such a schedule, which ``Schedule.read`` and ``read_back`` take."""
    values = ",".join(f"{numbers[name]:.6g}" for name in COLUMNS)
    ends = (FIRST, config.scene.tube.helix_length)
    lines = (f"{CSV_COMMENT} linear", ",".join(("inserted_length_m", *COLUMNS)), *(f"{end:g},{values}" for end in ends))
    return "\n".join(lines) + "\n"


def run(request: Request) -> Numbers:
    """Search, and play what was found in the validation tubes; writes NAME.csv, NAME-trials.csv and NAME.json.

    ``trials`` are schedules played, those of ``starts`` among them, ``limit`` the training tubes that each is played
    in, the first, which are balanced. What a metre counts for and the probe are those of the tube's file.

    Raises:
        ValueError: a budget is out of range.
        FileError: a stored episode is damaged, or of another task.
    """
    trials, limit = request.budget("trials", TRIALS), request.budget("limit", LIMIT, SPLIT_SIZES["train"])
    train = load_case(request.tube, "train", limit, "both")
    unseen = load_case(request.tube, "validation", 0, "both")
    config, output, played = train.config.full_observation, request.output, request.output / "simulated"
    space = ranges(config, load_case(request.tube, "train", 0, "both").contexts)
    print(f"{trials} trials of {limit} inspections each, kept in {played}; what is there is not played again")
    tried, commits = _tried(trials, space, train, played, request.workers)
    row = tried.iloc[int(tried["reward"].to_numpy().argmax())].to_dict()
    best = {column: row[column] for column in COLUMNS}
    compared = {NAME: best, BESIDE: starts(config, space)[0]}
    policies = {one: policy_of(config, numbers) for one, numbers in compared.items()}
    table = run_plan(_plan(policies, unseen), played / "validation", workers=request.workers)
    means = {one: table[table["policy"] == one][list(KPIS)].mean().to_dict() for one in compared}
    gain = paired_difference(table, NAME, BESIDE, "reward")
    record: dict[str, Any] = {"schedule": best, "inspects": config.inspects, "training_tubes": limit, "trials": trials}
    record |= {"reward": row["reward"], "ranges": space, "validation_tubes": len(unseen.contexts), "validated": means}
    record |= {"gain": asdict(gain)}
    write_atomically(output / f"{NAME}-trials.csv", tried.to_csv(index=False, float_format="%.6g"))
    write_atomically(output / f"{NAME}.csv", csv_of(config, best))
    write_json(output / f"{NAME}.json", origin(commits=[*commits, *table["commit"]]) | record)
    shown = pd.DataFrame([{"schedule": one} | dict(compared[one]) | means[one] for one in compared])
    print_frame(f"In {len(unseen.contexts)} validation tubes", shown)
    print(f"{NAME}: reward more than {BESIDE}: {gain.text()} (95 % interval)")
    print(f"written: {output}/ ({NAME}.csv: a schedule to evaluate, {NAME}-trials.csv, {NAME}.json)")
    return best


def _tried(
    trials: int, space: Space, place: EvaluationCase, played: Path, workers: Workers
) -> tuple[pd.DataFrame, list[str]]:
    """A row a trial: its numbers and what came of it, means over the tubes; and the commits that played them."""
    config, rows, commits = place.config.full_observation, [], []
    optuna.logging.set_verbosity(optuna.logging.ERROR)  # no greenlet: slower, the same
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        sampler = optuna.samplers.GPSampler(seed=0, n_startup_trials=DRAWN)
    study = optuna.create_study(direction="maximize", sampler=sampler)  # in memory: equal rewards, equal trials
    for numbers in starts(config, space):
        study.enqueue_trial(dict(numbers))
    feeds = FORTH[FEED], BACK[FEED]
    drawn: dict[str, optuna.distributions.BaseDistribution] = {}
    for name in COLUMNS:
        drawn[name] = optuna.distributions.FloatDistribution(*space[name], log=name in feeds)
    for number in tqdm(range(trials), desc=NAME, unit="trial"):
        trial = study.ask(drawn)
        numbers = as_given(config, trial.params)
        plan = _plan({"trial": policy_of(config, numbers)}, place)
        table = run_plan(plan, played / f"{number:03d}", progress=False, workers=workers)
        means = {kpi: float(table[kpi].mean()) for kpi in KPIS}
        study.tell(trial, means["reward"])
        rows.append(numbers | means | {"a90_95_percent_wall": a90_95(table, "trial")})
        commits += list(table["commit"])
    return pd.DataFrame(rows), commits


def _plan(policies: Mapping[str, Policy], place: EvaluationCase) -> Plan:
    fidelity = resolve_fidelity(FIDELITY, both_ways=True)
    return Plan(policies, place.contexts, config=place.config.full_observation, fidelity=fidelity)
