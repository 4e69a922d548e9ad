"""Commands for what controllers can reach."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from agents.processes.workers import Workers


@dataclass(frozen=True)
class Headroom:
    """Play planners, which try things out on the simulator, beside other policies: what feedback can still win."""

    policies: tyro.conf.Positional[tuple[str, ...]] = ("tension-scheduled", "adaptive", "privileged", "ppo")
    """Policies and agents as of `evaluate`; the planners and best-schedule are played beside them."""
    settings: bool = False
    """Instead: the planner with other horizons, candidates and terminal values."""
    contexts: Literal["train", "validation", "test"] = "test"
    """Shipped list of tubes."""
    limit: int = 12
    """How many of them, the first, which are balanced; 0: all."""
    fidelity: str = "fast"
    """How closely to simulate, the insertion and the copies that are tried."""
    tube: Path | None = None
    """Your own plant (tube.toml): its tubes and its map."""
    output: Path = Path("output/headroom")
    """Folder of the tables; episodes that are there already are not played again."""
    workers: Annotated[Workers, tyro.conf.arg(name="")] = field(default_factory=Workers)

    def run(self) -> None:
        """Play, store, print."""
        from agents.evaluation.headroom import run_headroom, run_settings
        from agents.policies.places import place_at

        place = place_at(self.tube, self.contexts, self.limit)
        if self.settings:
            run_settings(place, self.fidelity, self.output, self.workers)
            print(f"written: {self.output}/ (settings.csv, settings.png, episodes.csv)")
            return
        run_headroom(self.policies, place, self.fidelity, self.output, self.workers)
        print(f"written: {self.output}/ (headroom.csv, headroom.png, episodes.csv)")
