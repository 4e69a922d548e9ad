"""Multi-objective search for probe designs (vibration, inspection time, drive margin) by Optuna's NSGA-II.

Trials are appended to a journal, and the sampler is seeded by the number of complete trials: an interrupted search
continues to the same front.
"""

import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import moocore
import numpy as np
import optuna
import pandas as pd
from optuna.samplers import NSGAIISampler, PartialFixedSampler
from optuna.trial import FrozenTrial, TrialState
from scipy.stats import rankdata
from tqdm import tqdm

from probe_agents.design.trials import DIRECTIONS, EULER_MARGIN, OBJECTIVES, DesignProblem, Values
from probe_agents.evaluation.statistics import bootstrap_ends
from probe_agents.evaluation.workers import HERE, Workers
from probe_agents.records.atomic import write_atomically
from probe_agents.records.drawing import BLUE, RED, save
from probe_agents.records.manifest import commit
from probe_agents.records.result_folder import ResultFolder
from probe_agents.records.searches import JOURNAL, open_study
from probe_agents.records.store import COMMIT, write_tables
from probe_agents.terminal.tables import print_line, print_table
from probe_agents.terminal.work import Work, announce
from probe_env import Design
from probe_env.design import RANGES
from probe_env.envs.task.config import TaskConfig
from probe_env.envs.task.rules import reward_terms
from probe_env.envs.trials import segment_of
from probe_env.settings import within


class RepeatableNSGAII(NSGAIISampler):
    """NSGA-II with parents in the order of their trials.

    Optuna returns newly selected parents in the order of selection, but cached ones in the order of their trials, so a
    trial that was interrupted after the selection would have other parents when it runs again.
    """

    def select_parent(self, study: optuna.Study, generation: int) -> list[FrozenTrial]:
        """As Optuna, but in the order of the trials."""
        return sorted(super().select_parent(study, generation), key=lambda trial: trial.number)


def search(
    axes: dict[str, tuple[float, float, str]],
    value: Callable[[dict[str, float]], Values],
    trials: int,
    output: Path,
    name: str = "design",
    population: int = 24,
    seed: int = 0,
    starts: Sequence[Mapping[str, float]] = (),
    min_euler_margin: float = 0.0,
) -> optuna.Study:
    """Run or continue a search and return the study.

    Args:
        axes: name -> lowest, highest, unit.
        value: function from a point to its objectives, in the order of ``OBJECTIVES``, and its Euler margin.
        trials: total number of complete trials.
        output: folder of the journal.
        name: name of the study in the journal.
        population: designs per generation.
        seed: seed of the search.
        starts: first points, part of the first generation.
        min_euler_margin: constraint; designs that violate it come after all others.
    """
    output.mkdir(parents=True, exist_ok=True)
    study = open_study(output / JOURNAL, name, DIRECTIONS)

    def violation(trial: FrozenTrial) -> tuple[float]:
        return (min_euler_margin - float(trial.user_attrs[EULER_MARGIN]),)

    def complete() -> int:
        return len(study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,)))

    announce(Work("design", trials, complete, output))
    with tqdm(total=trials, initial=min(complete(), trials), desc=name, unit="design") as bar:
        for number in range(complete(), trials):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                draws = int(np.random.SeedSequence([seed, number]).generate_state(1)[0])
                sampler = RepeatableNSGAII(population_size=population, seed=draws, constraints_func=violation)
                fixed = dict(starts[number]) if number < len(starts) else {}
                study.sampler = PartialFixedSampler(fixed, sampler) if fixed else sampler
                trial = study.ask()
            point = {axis: trial.suggest_float(axis, low, high) for axis, (low, high, _) in axes.items()}
            trial.set_user_attr(COMMIT, commit())
            *objectives, margin = value(point)
            trial.set_user_attr(EULER_MARGIN, margin)
            study.tell(trial, objectives)
            bar.update()
    return study


def trials_table(study: optuna.Study, min_euler_margin: float = 0.0) -> pd.DataFrame:
    """Complete trials: number, point, objectives, Euler margin, commit, and whether the design is on the front.

    The front is that of the designs with at least the Euler margin; without any, that of all.
    """
    complete = sorted(study.get_trials(deepcopy=False, states=(TrialState.COMPLETE,)), key=lambda trial: trial.number)
    rows = (
        {"trial": k} | trial.params | dict(zip(OBJECTIVES, trial.values, strict=True))
        | {EULER_MARGIN: trial.user_attrs[EULER_MARGIN], COMMIT: trial.user_attrs.get(COMMIT, "unknown")}
        for k, trial in enumerate(complete)
    )  # fmt: skip
    table = pd.DataFrame(rows)
    signs = np.array([1.0 if direction == "minimize" else -1.0 for direction in DIRECTIONS])
    accepted = table[EULER_MARGIN] >= min_euler_margin
    accepted |= not accepted.any()
    table["on_front"] = False
    table.loc[accepted, "on_front"] = moocore.is_nondominated(table.loc[accepted, list(OBJECTIVES)].to_numpy() * signs)
    return table


def sensitivity(table: pd.DataFrame, axes: dict[str, tuple[float, float, str]]) -> pd.DataFrame:
    """Standardised rank regression of every objective on all parameters, with 95 % bootstrap intervals.

    +1: the objective increases with this parameter only. The trials are those of the search, so coefficients of
    parameters that converged early are smaller than over the whole space.
    """
    names = list(axes)
    rows: list[tuple[str, str, float, float, float]] = []

    def coefficients(*columns: np.ndarray) -> np.ndarray:
        ranks = rankdata(np.column_stack(columns), axis=0)
        scaled = (ranks - ranks.mean(axis=0)) / np.maximum(ranks.std(axis=0), 1e-12)
        return np.asarray(np.linalg.lstsq(scaled[:, :-1], scaled[:, -1], rcond=None)[0])

    for objective in OBJECTIVES:
        data = tuple(table[name].to_numpy() for name in (*names, objective))
        ends = bootstrap_ends(coefficients, *data, method="percentile", paired=True, vectorized=False, n_resamples=1000)
        values = np.column_stack([coefficients(*data), *map(np.atleast_1d, ends)]).tolist()
        rows += [(objective, name, *row) for name, row in zip(names, values, strict=True)]
    return pd.DataFrame(rows, columns=["objective", "parameter", "coefficient", "low", "high"])


def run_design_search(
    problem: DesignProblem, trials: int, output: Path, seed: int, workers: Workers = HERE
) -> pd.DataFrame:
    """Run the command ``design``: stores trials.csv, front.csv, sensitivity.csv, figures and the best design as TOML.

    A search in the folder is continued up to the total number of trials. The workers share the tubes of a trial.
    """
    problem.check()
    within("min_euler_margin", problem.min_euler_margin, 0.0, 1000.0, "")
    within("seed", seed, 0, 2**63, "")
    within("trials", trials, 2, 1_000_000, "")
    for cut in problem.cuts:
        print(f"probe-env: note: {cut}", file=sys.stderr)
    value = partial(problem.value, workers=workers)
    least = problem.min_euler_margin
    with problem.search_folder(output, seed).open(JOURNAL) as folder:
        study = search(problem.axes, value, trials, output, "design", 24, seed, problem.starts(), least)
        return _write_tables(problem, trials_table(study, least), folder, seed)


def _write_tables(problem: DesignProblem, table: pd.DataFrame, folder: ResultFolder, seed: int) -> pd.DataFrame:
    output = folder.path
    front = table[table["on_front"]].sort_values("mean_square_ratio")
    influence = sensitivity(table, problem.axes)
    tables = {"trials": table, "front": front, "sensitivity": influence}
    files = write_tables(output, {name: frame.assign(**problem.tube_column) for name, frame in tables.items()})
    write_atomically(output / "found.toml", best_of(front, problem.config).to_toml())
    names = [name for name in problem.probes for _ in problem.reference_feeds()]  # the first trials
    references = table.iloc[: len(names)].assign(design=names[: len(table)])
    _draw_front(table, references, output / "front.png", problem.plant_label.title)
    setting: dict[str, Any] = {"contexts": len(problem.contexts), "trials": len(table), "seed": seed}
    folder.write_manifest(*files, "found.toml", seeds=(seed,), commits=table[COMMIT], **problem.setting, **setting)
    _print(front, influence, problem)
    print_line(f"written: {output}/ (front.csv, trials.csv, sensitivity.csv, front.png, found.toml)")
    return table


def best_of(front: pd.DataFrame, config: TaskConfig) -> Design:
    """The design of the front with the best reward of the task, among those with a positive drive margin."""
    span = segment_of(config).span

    def reward(row: dict[str, float]) -> float:  # over the span; the air of a fixed schedule is equal for all designs
        seconds = row["inspection_time_s"]
        squares, air = span * row["mean_square_ratio"], seconds * row.get("air_supply_rate", 0.0)
        inspected = span - row["guide_length"]
        terms = reward_terms(config, inspected=inspected, squares=squares, seconds=seconds, air=air)
        return float(sum(terms.values()))

    rows: list[Any] = front.to_dict("records")
    best = max([row for row in rows if row["drive_margin_n"] >= 0.0] or rows, key=reward)
    return Design(**{name: float(best[name]) for name in RANGES}).built


def _print(front: pd.DataFrame, influence: pd.DataFrame, problem: DesignProblem) -> None:
    axes, where = problem.axes, f" in {problem.plant_label.title}" if problem.plant_label.title else ""
    names = (*axes, *OBJECTIVES, EULER_MARGIN)
    rows = ([str(row["trial"]), *(f"{row[name]:.3g}" for name in names)] for row in front.to_dict("records"))
    units = {name: unit for name, (_, _, unit) in axes.items()} | {"inspection_time_s": "s", "drive_margin_n": "N"}
    labels = (name.removesuffix("_s").removesuffix("_n").replace("_", " ") for name in names)
    header = [f"{label} [{units[n]}]" if units.get(n) else label for n, label in zip(names, labels, strict=True)]
    print_table(f"Designs on the front{where}", ["trial", *header], rows)
    for row in influence[influence["objective"] == OBJECTIVES[0]].to_dict("records"):
        print(f"vibration and {row['parameter']}: {row['coefficient']:+.2f} [{row['low']:+.2f}, {row['high']:+.2f}]")


def _draw_front(table: pd.DataFrame, references: pd.DataFrame, path: Path, tube: str = "") -> None:
    figure, axes = plt.subplots(1, 2, figsize=(11, 4.5), sharey=True, layout="constrained")
    labels = {"inspection_time_s": "inspection time [s]", "drive_margin_n": "drive margin [N]"}
    if np.ptp(table["inspection_time_s"].quantile([0.1, 0.9])) < 1.0:  # fixed feed: all take the same time
        labels = {"guide_length": "guide length [m]", "drive_margin_n": "drive margin [N]"}
    for axis, (column, label) in zip(axes, labels.items(), strict=True):
        for on_front, colour, size, name in ((False, "0.8", 10, "tried"), (True, BLUE, 28, "on the front")):
            part = table[table["on_front"] == on_front]
            axis.scatter(part[column], part["mean_square_ratio"], color=colour, s=size, label=name)
        for colour, marker, (probe, rows) in zip((RED, "#d98c00"), "sD", references.groupby("design", sort=False)):  # noqa: B905
            axis.scatter(rows[column], rows["mean_square_ratio"], color=colour, marker=marker, s=40, label=probe)
        axis.set(xlabel=label, yscale="log")
    axes[0].set_ylabel("mean of (radial rms / limit)$^2$")
    handles, names = axes[1].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=4, frameon=False, fontsize=9)
    if tube:
        figure.suptitle(f"Designs tried in {tube}", fontsize=10)
    save(figure, path)
