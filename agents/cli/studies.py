"""Command study."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from agents.evaluation.workers import Workers


@dataclass(frozen=True)
class Study:
    """Run a study: policies in tasks that vary, compared tube by tube; also what makes the shipped data.

    A study is a TOML file (configs/studies holds those that ship): a question, policies, tubes, fields that are varied,
    metrics that are compared. It writes episodes.csv, comparison.csv and comparison.png.
    """

    study: tyro.conf.Positional[str] = ""
    """File (.toml), or the name of a study that ships."""
    list: bool = False
    """Print the names of all studies and their questions."""
    limit: int | None = None
    """Tubes (claims: any number is five cases; response: groups of insertions), the first so many; 0: all. Default:
    what the study says."""
    policies: tuple[str, ...] = ()
    """Policies instead of the study's, as `evaluate` takes them; those it compares with stay."""
    fidelity: tuple[str, ...] = ()
    """Fidelities instead of the study's."""
    tube: Path | None = None
    """Your own plant (tube.toml)."""
    trials: int | None = None
    """Of shipped data: schedules or laws that are tried, or insertions on each tube; of claims: runs of each case."""
    output: Path | None = None
    """Folder of what is made; what is there already is not run again. Default: output/NAME."""
    workers: Annotated[Workers, tyro.conf.arg(name="")] = field(default_factory=Workers)

    def run(self) -> None:
        """Run what is missing, store, draw, print."""
        from agents.records.shipped import NoSuchFileError, file_or_shipped
        from agents.studies.builtin import BUILT_IN, Request
        from agents.terminal.tables import print_terms

        if self.list:
            print_terms(_questions())
            return
        if not self.study:
            raise ValueError("study: give a file or a name; probe-env study --list prints the names")
        output = self.output or Path("output") / Path(self.study).stem
        if self.study in BUILT_IN and not Path(self.study).is_file():
            for name in ("policies", "fidelity"):
                if getattr(self, name):
                    raise ValueError(f"{name} = {', '.join(getattr(self, name))}: this study has no such option")
            BUILT_IN[self.study].run(Request(output, self.limit, self.trials, self.tube, self.workers))
            return
        try:
            path = file_or_shipped("studies", self.study)
        except NoSuchFileError as error:
            error.hint += f", {', '.join(BUILT_IN)}"
            raise
        self._run_file(path, output)

    def _run_file(self, path: Path, output: Path) -> None:
        from agents.studies.compare import baselines, write_comparison
        from agents.studies.run import expand, run_study
        from agents.studies.spec import Study as Spec
        from probe_env.files import FileError

        if self.trials is not None:
            raise ValueError(f"trials = {self.trials!r}: this study has no such option")
        spec = Spec.from_toml(path).changed(self.limit, self.policies, self.fidelity, self.tube)
        try:
            settings = expand(spec)
            baselines(spec, settings)
        except FileError:
            raise
        except ValueError as error:
            raise FileError(path, str(error)) from error
        write_comparison(spec, settings, run_study(settings, output, self.workers), output)
        print(f"written: {output}/ (episodes.csv, comparison.csv, comparison.png)")


def _questions() -> dict[str, str]:
    from agents.records.shipped import file_or_shipped, shipped_names
    from agents.studies.builtin import BUILT_IN
    from agents.studies.spec import Study as Spec

    questions = {name: Spec.from_toml(file_or_shipped("studies", name)).question for name in shipped_names("studies")}
    return questions | {name: study.question for name, study in BUILT_IN.items()}
