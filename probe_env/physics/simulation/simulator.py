"""Simulator of one probe: drive, time stepping, sampling, and an error if the state diverges."""

from __future__ import annotations

import copy
import math
import warnings
from collections.abc import Callable, Sequence
from typing import Any, Final, Literal, TypedDict, Unpack

import numpy as np
import numpy.typing as npt

from probe_env.arrays import FloatArray
from probe_env.errors import SimulationError, StabilityWarning
from probe_env.physics.methods import check_scene, check_step, method_named, method_names
from probe_env.physics.methods.method import KernelArguments, Method
from probe_env.physics.model.chain import (
    air_speed,
    build_chain,
    drag_factors,
    entrance_force,
    outer_start,
    sensor_node,
)
from probe_env.physics.model.drive import APPEND, Drive
from probe_env.physics.model.state import at_rest, check_points, check_state
from probe_env.physics.simulation.run import (
    CHANNELS,
    ROOT,
    Recorder,
    Run,
    Samples,
    node_of,
    progress_bar,
    snapshot_steps,
)
from probe_env.scene import Scene
from probe_env.settings import check_keywords, whole_steps, within

STEPS_PER_CALL: Final = 2000
"""Most steps in one kernel call; progress and interrupts are handled between calls."""


class Options(TypedDict, total=False):
    """Options of the start and the feed of a probe, documented in ``Simulator``."""

    growing: bool
    time_lapse: float
    ramp: float
    air_lag: float
    perturbation: float
    start: Literal["inner", "outer"]


DEFAULTS: Final[Options] = {
    "growing": False, "time_lapse": 1.0, "ramp": math.inf, "air_lag": 0.0, "perturbation": 0.0,
    "start": "inner",
}  # fmt: skip


def advance_group(simulators: Sequence[Simulator], samples: Sequence[Samples], done: int, steps: int) -> float:
    """Advance a group of probes of one method and kind; a group may have one probe.

    A probe that diverges stores its error and stops, the others continue. Its samples after that are zero.

    Args:
        simulators: the probes, with equal time steps and nodes per pitch.
        samples: of each probe, with equal periods and equally many points.
        done: steps since the first sample period began.
        steps: number of steps.

    Returns:
        run time of the kernels [s].
    """
    time_step, nodes_per_pitch, every = simulators[0].time_step, simulators[0].nodes_per_pitch, samples[0].every
    seconds = 0.0
    for first in range(done, done + steps, STEPS_PER_CALL):
        count = min(done + steps - first, STEPS_PER_CALL)
        running = [(s, record) for s, record in zip(simulators, samples, strict=True) if not s.diverged]
        if not running:
            break
        lanes = []
        entrance = any(s.scene.terms.entrance and (record.points == ROOT).any() for s, record in running)
        for s, record in running:
            room, spare = s.chain.node_count - 1 - s.root, max(s.root - s.sensor - nodes_per_pitch, 0)
            ripple = s.scene.feed_ripple, s.scene.ripple_length
            drag = s.drag(s.root) if s.scene.air.compressible else None
            inputs = s.drive.inputs_of_steps(count, time_step, s.chain.element_length, room, spare, ripple)
            end = s.root + int(inputs[:, APPEND].sum())
            constants = s.constants if drag is None else s.constants_in_air(drag, s.drag(end), count)
            rows, points = record.rows[first // every : (first + count) // every], record.points  # filled in this call
            if entrance:  # and the node ahead of the root
                points, rows = np.append(points, ROOT - 1), np.zeros((len(rows), len(points) + 1, CHANNELS))
            lanes.append(KernelArguments(constants, s.state, s.root, inputs, points, rows, record.tension_sum))
        seconds += simulators[0].method.run(lanes, time_step, nodes_per_pitch, every - first % every, every)
        for (s, record), lane in zip(running, lanes, strict=True):
            if entrance:
                s.subtract_entrance(lane.samples[:, :-1], record.points, lane.samples[:, -1, :3])
                record.rows[first // every : (first + count) // every] = lane.samples[:, :-1]
            s.steps_done += lane.failed or count
            s.root = int(lane.root)
            s.iterations += lane.iterations
            s.unconverged_steps += lane.unconverged
            # the lanes check floats and the tip only: check that all nodes are finite
            if lane.failed or not np.isfinite(s.state.d[: s.root]).all():
                s.set_diverged()
    return seconds


class Simulator:
    """Simulates one probe, of constant length or growing during insertion.

    ``iterations`` and ``unconverged_steps`` count the iterations of ``implicit`` since the start, and the steps in
    which they did not converge (see ``methods.implicit``).

    Args:
        scene: tube, probe and inputs; its carrier length is the initial one.
        method: "newmark" (beta 1/4, gamma 1/2) or "wilson" (theta 1.4), table 1 of the study; "imex", a fast
            implicit-explicit scheme; "superelement", a converged mesh condensed to its floats, the method of the
            environments; "imex32" and "superelement32", the same in single precision, for batches; "implicit", stable
            at any step; "explicit", central differences.
        time_step: [s], > 0, for imex32 and superelement32 at least 5e-5. A step above ``stable_time_step`` causes a
            ``StabilityWarning``.
        nodes_per_pitch: nodes in one float pitch, >= 1; the study has 4.
        seed: of the perturbation.
        options: ``growing`` (default False): append nodes at the root as cable enters, up to the end of the helix;
            ``time_lapse`` (default 1, real time): length fed in per length travelled, >= 1: the length grows faster
            than the feed speed, which the dynamics keep;
            ``ramp`` (default: no limit): greatest change of the feed speed [m/s2];
            ``air_lag`` (default 0): time constant of the air supply [s];
            ``perturbation`` (default 0, as in the study): standard deviation of random initial radial displacements of
            all nodes [m], for independent members of an ensemble;
            ``start`` (default "inner"): wall on which the probe lies initially; use "outer" for withdrawal, in which
            compression presses the probe against the outer wall.

    Raises:
        ValueError: an argument is not valid; names argument, value and accepted range.
        TypeError: unknown option.
    """

    CHANGING: Final = ("state", "drive", "steps_done", "root", "iterations", "unconverged_steps", "_error")
    """Attributes that change with time."""

    def __init__(
        self,
        scene: Scene,
        method: str | Method = "newmark",
        time_step: float = 1e-4,
        nodes_per_pitch: int = 4,
        *,
        seed: int = 0,
        **options: Unpack[Options],
    ) -> None:
        check_keywords(type(self).__name__, options, DEFAULTS)
        settings = DEFAULTS | options
        self.method: Final = method_named(method)
        within("time_step", time_step, 0.0, 1.0, "s", exclude_low=True)
        check_step(self.method, time_step)
        check_scene(self.method, scene)
        within("time_lapse", settings["time_lapse"], 1.0, 1000.0, "")
        within("ramp", settings["ramp"], 0.0, math.inf, "m/s2", exclude_low=True)
        within("air_lag", settings["air_lag"], 0.0, 1e3, "s")
        within("perturbation", settings["perturbation"], 0.0, 1e-3, "m")
        if settings["start"] not in ("inner", "outer"):
            raise ValueError(f"start = {options['start']!r} is not one of inner, outer")
        whole = not isinstance(nodes_per_pitch, bool) and nodes_per_pitch == int(nodes_per_pitch)
        if not (whole and 1 <= nodes_per_pitch <= 64):
            raise ValueError(f"nodes_per_pitch = {nodes_per_pitch!r} is not a whole number from 1 to 64")
        self.scene = scene
        self.time_step, self.nodes_per_pitch = float(time_step), int(nodes_per_pitch)
        self.growing, self.time_lapse = settings["growing"], settings["time_lapse"]
        self.ramp, self.air_lag = settings["ramp"], settings["air_lag"]
        self.perturbation, self.seed, self.start = settings["perturbation"], seed, settings["start"]
        h = scene.probe.float_pitch / self.nodes_per_pitch
        max_length = math.floor(scene.tube.helix_length / h + 1e-6) * h if self.growing else scene.inserted_length
        self.chain = build_chain(scene, self.nodes_per_pitch, max_length)
        self._start_root = round(scene.inserted_length / h)
        self.sensor = sensor_node(scene, self.nodes_per_pitch)
        self.constants = self._constants()
        self.check_targets(scene.feed_speed, scene.air_supply_rate)
        self.stable_time_step = self.method.stable_step(scene, self.nodes_per_pitch)
        if self.time_step > self.stable_time_step * (1.0 + 1e-9):
            stable = self.stable_time_step
            limit = f"is beyond the known stable limit {stable:.2g} s of" if stable else "has no known limit with"
            warnings.warn(
                f"time_step = {time_step:g} s {limit} {self.method.name} for this scene; the run"
                " stops with SimulationError if it diverges",
                StabilityWarning,
                stacklevel=2,
            )
        self.reset()

    def reset(self) -> None:
        """Return to the initial state: t = 0, at rest, with length, feed speed and air supply of the scene."""
        self.state = at_rest(self.chain.node_count, self.method.memory)
        self.steps_done, self.root = 0, self._start_root
        self.iterations, self.unconverged_steps = 0, 0
        self.drive = Drive(
            feed_speed=self.scene.feed_speed,
            air_speed=air_speed(self.scene, self.scene.air_supply_rate),
            ramp=self.ramp,
            air_lag=self.air_lag,
        )
        self.feed_length()
        self._error: SimulationError | None = None
        if self.start == "outer":
            self.state.d[:] = outer_start(self.chain, self.root)
        if self.perturbation > 0.0:
            noise = np.random.default_rng(self.seed).normal(size=self.root)
            self.state.d[: self.root, 1] += self.perturbation * noise
        if self.start == "outer" or self.perturbation > 0.0:
            self.state = self.method.at_rest(self.chain, self.nodes_per_pitch, self.time_step, self.root, self.state.d)

    def branch(self, scene: Scene | None = None) -> Simulator:
        """An independent copy in the same state, for predictions; constant data are shared.

        Args:
            scene: scene of the copy, with the same mesh; default: the scene of this simulator.

        Raises:
            ValueError: the state does not fit the scene: another mesh or length.
        """
        if scene is None:
            new = copy.copy(self)
        else:
            new = Simulator(
                scene, self.method, self.time_step, self.nodes_per_pitch, growing=self.growing,
                time_lapse=self.time_lapse, ramp=self.ramp, air_lag=self.air_lag, perturbation=self.perturbation,
                seed=self.seed, start=self.start,
            )  # fmt: skip
            if (new.chain.node_count, new.chain.element_length, new.sensor) != (
                self.chain.node_count, self.chain.element_length, self.sensor,
            ):  # fmt: skip
                sizes = [f"{s.chain.node_count} nodes of {s.chain.element_length:g} m" for s in (new, self)]
                raise ValueError(
                    f"scene: {sizes[0]}, sensor at node {new.sensor}; the state has {sizes[1]}, at {self.sensor}"
                )
        new.__dict__.update(copy.deepcopy({name: getattr(self, name) for name in self.CHANGING}))
        return new

    def hold_length(self) -> None:
        """Keep the length constant at any feed speed until ``feed_length`` is called, as in settling."""
        self.drive.growth = 0.0

    def displace(self, radial: FloatArray) -> None:
        """Displace the free nodes radially by ``radial`` (root,), tip first [m], as a disturbance."""
        if radial.shape != (self.root,):
            raise ValueError(f"radial of shape {radial.shape}: one displacement for each of {self.root} free nodes")
        self.state.d[: self.root, 1] += radial

    def feed_length(self) -> None:
        """Change the length by ``time_lapse`` times the feed, if the probe is growing."""
        self.drive.growth = self.time_lapse if self.growing else 0.0

    def follow_length(self) -> None:
        """Change the length by the feed, without time-lapse, if the probe is growing."""
        self.drive.growth = 1.0 if self.growing else 0.0

    def _constants(self) -> Any:
        return self.method.constants(self.chain, self.sensor, self.nodes_per_pitch, self.time_step)

    def drag(self, root: int) -> FloatArray:
        """Drag of every node at the present feed and air, with node ``root`` held."""
        drag = self.chain.drag.copy()
        floats = drag[:: self.nodes_per_pitch]
        floats *= drag_factors(
            self.scene, self.scene.probe.float_pitch * np.arange(len(floats) + 1), self._length_in_helix(root),
            self.drive.feed_speed, self.drive.air_speed,
        )  # fmt: skip
        return drag

    def constants_in_air(self, drag: FloatArray, end: FloatArray, steps: int) -> Any:
        """Constants of one kernel call, in which the drag changes linearly.

        During withdrawal the pressure at every float falls. A drag that is constant in each call would jump between
        calls, and friction amplifies these waves by exp(mu l / r) towards the tip.
        """
        chain = self.chain._replace(drag=drag, drag_rate=(end - drag) / steps)
        return self.method.with_drag(self.constants, chain, self.sensor, self.nodes_per_pitch, self.time_step)

    def __repr__(self) -> str:
        return (
            f"<Simulator by {self.method.name}, step {self.time_step:g} s, {self.inserted_length:.6g} m in {self.root}"
            f" elements, t = {self.time:.6g} s{', diverged' if self.diverged else ''}>"
        )

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self.steps_done * self.time_step

    @property
    def inserted_length(self) -> float:
        """Length of cable inside the helix, including a partial element at the entrance [m]."""
        return self.root * self.chain.element_length + self.drive.travel

    @property
    def length_in_helix(self) -> float:
        """``inserted_length``, at most the length of the helix [m]."""
        return self._length_in_helix(self.root)

    def _length_in_helix(self, root: int) -> float:
        return min(root * self.chain.element_length + self.drive.travel, self.scene.tube.helix_length)

    @property
    def feed_speed(self) -> float:
        """Present feed speed [m/s]."""
        return self.drive.feed_speed

    @property
    def air_supply_rate(self) -> float:
        """Present air supply rate [m3/s]."""
        return self.drive.air_speed / air_speed(self.scene, 1.0)

    @property
    def tension(self) -> FloatArray:
        """(n,) present axial force of every element [N], entrance first."""
        return self.state.tension[self.root - 1 :: -1].copy()

    def run(
        self,
        duration: float = 8.0,
        sample_period: float = 1e-3,
        points: Sequence[str | float] = ("sensor", "tip"),
        snapshots: Sequence[float] = (),
        progress: Callable[[float], None] | bool = False,
    ) -> Run:
        """Simulate from rest at t = 0 with the scene's constant inputs; see ``advance`` for the arguments."""
        self.reset()
        return self.advance(None, None, duration, sample_period, points, snapshots, progress)

    def advance(
        self,
        feed_speed: float | None = None,
        air_supply_rate: float | None = None,
        duration: float | None = None,
        sample_period: float = 1e-3,
        points: Sequence[str | float] = ("sensor", "tip"),
        snapshots: Sequence[float] = (),
        progress: Callable[[float], None] | bool = False,
    ) -> Run:
        """Continue for ``duration`` with new targets of feed speed and air supply.

        Args:
            feed_speed: target [m/s], -2 to 2, approached within the ramp limit. A negative speed withdraws the cable;
                a growing probe stops with the sensor one pitch from the entrance. None: unchanged.
            air_supply_rate: target [m3/s], -0.2 to 0.2, negative: towards the feed device; approached with the air
                lag. None: unchanged.
            duration: [s], a whole number of time steps; required.
            sample_period: [s], a whole number of time steps.
            points: "sensor", "tip", "root" or distances from the tip [m] (the nearest node is used).
            snapshots: ascending times of snapshots of the whole probe [s], on time steps of this run;
                constant length only.
            progress: True shows a progress bar; a function is called repeatedly with the simulated time [s].

        Raises:
            ValueError: an argument is not valid, or the samples exceed the memory limit.
            SimulationError: the state diverged, now or in an earlier call.
        """
        steps = whole_steps("duration", duration, self.time_step)
        every = whole_steps("sample_period", sample_period, self.time_step)
        h, length = self.chain.element_length, self.root * self.chain.element_length
        nodes = np.array([node_of(point, self.sensor, length, h) for point in points], dtype=np.int64)
        if self.growing and len(snapshots) > 0:
            raise ValueError(f"snapshots = {list(snapshots)!r} s need a constant length, and this probe is growing")
        stops = snapshot_steps(snapshots, self.time_step, self.steps_done, steps)
        self.check_targets(feed_speed, air_supply_rate)
        if self._error is not None:
            raise self._error
        self.check_fits()
        recording = Recorder(self.chain, self.state, self.root, nodes, steps, every)
        self.subtract_entrance(recording.signals[:1], nodes, self.state.d[self.root - 1 : self.root])
        self.set_targets(feed_speed, air_supply_rate)
        first, done = self.steps_done, 0
        with progress_bar(progress, self.time, steps * self.time_step) as report:
            while True:
                if done in stops:
                    recording.add_snapshot(self.time, self.state)
                if done == steps:
                    break
                count = min([steps - done, STEPS_PER_CALL, *(s - done for s in stops if s > done)])
                advance_group([self], [recording.samples], done, count)
                if self._error is not None:
                    raise self._error
                done += count
                report(self.time)
        return recording.to_run(first, self.time_step, points)

    def subtract_entrance(self, samples: FloatArray, points: npt.NDArray[np.int64], ahead: FloatArray) -> None:
        """Reduce the root tension in samples (k, p, 4) of p points by the force of the entrance, if it is simulated.

        ``ahead`` (k, 3) is the displacement of the last free node.
        """
        if self.scene.terms.entrance:
            for column in np.flatnonzero(points == ROOT):
                samples[:, column, 3] -= entrance_force(self.chain, ahead, samples[:, column, :3])

    def set_diverged(self) -> None:
        """Store the error of a state that has diverged, with the node that is furthest out."""
        size = np.abs(self.state.d[: self.root]).max(axis=1)
        worst = int(np.argmax(np.where(np.isfinite(size), size, np.inf)))
        distance = worst * self.chain.element_length
        self._error = SimulationError(
            self.method.name, self.time_step, self.time, worst, distance, self.stable_time_step
        )

    @property
    def diverged(self) -> bool:
        """Whether the state has diverged; it cannot be continued then."""
        return self._error is not None

    @property
    def error(self) -> SimulationError | None:
        """The error of a state that has diverged, or None."""
        return self._error

    def check_targets(self, feed_speed: float | None, air_supply_rate: float | None) -> None:
        """Raise ValueError if a target, [m/s] or [m3/s], is out of range or not supported by the method; None is valid.

        Warns of withdrawal or compression with a couple (9) that is not valid for it.
        """
        targets = (("feed_speed", feed_speed, 2.0, "m/s"), ("air_supply_rate", air_supply_rate, 0.2, "m3/s"))
        for name, value, maximum, unit in targets:
            if value is None:
                continue
            within(name, value, -maximum, maximum, unit)
            if value < 0.0 and not self.method.simulates_withdrawal:
                able = method_names(lambda method: method.simulates_withdrawal)
                raise ValueError(
                    f"{name} = {value!r} {unit}: {self.method.name} does not simulate withdrawal; use {able}"
                )
            if value < 0.0 and self.scene.couple == "frame":
                warnings.warn(
                    f'{name} = {value:g} {unit} with couple = "frame": this couple adds energy to a compressed probe,'
                    ' and its root force is about three times too large; use couple = "tangent"',
                    StabilityWarning,
                    stacklevel=3,
                )

    def set_targets(self, feed_speed: float | None, air_supply_rate: float | None) -> None:
        """Set new targets [m/s], [m3/s]; None leaves a target unchanged."""
        if feed_speed is not None:
            self.drive.feed_speed_target = float(feed_speed)
        if air_supply_rate is not None:
            self.drive.air_speed_target = air_speed(self.scene, float(air_supply_rate))

    def set_friction(self, friction: float) -> None:
        """Change the coefficient of friction."""
        within("friction", friction, 0.0, 1.0, "")
        self.chain = self.chain._replace(friction=float(friction))
        self.constants = self._constants()

    def check_fits(self) -> None:
        """Raise ValueError if the state does not fit the chain; users may change its arrays."""
        check_state(self.state, self.root, self.chain.node_count, self.method.memory)
        check_points(np.array([self.sensor]), self.root)
