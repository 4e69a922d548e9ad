"""Commands compare and design."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from probe_agents.cli.parsing import File, hide_default
from probe_agents.evaluation.workers import Workers
from probe_agents.terminal.tables import print_line

if TYPE_CHECKING:
    from probe_env import Design
    from probe_env.scene import Probe


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
    """Folder of designs.csv and summary.csv; stored trials are not run again."""

    def run(self) -> None:
        """Run what is missing, store, print."""
        from probe_agents.design.compare import compare, print_comparison
        from probe_agents.design.trials import DesignTrials
        from probe_agents.policies.cases import read_case
        from probe_agents.records.shipped import file_or_shipped
        from probe_agents.terminal.names import checked_name, name_of
        from probe_env.fidelity import resolve_fidelity

        paths = [file_or_shipped("design", design) for design in self.designs]
        stems = [name_of(path) for path in paths]
        names = [
            checked_name(stem if stems.count(stem) == 1 else f"{path.parent.name}/{stem}", "design", "rename the file")
            for path, stem in zip(paths, stems, strict=True)
        ]
        case = read_case(self.tube, self.contexts, self.limit)
        designs = {name: _design(path, case.config.scene.probe) for name, path in zip(names, paths, strict=True)}
        if len(designs) != len(paths):
            raise ValueError(f"designs = {', '.join(map(str, self.designs))}: two have the same name")
        config = case.config.full_observation
        fidelity = resolve_fidelity(self.fidelity, config.scene, self.full)
        trials = DesignTrials(case.contexts, self.feed, self.full, fidelity, config, case.vibration, case.plant_label)
        print_comparison(compare(designs, trials, self.output))
        print_line(f"written: {self.output}/ (designs.csv, summary.csv)")


def _design(path: Path, probe: Probe) -> Design:
    """The design of a file; missing fields are those of the plant's probe. It must be buildable as it is."""
    from probe_env import Design
    from probe_env.files import FileError

    try:
        design = Design.from_toml(path).completed(probe)
        design.check_whole_pitches()
    except FileError:
        raise
    except ValueError as error:
        raise FileError(path, str(error)) from error
    return design


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
        from probe_agents.design.problem import design_problem
        from probe_agents.design.search import run_design_search
        from probe_agents.policies.cases import read_case

        case = read_case(self.tube, self.contexts, self.limit)
        problem = design_problem(self.feed, self.full, case, self.fidelity)
        for cut in problem.cuts:
            print(f"probe-env: note: {cut}", file=sys.stderr)
        run_design_search(problem, self.trials, self.output, self.seed, self.workers)
