"""The command for robustness: policies where the task is not what they were made for."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from agents.processes.workers import Workers


@dataclass(frozen=True)
class Robustness:
    """Play policies along named axes: late, noisy and lost observations, slow air, other friction, tube and probe."""

    policies: tyro.conf.Positional[tuple[str, ...]] = ("best-schedule", "tension-scheduled", "adaptive", "ppo")
    """Policies and agents as `probe-env evaluate` takes them; shielded:POLICY keeps a margin of drive."""
    axes: tuple[str, ...] = ()
    """Some of delay, noise, dropout, "air lag", "friction drift", "oval tube", probe and bore; default: all."""
    output: Path = Path("output/robustness")
    """Folder of robustness.csv, robustness.png and the insertions; what is there already is not played again."""
    limit: int = 0
    """Take so many of the 48 test tubes only, the first, which are balanced; 0: all."""
    fidelity: str = "fast"
    """How closely to simulate: study, reference, standard, fast or auto."""
    workers: Annotated[Workers, tyro.conf.arg(name="")] = field(default_factory=Workers)
    tube: Path | None = None
    """Your own plant (tube.toml), see `probe-env evaluate --help`."""

    def run(self) -> None:
        """Play what is missing, store, draw, print."""
        from agents.policies.places import place_at
        from agents.robustness.axes import AXES
        from agents.robustness.study import run_study

        place = place_at(self.tube, "test", self.limit)
        run_study(self.policies, place, self.fidelity, self.output, self.workers, self.axes or tuple(AXES))
        print(f"written: {self.output}/ (robustness.csv, robustness.png, episodes.csv)")
