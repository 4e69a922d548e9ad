"""Commands evaluate, agents, render and signal."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from agents.evaluation.workers import Workers


@dataclass(frozen=True)
class Evaluate:
    """Evaluate policies on the same tubes: KPIs with intervals, paired differences, a table and a report."""

    policies: tyro.conf.Positional[tuple[str, ...]] = ("constant", "slow", "slow-down", "pi")
    """Policies and trained agents by name (probe-env agents lists them; ppo@2 is another training seed), schedule files
    (.csv, .toml), feedback laws (.json) or agents' bundles (.npz). NAME=FILE names one, NAME@K=FILE the training seeds
    of one method. shielded:POLICY blows more where its feed and air would leave too little drive. Alone, the folder
    of a stored evaluation, also an interrupted one: its report is written again, with --against of another policy."""
    probes: Literal["scene", "random"] = "scene"
    """scene: the study's probe; random: one for every tube and seed, drawn from the design space."""
    against: str | None = None
    """Policy that the others are compared with; default: the first."""
    output: Path = Path("output/evaluation")
    """Folder of the tables and the report; what is there already is not run again."""
    contexts: Literal["train", "validation", "test"] = "test"
    """Shipped list of tubes."""
    limit: int = 0
    """Take so many tubes of the list only, the first of it, which are balanced; 0: all."""
    seeds: int = 1
    """Seeds of sensor noise and start for every tube."""
    fidelity: str = "standard"
    """How closely to simulate: study, reference, standard, fast, one of version 0 (fast-v0), auto or auto:TOLERANCE;
    with --passes both study, standard, unlapsed or fast, which has time-lapse on the way in alone. Or settings in
    braces, as errors advise them."""
    workers: Annotated[Workers, tyro.conf.arg(name="")] = field(default_factory=Workers)
    tube: Path | None = None
    """Your own plant (tube.toml): its task, and as many tubes drawn from what is known of it instead of the list."""
    strict: bool = False
    """Refuse policies that were not made for these tubes, instead of saying so."""
    passes: Literal["in", "both"] | None = None
    """Default: in, or what the tube's file says. both: feed the probe in and draw it back. Policies are for the way in;
    schedule files may have columns for the way back (return_feed_speed_m_per_s, return_air_supply_m3_per_h), others
    come back as fast as the device can. Agents that were trained for both passes act on both."""
    inspects: Literal["in", "back", "best"] | None = None
    """What a metre counts for with --passes both: the way in, the way back, or the better of both (default)."""

    def run(self) -> None:
        """Run what is missing, print, write the report; of a stored evaluation the report alone."""
        from agents.evaluation.folder import holds_evaluation
        from agents.evaluation.run import evaluate, report_again
        from agents.terminal.fidelities import fidelity_given

        folder = Path(self.policies[0]) if len(self.policies) == 1 else Path()
        named = folder.is_dir() and len(folder.parts) > 1 and not folder.suffix  # a folder, and no damaged policy file
        if folder.parts and (named or holds_evaluation(folder)):
            print(f"written: {report_again(folder, self.against)}")
            return
        evaluate(
            self.policies,
            self.output,
            tube=self.tube,
            contexts=self.contexts,
            limit=self.limit,
            seeds=self.seeds,
            fidelity=fidelity_given(self.fidelity),
            probes=self.probes,
            passes=self.passes,
            inspects=self.inspects,
            against=self.against,
            strict=self.strict,
            workers=self.workers,
        )


@dataclass(frozen=True)
class Agents:
    """List the trained agents that ship: name, what each sees, what it was trained for, training seeds."""

    def run(self) -> None:
        """Print."""
        from agents.policies.catalogue import NAMES
        from agents.policies.trained import print_agents
        from agents.records.shipped import shipped_names
        from agents.terminal.tables import print_terms

        print_agents()
        print("Other policies")
        print_terms({"by name": ", ".join(NAMES), "schedules": ", ".join(shipped_names("schedules"))})


@dataclass(frozen=True)
class Render:
    """Film a probe under a policy: an episode, or the motion near its tip in slow motion."""

    output: Path = Path("output/insertion.gif")
    """File to write: .gif, .mp4, or .png for the last picture alone."""
    view: Literal["helix", "strip"] = "helix"
    """helix: a whole episode, the helix with the probe in it, feed, air, vibration, reward; strip: the tube unrolled
    near the tip, 8 times slowed, with walls, floats, contacts and the sensor's motion."""
    env_id: Literal[
        "probe_env/Insertion-v1",
        "probe_env/Snapshot-v1",
        "probe_env/Inspection-v0",
        "probe_env/Insertion-v0",
        "probe_env/Snapshot-v0",
    ] = "probe_env/Insertion-v1"
    """Which environment; version 0 has the coarser mesh of before."""
    policy: str = "constant"
    """Policy or trained agent by name, schedule file or agent's bundle."""
    fidelity: str = "standard"
    """How closely to simulate: study, reference, standard, fast (for Insertion-v1 alone) or auto."""
    contexts: Literal["random", "train", "validation", "test"] = "random"
    """Shipped list that the tube is drawn from; random: from the ranges that the lists were drawn from."""
    every: int = 4
    """Of the helix, control periods a frame: of 1 s in Insertion-v1, 0.1 s in Snapshot-v1."""
    at: float | None = None
    """Of the strip, the inserted length at which it begins [m]; default: three quarters of the helix."""
    length: float = 10.0
    """Of the strip, how far behind the tip it reaches [m]."""
    duration: float = 0.5
    """Of the strip, how much of the probe's motion it shows [s], up to 2; a picture each 5 ms."""
    seed: int = 0
    """Of the tube and the sensors' noise."""
    tube: Path | None = None
    """Your own plant (tube.toml), of which a random tube is drawn."""

    def run(self) -> None:
        """Simulate, draw, write."""
        from agents.evaluation.film import Look, render_episode, render_strip
        from agents.policies.places import plant_at

        if self.at is not None and self.view != "strip":
            raise ValueError(f"at = {self.at!r} m is of the strip: add --view strip")
        of = {"tube": plant_at(self.tube), "fidelity": self.fidelity, "contexts": self.contexts}
        if self.view == "strip":
            look = Look(self.at, self.length, self.duration)
            figures = render_strip(self.env_id, self.output, self.policy, self.seed, look, **of)
        else:
            figures = render_episode(self.env_id, self.output, self.policy, self.every, self.seed, **of)
        for name, value in figures.items():
            print(f"{name:40s} {value:.6g}")
        print(f"written: {self.output}")


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
