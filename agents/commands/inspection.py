"""The commands for what inspection engineers see: channels, charts, flaws, calls."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro


@dataclass(frozen=True)
class Signal:
    """Simulate a run as the sensor shows it: X and Y with supports and flaws, Lissajous figures, what is called."""

    policy: tyro.conf.Positional[str] = "constant"
    """Policy or trained agent by name, schedule file, feedback law or agent's bundle."""
    flaws: tuple[str, ...] = ()
    """Flaws to put into the tube, PLACE:DEPTH in metres from the helix's entrance and % of the wall: 10:20 30:40.
    Default: 20 % every 5 m."""
    output: Path = Path("output/signal")
    """Folder of strip.png, flaws.png, channels.csv (X and Y, a row a millisecond), flaws.csv, periods.csv (noise,
    vibration and S/N) and signal.json."""
    evaluation: Path | None = None
    """Folder of an evaluation (probe-env evaluate) whose policies' curves of detection are drawn as well: pod.png and
    pod.csv."""
    contexts: Literal["train", "validation", "test"] = "test"
    """Shipped list of tubes."""
    context: int = 0
    """Which tube of the list."""
    until: float | None = None
    """Inserted length at which to stop [m]; default: the helix's end."""
    fidelity: str = "standard"
    """How closely to simulate: standard, reference or settings without time-lapse, which would leave metres out."""
    seed: int = 0
    """Of sensor noise, start and electronic noise."""
    tube: Path | None = None
    """Your own plant (tube.toml): its tubes, its [sensor], its support_spacing."""

    def run(self) -> None:
        """Simulate, draw, write, print."""
        from agents.evaluation.signal import Look, draw_curves, run_signal
        from agents.policies.places import place_at, plant_at

        plant = plant_at(self.tube)
        spacing = plant.tube.support_spacing if plant else None
        look = Look(self.context, self.flaws, spacing, self.until, self.seed)
        if self.evaluation:
            draw_curves(self.evaluation, self.output)
        run_signal(self.policy, place_at(self.tube, self.contexts), self.fidelity, look, self.output)
