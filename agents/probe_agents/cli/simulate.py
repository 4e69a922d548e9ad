"""Command simulate."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro

from probe_agents.cli.parsing import File, hide_default
from probe_agents.records.shipped import file_or_shipped
from probe_agents.terminal.tables import print_line
from probe_env import Scene, Simulator
from probe_env.physics.methods import METHODS, SOLVERS, method_named
from probe_env.settings import within


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
    solver: Annotated[str, tyro.conf.arg(metavar=f"{{{','.join(SOLVERS)}}}")] = "ticm"
    """Linear solver of newmark and wilson."""
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
        simulator = Simulator(self.scene, method, step, self.nodes_per_pitch, solver=self.solver, start=self.start)
        stable = simulator.stable_time_step
        limit = "with any step" if math.isinf(stable) else f"up to {stable:.2g} s" if stable else "limit not known"
        print_line(f"{name}: {simulator.chain.node_count} nodes, {self.method}, time step {step:g} s (stable: {limit})")
        begin = 0.25 * self.duration if self.statistics_from is None else self.statistics_from
        statistics = simulate_scene(simulator, self.duration, begin, output, name)
        print_statistics(statistics, f"{name}, t = {begin:g} to {self.duration:g} s")
        print_line(f"written: {output}/ (scene.toml, results.json, signals.npz, figures)")
