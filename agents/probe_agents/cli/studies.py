"""Command study."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from probe_agents.cli.parsing import File, hide_default
from probe_agents.evaluation.workers import Workers
from probe_agents.terminal.tables import print_line


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
                fidelity=self.fidelity,
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
        print_line(f"written: {output}/ (episodes.csv, comparison.csv, comparison.png)")
