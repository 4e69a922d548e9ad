"""Search for an agent's hyperparameters: TPE of Optuna over a training file's space, hopeless trainings ended early.

A trial is a training of few phases, worth the best validation reward of them. Trials are kept in SQLite one by one,
trainings have their checkpoints, and the sampler is seeded by how many trials are done, so a search that was killed
goes on, in the middle of a training too, to the same result.
"""

from __future__ import annotations

import warnings
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np
import optuna
import pandas as pd
from optuna.distributions import BaseDistribution, CategoricalDistribution, FloatDistribution, IntDistribution
from optuna.samplers import BaseSampler, PartialFixedSampler, TPESampler
from optuna.trial import FrozenTrial, TrialState
from tqdm import tqdm

from agents.learning.checkpoints import settings_that_differ
from agents.learning.config import Training
from agents.learning.space import Axis, axes_of, value_in, with_values
from agents.learning.train import CHECKPOINT, prepare, train
from agents.records.models import Stored, valid
from agents.records.provenance import provenance, write_atomically
from agents.searches.database import open_study
from agents.terminal.work import Work, announce
from probe_env import SimulationError
from probe_env.files import FileError, one_line

DATABASE, TRIALS = "study.db", "trials.csv"
JUDGES: Final = 5
"""Trials that have to be complete before their median ends others."""


class Tuning(Stored):
    """What is searched, as the database notes it.

    Attributes:
        training: begun from; its first seed is trained.
        phases: of each training, behind the warm start.
        seed: of the search.
    """

    training: Training
    phases: int
    seed: int = 0

    @cached_property
    def axes(self) -> dict[str, Axis]:
        """Field -> what it may be."""
        return axes_of(self.training)

    @cached_property
    def distributions(self) -> dict[str, BaseDistribution]:
        """The same for Optuna."""
        return {name: _distribution(axis) for name, axis in self.axes.items()}

    def sampler(self, number: int) -> BaseSampler:
        """Of the trial of this number; the first has the file's own values, as far as they are in the space."""
        seed = int(np.random.SeedSequence([self.seed, number]).generate_state(1)[0])
        sampler = TPESampler(seed=seed, multivariate=True, constant_liar=False)
        own = {name: _label(value_in(self.training, name)) for name in self.axes}
        fixed = {name: value for name, value in own.items() if _contains(self.distributions[name], value)}
        return sampler if number else PartialFixedSampler(fixed, sampler)

    def with_parameters(self, parameters: dict[str, Any]) -> Training:
        """The whole training with the parameters of a trial."""
        labels = {name: {_label(v): v for v in axis} for name, axis in self.axes.items() if isinstance(axis, tuple)}
        point = {name: labels[name][value] if name in labels else value for name, value in parameters.items()}
        return with_values(self.training.model_copy(update={"search": None}), point)

    def short(self, parameters: dict[str, Any]) -> Training:
        """The training of a trial."""
        return self.with_parameters(parameters).model_copy(
            update={"phases": self.phases, "seeds": self.training.seeds[:1]}
        )

    def differs(self, other: Tuning) -> list[str]:
        """Names of settings that make another search of it."""
        same = {
            "seeds": self.training.seeds[0] == other.training.seeds[0], "search": self.axes == other.axes,
            "phases": self.phases == other.phases, "seed": self.seed == other.seed,
        }  # fmt: skip
        return settings_that_differ(self.training, other.training) + [name for name, equal in same.items() if not equal]


def search(tuning: Tuning, trials: int, output: Path) -> optuna.Study:
    """Run a search, or what is left of it, in a folder; trials.csv in it grows by a line a trial.

    Raises:
        FileError: the folder holds another search, or something damaged.
    """
    study, origin = _open(tuning, output), provenance()
    announce(Work("trial", trials, lambda: len(ended(study)), output))
    with tqdm(total=trials, initial=min(len(ended(study)), trials), desc="search", unit="trial") as bar:
        for number in range(len(ended(study)), trials):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
                warnings.filterwarnings("ignore", ".*mini-batch size")  # the last one of an epoch may be smaller
                study.sampler = tuning.sampler(number)
                trial = study.ask(tuning.distributions)
                _train(tuning, study, trial, output / "trials" / f"{number:04d}", origin)
            write_atomically(output / TRIALS, trials_table(study).to_csv(index=False))
            bar.update()
    return study


def _open(tuning: Tuning, output: Path) -> optuna.Study:
    """The search in a folder, without what a killed one left half done; a new one is noted."""
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    output.mkdir(parents=True, exist_ok=True)
    study = open_study(f"sqlite:///{output / DATABASE}", "tuning", ["maximize"], tuning.axes)
    noted = study.user_attrs.get("search")
    if noted is not None:
        different = tuning.differs(valid(output / DATABASE, "", noted, Tuning))
        if different:
            raise FileError(
                output, f"holds a search with other settings ({', '.join(different)}): choose another folder"
            )
    study.set_user_attr("search", tuning.model_dump_json())
    # the median is of complete trials, where rungs of successive halving would count those that were killed, too; phase
    # 0 is the warm start, which tells little
    study.pruner = optuna.pruners.MedianPruner(n_startup_trials=JUDGES, n_warmup_steps=1)
    for stale in study.get_trials(deepcopy=False, states=(TrialState.RUNNING,)):
        study.tell(stale.number, state=TrialState.FAIL)
    return study


def _train(tuning: Tuning, study: optuna.Study, trial: optuna.Trial, folder: Path, origin: dict[str, Any]) -> None:
    """Run a trial: from its last checkpoint if it was killed; one that breaks down counts as worse than any."""
    rows: list[dict[str, Any]] = []

    def watch(row: dict[str, Any]) -> None:
        rows.append(row)
        trial.report(row["reward"], row["phase"])
        if row["phase"] < tuning.phases and trial.should_prune():
            raise optuna.TrialPruned

    state, training = TrialState.COMPLETE, tuning.short(trial.params)
    ((seed, place),) = prepare(training, folder, True, origin).items()
    try:
        train(training, seed, place, origin, place=1, watch=watch)
    except FileError:
        raise
    except optuna.TrialPruned:
        state = TrialState.PRUNED
    except (ValueError, SimulationError) as error:  # weights that are not finite
        state = TrialState.PRUNED
        trial.set_user_attr("failed", one_line(str(error)))
    trial.set_user_attr("commit", origin["commit"])
    trial.set_user_attr("seconds", sum(row["wall_s"] + row["validation_s"] for row in rows))
    study.tell(trial, max(row["reward"] for row in rows) if state == TrialState.COMPLETE else None, state)
    (place / CHECKPOINT).unlink(missing_ok=True)  # a replay buffer may be large


def ended(study: optuna.Study) -> list[FrozenTrial]:
    """Trials that ended, by themselves or by the pruner, in their order."""
    trials = study.get_trials(deepcopy=False, states=(TrialState.COMPLETE, TrialState.PRUNED))
    return sorted(trials, key=lambda trial: trial.number)


def trials_table(study: optuna.Study) -> pd.DataFrame:
    """Trials that ended: number, state, parameters, best reward so far, phases behind the warm start, time, commit."""
    rows = []
    for number, trial in enumerate(ended(study)):
        state = "failed" if "failed" in trial.user_attrs else trial.state.name.lower()
        rewards = trial.intermediate_values
        row = {"trial": number, "state": state} | trial.params
        row |= {"reward": max(rewards.values(), default=np.nan), "phases": max(rewards, default=0)}
        rows.append(row | {"seconds": trial.user_attrs["seconds"], "commit": trial.user_attrs["commit"]})
    return pd.DataFrame(rows)


def _distribution(axis: Axis) -> BaseDistribution:
    if isinstance(axis, tuple):
        return CategoricalDistribution([_label(value) for value in axis])
    if isinstance(axis.low, int) and isinstance(axis.high, int):
        return IntDistribution(axis.low, axis.high, axis.log)
    return FloatDistribution(axis.low, axis.high, axis.log)


def _label(value: Any) -> Any:
    """A choice as Optuna stores it and tables show it: widths of layers as text."""
    return "x".join(map(str, value)) if isinstance(value, tuple) else value


def _contains(distribution: BaseDistribution, value: Any) -> bool:
    if isinstance(distribution, CategoricalDistribution):
        return value in distribution.choices
    assert isinstance(distribution, FloatDistribution | IntDistribution)
    kind = int if isinstance(distribution, IntDistribution) else (int, float)
    return isinstance(value, kind) and distribution.low <= value <= distribution.high
