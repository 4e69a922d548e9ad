"""Search for probe designs: vibration, inspection time and drive margin at once, by NSGA-II of Optuna.

Trials are kept in SQLite (or any storage that Optuna knows), one by one, and the sampler is seeded by how many are
complete, so a search that was killed goes on to the same front.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import moocore
import numpy as np
import optuna
import pandas as pd
from optuna.distributions import BaseDistribution, FloatDistribution
from optuna.samplers import NSGAIISampler
from optuna.trial import FrozenTrial, TrialState, create_trial
from scipy.stats import rankdata
from tqdm import tqdm

from agents.design import figures
from agents.design.compare import tube_column
from agents.design.folders import claim
from agents.design.problem import DIRECTIONS, OBJECTIVES, DesignProblem, Values
from agents.evaluation.statistics import bootstrap_ends
from agents.processes.workers import HERE, Workers
from agents.records.provenance import commit, provenance, write_atomically, write_json
from agents.records.store import COMMIT
from agents.searches.database import open_study
from agents.terminal.masking import masked
from agents.terminal.tables import print_table
from agents.terminal.work import Work, announce
from probe_env import Design
from probe_env.design import RANGES
from probe_env.envs.task import Outcome, TaskConfig, reward_terms
from probe_env.envs.trials import stretch_of


class RepeatableNSGAII(NSGAIISampler):
    """NSGA-II whose parents stand in the order of their trials.

    Optuna hands parents that it has just selected over in the order of the selection, but those that it has cached in
    the order of their trials: a trial that was killed right after the selection drew other parents when it ran again.
    """

    def select_parent(self, study: optuna.Study, generation: int) -> list[FrozenTrial]:
        """As Optuna, but in the order of the trials."""
        return sorted(super().select_parent(study, generation), key=lambda trial: trial.number)


class Kept(NamedTuple):
    """Where the trials of a search are kept.

    Attributes:
        storage: URL of any storage that Optuna knows; one search at a time in a study.
        name: of the study in it.
        place: what it is called in messages; default: ``storage``, without its password.
    """

    storage: str
    name: str
    place: Path | None = None


def search(
    axes: dict[str, tuple[float, float, str]],
    value: Callable[[dict[str, float]], Values],
    trials: int,
    kept: Kept,
    population: int = 24,
    seed: int = 0,
    starts: Sequence[Mapping[str, float]] = (),
) -> optuna.Study:
    """Run a search, or what is left of it, and return the study.

    Args:
        axes: name -> lowest, highest, unit.
        value: objectives of a point, by ``DIRECTIONS``.
        trials: to be complete at the end.
        kept: where they are.
        population: designs in a generation.
        seed: of the search.
        starts: points to begin with, part of the first generation.
    """
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    study = open_study(kept.storage, kept.name, DIRECTIONS, axes)
    for stale in study.get_trials(deepcopy=False, states=(TrialState.RUNNING,)):
        study._storage.set_trial_state_values(stale._trial_id, TrialState.FAIL)  # of a run that was killed

    def complete() -> int:
        return len(study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,)))

    done = complete()
    announce(Work("design", trials, complete, kept.place or masked(kept.storage)))
    with tqdm(total=trials, initial=min(done, trials), desc=kept.name, unit="design") as bar:
        for number in range(done, min(len(starts), trials)):
            distributions: dict[str, BaseDistribution] = {
                axis: FloatDistribution(low, high) for axis, (low, high, _) in axes.items()
            }
            study.add_trial(
                create_trial(
                    params=dict(starts[number]), distributions=distributions, values=value(dict(starts[number])),
                    system_attrs={RepeatableNSGAII._get_generation_key(): 0}, user_attrs={COMMIT: commit()},
                )
            )  # fmt: skip
            bar.update()
        for number in range(max(done, len(starts)), trials):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                study.sampler = RepeatableNSGAII(
                    population_size=population, seed=int(np.random.SeedSequence([seed, number]).generate_state(1)[0])
                )
            trial = study.ask()
            point = {axis: trial.suggest_float(axis, low, high) for axis, (low, high, _) in axes.items()}
            trial.set_user_attr(COMMIT, commit())
            study.tell(trial, value(point))
            bar.update()
    return study


def trials_table(study: optuna.Study) -> pd.DataFrame:
    """Complete trials: number, point, objectives, the commit that made it, and whether the design is on the front."""
    complete = sorted(study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,)), key=lambda trial: trial.number)
    rows = [_row(k, trial) for k, trial in enumerate(complete)]
    table = pd.DataFrame(rows)
    signs = np.array([1.0 if direction == "minimize" else -1.0 for direction in DIRECTIONS])
    table["on_front"] = moocore.is_nondominated(table[list(OBJECTIVES)].to_numpy() * signs)
    return table


def _row(number: int, trial: FrozenTrial) -> dict[str, Any]:
    values = dict(zip(OBJECTIVES, trial.values, strict=True))
    return {"trial": number} | trial.params | values | {COMMIT: trial.user_attrs.get(COMMIT, "unknown")}


def sensitivity(table: pd.DataFrame, axes: dict[str, tuple[float, float, str]]) -> pd.DataFrame:
    """Standardised rank regression of every objective on all parameters, with 95 % bootstrap intervals.

    A coefficient of +1 would say that the objective rises with the parameter alone; the trials are those of the search,
    so parameters that it soon agreed on show less than they would over the whole space.
    """
    names = list(axes)
    rows: list[tuple[str, str, float, float, float]] = []
    for objective in OBJECTIVES:

        def coefficients(*columns: np.ndarray) -> np.ndarray:
            ranks = rankdata(np.column_stack(columns), axis=0)
            scaled = (ranks - ranks.mean(axis=0)) / np.maximum(ranks.std(axis=0), 1e-12)
            return np.asarray(np.linalg.lstsq(scaled[:, :-1], scaled[:, -1], rcond=None)[0])

        data = tuple(table[name].to_numpy() for name in (*names, objective))
        ends = bootstrap_ends(coefficients, *data, method="percentile", paired=True, vectorized=False, n_resamples=1000)
        middle = coefficients(*data)
        low, high = map(np.atleast_1d, ends)
        rows += [(objective, n, float(middle[k]), float(low[k]), float(high[k])) for k, n in enumerate(names)]
    return pd.DataFrame(rows, columns=["objective", "parameter", "coefficient", "low", "high"])


def run_design_search(
    problem: DesignProblem, trials: int, output: Path, storage: str | None, seed: int, workers: Workers = HERE
) -> pd.DataFrame:
    """The search as a command: stores trials.csv, front.csv, sensitivity.csv, pictures and the best designs as TOML.

    Args:
        problem: what is searched.
        trials: designs to be tried at the end.
        output: folder of the tables and pictures.
        storage: URL of any storage that Optuna knows; None: SQLite in ``output``.
        seed: of the search.
        workers: what the tubes of a trial are spread over.

    Raises:
        ValueError: an argument is not valid; nothing was run.
    """
    if seed < 0:
        raise ValueError(f"seed = {seed!r} is outside the accepted range 0 and more")
    if not 2 <= trials <= 1_000_000:
        raise ValueError(f"trials = {trials!r} is outside the accepted range 2 to 1000000")
    identity = problem.identity()
    claim(output, problem.tube)
    if storage is None:
        output.mkdir(parents=True, exist_ok=True)
    kept = Kept(
        storage or f"sqlite:///{output / 'study.db'}",
        f"{problem.feed} {identity} seed {seed}",
        None if storage else output,
    )
    value = partial(problem.value, workers=workers)
    study = search(problem.axes, value, trials, kept, seed=seed, starts=problem.starts())
    table = trials_table(study)
    front = table[table["on_front"]].sort_values("mean_square_ratio")
    influence = sensitivity(table, problem.axes)
    for name, frame in (("trials", table), ("front", front), ("sensitivity", influence)):
        frame = frame.assign(**tube_column(problem.tube))
        write_atomically(output / f"{name}.csv", frame.to_csv(index=False, float_format="%.6g"))
    design = best_of(front, problem.config)
    write_atomically(output / "found.toml", design.to_toml())
    figures.design_front(table, reference_probes(table, problem), output / "front.png", problem.tube.title)
    figures.parallel_coordinates(table, problem.axes, output / "parallel.png", problem.tube.title)
    setting = {"feed": problem.feed, "full": problem.full, "fidelity": problem.fidelity.model_dump()}
    setting |= {"contexts": len(problem.contexts), "trials": len(table), "seed": seed}
    setting |= tube_column(problem.tube)
    write_json(output / "provenance.json", provenance(commits=table[COMMIT]) | setting)
    _print(front, influence, problem)
    print(f"written: {output}/ (front.csv, trials.csv, sensitivity.csv, front.png, parallel.png, found.toml)")
    return table


def best_of(front: pd.DataFrame, config: TaskConfig) -> Design:
    """The design of the front with the best reward by the task's weights, among those that keep some drive."""
    span = stretch_of(config).span

    def reward(row: dict[str, float]) -> float:  # of the span; air of a given schedule is the same for all
        seconds = row["inspection_time_s"]
        parts = {
            "inspected": span - row["guide_length"], "squares": span * row["mean_square_ratio"], "seconds": seconds,
            "air": seconds * row.get("air_supply_rate", 0.0), "uninspected": 0.0, "diverged": 0.0,
        }  # fmt: skip
        outcome = Outcome(**{name: np.asarray(value) for name, value in parts.items()})
        return float(sum(reward_terms(config, outcome).values()))

    rows: list[Any] = front.to_dict("records")
    best = max([row for row in rows if row["drive_margin_n"] >= 0.0] or rows, key=reward)
    return Design(**{name: float(best[name]) for name in RANGES}).built


def reference_probes(table: pd.DataFrame, problem: DesignProblem) -> pd.DataFrame:
    """The first trials, which are the probes that a search is to beat, with their names."""
    names = [name for name in problem.probes for _ in problem.reference_feeds()]
    return table.iloc[: len(names)].assign(design=names[: len(table)])


def _print(front: pd.DataFrame, influence: pd.DataFrame, problem: DesignProblem) -> None:
    axes, where = problem.axes, f" in {problem.tube.title}" if problem.tube.title else ""
    names = (*axes, *OBJECTIVES)
    rows = ([str(row["trial"]), *(f"{row[name]:.3g}" for name in names)] for row in front.to_dict("records"))
    units = {name: unit for name, (_, _, unit) in axes.items()} | {"inspection_time_s": "s", "drive_margin_n": "N"}
    labels = (name.removesuffix("_s").removesuffix("_n").replace("_", " ") for name in names)
    header = [f"{label} [{units[n]}]" if units.get(n) else label for n, label in zip(names, labels, strict=True)]
    print_table(f"Designs on the front{where}", ["trial", *header], rows)
    for row in influence[influence["objective"] == OBJECTIVES[0]].to_dict("records"):
        print(f"vibration and {row['parameter']}: {row['coefficient']:+.2f} [{row['low']:+.2f}, {row['high']:+.2f}]")
