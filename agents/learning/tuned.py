"""What a search for hyperparameters found: its trials, what mattered, and a training file to go on with."""

from __future__ import annotations

import json
import warnings
from pathlib import Path
from typing import Any, Final

import pandas as pd
from optuna import Study
from optuna.exceptions import ExperimentalWarning
from optuna.importance import PedAnovaImportanceEvaluator, get_param_importances
from optuna.trial import FrozenTrial, TrialState

from agents.learning.config import Training
from agents.learning.figures import search_history
from agents.learning.tuning import TRIALS, Tuning, ended, search, trials_table
from agents.records.provenance import provenance, write_atomically, write_json
from agents.terminal.tables import print_table
from probe_env.files import one_line
from probe_env.settings import within

RANKED: Final = 10
"""Complete trials that it takes to tell what mattered."""
SHOWN: Final = 5
"""Trials on the terminal."""


def run_tuning(training: Training, trials: int, phases: int | None, output: Path, seed: int) -> pd.DataFrame:
    """The search as a command: stores trials.csv, search.png, found.toml and provenance.json.

    Args:
        training: what the search begins from; its first seed is trained.
        trials: that have ended at the end.
        phases: of a trial, behind the warm start; None: half of the file's.
        output: folder; the search in it goes on.
        seed: of the search.

    Raises:
        ValueError: an argument is not valid and nothing was run, or the folder holds another search.
        RuntimeError: all trainings broke down.
    """
    if training.phases < 1:
        raise ValueError("phases = 0 in the training file: a search needs at least one behind the warm start")
    phases = (training.phases + 1) // 2 if phases is None else phases
    within("phases", phases, 1, training.phases, "")
    within("trials", trials, 1, 100_000, "")
    within("seed", seed, 0, 2**32 - 1, "")
    tuning = Tuning(training=training, phases=phases, seed=seed)
    study = search(tuning, trials, output)
    table, mattered = trials_table(study), importances(study)
    write_atomically(output / TRIALS, table.to_csv(index=False))  # a killed search may have told one more trial
    complete = [(number, trial) for number, trial in enumerate(ended(study)) if trial.state == TrialState.COMPLETE]
    if not complete:
        raise RuntimeError(f"all {len(table)} trainings broke down: {ended(study)[-1].user_attrs['failed']}")
    number, best = max(complete, key=lambda entry: entry[1].values[0])
    origin = provenance(commits=table["commit"])
    write_atomically(
        output / "found.toml", _heading(tuning, number, best, origin) + tuning.with_parameters(best.params).to_toml()
    )
    search_history(table, mattered, output / "search.png")
    space = {name: axis if isinstance(axis, tuple) else axis.model_dump() for name, axis in tuning.axes.items()}
    setting = json.loads(tuning.model_dump_json()) | {"space": space, "trials": len(table), "best": number}
    write_json(output / "provenance.json", origin | setting | {"importances": mattered})
    _print(table)
    print(f"written: {output}/ (found.toml, trials.csv, search.png, provenance.json, trials/)")
    return table


def importances(study: Study) -> dict[str, float]:
    """Share of each parameter in what sets the best quarter of the complete trials apart; empty if these are few."""
    if sum(trial.state == TrialState.COMPLETE for trial in ended(study)) < RANKED:
        return {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ExperimentalWarning)
        return get_param_importances(study, evaluator=PedAnovaImportanceEvaluator(target_quantile=0.25))


def _heading(tuning: Tuning, number: int, best: FrozenTrial, origin: dict[str, Any]) -> str:
    """How it was found, as comments of a TOML file."""
    seed, phases, value = tuning.training.seeds[0], tuning.training.phases, f"{best.values[0]:.4g}"
    lines = (
        f"Found by: {origin['command']}",
        f"Trial {number} (commit {best.user_attrs['commit']}): reward {value} on the validation tubes, the best phase",
        f"of a training with {tuning.phases} instead of {phases} of them and seed {seed} alone.",
    )
    return "".join(f"# {one_line(line)}\n" for line in lines) + "\n"


def _print(table: pd.DataFrame) -> None:
    complete = table[table["state"] == "complete"].drop(columns=["state", "phases", "commit"])
    shown = complete.sort_values("reward", ascending=False, kind="stable").head(SHOWN)
    header = [name.replace("seconds", "time [s]") for name in shown.columns]
    rows = ([f"{v:.4g}" if isinstance(v, float) else str(v) for v in row] for row in shown.itertuples(index=False))
    print_table("The best trials", header, rows)
