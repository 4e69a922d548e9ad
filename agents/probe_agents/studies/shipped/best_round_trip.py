"""Optimises feed and air of insertion and withdrawal (four numbers) by Bayesian optimisation of simulated round trips.

The vibration map does not cover withdrawal, so every trial is simulated; stored trials are not simulated again. The air
is limited to the range of ``safe_air``.
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

from probe_agents.evaluation.plan import Plan, run_plan
from probe_agents.evaluation.statistics import a90_95, paired_difference
from probe_agents.evaluation.workers import Workers
from probe_agents.plant.recommendation import safe_air
from probe_agents.policies.cases import EvaluationCase, load_case
from probe_agents.policies.fixed import STUDY_AIR, Scheduled
from probe_agents.policies.on_map import FIRST
from probe_agents.policies.policy import Policy
from probe_agents.policies.wrappers import RoundTripPolicy, insertion_task
from probe_agents.records.atomic import write_atomically
from probe_agents.records.manifest import origin, write_json
from probe_agents.studies.builtin import Request, print_frame
from probe_agents.terminal.tables import print_line
from probe_env import Context
from probe_env.envs.contexts import SPLIT_SIZES
from probe_env.envs.task import TaskConfig
from probe_env.fidelity import resolve_fidelity
from probe_env.schedule import AIR, CSV_COMMENT, FEED, INSERTION, WITHDRAWAL, Schedule

FIDELITY: Final = "fast"
NAME: Final = "best-both-ways"
TRIALS, LIMIT = 40, 12
"""Number of trials, and training tubes per trial."""
COLUMNS: Final = (*INSERTION.values(), *WITHDRAWAL.values())
"""Search parameters: columns of a schedule file."""
STARTUP_TRIALS: Final = 5
"""Random trials before the Gaussian process is used, including ``starts``."""
KPIS: Final = ("reward", "inspection_time_s", "a90_percent_wall")
BASELINE: Final = "fastest"

SLOWEST: Final = 0.25
"""Share of the highest feed: slower round trips take most of the time limit."""

Numbers = Mapping[str, float]  # column of ``COLUMNS`` -> value [m/s], [m3/h]
Space = Mapping[str, tuple[float, float]]  # column of ``COLUMNS`` -> search range


def ranges(config: TaskConfig, tubes: Sequence[Context]) -> Space:
    """Search ranges, with air that is safe in all tubes, see ``safe_air``."""
    least, most = (3600.0 * air for air in config.air_supply_rates)
    feeds = max(SLOWEST * config.feed_speeds[1], config.feed_speeds[0]), config.feed_speeds[1]
    air_in, air_back = safe_air(config, tubes, feeds)
    return dict(zip(COLUMNS, (feeds, (air_in, most), feeds, (least, air_back)), strict=True))


def starts(config: TaskConfig, space: Space) -> list[Numbers]:
    """First trials: highest feed for both passes, and half of it for the withdrawal, with the study's air."""
    fast, air = config.feed_speeds[1], 3600.0 * STUDY_AIR
    low, high = np.array(list(space.values())).T
    rows = np.clip([(fast, air, fast, air), (fast, air, 0.5 * fast, air)], low, high).tolist()
    return [rounded_numbers(config, dict(zip(COLUMNS, row, strict=True))) for row in rows]


def rounded_numbers(config: TaskConfig, numbers: Numbers) -> dict[str, float]:
    """Feed to three digits and air in whole m3/h, as the feed device and the supply can set them."""
    rounded: dict[str, float] = {}
    for columns in (INSERTION, WITHDRAWAL):
        targets = round(numbers[columns[FEED]], 3), round(numbers[columns[AIR]]) / 3600.0
        feed, air = (float(value) for value in config.feasible(*targets)[0])
        rounded |= {columns[FEED]: round(feed, 9), columns[AIR]: round(3600.0 * air, 9)}
    return rounded


def policy_of(config: TaskConfig, numbers: Numbers) -> RoundTripPolicy:
    """A schedule with constant feed and air in each pass."""
    ways = [
        Schedule("inserted_length", "linear", (FIRST,), (numbers[columns[FEED]],), (numbers[columns[AIR]] / 3600.0,))
        for columns in (INSERTION, WITHDRAWAL)
    ]
    return RoundTripPolicy(config, Scheduled(insertion_task(config), ways[0]), ways[1])


def csv_of(config: TaskConfig, numbers: Numbers) -> str:
    """The schedule file, for ``Schedule.read`` and ``read_withdrawal``."""
    values = ",".join(f"{numbers[name]:.6g}" for name in COLUMNS)
    ends = (FIRST, config.scene.tube.helix_length)
    lines = (f"{CSV_COMMENT} linear", ",".join(("inserted_length_m", *COLUMNS)), *(f"{end:g},{values}" for end in ends))
    return "\n".join(lines) + "\n"


def run(request: Request) -> Numbers:
    """Search, and evaluate the best in the validation tubes; writes NAME.csv, NAME-trials.csv and NAME.json.

    ``trials`` is the number of schedules, including ``starts``; ``limit`` the number of training tubes per schedule.

    Raises:
        ValueError: a budget is out of range.
        FileError: a stored episode is damaged, or of another task.
    """
    trials, limit = request.budget("trials", TRIALS), request.budget("limit", LIMIT, SPLIT_SIZES["train"])
    whole = load_case(request.tube, "train", 0, "both")
    train = whole._replace(contexts=whole.contexts[:limit])
    unseen = load_case(whole.plant, "validation", 0, "both")
    config, output, played = train.config.full_observation, request.output, request.output / "simulated"
    space = ranges(config, whole.contexts)
    print_line(f"{trials} trials of {limit} inspections each, stored in {played}; stored ones are not run again")
    tried, commits = _run_trials(trials, space, train, played, request.workers)
    row = tried.iloc[int(tried["reward"].to_numpy().argmax())].to_dict()
    best = {column: row[column] for column in COLUMNS}
    compared = {NAME: best, BASELINE: starts(config, space)[0]}
    policies = {one: policy_of(config, numbers) for one, numbers in compared.items()}
    table = run_plan(_plan(policies, unseen), played / "validation", workers=request.workers)
    means = {one: table[table["policy"] == one][list(KPIS)].mean().to_dict() for one in compared}
    gain = paired_difference(table, NAME, BASELINE, "reward")
    record: dict[str, Any] = {"schedule": best, "inspects": config.inspects, "training_tubes": limit, "trials": trials}
    record |= {"reward": row["reward"], "ranges": space, "validation_tubes": len(unseen.contexts), "validated": means}
    record |= {"gain": asdict(gain)}
    write_atomically(output / f"{NAME}-trials.csv", tried.to_csv(index=False, float_format="%.6g"))
    write_atomically(output / f"{NAME}.csv", csv_of(config, best))
    write_json(output / f"{NAME}.json", origin(commits=[*commits, *table["commit"]]) | record)
    rows = pd.DataFrame([{"schedule": one} | dict(compared[one]) | means[one] for one in compared])
    print_frame(f"In {len(unseen.contexts)} validation tubes", rows)
    print(f"{NAME}: reward minus that of {BASELINE}: {gain.text()} (95 % interval)")
    print_line(f"written: {output}/ ({NAME}.csv: a schedule to evaluate, {NAME}-trials.csv, {NAME}.json)")
    return best


def _run_trials(
    trials: int, space: Space, case: EvaluationCase, played: Path, workers: Workers
) -> tuple[pd.DataFrame, list[str]]:
    """One row per trial: numbers, and means over the tubes; and the commits of the episodes."""
    config, rows, commits = case.config.full_observation, [], []
    optuna.logging.set_verbosity(optuna.logging.ERROR)  # without greenlet: slower, same result
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        sampler = optuna.samplers.GPSampler(seed=0, n_startup_trials=STARTUP_TRIALS)
    study = optuna.create_study(direction="maximize", sampler=sampler)  # in memory: deterministic
    for numbers in starts(config, space):
        study.enqueue_trial(dict(numbers))
    feeds = INSERTION[FEED], WITHDRAWAL[FEED]
    distributions: dict[str, optuna.distributions.BaseDistribution] = {}
    for name in COLUMNS:
        distributions[name] = optuna.distributions.FloatDistribution(*space[name], log=name in feeds)
    for number in tqdm(range(trials), desc=NAME, unit="trial"):
        trial = study.ask(distributions)
        numbers = rounded_numbers(config, trial.params)
        plan = _plan({"trial": policy_of(config, numbers)}, case)
        table = run_plan(plan, played / f"{number:03d}", progress=False, workers=workers)
        means = {kpi: float(table[kpi].mean()) for kpi in KPIS}
        study.tell(trial, means["reward"])
        rows.append(numbers | means | {"a90_95_percent_wall": a90_95(table, "trial")})
        commits += list(table["commit"])
    return pd.DataFrame(rows), commits


def _plan(policies: Mapping[str, Policy], case: EvaluationCase) -> Plan:
    fidelity = resolve_fidelity(FIDELITY, round_trip=True)
    return Plan(policies, case.contexts, config=case.config.full_observation, fidelity=fidelity)
