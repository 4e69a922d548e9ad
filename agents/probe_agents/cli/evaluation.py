"""Commands simulate, evaluate, agents, render and signal."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from probe_agents.cli.parsing import File, hide_default
from probe_agents.evaluation.workers import Workers
from probe_agents.records.shipped import file_or_shipped
from probe_agents.terminal.tables import print_line
from probe_env import Scene, Simulator
from probe_env.physics.methods import METHODS, method_named
from probe_env.scene import Probe
from probe_env.settings import within

Policies = Annotated[tuple[str, ...], tyro.conf.arg(metavar="[POLICY ...]")]


@dataclass(frozen=True)
class Simulate:
    """Simulate one scene: print statistics, store scene, results, signals and figures.

    Example: probe-env simulate fig11_l30 --method imex --scene.contact.friction 0.2
    """

    scene_file: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="SCENE")]]
    """Scene file (TOML), or the name of a shipped scene: fig11_l10, ...; the --scene options change single fields."""
    scene: Scene = field(default_factory=Scene)
    method: Annotated[str, tyro.conf.arg(metavar=f"{{{','.join(METHODS)}}}")] = "newmark"
    """newmark and wilson: the study's methods; imex: fast implicit-explicit method; implicit: stable at any time step.
    superelement: converged mesh condensed to the floats; imex32 and superelement32: the same in single precision.
    explicit: central differences."""
    time_step: Annotated[float | None, hide_default()] = None
    """Time step [s]; default: that of the method."""
    nodes_per_pitch: int = 4
    """Nodes per float pitch."""
    start: Literal["inner", "outer"] = "inner"
    """Wall on which the probe lies at rest; outer is for withdrawal, with --scene.couple tangent and
    negative --scene.feed-speed and --scene.air-supply-rate."""
    duration: float = 8.0
    """Simulated time [s]."""
    statistics_from: Annotated[float | None, hide_default()] = None
    """Start of the statistics [s]; default: after a quarter of the duration."""
    output: File = None
    """Folder; default: output/NAME."""

    @classmethod
    def of_scene(cls, name: str | None) -> Simulate | None:
        """The command with the defaults of a scene file or shipped scene; None without a name."""
        if name is None:
            return None
        path = file_or_shipped("scenes", name)
        if path.suffix != ".toml":
            raise ValueError(f"scene_file = {name!r} is not a TOML file (.toml)")
        return cls(path, Scene.from_toml(path))

    def run(self) -> None:
        """Simulate, store and print."""
        from probe_agents.evaluation.simulate import print_statistics, simulate_scene

        name = self.scene_file.stem
        within("duration", self.duration, 1e-3, 1e5, "s")
        output = self.output or Path("output") / name
        method = method_named(self.method)
        step = method.usual_step if self.time_step is None else self.time_step
        simulator = Simulator(self.scene, method, step, self.nodes_per_pitch, start=self.start)
        stable = simulator.stable_time_step
        limit = "with any step" if math.isinf(stable) else f"up to {stable:.2g} s" if stable else "limit not known"
        print_line(f"{name}: {simulator.chain.node_count} nodes, {self.method}, time step {step:g} s (stable: {limit})")
        begin = 0.25 * self.duration if self.statistics_from is None else self.statistics_from
        statistics = simulate_scene(simulator, self.duration, begin, output, name)
        print_statistics(statistics, f"{name}, t = {begin:g} to {self.duration:g} s")
        print_line(f"written: {output}/ (scene.toml, results.json, signals.npz, figures)")


@dataclass(frozen=True)
class Evaluate:
    """Evaluate policies on the same tubes: KPIs with intervals, paired differences, a table and a report.

    The folder of a stored or interrupted evaluation as the only argument writes its report again. A schedule file as
    the only argument is compared with best-schedule.

    Example: probe-env evaluate ppo pi my-schedule.csv --limit 6
    """

    policies: tyro.conf.Positional[Policies] = ("constant", "slow", "slow-down", "pi")
    """Names (see `probe-env agents`; ppo@2: training seed 2), schedules (.csv, .toml, .xlsx), laws (.json), agents
    (.safetensors).
    NAME=FILE sets the name in tables; NAME@0=FILE, NAME@1=FILE ... are training seeds of one method.
    shielded:POLICY raises the air supply where the drive would be too low."""
    sheet: Annotated[str | None, hide_default()] = None
    """Sheet of the workbooks among the schedules (FILE.xlsx#SHEET names one of one file); default: the first with known
    headings."""
    probes: Literal["scene", "random"] = "scene"
    """scene: the probe of the task; random: another probe of the design space for every tube and seed."""
    against: Annotated[str | None, hide_default()] = None
    """Reference policy of the comparison; default: the first."""
    output: Path = Path("output/evaluation")
    """Folder of the tables and the report; stored episodes are not run again."""
    contexts: Literal["train", "validation", "test"] = "test"
    """Shipped list of tubes."""
    limit: int = 0
    """Number of tubes, the first of the list; 0: all."""
    seeds: int = 1
    """Number of seeds of sensor noise and start for every tube."""
    fidelity: str = "fast"
    """Accuracy of the simulation: fast, standard (four times as slow), reference, study, surrogate, auto or
    auto:TOLERANCE.
    With --passes both: fast, standard or study. Or settings, such as "{'method': 'imex', 'time_step': 1e-4}"."""
    workers: Annotated[Workers, tyro.conf.arg(name="")] = field(default_factory=Workers)
    tube: File = None
    """Your plant (tube.toml). Its tubes replace the shipped list."""
    strict: bool = False
    """Error instead of a warning for policies that were trained or searched for other tubes."""
    passes: Annotated[Literal["in", "both"] | None, hide_default()] = None
    """in: insertion; both: insertion and withdrawal. Default: as in the tube file, else in.
    Schedule files can have columns return_feed_speed_m_per_s and return_air_supply_m3_per_h for the withdrawal.
    Policies for insertion withdraw at the highest feed speed."""
    scored_pass: Annotated[
        Literal["insertion", "withdrawal", "best", "in", "back"] | None,
        hide_default(),
        tyro.conf.arg(metavar="{insertion,withdrawal,best}", aliases=("--inspects",)),
    ] = None
    """Pass that is scored with --passes both: the insertion, the withdrawal, or the better of both (default)."""

    def run(self) -> None:
        """Run what is missing, print, write the report; of a stored evaluation the report alone."""
        from probe_agents.cli.parsing import parse_fidelity
        from probe_agents.evaluation.folder import is_evaluation
        from probe_agents.evaluation.run import evaluate, report_again
        from probe_agents.evaluation.statistics import BAR
        from probe_agents.policies.catalogue import is_schedule_file
        from probe_agents.records.sources import with_sheet

        folder = Path(self.policies[0] if len(self.policies) == 1 else "policies")
        named = folder.is_dir() and len(folder.parts) != 1 and not folder.suffix
        if len(self.policies) == 1 and (named or is_evaluation(folder)):
            report = report_again(folder, self.against)
            print_line(f"report of the stored evaluation {folder}: nothing is simulated")
            print_line(f"written: {report}")
            return
        policies = tuple(with_sheet(policy, self.sheet) for policy in self.policies) if self.sheet else self.policies
        if self.sheet and policies == self.policies:
            raise ValueError(f"sheet = {self.sheet!r}: none of the policies is a workbook: leave --sheet out")
        arguments: dict[str, Any] = vars(self) | {"fidelity": parse_fidelity(self.fidelity), "policies": policies}
        del arguments["sheet"]
        lone = len(policies) == 1 and is_schedule_file(policies[0]) and not self.strict
        if lone:
            print_line(f"one schedule, {policies[0]}: {BAR} is added for comparison")
            arguments |= {"policies": (*policies, BAR), "against": self.against or BAR}
        evaluate(**arguments)


@dataclass(frozen=True)
class Agents:
    """List trained agents with their observations, training tasks and seeds, and the names of other policies.

    Example: probe-env agents
    """

    def run(self) -> None:
        """Print."""
        from probe_agents.policies.catalogue import NAMES
        from probe_agents.policies.trained import print_agents
        from probe_agents.records.shipped import shipped_names
        from probe_agents.terminal.tables import print_terms

        print_agents()
        print("Other policies")
        print_terms({"by name": ", ".join(NAMES), "schedules": ", ".join(shipped_names("schedules"))})


@dataclass(frozen=True)
class Render:
    """Film an episode of a policy, or the motion near the tip in slow motion.

    Example: probe-env render --policy ppo --output output/ppo.gif
    """

    output: Path = Path("output/insertion.gif")
    """File: .gif, .mp4, or .png for the last frame."""
    view: Literal["helix", "strip"] = "helix"
    """helix: an episode, with the probe in the helix, feed, air, vibration and reward.
    strip: the unrolled tube near the tip, 8 times slower, with floats, contacts and the sensor's motion."""
    env_id: Literal["probe_env/Insertion-v1", "probe_env/Snapshot-v1", "probe_env/Inspection-v0"] = (
        "probe_env/Insertion-v1"
    )
    """Environment."""
    policy: str = "constant"
    """Name of a policy or trained agent, schedule file, or trained agent (.safetensors)."""
    fidelity: str = "fast"
    """Accuracy of the simulation: fast, standard, reference, study or auto."""
    contexts: Literal["random", "train", "validation", "test"] = "random"
    """List from which the tube is sampled; random: from the ranges of all lists."""
    every: int = 4
    """Control periods per frame of the helix: 1 s each in Insertion-v1, 0.1 s in Snapshot-v1."""
    at: Annotated[float | None, hide_default()] = None
    """Inserted length at which the strip begins [m]; default: three quarters of the helix."""
    length: float = 10.0
    """Length of the strip, behind the tip [m]."""
    duration: float = 0.5
    """Simulated duration of the strip [s], at most 2; a frame every 5 ms."""
    seed: int = 0
    """Seed of the tube and the sensor noise."""
    tube: File = None
    """Your plant (tube.toml), from which a tube is sampled."""
    design: File = None
    """Design file (.toml) or name of a shipped design, instead of the plant's or table 2's probe."""

    def run(self) -> None:
        """Simulate, draw, write."""
        from probe_agents.design.trials import read_design
        from probe_agents.evaluation.film import render_episode, render_strip
        from probe_agents.policies.cases import plant_at

        if self.at is not None and self.view != "strip":
            raise ValueError(f"at = {self.at!r} m needs --view strip")
        plant = plant_at(self.tube)
        options: dict[str, Any] = {"tube": plant, "fidelity": self.fidelity, "contexts": self.contexts}
        if self.design:
            base = plant.probe if plant else Probe()
            probe = read_design(file_or_shipped("design", self.design), base).probe(base)
            changed = plant.model_copy(update={"probe": probe}) if plant else None
            options |= {"tube": changed} if changed else {"scene": Scene.fitted({"probe": probe}).whole()}
        if self.view == "strip":
            options |= {"at": self.at, "length": self.length, "duration": self.duration}
            figures = render_strip(self.env_id, self.output, self.policy, self.seed, **options)
        else:
            figures = render_episode(self.env_id, self.output, self.policy, self.every, self.seed, **options)
        for name, value in figures.items():
            print(f"{name:40s} {value:.6g}")
        print_line(f"written: {self.output}")


@dataclass(frozen=True)
class Signal:
    """Simulate the sensor signals of a run: X and Y with supports and flaws, Lissajous figures, calls.

    Example: probe-env signal best-schedule --flaws 10:20 30:20 50:40
    """

    policy: tyro.conf.Positional[Annotated[str, tyro.conf.arg(metavar="[POLICY]")]] = "constant"
    """Name of a policy or trained agent, schedule file, feedback law (.json), or trained agent (.safetensors)."""
    flaws: Annotated[tuple[str, ...], hide_default("POSITION:DEPTH ...")] = ()
    """Flaws: metres from the entrance of the helix and % of the wall, such as 10:20 30:40. Default: 20 % every 5 m."""
    output: Path = Path("output/signal")
    """Folder of strip.png, flaws.png, channels.csv (every millisecond), flaws.csv, periods.csv and signal.json."""
    evaluation: File = None
    """Folder of an evaluation; the probability of detection of its policies is written to pod.png and pod.csv."""
    contexts: Literal["train", "validation", "test"] = "test"
    """Shipped list of tubes."""
    context: int = 0
    """Index of the tube in the list."""
    until: Annotated[float | None, hide_default()] = None
    """Inserted length at the end [m]; default: the end of the helix."""
    fidelity: str = "fast"
    """Accuracy of the simulation: study, reference, standard or fast, without time-lapse, which would skip metres."""
    seed: int = 0
    """Seed of the start, the sensor noise and the electronic noise."""
    tube: File = None
    """Your plant (tube.toml), with its tubes, sensor and support_spacing."""

    def run(self) -> None:
        """Simulate, draw, write, print."""
        from probe_agents.evaluation.signal import draw_curves, run_signal
        from probe_agents.policies.cases import read_case

        case = read_case(self.tube, self.contexts)
        if self.evaluation:
            draw_curves(self.evaluation, self.output)
        spacing = case.plant.tube.support_spacing if case.plant else None
        options: dict[str, Any] = {"context": self.context, "flaws": self.flaws, "support_spacing": spacing}
        options |= {"until": self.until, "seed": self.seed}
        run_signal(self.policy, case, self.fidelity, self.output, **options)
