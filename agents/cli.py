"""The ``probe-env`` command: one dataclass a subcommand, tyro makes the options from them."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, Union

import tyro
from pydantic import ValidationError

from probe_env import Scene, SimulationError, Simulator
from probe_env.scene import explain


@dataclass(frozen=True)
class Simulate:
    """Simulate one scene: statistics as a table; scene, results, signals and figures in a folder."""

    scene_file: tyro.conf.Positional[Path]
    """Scene file (TOML); single fields can be changed with the --scene options."""
    scene: Scene = field(default_factory=Scene)
    method: Literal["newmark", "wilson"] = "newmark"
    time_step: float = 1e-4
    """Time step [s]."""
    nodes_per_pitch: int = 4
    """Nodes in one float pitch."""
    solver: Literal["ticm", "banded", "transfer-matrix"] = "ticm"
    """Linear solver of a step."""
    duration: float = 8.0
    """Simulated time [s]."""
    statistics_from: float = 2.0
    """Start of the statistics [s]; before it the start's transient decays."""
    output: Path | None = None
    """Output folder; default: output/NAME-OF-THE-SCENE."""

    def run(self) -> None:
        """Simulate, store and print."""
        from agents.simulate import print_statistics, simulate_scene

        name = self.scene_file.stem
        output = self.output or Path("output") / name
        simulator = Simulator(self.scene, self.method, self.time_step, self.nodes_per_pitch, solver=self.solver)
        print(
            f"{name}: {simulator.chain.node_count} nodes, {self.method}, time step {self.time_step:g} s"
            f" (known to hold up to {simulator.stable_time_step:.2g} s)"
        )
        statistics = simulate_scene(simulator, self.duration, self.statistics_from, output, name)
        print_statistics(statistics, f"{name}, t = {self.statistics_from:g} to {self.duration:g} s")
        print(f"written: {output}/ (scene.toml, results.json, signals.npz, figures)")


@dataclass(frozen=True)
class Study:
    """Run the study's scenes and print its claims beside what was found. Stored runs are not repeated."""

    scenes: Path = Path("configs/scenes")
    """Folder of the scene files."""
    output: Path = Path("output/study")
    """Folder of ensemble.csv and provenance.json."""
    members: int = 1
    """Perturbed runs a case."""
    duration: float = 8.0
    """Simulated time of a run [s]."""
    subset: bool = False
    """Five cases instead of all."""
    jobs: int = 2
    """Runs at the same time."""

    def run(self) -> None:
        """Run what is missing, print the table."""
        from agents import study
        from agents.claims import print_findings

        for name, low, high in (("members", 1, 1000), ("jobs", 1, 256), ("duration", 0.5, 1e4)):
            value = getattr(self, name)
            if not low <= value <= high:
                raise ValueError(f"{name} = {value!r} is outside the accepted range {low} to {high:g}")
        names = study.SUBSET if self.subset else ()
        table = study.run_study(self.scenes, self.output, self.members, self.duration, names, self.jobs)
        print_findings(table, self.scenes)
        print(f"written: {self.output}/ensemble.csv")


@dataclass(frozen=True)
class Bench:
    """Measure the kernels' speed as ratios within one run, and store the table."""

    output: Path = Path("output/bench")
    """Folder of bench.json."""
    repeats: int = 7
    """Repeats of every timing, the best of which counts."""

    def run(self) -> None:
        """Measure, store, print."""
        from agents.bench import run_bench

        if not 1 <= self.repeats <= 1000:
            raise ValueError(f"repeats = {self.repeats!r} is outside the accepted range 1 to 1000")
        run_bench(self.output, self.repeats)


@dataclass(frozen=True)
class Timelapse:
    """Measure what time-lapse changes in the vibration profile of a full insertion, with intervals."""

    output: Path = Path("output/timelapse")
    """Folder of profile.csv, summary.csv and profile.png."""

    def run(self) -> None:
        """Run, store, print."""
        from agents.timelapse import run_timelapse

        run_timelapse(self.output)


@dataclass(frozen=True)
class Stability:
    """Map which time steps hold, over method, contact stiffness and length."""

    output: Path = Path("output/stability")
    """Folder of map.csv and map.png."""

    def run(self) -> None:
        """Run, store, print."""
        from agents.stability_map import run_map

        run_map(self.output)


@dataclass(frozen=True)
class Render:
    """Film an episode under a policy: the helix with the probe in it, feed, air, vibration, reward."""

    output: Path = Path("output/insertion.gif")
    """File to write: .gif, .mp4, or .png for the last picture alone."""
    env_id: Literal["probe_env/Insertion-v0", "probe_env/Snapshot-v0"] = "probe_env/Insertion-v0"
    """Which environment."""
    policy: str = "constant"
    """Built-in policy, schedule file or agent's bundle."""
    fidelity: Literal["study", "standard", "fast"] = "standard"
    """How closely to simulate; fast is for Insertion-v0 alone."""
    contexts: Literal["random", "train", "validation", "test"] = "random"
    """Where the tube's properties are drawn from."""
    every: int = 4
    """Control periods a frame."""
    seed: int = 0
    """Of the context and the sensors' noise."""

    def run(self) -> None:
        """Simulate, draw, write."""
        from agents.render import render_episode

        kpis = render_episode(
            self.env_id, self.output, self.policy, self.every, self.seed,
            fidelity=self.fidelity, contexts=self.contexts,
        )  # fmt: skip
        for name, value in kpis.items():
            print(f"{name:40s} {value:.6g}")
        print(f"written: {self.output}")


@dataclass(frozen=True)
class Evaluate:
    """Evaluate policies on the same contexts: KPIs with intervals, paired differences, a table and a report."""

    policies: tyro.conf.Positional[tuple[str, ...]] = ("constant", "slow", "slow-down", "pi")
    """Built-in policies, schedule files (.csv, .toml) or agents' bundles (.npz); NAME=FILE names one, NAME@K=FILE the
    training seeds of one method."""
    against: str | None = None
    """Policy that the others are compared with; default: the first."""
    output: Path = Path("output/evaluation")
    """Folder of the tables and the report; what is there already is not run again."""
    contexts: Literal["train", "validation", "test"] = "test"
    """Shipped list of contexts."""
    limit: int = 0
    """Take so many contexts of the list only, evenly spread; 0: all."""
    seeds: int = 1
    """Seeds of sensor noise and start for every context."""
    fidelity: Literal["study", "standard", "fast"] = "standard"
    """How closely to simulate."""
    check_fidelity: Literal["no", "half-step", "all"] = "no"
    """Repeat at half the time step; "all": and a sample with the study's scheme, which takes an hour."""

    def run(self) -> None:
        """Run what is missing, print, write the report."""
        from agents.report import evaluate

        evaluate(
            self.policies, self.output, self.contexts, self.limit, self.seeds, self.fidelity, self.check_fidelity,
            self.against,
        )  # fmt: skip


@dataclass(frozen=True)
class Report:
    """Write the report of a stored evaluation again: one HTML page that needs no network."""

    folder: tyro.conf.Positional[Path] = Path("results/evaluation")
    """Folder of the evaluation's tables."""

    def run(self) -> None:
        """Write report.html and summary.csv beside the tables."""
        from agents.report import write_report

        print(f"written: {write_report(self.folder)}")


@dataclass(frozen=True)
class Tradeoff:
    """Sweep one parameter of every policy family: the front of inspection time against vibration."""

    families: tyro.conf.Positional[tuple[str, ...]] = ("constant", "slow-down", "on-off", "pi", "tension-scheduled")
    """Families to sweep."""
    output: Path = Path("output/tradeoff")
    """Folder of the tables and the figure; what is there already is not run again."""
    contexts: Literal["train", "validation", "test"] = "test"
    """Shipped list of contexts."""
    beside: tuple[str, ...] = ()
    """Single policies to draw beside the fronts: schedules, agents."""
    limit: int = 12
    """Take so many contexts of the list only, evenly spread; 0: all."""
    fidelity: Literal["study", "standard", "fast"] = "fast"
    """How closely to simulate."""

    def run(self) -> None:
        """Run what is missing, store, print."""
        from agents.tradeoff import run_tradeoff

        run_tradeoff(self.families, self.output, self.contexts, self.limit, self.fidelity, self.beside)


@dataclass(frozen=True)
class Map:
    """Wander on the training tubes and fit how loud the probe is over length, feed, air and tube."""

    seeds: int = 2
    """Insertions on each of the 96 training tubes."""
    output: Path = Path("output/map")
    """Folder of the insertions; what is there already is not run again."""

    def run(self) -> None:
        """Run what is missing, fit, store in agents/data/."""
        from agents.vibration_map import make_map

        make_map(self.seeds, self.output)


@dataclass(frozen=True)
class Optimise:
    """Find the best constant feed or the best schedule over length for the training tubes, by CMA-ES on the map."""

    families: tyro.conf.Positional[tuple[str, ...]] = ()
    """What to search: best-constant, best-schedule, best-schedule-dDIAMETER; none: all."""
    trials: int = 1200
    """Schedules tried in each search."""
    output: Path = Path("agents/data")
    """Folder of the schedules, their trials and how they were made."""
    work: Path = Path("output/optimise")
    """Folder of the searches themselves, from which an interrupted one goes on."""

    def run(self) -> None:
        """Search, simulate on the validation tubes, store, print."""
        from agents.optimise import FAMILIES, run_search

        for family in self.families or FAMILIES:
            run_search(family, self.trials, self.output, self.work)


@dataclass(frozen=True)
class Train:
    """Train agents with Stable-Baselines3: checkpoints, validation, the best agent of each seed as a bundle."""

    config_file: tyro.conf.Positional[Path]
    """Training file (TOML), see configs/train/."""
    output: Path | None = None
    """Folder of the runs, seed-K in it; default: output/train/NAME-OF-THE-FILE."""
    seeds: tuple[int, ...] = ()
    """Seeds instead of the file's."""
    jobs: int = 1
    """Seeds trained side by side."""
    resume: bool = False
    """Go on from the last checkpoints in the folder."""

    def run(self) -> None:
        """Train, print the learning curves."""
        from agents.train import print_curves, train_all
        from agents.train_config import Training

        training = Training.from_toml(self.config_file)
        if self.seeds:
            training = training.model_copy(update={"seeds": self.seeds})
        output = self.output or Path("output/train") / self.config_file.stem
        print_curves(train_all(training, output, self.resume, self.jobs))
        print(f"written: {output}/seed-*/ (agent.npz: the best by validation, learning.csv, run.json, logs)")


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
    fidelity: Literal["study", "standard", "fast"] = "standard"
    """How closely to simulate; fast saves time in whole insertions only."""
    output: Path = Path("output/compare")
    """Folder of designs.csv and summary.csv; what is there already is not run again."""

    def run(self) -> None:
        """Run what is missing, store, print."""
        from agents.design_compare import Comparison, compare, print_comparison
        from probe_env import Design
        from probe_env.contexts import spread_contexts
        from probe_env.fidelity import resolve_fidelity

        designs = {path.stem: Design.from_toml(path) for path in self.designs}
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
    """Whole insertions instead of sections of constant length: some 5 s a tube."""
    trials: int = 240
    """Designs tried."""
    contexts: int = 6
    """Training tubes that each is tried in."""
    output: Path = Path("output/design")
    """Folder of the study, the tables and the pictures; a search that was interrupted goes on."""
    storage: str | None = None
    """URL of an Optuna storage; default: SQLite in the output folder."""
    seed: int = 0
    """Of the search."""

    def run(self) -> None:
        """Search, store, print."""
        from agents.design_search import run_design_search

        run_design_search(self.feed, self.full, self.trials, self.contexts, self.output, self.storage, self.seed)


@dataclass(frozen=True)
class Readme:
    """Rewrite the README's tables and figures from the stored results."""

    check: bool = False
    """Change nothing; fail if the README is not what the stored results say."""

    def run(self) -> None:
        """Rewrite or check."""
        from agents.readme import check_readme, rewrite_readme

        check_readme() if self.check else rewrite_readme()


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of ``probe-env``; returns the exit status."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    try:
        warnings.formatwarning = lambda message, *_, **__: f"probe-env: warning: {message}\n"
        command = tyro.cli(_commands(arguments), args=arguments, prog="probe-env", description=__doc__)
        command.run()
    except ValidationError as error:
        return _fail(explain(error))
    except FileNotFoundError as error:
        return _fail(f"no such file: {error.filename}")
    except (ValueError, OSError, SimulationError) as error:
        return _fail(str(error))
    except KeyboardInterrupt:
        return _fail("interrupted; what was finished is stored", 130)
    return 0


def _commands(arguments: Sequence[str]) -> Any:
    """The subcommands; the scene file named on the command line gives the defaults of --scene options."""
    simulate = tyro.conf.subcommand("simulate")
    if arguments[:1] == ["simulate"]:
        files = [argument for argument in arguments[1:] if argument.endswith(".toml")]
        if files:
            simulate = tyro.conf.subcommand("simulate", default=Simulate(Path(files[0]), Scene.from_toml(files[0])))
    others = (
        Annotated[kind, tyro.conf.subcommand(name)]
        for name, kind in (
            ("study", Study),
            ("bench", Bench),
            ("timelapse", Timelapse),
            ("stability", Stability),
            ("render", Render),
            ("evaluate", Evaluate),
            ("report", Report),
            ("tradeoff", Tradeoff),
            ("map", Map),
            ("optimise", Optimise),
            ("train", Train),
            ("compare", Compare),
            ("design", DesignSearch),
            ("readme", Readme),
        )
    )
    return Union[Annotated[Simulate, simulate], *others]


def _fail(message: str, status: int = 2) -> int:
    print(f"probe-env: error: {message}", file=sys.stderr)
    return status


if __name__ == "__main__":
    sys.exit(main())
