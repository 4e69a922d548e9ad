"""Commands of the simulator: single scenes, the study's claims, speed, stability."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from agents.records.shipped import file_or_shipped
from probe_env import Scene, Simulator
from probe_env.physics.methods import METHODS, SOLVERS, method_named
from probe_env.settings import within


@dataclass(frozen=True)
class Simulate:
    """Simulate one scene: statistics as a table; scene, results, signals and figures in a folder."""

    scene_file: tyro.conf.Positional[Path]
    """Scene file (TOML), or the name of one that ships: fig11_l10, ...; single fields can be changed with the --scene
    options."""
    scene: Scene = field(default_factory=Scene)
    method: Annotated[str, tyro.conf.arg(metavar=f"{{{','.join(METHODS)}}}")] = "newmark"
    """newmark and wilson are the study's, imex is the fast scheme, superelement a converged mesh condensed to its
    floats, imex32 and superelement32 the same in single precision, implicit holds with any step, explicit is central
    differences."""
    time_step: float | None = None
    """Time step [s]; default: the one that the study's probe is simulated with by this method."""
    nodes_per_pitch: int = 4
    """Nodes in one float pitch."""
    solver: Annotated[str, tyro.conf.arg(metavar=f"{{{','.join(SOLVERS)}}}")] = "ticm"
    """Linear solver of a step of newmark and wilson."""
    start: Literal["inner", "outer"] = "inner"
    """Wall that the probe lies on at rest; outer is for the return: --scene.feed-speed -0.2 --scene.air-supply-rate
    -0.0175 --scene.couple tangent."""
    duration: float = 8.0
    """Simulated time [s]."""
    statistics_from: float | None = None
    """Start of the statistics [s]; None: after a quarter of the duration."""
    output: Path | None = None
    """Output folder; default: output/NAME-OF-THE-SCENE."""

    @classmethod
    def of_scene(cls, given: str | None) -> Simulate | None:
        """The command for a scene file or the name of one, whose fields options change; None if none is given.

        Raises:
            FileNotFoundError: no such file, nor a scene of this name that ships.
            ValueError: not a scene.
        """
        if given is None:
            return None
        path = file_or_shipped("scenes", given)
        if path.suffix != ".toml":
            raise ValueError(f"scene_file = {given!r} is not a scene file, which is TOML (.toml)")
        return cls(path, Scene.from_toml(path))

    def run(self) -> None:
        """Simulate, store and print."""
        from agents.study.simulate import print_statistics, simulate_scene

        name = self.scene_file.stem
        within("duration", self.duration, 1e-3, 1e5, "s")
        output = self.output or Path("output") / name
        step = method_named(self.method).usual_step if self.time_step is None else self.time_step
        simulator = Simulator(self.scene, self.method, step, self.nodes_per_pitch, solver=self.solver, start=self.start)
        stable = simulator.stable_time_step
        holds = f"known to hold up to {stable:.2g} s" if math.isfinite(stable) else "holds with any"
        print(f"{name}: {simulator.chain.node_count} nodes, {self.method}, time step {step:g} s ({holds})")
        begin = 0.25 * self.duration if self.statistics_from is None else self.statistics_from
        statistics = simulate_scene(simulator, self.duration, begin, output, name)
        print_statistics(statistics, f"{name}, t = {begin:g} to {self.duration:g} s")
        print(f"written: {output}/ (scene.toml, results.json, signals.npz, figures)")


@dataclass(frozen=True)
class Bench:
    """Measure the kernels' speed as ratios within one run, and store the table."""

    output: Path = Path("output/bench")
    """Folder of bench.json."""
    repeats: int = 7
    """Repeats of every timing, the best of which counts."""

    def run(self) -> None:
        """Measure, store, print."""
        from agents.bench.kernels import run_bench

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
        from agents.chart.timelapse import run_timelapse

        run_timelapse(self.output)


@dataclass(frozen=True)
class Stability:
    """Map which time steps hold, over method, contact stiffness and length."""

    output: Path = Path("output/stability")
    """Folder of map.csv and map.png."""

    def run(self) -> None:
        """Run, store, print."""
        from agents.chart.stability.map import run_map

        run_map(self.output)


@dataclass(frozen=True)
class Pressed:
    """Run what is pressed: two hundred drawn scenes, the map of steps drawn back, and insertions that were lost."""

    parts: tyro.conf.Positional[tuple[Literal["scenes", "map", "insertions"], ...]] = ("scenes", "map", "insertions")
    """What of it."""
    output: Path = Path("output/pressed")
    """Folder of scenes.csv, map.csv and insertions.csv; what is there already is not run again."""
    episodes: Path = Path("results/any-probe/episodes.csv")
    """Table of `probe-env evaluate --probes random`, of which the insertions that diverged are run again."""
    limit: int = 0
    """The first so many scenes, cells of a method, and insertions of a set; 0: all."""
    jobs: int = 1
    """Threads."""

    def run(self) -> None:
        """Run what is missing, print."""
        from agents.chart.stability import lost, pressed_runs, pressed_words, returns
        from agents.chart.stability.pressed import SCENES

        if not 0 <= self.limit <= SCENES:
            raise ValueError(f"limit = {self.limit!r} is outside the accepted range 0 (all) to {SCENES}")
        if "scenes" in self.parts:
            print(pressed_words.markdown(pressed_runs.run_pressed(self.output, self.limit, self.jobs)))
        if "map" in self.parts:
            print(returns.markdown(returns.run_returns(self.output, self.limit)))
        if "insertions" in self.parts:
            print(lost.markdown(lost.rerun(self.episodes, self.output, self.limit, self.jobs)))
        print(f"written: {self.output}/ ({', '.join(f'{part}.csv' for part in self.parts)})")


@dataclass(frozen=True)
class Chart:
    """Chart accuracy against cost: every method before chaos and in it, mesh and model choices. Stored runs stay."""

    output: Path = Path("output/chart")
    """Folder of smooth.csv, ensembles.csv, insertions.csv, costs.csv and the figures."""
    target: Path | None = None
    """File of the errors that `auto` goes by; default: measured_errors.csv in the output folder."""

    def run(self) -> None:
        """Run what is missing, draw, print."""
        from agents.chart.report import run_chart

        run_chart(self.output, self.target or self.output / "measured_errors.csv")


@dataclass(frozen=True)
class OtherProbes:
    """Compare the mesh and step of `standard` with the converged ones for random designs in random tubes."""

    output: Path = Path("output/other-probes")
    """Folder of other-probes.csv."""
    limit: int = 0
    """The first so many probes; 0: all eleven."""

    def run(self) -> None:
        """Run what is missing, print."""
        from agents.chart import other_probes

        most = len(other_probes.other_probes())
        if not 0 <= self.limit <= most:
            raise ValueError(f"limit = {self.limit!r} is outside the accepted range 0 (all) to {most}")
        table = other_probes.run_other_probes(self.output, self.limit)
        print(other_probes.markdown(table))
        print(f"written: {self.output}/other-probes.csv")


@dataclass(frozen=True)
class Peers:
    """Put other packages beside ours on a scene that all can run: PyElastica, MuJoCo, Exudyn, as far as installed."""

    output: Path = Path("output/chart")
    """Folder of peers.csv and peers.png."""

    def run(self) -> None:
        """Run, draw, print."""
        from agents.chart.peers import comparison as peers

        table = peers.run_peers(self.output)
        peers.draw(table, self.output / "peers.png")
        print(peers.markdown(table))
        print(f"written: {self.output}/ (peers.csv, peers.png)")


@dataclass(frozen=True)
class Scaling:
    """Measure what insertions cost in portions of several sizes, and project a thousand of them onto more cores."""

    output: Path = Path("output/scaling")
    """Folder of the tables."""

    def run(self) -> None:
        """Measure, store, print."""
        from agents.bench.scaling import run_scaling

        run_scaling(self.output)
