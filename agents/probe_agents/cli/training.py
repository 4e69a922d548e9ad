"""Commands train and tune."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro

from probe_agents.cli.parsing import File, hide_default
from probe_agents.evaluation.workers import Workers
from probe_agents.terminal.tables import print_line


@dataclass(frozen=True)
class Train:
    """Train agents with Stable-Baselines3; for each seed the best agent in validation is stored.

    Example: probe-env train ppo --seeds 7 --output output/train/mine
    """

    config_file: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="CONFIG")]]
    """Training file (TOML), or the name of a shipped one: ppo, student, ppo-any-probe, both-ways."""
    output: File = None
    """Folder of the runs seed-K; default: output/train/NAME."""
    seeds: Annotated[tuple[int, ...], hide_default("SEED ...")] = ()
    """Training seeds; default: as in the file."""
    workers: Annotated[Workers, tyro.conf.arg(name="")] = field(default_factory=Workers)
    resume: bool = False
    """Continue from the last checkpoints in the folder."""
    tube: File = None
    """Your plant (tube.toml); default: as in the file."""

    def run(self) -> None:
        """Train, print the learning curves."""
        from probe_agents.records.shipped import file_or_shipped
        from probe_agents.training.config import Training
        from probe_agents.training.train import print_curves, train_all

        training = Training.from_toml(file_or_shipped("train", self.config_file))
        update: dict[str, Any] = {"seeds": self.seeds} if self.seeds else {}
        if self.tube:
            update["environment"] = {"tube": file_or_shipped("tubes", self.tube), "surrogate_map": None}
        training = training.model_copy(update=update) if update else training
        output = self.output or Path("output/train") / self.config_file.stem
        print_curves(train_all(training, output, self.resume, self.workers))
        print_line(f"written: {output}/seed-*/ (agent.safetensors: best in validation, learning.csv, run.json, logs)")


@dataclass(frozen=True)
class Tune:
    """Search for hyperparameters: short trainings, scored by their reward on the validation tubes.

    Example: probe-env tune ppo --trials 40 --phases 2 --output output/tune/ppo
    """

    config_file: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="CONFIG")]]
    """Training file (TOML), or the name of a shipped one. Its first seed is trained."""
    trials: int = 40
    """Number of trials, including pruned ones."""
    phases: Annotated[int | None, hide_default()] = None
    """Phases per trial after the warm start; default: half of the file's."""
    output: File = None
    """Folder of the search; an interrupted search continues. Default: output/tune/NAME."""
    seed: int = 0
    """Seed of the search."""

    def run(self) -> None:
        """Search, store, print."""
        from probe_agents.records.shipped import file_or_shipped
        from probe_agents.training.config import Training
        from probe_agents.training.tuning import run_tuning

        training = Training.from_toml(file_or_shipped("train", self.config_file))
        output = self.output or Path("output/tune") / self.config_file.stem
        run_tuning(training, self.trials, self.phases, output, self.seed)
