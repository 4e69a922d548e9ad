"""Searches the hyperparameters of an agent: Optuna's TPE over ``SPACE``, with a median pruner.

A trial is a training with fewer phases; its value is the best validation reward. Trials are stored in a journal, and
the sampler is seeded by the number of finished trials, so an interrupted search continues to the same result.
"""

import inspect
import json
import warnings
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import matplotlib.pyplot as plt
import numpy as np
import optuna
import pandas as pd
from optuna.distributions import BaseDistribution, CategoricalDistribution, FloatDistribution, IntDistribution
from optuna.samplers import BaseSampler, PartialFixedSampler, TPESampler
from optuna.trial import FrozenTrial, TrialState
from stable_baselines3 import PPO
from tqdm import tqdm

from probe_agents.records.atomic import write_atomically
from probe_agents.records.drawing import BLUE, RED, save
from probe_agents.records.manifest import origin as made_by
from probe_agents.records.models import Stored
from probe_agents.records.result_folder import ResultFolder
from probe_agents.records.searches import JOURNAL, open_study
from probe_agents.terminal.tables import print_line, print_table
from probe_agents.terminal.work import Work, announce
from probe_agents.training.config import Training
from probe_agents.training.train import CHECKPOINT, prepare, train
from probe_env import SimulationError
from probe_env.files import FileError, one_line
from probe_env.settings import within

TRIALS: Final = "trials.csv"
STARTUP_TRIALS: Final = 5
"""Complete trials before pruning by the median starts."""

ROLLOUT: Final = "learning.n_steps"
SPACE: Final[dict[str, BaseDistribution]] = {
    "learning.gamma": CategoricalDistribution((0.98, 0.99, 0.995, 0.998, 0.999, 0.9995)),
    "learning.batch_size": CategoricalDistribution((64, 128, 256, 512)),
    "network.net_arch": CategoricalDistribution(("32x32", "64x64", "128x128")),
    "learning.learning_rate": FloatDistribution(1e-5, 1e-3, log=True),
    "learning.n_epochs": IntDistribution(2, 12),
    "learning.gae_lambda": FloatDistribution(0.9, 1.0),
    "learning.clip_range": FloatDistribution(0.05, 0.3),
    "learning.ent_coef": FloatDistribution(1e-6, 1e-2, log=True),
    "network.log_std_init": FloatDistribution(-4.0, -1.0),
}
"""Search space, field -> values; lengths of rollouts that fill phases are added."""


class Tuning(Stored):
    """Settings of a search.

    Attributes:
        training: initial values; its first seed is trained.
        phases: phases of each training, after the warm start.
        seed: seed of the search.
    """

    training: Training
    phases: int
    seed: int = 0

    @cached_property
    def space(self) -> dict[str, BaseDistribution]:
        """``SPACE``, and rollouts that fill the phases: otherwise the trainings would differ in length."""
        environments = self.training.environment.num_envs
        rollouts = [n for n in (32, 64, 128, 256, 512) if self.training.phase_steps % (n * environments) == 0]
        return SPACE | ({ROLLOUT: CategoricalDistribution(rollouts)} if len(rollouts) > 1 else {})

    def sampler(self, number: int) -> BaseSampler:
        """Sampler of the trial with this number; the first trial has the values of the file that are in the space."""
        seed = int(np.random.SeedSequence([self.seed, number]).generate_state(1)[0])
        sampler = TPESampler(seed=seed, multivariate=True, constant_liar=False)
        values = {name: _value_in(self.training, name) for name in self.space}
        fixed = {name: value for name, value in values.items() if _contains(self.space[name], value)}
        return sampler if number else PartialFixedSampler(fixed, sampler)

    def with_parameters(self, parameters: Mapping[str, Any]) -> Training:
        """The training with the parameters of a trial."""
        update: dict[str, dict[str, Any]] = {}
        for name, value in parameters.items():
            table, _, field = name.partition(".")
            update.setdefault(table, {})[field] = tuple(map(int, value.split("x"))) if field == "net_arch" else value
        return self.training.model_copy(update=update)

    @property
    def settings(self) -> dict[str, Any]:
        """Settings that must be equal to continue a search: the training with its first seed, phases, seed."""
        fields: dict[str, Any] = self.model_dump(mode="json")
        training: dict[str, Any] = fields["training"]
        return training | {"seeds": training["seeds"][:1], "phases": self.phases, "seed": self.seed}


def _value_in(training: Training, name: str) -> Any:
    """Value of a field as in ``SPACE``; the default of ``learning`` is PPO's."""
    table, _, field = name.partition(".")
    value = getattr(getattr(training, table), field)
    if value is None:
        value = inspect.signature(PPO.__init__).parameters[field].default
    return "x".join(map(str, value)) if isinstance(value, tuple) else value


def _contains(distribution: BaseDistribution, value: Any) -> bool:
    if isinstance(distribution, CategoricalDistribution):
        return value in distribution.choices
    assert isinstance(distribution, IntDistribution | FloatDistribution)
    return isinstance(value, int | float) and distribution.low <= value <= distribution.high


def search(tuning: Tuning, trials: int, output: Path) -> optuna.Study:
    """Run or continue a search in a folder; each trial adds a row to trials.csv."""
    output.mkdir(parents=True, exist_ok=True)
    study, origin = open_study(output / JOURNAL, "tuning", ["maximize"]), made_by()
    # phase 0 is the warm start, which hardly depends on the hyperparameters
    study.pruner = optuna.pruners.MedianPruner(n_startup_trials=STARTUP_TRIALS, n_warmup_steps=1)
    announce(Work("trial", trials, lambda: len(finished(study)), output))
    with tqdm(total=trials, initial=min(len(finished(study)), trials), desc="search", unit="trial") as bar:
        for number in range(len(finished(study)), trials):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
                warnings.filterwarnings("ignore", ".*mini-batch size")  # the last one of an epoch may be smaller
                study.sampler = tuning.sampler(number)
                trial = study.ask(tuning.space)
                _run_trial(tuning, study, trial, output / "trials" / f"{number:04d}", origin)
            write_atomically(output / TRIALS, trials_table(study).to_csv(index=False))
            bar.update()
    return study


def _run_trial(tuning: Tuning, study: optuna.Study, trial: optuna.Trial, folder: Path, origin: dict[str, Any]) -> None:
    """Train from the last checkpoint of the trial; a failed training counts as pruned."""
    rows: list[dict[str, Any]] = []

    def watch(row: dict[str, Any]) -> None:
        rows.append(row)
        trial.report(row["reward"], row["phase"])
        if row["phase"] < tuning.phases and trial.should_prune():
            raise optuna.TrialPruned

    update = {"phases": tuning.phases, "seeds": tuning.training.seeds[:1]}
    training, state = tuning.with_parameters(trial.params).model_copy(update=update), TrialState.COMPLETE
    ((seed, run),) = prepare(training, folder, True, origin).items()
    try:
        train(training, folder, origin, seed, position=1, watch=watch)
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
    (run / CHECKPOINT).unlink(missing_ok=True)


def finished(study: optuna.Study) -> list[FrozenTrial]:
    """Complete and pruned trials by number."""
    trials = study.get_trials(deepcopy=False, states=(TrialState.COMPLETE, TrialState.PRUNED))
    return sorted(trials, key=lambda trial: trial.number)


def trials_table(study: optuna.Study) -> pd.DataFrame:
    """Finished trials: number, state, parameters, best reward, phases after the warm start, time, commit."""
    rows = []
    for number, trial in enumerate(finished(study)):
        state = "failed" if "failed" in trial.user_attrs else trial.state.name.lower()
        rewards = trial.intermediate_values
        row = {"trial": number, "state": state} | trial.params
        row |= {"reward": max(rewards.values(), default=np.nan), "phases": max(rewards, default=0)}
        rows.append(row | {"seconds": trial.user_attrs["seconds"], "commit": trial.user_attrs["commit"]})
    return pd.DataFrame(rows)


def run_tuning(training: Training, trials: int, phases: int | None, output: Path, seed: int) -> pd.DataFrame:
    """Run the command ``tune``: stores trials.csv, search.png, found.toml and manifest.json.

    Args:
        training: initial values; its first seed is trained.
        trials: total number of finished trials.
        phases: phases of a trial, after the warm start; None: half of the file's.
        output: folder; a search in it is continued.
        seed: seed of the search.
    """
    if training.phases < 1:
        raise ValueError("phases = 0 in the training file: a search needs at least one after the warm start")
    phases = (training.phases + 1) // 2 if phases is None else phases
    within("phases", phases, 1, training.phases, "")
    within("trials", trials, 1, 100_000, "")
    within("seed", seed, 0, 2**32 - 1, "")
    tuning = Tuning(training=training, phases=phases, seed=seed)
    with ResultFolder(output, tuning.settings, "these trials were trained").open(JOURNAL) as folder:
        return _write_results(tuning, search(tuning, trials, output), folder)


def _write_results(tuning: Tuning, study: optuna.Study, folder: ResultFolder) -> pd.DataFrame:
    output, training = folder.path, tuning.training
    table = trials_table(study)
    write_atomically(output / TRIALS, table.to_csv(index=False))  # an interrupt may have come before it
    complete = [(number, trial) for number, trial in enumerate(finished(study)) if trial.state == TrialState.COMPLETE]
    if not complete:
        raise RuntimeError(f"all {len(table)} trainings failed: {finished(study)[-1].user_attrs['failed']}")
    number, best = max(complete, key=lambda entry: entry[1].values[0])
    origin = made_by(commits=table["commit"])
    heading = (
        f"# Found by: {one_line(origin['command'])}\n# Trial {number} (commit {best.user_attrs['commit']}): reward"
        f" {best.values[0]:.4g} on the validation tubes, the best phase\n# of a training with {tuning.phases} instead"
        f" of {training.phases} of them and seed {training.seeds[0]} alone.\n"
    )
    write_atomically(output / "found.toml", f"{heading}\n{tuning.with_parameters(best.params).to_toml()}")
    _draw(table, output / "search.png")
    space = {name: distribution._asdict() for name, distribution in tuning.space.items()}
    setting = json.loads(tuning.model_dump_json()) | {"space": space, "trials": len(table), "best": number}
    folder.write_manifest(TRIALS, "found.toml", seeds=(tuning.seed,), commits=table["commit"], **setting)
    _print(table)
    print_line(f"written: {output}/ (found.toml, trials.csv, search.png, manifest.json, trials/)")
    return table


def _draw(table: pd.DataFrame, path: Path) -> None:
    figure, axis = plt.subplots(figsize=(7, 4), layout="constrained")
    kinds = (("complete", BLUE, "all phases"), ("pruned", "0.7", "pruned"), ("failed", RED, "failed"))
    for state, colour, label in kinds:
        part = table[table["state"] == state]
        axis.scatter(part["trial"], part["reward"], color=colour, s=16, label=label if len(part) else None)
    best = table["reward"].where(table["state"] == "complete").cummax()
    axis.step(table["trial"], best, where="post", color=BLUE, linewidth=1.0, label="best so far")
    axis.set(xlabel="trial", ylabel="reward on the validation tubes")
    axis.legend(frameon=False, fontsize=8)
    save(figure, path)


def _print(table: pd.DataFrame) -> None:
    complete = table[table["state"] == "complete"].drop(columns=["state", "phases", "commit"])
    best = complete.sort_values("reward", ascending=False, kind="stable").head(5)
    header = [name.replace("seconds", "time [s]") for name in best.columns]
    rows = ([f"{v:.4g}" if isinstance(v, float) else str(v) for v in row] for row in best.itertuples(index=False))
    print_table("The best trials", header, rows)
