"""Commands compare and design."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Literal

import tyro

from agents.evaluation.workers import Workers

if TYPE_CHECKING:
    from probe_env import Design
    from probe_env.scene import Probe

USUAL_TUBES: Final = 6
"""Tubes that designs are tried in by a search."""


@dataclass(frozen=True)
class Compare:
    """Compare probe designs on the same tubes under one feed: KPIs with intervals, changes against the first."""

    designs: tyro.conf.Positional[tuple[Path, ...]]
    """Design files (TOML), or names of designs that ship: original, improved, ..."""
    feed: str = "constant"
    """A schedule over inserted length: constant, best-constant, best-schedule, example or a file; with --full any
    policy."""
    full: bool = False
    """Whole insertions instead of sections of constant length."""
    contexts: Literal["train", "validation", "test"] = "test"
    """Shipped list of tubes."""
    limit: int = 0
    """Take so many tubes of the list only, the first of it, which are balanced; 0: all."""
    tube: Path | None = None
    """Your own plant (tube.toml): its task, and as many tubes drawn from what is known of it instead of the list. What
    a design file does not name is the plant's probe's."""
    fidelity: str = "standard"
    """How closely to simulate: study, reference, standard, fast (saves time in whole insertions only) or auto."""
    output: Path = Path("output/compare")
    """Folder of designs.csv and summary.csv; what is there already is not run again."""

    def run(self) -> None:
        """Run what is missing, store, print."""
        from agents.design.compare import compare, print_comparison
        from agents.design.trials import DesignTrials
        from agents.policies.places import place_at
        from agents.records.shipped import file_or_shipped
        from agents.terminal.names import checked_name, name_of
        from probe_env.fidelity import resolve_fidelity

        paths = [file_or_shipped("design", design) for design in self.designs]
        stems = [name_of(path) for path in paths]
        names = [
            checked_name(stem if stems.count(stem) == 1 else f"{path.parent.name}/{stem}", "design", "rename the file")
            for path, stem in zip(paths, stems, strict=True)
        ]
        place = place_at(self.tube, self.contexts, self.limit)
        designs = {name: _design(path, place.config.scene.probe) for name, path in zip(names, paths, strict=True)}
        if len(designs) != len(paths):
            raise ValueError(f"designs = {', '.join(map(str, self.designs))}: two have the same name")
        config = place.config.all_shown
        fidelity = resolve_fidelity(self.fidelity, config.scene)
        trials = DesignTrials(place.contexts, self.feed, self.full, fidelity, config, place.vibration, place.tube)
        print_comparison(compare(designs, trials, self.output))
        print(f"written: {self.output}/ (designs.csv, summary.csv)")


def _design(path: Path, own: Probe) -> Design:
    """A design file; what it does not name is the plant's own probe's."""
    from probe_env import Design
    from probe_env.files import FileError

    try:
        return Design.from_toml(path).completed(own)
    except FileError:
        raise
    except ValueError as error:
        raise FileError(path, str(error)) from error


@dataclass(frozen=True)
class DesignSearch:
    """Search for probes: vibration, inspection time and drive margin at once, on the same tubes."""

    feed: str = "best-constant"
    """best-constant searches feed speed and air with the probe; else a schedule, or with --full any policy."""
    full: bool = False
    """Whole insertions instead of sections of constant length."""
    trials: int = 240
    """Designs tried."""
    contexts: Literal["train", "validation", "test"] = "train"
    """Shipped list of tubes that designs are tried in."""
    limit: int = USUAL_TUBES
    """Take so many tubes of the list only, the first of it, which are balanced; 0: all."""
    tube: Path | None = None
    """Your own plant (tube.toml), see `probe-env compare --help`: searched for and tried in its tubes, among the floats
    that fit its bore."""
    fidelity: str = "standard"
    """How closely to simulate: study, reference, standard, fast (saves time in whole insertions only) or auto."""
    output: Path = Path("output/design")
    """Folder of the trials, the tables and the figures; a search that was interrupted goes on."""
    workers: Annotated[Workers, tyro.conf.arg(name="")] = field(default_factory=Workers)
    seed: int = 0
    """Of the search."""

    def run(self) -> None:
        """Search, store, print."""
        from agents.design.problem import design_problem
        from agents.design.search import run_design_search
        from agents.policies.places import place_at

        place = place_at(self.tube, self.contexts, self.limit)
        problem = design_problem(self.feed, self.full, place, self.fidelity)
        for cut in problem.cuts:
            print(f"probe-env: note: {cut}", file=sys.stderr)
        run_design_search(problem, self.trials, self.output, self.seed, self.workers)
