"""The commands for what inspection engineers see: channels, charts, flaws, calls."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from agents.processes.workers import Workers


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


@dataclass(frozen=True)
class Anchors:
    """Play policies with the sensor's anchors as they are, each halved and doubled: which finds smaller flaws?"""

    policies: tyro.conf.Positional[tuple[str, ...]] = ()
    """Policies and agents as of `evaluate`; default: those of the published table."""
    limit: int = 12
    """Tubes of the test list, the first of it, which are balanced; 0: all."""
    fidelity: str = "fast"
    """How closely to simulate; thresholds and depths come out higher at fast than at standard."""
    tube: Path | None = None
    """Your own plant (tube.toml): its tubes and its [sensor]."""
    output: Path = Path("output/anchors")
    """Folder of the tables; episodes that are there already are not played again."""
    workers: Annotated[Workers, tyro.conf.arg(name="")] = field(default_factory=Workers)

    def run(self) -> None:
        """Play, store, print."""
        from agents.detection.anchors import POLICIES, run_anchors
        from agents.policies.places import place_at

        place = place_at(self.tube, "test", self.limit)
        run_anchors(self.policies or POLICIES, place, self.fidelity, self.output, self.workers)
        print(f"written: {self.output}/ (anchors.csv, pairs.csv, a folder of episodes for each)")


@dataclass(frozen=True)
class FalseCalls:
    """Count calls where there is no flaw: whether noise is called as seldom as the threshold promises."""

    policies: tyro.conf.Positional[tuple[str, ...]] = ()
    """Policies and agents as of `evaluate`; default: those of the published table."""
    limit: int = 12
    """Tubes of the test list, the first of it, which are balanced; 0: all."""
    fidelity: str = "standard"
    """How closely to simulate: standard, reference or settings without time-lapse, which would leave metres out."""
    tube: Path | None = None
    """Your own plant (tube.toml): its tubes and its [sensor]."""
    output: Path = Path("output/false-calls")
    """Folder of the tables; insertions that are there already are not simulated again."""
    workers: Annotated[Workers, tyro.conf.arg(name="")] = field(default_factory=Workers)

    def run(self) -> None:
        """Simulate, count, store, print."""
        from agents.detection.false_calls import POLICIES, run_false_calls
        from agents.policies.places import place_at

        place = place_at(self.tube, "test", self.limit)
        run_false_calls(self.policies or POLICIES, place, self.fidelity, self.output, self.workers)
        print(f"written: {self.output}/ (false-calls.csv, counts.csv a row an insertion)")
