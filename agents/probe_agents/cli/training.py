"""Commands train, compare, design and study."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

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
    """Training file (TOML), or the name of a shipped one: ppo, student."""
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
class Compare:
    """Compare probe designs on the same tubes under one feed: KPIs with intervals, differences from the first.

    Example: probe-env compare original improved my-design.toml --limit 6
    """

    designs: tyro.conf.Positional[Annotated[tuple[Path, ...], hide_default("DESIGN ...")]]
    """Design files (.toml) or names of shipped designs (original, improved, ...)."""
    feed: str = "constant"
    """Schedule over inserted length: constant, best-constant, best-schedule, example or a file; --full: any policy."""
    full: bool = False
    """Simulate whole insertions instead of sections of constant length."""
    contexts: Literal["train", "validation", "test"] = "test"
    """Shipped list of tubes."""
    limit: int = 0
    """Number of tubes, the first of the list; 0: all."""
    tube: File = None
    """Your plant (tube.toml). Its tubes replace the shipped list; its probe supplies fields missing in a design."""
    fidelity: str = "fast"
    """Accuracy of the simulation: fast (time-lapse in whole insertions only), standard, reference, study or auto."""
    output: Path = Path("output/compare")
    """Folder of designs.csv, summary.csv and designs.png; stored trials are not run again."""

    def run(self) -> None:
        """Run what is missing, store, print."""
        from probe_agents.design.compare import compare, print_comparison
        from probe_agents.design.picture import draw_designs
        from probe_agents.design.trials import DesignTrials, read_design
        from probe_agents.policies.cases import read_case
        from probe_agents.records.shipped import file_or_shipped
        from probe_agents.terminal.names import checked_name, name_of

        paths = [file_or_shipped("design", design) for design in self.designs]
        stems = [name_of(path) for path in paths]
        names = [
            checked_name(stem if stems.count(stem) == 1 else f"{path.parent.name}/{stem}", "design", "rename the file")
            for path, stem in zip(paths, stems, strict=True)
        ]
        case = read_case(self.tube, self.contexts, self.limit)
        designs = {name: read_design(path, case.config.scene.probe) for name, path in zip(names, paths, strict=True)}
        if len(designs) != len(paths):
            raise ValueError(f"designs = {', '.join(map(str, self.designs))}: two have the same name")
        trials = DesignTrials.of_case(case, self.feed, self.full, self.fidelity)
        table = compare(designs, trials, self.output)
        print_comparison(table)
        draw_designs(designs, table, case.config, self.output / "designs.png")
        print_line(f"written: {self.output}/ (designs.csv, summary.csv, designs.png)")


@dataclass(frozen=True)
class DesignSearch:
    """Search for probe designs with little vibration, short inspection time and large drive margin.

    Example: probe-env design --trials 100 --limit 6 --jobs 2
    """

    feed: str = "best-constant"
    """best-constant: feed speed and air are searched with the probe. Else a schedule; with --full, any policy."""
    full: bool = False
    """Simulate whole insertions instead of sections of constant length."""
    trials: int = 240
    """Number of designs."""
    min_euler_margin: float = 4.0
    """Constraint: least Euler load of a pitch over the root tension [-]; 0: none."""
    contexts: Literal["train", "validation", "test"] = "train"
    """Shipped list of tubes."""
    limit: int = 6
    """Number of tubes, the first of the list; 0: all."""
    tube: File = None
    """Your plant (tube.toml). Its tubes replace the shipped list; floats are limited by its bore."""
    fidelity: str = "fast"
    """Accuracy of the simulation: fast (time-lapse in whole insertions only), standard, reference, study or auto."""
    output: Path = Path("output/design")
    """Folder of the trials, tables and figures; an interrupted search continues."""
    workers: Annotated[Workers, tyro.conf.arg(name="")] = field(default_factory=Workers)
    seed: int = 0
    """Seed of the search."""

    def run(self) -> None:
        """Search, store, print."""
        from probe_agents.design.search import run_design_search
        from probe_agents.design.trials import DesignProblem
        from probe_agents.policies.cases import read_case

        case = read_case(self.tube, self.contexts, self.limit)
        problem = replace(
            DesignProblem.of_case(case, self.feed, self.full, self.fidelity), min_euler_margin=self.min_euler_margin
        )
        run_design_search(problem, self.trials, self.output, self.seed, self.workers)


@dataclass(frozen=True)
class Study:
    """Run a study: policies in varied tasks, compared tube by tube. Some studies generate the shipped data.

    A study is a TOML file with policies, tubes, varied fields and compared metrics. It writes episodes.csv,
    comparison.csv and comparison.png.

    Example: probe-env study robustness --limit 2
    """

    study: tyro.conf.Positional[Annotated[str, hide_default("[STUDY]")]] = ""
    """Study file (.toml), or the name of a shipped study."""
    list: bool = False
    """List the shipped studies and their questions."""
    limit: Annotated[int | None, hide_default()] = None
    """Number of tubes, 0: all; of a built-in study what --list says. Default: as in the study."""
    policies: Annotated[tuple[str, ...], hide_default("NAME ...")] = ()
    """Policies instead of the study's, as in `evaluate`; the reference policies are always included."""
    fidelity: Annotated[tuple[str, ...], hide_default("NAME ...")] = ()
    """Fidelities instead of the study's."""
    tube: File = None
    """Your plant (tube.toml); default: as in the study."""
    trials: Annotated[int | None, hide_default()] = None
    """Number of runs, schedules or laws of a built-in study, as --list says."""
    assumptions: Annotated[Literal["study", "whole"] | None, hide_default()] = None
    """Model of claims, chart and stability: the published study's, or the whole model. Default: the study's."""
    output: File = None
    """Folder; stored episodes are not run again. Default: output/NAME."""
    workers: Annotated[Workers, tyro.conf.arg(name="")] = field(default_factory=Workers)

    def run(self) -> None:
        """Run what is missing, store, draw, print."""
        from probe_agents.records.shipped import NoSuchFileError, file_or_shipped, shipped_names
        from probe_agents.studies.builtin import BUILT_IN
        from probe_agents.studies.spec import Study as Spec
        from probe_agents.terminal.tables import print_terms

        if self.list:
            names = shipped_names("studies")
            files = {name: Spec.from_toml(file_or_shipped("studies", name)).question for name in names}
            print_terms(files | {name: study.summary for name, study in BUILT_IN.items()})
            return
        if not self.study:
            raise ValueError("study is missing: a file or a name from probe-env study --list")
        output = self.output or Path("output") / Path(self.study).stem
        if self.study in BUILT_IN and not Path(self.study).is_file():
            BUILT_IN[self.study].run(
                output, self.workers, limit=self.limit, trials=self.trials, tube=self.tube, policies=self.policies,
                fidelity=self.fidelity, assumptions=self.assumptions,
            )  # fmt: skip
            return
        try:
            path = file_or_shipped("studies", self.study)
        except NoSuchFileError as error:
            error.hint += f", {', '.join(BUILT_IN)}"
            raise
        self._run_file(path, output)

    def _run_file(self, path: Path, output: Path) -> None:
        from probe_agents.studies.compare import baselines, write_comparison
        from probe_agents.studies.run import expand, run_study
        from probe_agents.studies.spec import Study as Spec
        from probe_env.settings import errors_in

        for name in ("trials", "assumptions"):
            if (value := getattr(self, name)) is not None:
                raise ValueError(f"{name} = {value!r}: this study has no such option")
        spec = Spec.from_toml(path).changed(self.limit, self.policies, self.fidelity, self.tube)
        with errors_in(path):
            settings = expand(spec)
            baselines(spec, settings)
        write_comparison(spec, settings, run_study(settings, output, self.workers), output)
        print_line(f"written: {output}/ (episodes.csv, comparison.csv, comparison.png)")
