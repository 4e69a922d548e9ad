"""Commands train and tune."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from agents.evaluation.workers import Workers


@dataclass(frozen=True)
class Train:
    """Train agents with Stable-Baselines3: checkpoints, validation, the best agent of each seed as a bundle."""

    config_file: tyro.conf.Positional[Path]
    """Training file (TOML), or the name of one that ships: ppo, student, ppo-any-probe, both-ways."""
    output: Path | None = None
    """Folder of the runs, seed-K in it; default: output/train/NAME-OF-THE-FILE."""
    seeds: tuple[int, ...] = ()
    """Seeds instead of the file's."""
    workers: Annotated[Workers, tyro.conf.arg(name="")] = field(default_factory=Workers)
    resume: bool = False
    """Go on from the last checkpoints in the folder."""
    tube: Path | None = None
    """Your own plant (tube.toml) instead of the file's."""

    def run(self) -> None:
        """Train, print the learning curves."""
        from agents.policies.places import plant_at
        from agents.records.shipped import file_or_shipped
        from agents.training.config import Training
        from agents.training.train import print_curves, train_all

        training = Training.from_toml(file_or_shipped("train", self.config_file))
        if self.seeds:
            training = training.model_copy(update={"seeds": self.seeds})
        if self.tube:
            own = {"tube": plant_at(self.tube), "map_beside": str(self.tube)}
            training = training.model_copy(update={"environment": own})
        output = self.output or Path("output/train") / self.config_file.stem
        print_curves(train_all(training, output, self.resume, self.workers))
        print(f"written: {output}/seed-*/ (agent.safetensors: the best by validation, learning.csv, run.json, logs)")


@dataclass(frozen=True)
class Tune:
    """Search for the hyperparameters of an agent: short trainings, judged by their reward on the validation tubes."""

    config_file: tyro.conf.Positional[Path]
    """Training file (TOML), or the name of one that ships: ppo, student, ppo-any-probe, both-ways.
    Its table [search] is the search space, else the usual ranges of its algorithm; its first seed is trained."""
    trials: int = 40
    """Trainings, those included that are ended early."""
    phases: int | None = None
    """Phases of a training behind its warm start, 1 to the file's; default: half of the file's."""
    output: Path | None = None
    """Folder of the study, the trainings and what was found; a search that was interrupted goes on. Default:
    output/tune/NAME-OF-THE-FILE."""
    seed: int = 0
    """Of the search."""

    def run(self) -> None:
        """Search, store, print."""
        from agents.records.shipped import file_or_shipped
        from agents.training.config import Training
        from agents.training.tuning import run_tuning

        training = Training.from_toml(file_or_shipped("train", self.config_file))
        output = self.output or Path("output/tune") / self.config_file.stem
        run_tuning(training, self.trials, self.phases, output, self.seed)
