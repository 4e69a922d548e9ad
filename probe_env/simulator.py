"""A probe of constant length: state, stepping, sampling, and an error when the state diverges."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Callable, Sequence
from functools import partial
from typing import Final

import numpy as np

from probe_env import banded, ticm, transfer_matrix
from probe_env.chain import Chain, FloatArray, build_chain, sensor_node
from probe_env.run import Run, Shapes, point_name
from probe_env.scene import Scene
from probe_env.stability import stable_time_step

METHODS: Final[dict[str, Callable[[float], ticm.Scheme]]] = {"newmark": ticm.newmark, "wilson": ticm.wilson}
SOLVERS: Final = ("ticm", "banded", "transfer-matrix")
STEPS_PER_CALL: Final = 2000
"""Longest stretch in one kernel call: how often progress is shown and an interrupt is heard."""


class StabilityWarning(UserWarning):
    """The time step is beyond the method's known stable limit."""


class SimulationError(RuntimeError):
    """The simulated state diverged.

    Attributes:
        method, time_step: what was used.
        time: time reached [s].
        node: the worst node, counted from the tip.
        stable_time_step: the step that is known to hold [s]; 0 if none is.
    """

    def __init__(self, method: str, time_step: float, time: float, node: int, distance: float, stable: float) -> None:
        self.method, self.time_step, self.time, self.node = method, time_step, time, node
        self.stable_time_step = stable
        if stable == 0.0:
            hint = "no time step is known to hold for this scene: raise probe.damping_time or nodes_per_pitch"
        elif time_step > stable:
            hint = f"a time step of {stable:.2g} s or less is known to hold for this scene"
        else:
            hint = f"the step is within the known limit of {stable:.2g} s: halve it, and check the scene"
        super().__init__(
            f"{method} with time_step {time_step:g} s diverged at t = {time:.6g} s;"
            f" worst at node {node}, {distance:g} m from the tip; {hint}"
        )

    def __reduce__(self) -> tuple[object, ...]:
        """Keep the error picklable, so that it can leave a worker process."""
        return _rebuild_error, (type(self), self.args, dict(self.__dict__))


def _rebuild_error(kind: type[SimulationError], args: tuple[str], attributes: dict[str, object]) -> SimulationError:
    error = kind.__new__(kind, *args)
    error.__dict__.update(attributes)
    return error


class Simulator:
    """Advances one probe of constant length with constant feed speed and air supply.

    Args:
        scene: what to simulate.
        method: "newmark" (beta 1/4, gamma 1/2) or "wilson" (theta 1.4), the study's table 1.
        time_step: [s], > 0. Beyond ``stable_time_step`` a ``StabilityWarning`` is given, nothing refused.
        nodes_per_pitch: nodes in one float pitch, >= 1; the study has 4.
        solver: of the linear system of a step: "ticm", "banded" (LAPACK) or "transfer-matrix".
        perturbation: standard deviation of a random radial start displacement of all nodes [m], to get
            independent members of an ensemble; 0 is the study's start.
        seed: of the perturbation.

    Raises:
        ValueError: an argument is not valid; names it, its value and what is accepted.
    """

    def __init__(
        self,
        scene: Scene,
        method: str = "newmark",
        time_step: float = 1e-4,
        nodes_per_pitch: int = 4,
        *,
        solver: str = "ticm",
        perturbation: float = 0.0,
        seed: int = 0,
    ) -> None:
        if method not in METHODS:
            raise ValueError(f"method = {method!r} is not one of {', '.join(METHODS)}")
        if solver not in SOLVERS:
            raise ValueError(f"solver = {solver!r} is not one of {', '.join(SOLVERS)}")
        if not 0.0 < time_step <= 1.0:
            raise ValueError(f"time_step = {time_step!r} s is outside the accepted range 0 (excluded) to 1 s")
        if (
            isinstance(nodes_per_pitch, bool)
            or nodes_per_pitch != int(nodes_per_pitch)
            or not 1 <= nodes_per_pitch <= 64
        ):
            raise ValueError(f"nodes_per_pitch = {nodes_per_pitch!r} is not a whole number from 1 to 64")
        if not 0.0 <= perturbation <= 1e-3:
            raise ValueError(f"perturbation = {perturbation!r} m is outside the accepted range 0 to 1e-3 m")
        self.scene, self.method, self.solver = scene, method, solver
        self.time_step, self.nodes_per_pitch = float(time_step), int(nodes_per_pitch)
        self.perturbation, self.seed = perturbation, seed
        self._prepare(build_chain(scene, self.nodes_per_pitch))
        if self.time_step > self.stable_time_step * (1.0 + 1e-9):
            warnings.warn(
                f"time_step = {time_step:g} s is beyond the known stable limit {self.stable_time_step:.2g} s of"
                f" {method} for this scene; the run stops with SimulationError if it diverges",
                StabilityWarning,
                stacklevel=2,
            )

    def _prepare(self, chain: Chain) -> None:
        self.chain = chain
        self.scheme = METHODS[self.method](self.time_step)
        self.stable_time_step = stable_time_step(self.scene, self.nodes_per_pitch)
        self._work = ticm.workspace(chain.node_count)
        self._step: Callable[[ticm.State, ticm.Work], int] | None = None  # None: the fused kernel
        if self.solver == "banded":
            self._step = banded.stepper(chain, self.scheme)
        elif self.solver == "transfer-matrix":
            self._step = partial(transfer_matrix.step, chain, self.scheme)
        self.reset()

    def reset(self) -> None:
        """Back to rest at t = 0."""
        self.state = ticm.at_rest(self.chain.node_count)
        self.steps_done = 0
        self._error: SimulationError | None = None
        if self.perturbation > 0.0:
            noise = np.random.default_rng(self.seed).normal(size=self.chain.node_count - 1)
            self.state.d[:-1, 1] = self.perturbation * noise

    def __getstate__(self) -> dict[str, object]:
        """Everything but the solver's closures and scratch, which are rebuilt."""
        return {k: v for k, v in self.__dict__.items() if k not in ("_step", "_work")}

    def __setstate__(self, saved: dict[str, object]) -> None:
        self.__dict__.update(saved)
        state, steps_done, error = self.state, self.steps_done, self._error
        self._prepare(self.chain)
        self.state, self.steps_done, self._error = state, steps_done, error

    @property
    def time(self) -> float:
        """Simulated time [s]."""
        return self.steps_done * self.time_step

    @property
    def tension(self) -> FloatArray:
        """(n,) axial force of every element now [N], entrance first."""
        return self.state.axial_force[-2::-1].copy()

    def run(
        self,
        duration: float = 8.0,
        sample_period: float = 1e-3,
        points: Sequence[str | float] = ("sensor", "tip"),
        snapshots: Sequence[float] = (),
        progress: Callable[[float], None] | None = None,
    ) -> Run:
        """Simulate from rest at t = 0; see ``advance`` for the arguments."""
        self.reset()
        return self.advance(duration, sample_period, points, snapshots, progress)

    def advance(
        self,
        duration: float,
        sample_period: float = 1e-3,
        points: Sequence[str | float] = ("sensor", "tip"),
        snapshots: Sequence[float] = (),
        progress: Callable[[float], None] | None = None,
    ) -> Run:
        """Continue for ``duration``.

        Args:
            duration: [s], a whole number of time steps.
            sample_period: [s], a whole number of time steps.
            points: "sensor", "tip", "root" or distances from the tip [m] (the nearest node is taken).
            snapshots: times of whole-probe snapshots [s], ascending, within this run, on a time step.
            progress: called now and then with the simulated time [s].

        Raises:
            ValueError: an argument is not valid.
            SimulationError: the state diverged, now or in an earlier call.
        """
        steps = self._whole_steps("duration", duration)
        every = self._whole_steps("sample_period", sample_period)
        nodes = np.array([self._node(point) for point in points], dtype=np.int64)
        stops = self._snapshot_steps(snapshots, steps)
        if self._error is not None:
            raise self._error
        samples = np.zeros((steps // every + 1, len(nodes), 4))
        discard = np.zeros(self.chain.node_count)
        tension_sum = np.zeros(self.chain.node_count)
        ticm.record(self.state, nodes, samples, 0, discard)
        start, done, shapes = self.steps_done, 0, []
        while True:
            if done in stops:
                shapes.append((self.time, self.state.d.copy(), self.state.axial_force.copy()))
            if done == steps:
                break
            stretch = min([steps - done, STEPS_PER_CALL, *(s - done for s in stops if s > done)])
            self._advance_steps(stretch, every - done % every, every, nodes, samples[done // every + 1 :], tension_sum)
            done += stretch
            if progress is not None:
                progress(self.time)
        h, n = self.chain.element_length, self.chain.node_count - 1
        return Run(
            time=(start + every * np.arange(len(samples))) * self.time_step,
            axial=samples[:, :, 0].copy(),
            radial=samples[:, :, 1].copy(),
            rotation=samples[:, :, 2].copy(),
            tension=samples[:, :, 3].copy(),
            points=tuple(point_name(point) for point in points),
            distance_from_tip=nodes * h,
            mean_tension=tension_sum[-2::-1] / max(len(samples) - 1, 1),
            position=(np.arange(n) + 0.5) * h,
            shapes=_shapes(shapes, h) if shapes else None,
        )

    def _advance_steps(
        self,
        steps: int,
        first: int,
        every: int,
        nodes: np.ndarray,
        samples: FloatArray,
        tension_sum: FloatArray,
    ) -> None:
        """Steps in one go; counts them, and turns a diverged state into an error."""
        if self._step is None:
            status, done, node = ticm.advance(
                self.chain,
                self.scheme,
                self.state,
                self._work,
                steps,
                first,
                every,
                nodes,
                samples,
                tension_sum,
            )
        else:
            status, done, node, row = ticm.OK, 0, -1, 0
            while done < steps and status == ticm.OK:
                node = self._step(self.state, self._work)
                done += 1
                status = ticm.DIVERGED if node >= 0 else ticm.OK
                if status == ticm.OK and (done - first) % every == 0 and done >= first:
                    ticm.record(self.state, nodes, samples, row, tension_sum)
                    row += 1
        self.steps_done += int(done)
        if status != ticm.OK:
            size = np.abs(self.state.d[:-1]).max(axis=1)
            worst = int(np.argmax(np.where(np.isfinite(size), size, np.inf)))
            self._error = SimulationError(
                self.method,
                self.time_step,
                self.time,
                worst,
                worst * self.chain.element_length,
                self.stable_time_step,
            )
            raise self._error

    def _whole_steps(self, name: str, value: float) -> int:
        ratio = value / self.time_step
        if not (np.isfinite(ratio) and round(ratio) >= 1 and abs(ratio - round(ratio)) <= 1e-9 * ratio):
            raise ValueError(
                f"{name} = {value!r} s is not a whole number (1 or more) of time steps of {self.time_step:g} s"
            )
        return round(ratio)

    def _node(self, point: str | float) -> int:
        length = self.scene.inserted_length
        if isinstance(point, str):
            named = {
                "sensor": sensor_node(self.scene, self.nodes_per_pitch),
                "tip": 0,
                "root": self.chain.node_count - 1,
            }
            if point not in named:
                raise ValueError(
                    f"points: {point!r} is not sensor, tip, root or a distance from the tip of 0 to {length:g} m"
                )
            return named[point]
        if not 0.0 <= point <= length + 1e-9:
            raise ValueError(f"points: {point!r} m from the tip is outside the inserted length 0 to {length:g} m")
        return round(point / self.chain.element_length)

    def _snapshot_steps(self, snapshots: Sequence[float], steps: int) -> list[int]:
        ratios = [time / self.time_step - self.steps_done for time in snapshots]
        for time, ratio in zip(snapshots, ratios, strict=True):
            if not (-1e-6 <= ratio <= steps + 1e-6 and abs(ratio - round(ratio)) <= 1e-6):
                raise ValueError(
                    f"snapshots: {time!r} s is not on a time step of {self.time_step:g} s within this run,"
                    f" {self.time:g} to {self.time + steps * self.time_step:g} s"
                )
        whole = [round(ratio) for ratio in ratios]
        if any(later <= earlier for earlier, later in itertools.pairwise(whole)):
            raise ValueError(f"snapshots = {list(snapshots)!r} s must ascend")
        return whole


def _shapes(stored: list[tuple[float, FloatArray, FloatArray]], h: float) -> Shapes:
    d = np.array([entry[1] for entry in stored])[:, ::-1]
    return Shapes(
        time=np.array([entry[0] for entry in stored]),
        position=np.arange(d.shape[1]) * h,
        axial=d[:, :, 0].copy(),
        radial=d[:, :, 1].copy(),
        rotation=d[:, :, 2].copy(),
        tension=np.array([entry[2][-2::-1] for entry in stored]),
    )
