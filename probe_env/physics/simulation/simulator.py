"""One probe: state, driving, stepping, sampling, and an error when the state diverges."""

from __future__ import annotations

import copy
import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, Literal, TypedDict, Unpack

import numpy as np

from probe_env.arrays import FloatArray
from probe_env.errors import SimulationError, StabilityWarning
from probe_env.physics.methods import check_step, method_named, names_of
from probe_env.physics.methods.method import Lane, Method
from probe_env.physics.model.chain import air_speed, build_chain, outer_start, sensor_node
from probe_env.physics.model.drive import Drive
from probe_env.physics.model.state import State, at_rest, check_points, check_state
from probe_env.physics.simulation.run import Recording, Run, Samples, node_of, shown, snapshot_steps
from probe_env.physics.simulation.saved import FORMAT, check_format, check_names, check_same, check_types
from probe_env.scene import Scene
from probe_env.settings import check_known, whole_steps, within

STEPS_PER_CALL: Final = 2000
"""Longest stretch in one kernel call: how often progress is shown and an interrupt is heard."""


class Options(TypedDict, total=False):
    """How a probe starts and is fed; see ``Simulator`` for what they mean."""

    solver: str
    growing: bool
    time_lapse: float
    ramp: float
    air_lag: float
    perturbation: float
    start: Literal["inner", "outer"]


DEFAULTS: Final[Options] = {
    "solver": "ticm", "growing": False, "time_lapse": 1.0, "ramp": math.inf, "air_lag": 0.0, "perturbation": 0.0,
    "start": "inner",
}  # fmt: skip


def advance_together(simulators: Sequence[Simulator], samples: Sequence[Samples], done: int, steps: int) -> float:
    """Advance probes of one method and kind side by side; a probe by itself is a group of one.

    A probe that diverges keeps its error, and its samples end there.

    Args:
        simulators: the probes, with equal steps and nodes a pitch.
        samples: of each, with equal periods and as many points.
        done: steps since the first of these began.
        steps: to do, at most ``STEPS_PER_CALL`` by custom.

    Returns:
        seconds that the kernel took.
    """
    first = simulators[0]
    lanes = [
        Lane(s.constants, s.state, s.root, s.inputs_of_steps(steps), own.points, own.due(done, steps), own.tension_sum)
        for s, own in zip(simulators, samples, strict=True)
    ]
    every = samples[0].every
    seconds = first.method.run(lanes, first.time_step, first.nodes_per_pitch, every - done % every, every)
    for simulator, lane in zip(simulators, lanes, strict=True):
        simulator.note(lane, steps)
    return seconds


class Simulator:
    """Advances one probe, of constant length or growing as it is fed in.

    ``iterations`` and ``unconverged_steps`` count, since the start, the iterations of ``implicit`` and its steps
    in which they did not converge (see ``methods.implicit`` for what is done then).

    Args:
        scene: what to simulate; its carrier length is the one at the start.
        method: "newmark" (beta 1/4, gamma 1/2) or "wilson" (theta 1.4), the study's table 1; "imex", the fast
            scheme; "superelement", a converged mesh condensed to its floats, which environments have; "imex32" and
            "superelement32", the same in single precision, for batches; "implicit", which holds with any step;
            "explicit", central differences.
        time_step: [s], > 0, for imex32 and superelement32 at least 5e-5. Beyond ``stable_time_step`` a
            ``StabilityWarning`` is given, nothing refused.
        nodes_per_pitch: nodes in one float pitch, >= 1; the study has 4.
        seed: of the perturbation.
        options: ``solver`` of the linear system of a step: "ticm" (default), "banded" (LAPACK) or "transfer-matrix";
            ``growing`` (default False): feed the probe in: nodes are appended at the root as cable enters, up to the
            helix's end;
            ``time_lapse`` (default 1, the truth): length fed in per length travelled, >= 1: the length grows faster
            than the clock while the dynamics keep the true speed;
            ``ramp`` (default: none): greatest change of the feed speed [m/s2];
            ``air_lag`` (default 0): time constant with which the air supply follows its target [s];
            ``perturbation`` (default 0, the study's start): standard deviation of a random radial start displacement of
            all nodes [m], to get independent members of an ensemble;
            ``start`` (default "inner"): the wall that the probe lies on at rest; "outer" is for the return, in which it
            is pressed there: from the inner wall it would have to fall across the tube.

    Raises:
        ValueError: an argument is not valid; names it, its value and what is accepted.
        TypeError: there is no such option.
    """

    BUILT: Final = ("method", "solver", "time_step", "nodes_per_pitch", "growing", "time_lapse", "ramp", "air_lag")
    """Those that a state depends on, with the scene."""
    FIXED: Final = frozenset(BUILT) | {
        "scene", "perturbation", "seed", "start", "chain", "sensor", "stable_time_step", "_start_root", "constants",
    }  # fmt: skip
    """Attributes that nothing changes after the constructor; all others are in a snapshot."""

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
        check_known(type(self).__name__, options, DEFAULTS)
        given = DEFAULTS | options
        self.method: Final = method_named(method, given["solver"])
        within("time_step", time_step, 0.0, 1.0, "s", exclude_low=True)
        check_step(self.method, time_step)
        within("time_lapse", given["time_lapse"], 1.0, 1000.0, "")
        within("ramp", given["ramp"], 0.0, math.inf, "m/s2", exclude_low=True)
        within("air_lag", given["air_lag"], 0.0, 1e3, "s")
        within("perturbation", given["perturbation"], 0.0, 1e-3, "m")
        if given["start"] not in ("inner", "outer"):
            raise ValueError(f"start = {given['start']!r} is not one of inner, outer")
        whole = not isinstance(nodes_per_pitch, bool) and nodes_per_pitch == int(nodes_per_pitch)
        if not (whole and 1 <= nodes_per_pitch <= 64):
            raise ValueError(f"nodes_per_pitch = {nodes_per_pitch!r} is not a whole number from 1 to 64")
        self.scene, self.solver = scene, given["solver"]
        self.time_step, self.nodes_per_pitch = float(time_step), int(nodes_per_pitch)
        self.growing, self.time_lapse = given["growing"], given["time_lapse"]
        self.ramp, self.air_lag = given["ramp"], given["air_lag"]
        self.perturbation, self.seed, self.start = given["perturbation"], seed, given["start"]
        h = scene.probe.float_pitch / self.nodes_per_pitch
        longest = math.floor(scene.tube.helix_length / h + 1e-6) * h if self.growing else scene.inserted_length
        self.chain = build_chain(scene, self.nodes_per_pitch, longest)
        self._start_root = round(scene.inserted_length / h)
        self.sensor = sensor_node(scene, self.nodes_per_pitch)
        self.constants = self._constants()
        self.check_targets(scene.feed_speed, scene.air_supply_rate)
        self.stable_time_step = self.method.stable_step(scene, self.nodes_per_pitch)
        if self.time_step > self.stable_time_step * (1.0 + 1e-9):
            warnings.warn(
                f"time_step = {time_step:g} s is beyond the known stable limit {self.stable_time_step:.2g} s of"
                f" {self.method.name} for this scene; the run stops with SimulationError if it diverges",
                StabilityWarning,
                stacklevel=2,
            )
        self.reset()

    def reset(self) -> None:
        """Back to rest at t = 0, at the scene's length, feed speed and air supply."""
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
        """Another one in the same state, which goes on by itself: what a controller tries out, see ``SimulatorBatch``.

        What nothing changes is shared with this one.

        Args:
            scene: another one to go on in, with the same mesh; default: this one's.

        Raises:
            ValueError: the state does not fit the scene: another mesh or length.
        """
        if scene is None:
            new = object.__new__(type(self))
            new.__dict__.update(self.__dict__)
        else:
            new = Simulator(
                scene, self.method, self.time_step, self.nodes_per_pitch, solver=self.solver, growing=self.growing,
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
        new.__dict__.update(copy.deepcopy(self._changing()))
        return new

    def hold_length(self) -> None:
        """Feed without the length growing, until ``feed_length``: a probe that settles inspects nothing."""
        self.drive.growth = 0.0

    def displace(self, radial: FloatArray) -> None:
        """Move the free nodes radially by (root,) displacements, tip first [m]: what is not known of a state.

        Raises:
            ValueError: of another shape.
        """
        if radial.shape != (self.root,):
            raise ValueError(f"radial of shape {radial.shape}: one displacement for each of {self.root} free nodes")
        self.state.d[: self.root, 1] += radial

    def feed_length(self) -> None:
        """Let the length grow with the feed, where the probe is a growing one."""
        self.drive.growth = self.time_lapse if self.growing else 0.0

    def follow_length(self) -> None:
        """Let the length go with the feed as it is, without time-lapse, where the probe is a growing one."""
        self.drive.growth = 1.0 if self.growing else 0.0

    def snapshot(self) -> dict[str, Any]:
        """Everything that changes with time, as a copy for ``restore``, and what it belongs to."""
        return {"format": FORMAT, "built": self._built(), "changing": copy.deepcopy(self._changing())}

    def restore(self, snapshot: Mapping[str, Any]) -> None:
        """Back to a snapshot of this simulator, or of one built alike; goes on bit for bit as it did.

        Alike is all but ``perturbation`` and ``seed``, which only ``reset`` looks at.

        Raises:
            ValueError: not a snapshot, of another version, or of one built otherwise; names the field, what was found
                and what is accepted. Nothing has been changed then.
        """
        self.__dict__.update(copy.deepcopy(self.checked(snapshot)))

    def checked(self, snapshot: Mapping[str, Any], what: str = "snapshot") -> Mapping[str, Any]:
        """What ``restore`` would take from a snapshot; its errors name it ``what``."""
        snapshot = check_names(what, check_format(what, snapshot), ("format", "built", "changing"))
        check_same(what, snapshot["built"], self._built())
        changing = check_names(f"{what}: changing", snapshot["changing"], self._changing())
        self._check_changing(what, changing)
        return changing

    def _built(self) -> dict[str, Any]:
        built = {name: getattr(self, name) for name in self.BUILT}
        return built | {"method": self.method.name, "scene": self.scene.model_dump()}

    def _changing(self) -> dict[str, Any]:
        """All but what is declared as fixed: what was forgotten there is saved needlessly, never lost."""
        return {name: value for name, value in self.__dict__.items() if name not in self.FIXED}

    def __getstate__(self) -> dict[str, Any]:
        """Everything but the kernel's constants, which are made again."""
        return {"format": FORMAT} | {name: value for name, value in self.__dict__.items() if name != "constants"}

    def __setstate__(self, saved: Mapping[str, Any]) -> None:
        state = dict(check_format(f"pickled {type(self).__name__}", saved))
        del state["format"]
        self.__dict__.update(state)
        self.constants = self._constants()

    def _check_changing(self, what: str, changing: Mapping[str, Any]) -> None:
        counts = ("steps_done", "root", "iterations", "unconverged_steps")
        check_types(what, changing, {"state": State, "drive": Drive} | dict.fromkeys(counts, int))
        check_names(f"{what}: drive", vars(changing["drive"]), vars(self.drive))
        nodes, memory = self.chain.node_count, self.method.memory
        check_state(changing["state"], changing["root"], nodes, memory, f"{what}: state")
        if not isinstance(changing["_error"], SimulationError | None):
            raise ValueError(f"{what}: _error = {changing['_error']!r} is not a SimulationError or None")

    def _constants(self) -> Any:
        return self.method.constants(self.chain, self.sensor, self.nodes_per_pitch, self.time_step)

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
        """Cable inside the helix, the part of an element that has not got its node yet included [m]."""
        return self.root * self.chain.element_length + self.drive.travel

    @property
    def length_in_helix(self) -> float:
        """``inserted_length``, and not more than the helix is long [m]."""
        return min(self.inserted_length, self.scene.tube.helix_length)

    @property
    def feed_speed(self) -> float:
        """Feed speed now [m/s]."""
        return self.drive.feed_speed

    @property
    def air_supply_rate(self) -> float:
        """Air supply rate now [m3/s]."""
        return self.drive.air_speed / air_speed(self.scene, 1.0)

    @property
    def tension(self) -> FloatArray:
        """(n,) axial force of every element now [N], entrance first."""
        return self.state.axial_force[self.root - 1 :: -1].copy()

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
        """Continue for ``duration`` towards new targets of feed speed and air supply.

        Args:
            feed_speed: target [m/s], -2 to 2, approached within the ramp limit. Below 0 the cable is drawn back, of a
                growing probe until the sensor is a pitch from the entrance. None: as before.
            air_supply_rate: target [m3/s], -0.2 to 0.2, below 0 towards the feed device; approached with the air's
                lag. None: as before.
            duration: [s], a whole number of time steps; must be given.
            sample_period: [s], a whole number of time steps.
            points: "sensor", "tip", "root" or distances from the tip [m] (the nearest node is taken).
            snapshots: times of whole-probe snapshots [s], ascending, within this run, on a time step;
                constant length only.
            progress: True shows a bar; a function is called now and then with the simulated time [s].

        Raises:
            ValueError: an argument is not valid, or the samples would not fit in memory.
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
        recording = Recording(self.chain, self.state, self.root, nodes, steps, every)
        self.set_targets(feed_speed, air_supply_rate)
        first, done = self.steps_done, 0
        with shown(progress, self.time, steps * self.time_step) as tell:
            while True:
                if done in stops:
                    recording.keep_shape(self.time, self.state)
                if done == steps:
                    break
                stretch = min([steps - done, STEPS_PER_CALL, *(s - done for s in stops if s > done)])
                advance_together([self], [recording.samples], done, stretch)
                if self._error is not None:
                    raise self._error
                done += stretch
                tell(self.time)
        return recording.as_run(first, self.time_step, points)

    def inputs_of_steps(self, steps: int) -> FloatArray:
        """Inputs (steps, 4) of the coming steps, see model/drive.py; the drive moves on to their end."""
        room, spare = self.chain.node_count - 1 - self.root, self.root - self.sensor - self.nodes_per_pitch
        return self.drive.inputs_of_steps(steps, self.time_step, self.chain.element_length, room, max(spare, 0))

    def note(self, lane: Lane, steps: int) -> None:
        """Count the steps that a kernel has done on this state, and keep the error if it diverged."""
        self.steps_done += lane.failed or steps
        self.root = int(lane.root)
        self.iterations += lane.iterations
        self.unconverged_steps += lane.unconverged
        # the lanes look at floats and the tip only: nothing that is not finite may go on from here
        if lane.failed or not np.isfinite(self.state.d[: self.root]).all():
            size = np.abs(self.state.d[: self.root]).max(axis=1)
            worst = int(np.argmax(np.where(np.isfinite(size), size, np.inf)))
            distance = worst * self.chain.element_length
            self._error = SimulationError(
                self.method.name, self.time_step, self.time, worst, distance, self.stable_time_step
            )

    @property
    def diverged(self) -> bool:
        """Whether the state has diverged; it is not continued then."""
        return self._error is not None

    @property
    def error(self) -> SimulationError | None:
        """Why the state is not continued, if it has diverged."""
        return self._error

    def check_targets(self, feed_speed: float | None, air_supply_rate: float | None) -> None:
        """Raise ValueError if a target, [m/s] or [m3/s], is out of range or not for this method; None is none.

        Warns where a probe is pressed or drawn back and the couple of (9) is not fit for it.
        """
        targets = (("feed_speed", feed_speed, 2.0, "m/s"), ("air_supply_rate", air_supply_rate, 0.2, "m3/s"))
        for name, value, most, unit in targets:
            if value is None:
                continue
            within(name, value, -most, most, unit)
            if value < 0.0 and not self.method.draws_back:
                able = names_of(lambda known: known.draws_back)
                raise ValueError(
                    f"{name} = {value!r} {unit}: {self.method.name} does not simulate the return; {able} do"
                )
            if value < 0.0 and self.scene.couple == "frame":
                warnings.warn(
                    f'{name} = {value:g} {unit} with couple = "frame": counted from the frame the couple of (9) feeds a'
                    ' pressed probe, whose root force is some three times too large; couple = "tangent" does not',
                    StabilityWarning,
                    stacklevel=3,
                )

    def set_targets(self, feed_speed: float | None, air_supply_rate: float | None) -> None:
        """New targets [m/s], [m3/s]; None leaves one as it is."""
        if feed_speed is not None:
            self.drive.feed_speed_target = float(feed_speed)
        if air_supply_rate is not None:
            self.drive.air_speed_target = air_speed(self.scene, float(air_supply_rate))

    def set_friction(self, friction: float) -> None:
        """Slide with another coefficient of friction from now on; a snapshot does not keep it.

        Raises:
            ValueError: it is out of range.
        """
        within("friction", friction, 0.0, 1.0, "")
        self.chain = self.chain._replace(friction=float(friction))
        self.constants = self._constants()

    def check_fits(self) -> None:
        """Raise ValueError if the state is not one of this chain any more: its arrays are open to the user."""
        check_state(self.state, self.root, self.chain.node_count, self.method.memory)
        check_points(np.array([self.sensor]), self.root)
