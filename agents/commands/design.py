"""Commands of probe design."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from agents.processes.workers import Workers


@dataclass(frozen=True)
class Compare:
    """Compare probe designs on the same tubes under one feed: KPIs with intervals, changes against the first."""

    designs: tyro.conf.Positional[tuple[Path, ...]]
    """Design files (TOML), see configs/design/."""
    feed: str = "constant"
    """A schedule over inserted length: constant, best-constant, best-schedule or a file; with --full any policy."""
    full: bool = False
    """Whole insertions instead of sections of constant length."""
    contexts: Literal["train", "validation", "test"] = "test"
    """Shipped list of contexts."""
    limit: int = 0
    """Take so many contexts of the list only, evenly spread; 0: all."""
    fidelity: str = "standard"
    """How closely to simulate: study, reference, standard, fast (saves time in whole insertions only) or auto."""
    output: Path = Path("output/compare")
    """Folder of designs.csv and summary.csv; what is there already is not run again."""

    def run(self) -> None:
        """Run what is missing, store, print."""
        from agents.design.compare import Comparison, compare, print_comparison
        from agents.terminal.names import checked_name, name_of
        from probe_env import Design
        from probe_env.envs.contexts import spread_contexts
        from probe_env.fidelity import resolve_fidelity

        stems = [name_of(path) for path in self.designs]
        names = [
            checked_name(stem if stems.count(stem) == 1 else f"{path.parent.name}/{stem}", "design", "rename the file")
            for path, stem in zip(self.designs, stems, strict=True)
        ]
        designs = {name: Design.from_toml(path) for name, path in zip(names, self.designs, strict=True)}
        if len(designs) != len(self.designs):
            raise ValueError(f"designs = {', '.join(map(str, self.designs))}: two have the same name")
        chosen = spread_contexts(self.contexts, self.limit)
        comparison = Comparison(designs, chosen, self.feed, self.full, resolve_fidelity(self.fidelity))
        print_comparison(compare(comparison, self.output))
        print(f"written: {self.output}/ (designs.csv, summary.csv)")


@dataclass(frozen=True)
class DesignSearch:
    """Search for probes: vibration, inspection time and drive margin at once, on training tubes."""

    feed: str = "best-constant"
    """best-constant searches feed speed and air with the probe; else a schedule, or with --full an agent's bundle."""
    full: bool = False
    """Whole insertions instead of sections of constant length."""
    trials: int = 240
    """Designs tried."""
    contexts: int = 6
    """Training tubes that each is tried in."""
    fidelity: str = "standard"
    """How closely to simulate: study, reference, standard, fast (saves time in whole insertions only) or auto."""
    output: Path = Path("output/design")
    """Folder of the study, the tables and the pictures; a search that was interrupted goes on."""
    workers: Annotated[Workers, tyro.conf.arg(name="")] = field(default_factory=Workers)
    storage: str | None = None
    """URL of an Optuna storage; default: SQLite in the output folder."""
    seed: int = 0
    """Of the search."""

    def run(self) -> None:
        """Search, store, print."""
        from agents.design.problem import design_problem
        from agents.design.search import run_design_search

        problem = design_problem(self.feed, self.full, self.contexts, self.fidelity)
        run_design_search(problem, self.trials, self.output, self.storage, self.seed, self.workers)
