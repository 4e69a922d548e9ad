"""What a method is: how it advances a chain, how accurate it is and up to which step it holds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from probe_env.arrays import FloatArray
from probe_env.physics.methods import ticm
from probe_env.physics.methods.lane_group import Lane, LaneKernel
from probe_env.physics.methods.stability import contact_step, known_step
from probe_env.physics.model.chain import Chain
from probe_env.physics.model.kernel_call import Sampling, check_call, check_chain
from probe_env.physics.model.state import State, at_rest
from probe_env.scene import Scene

Advance = Callable[[FloatArray, int, State, Sampling], tuple[int, int, int, int]]
"""(inputs, root, state, sampling) -> (status, steps done, diverged node or -1, root)."""
Prepare = Callable[[Chain, float, int, int], Advance]
"""(chain, time step [s], sensor's node, nodes a pitch) -> the advance function, constants and scratch prepared."""
Limit = Callable[[Scene, int], float]
"""(scene, nodes a pitch) -> time step [s]."""


@dataclass(frozen=True)
class Method:
    """A method that advances a chain in time.

    Attributes:
        name: by which it is asked for.
        prepare: its advance function for a chain.
        order: of convergence where the motion is smooth.
        usual_step: that table 2's probe is simulated with [s].
        stable_step: largest step known to hold; 0 where none is known.
        contact_step: largest step that contact allows, whatever damping and mesh: beyond it a run diverges.
        least_step: below which rounding shows [s].
        solved_by: the advance function with another solver of the linear system, where there can be one.
        lanes: the kernel of a method that advances several probes side by side.
        memory: numbers a node that it keeps of its last step.
        start: a state at rest, where displacements are not all of it; arguments of ``at_rest``.
        draws_back: whether it simulates the return: pressed on the outer wall, and drawn out at the root.
    """

    name: str
    prepare: Prepare
    order: int
    usual_step: float
    stable_step: Limit = known_step
    contact_step: Limit = contact_step
    least_step: float = 0.0
    solved_by: Callable[[Any], Prepare] | None = None
    lanes: LaneKernel | None = None
    memory: int = 3
    start: Callable[[Chain, int, float, int, FloatArray], State] | None = None
    draws_back: bool = True

    def at_rest(self, chain: Chain, nodes_per_pitch: int, time_step: float, root: int, d: FloatArray) -> State:
        """A state at rest with displacements d (n + 1, 3) [m, rad] of a chain held at ``root``."""
        if self.start is not None:
            return self.start(chain, nodes_per_pitch, time_step, root, d)
        return at_rest(len(d), self.memory)._replace(d=d.copy())

    @property
    def width(self) -> int:
        """Probes side by side in a group."""
        return self.lanes.width if self.lanes else 1

    @property
    def alone_share(self) -> float:
        """Time that a probe by itself takes, of that of a full group."""
        return self.lanes.alone_share if self.lanes else 1.0

    def check_step(self, time_step: float) -> None:
        """Raise ValueError if a step [s] is so small that rounding shows."""
        if time_step < self.least_step:
            raise ValueError(
                f"time_step = {time_step!r} s is below {self.least_step:g} s, where the rounding of {self.name} shows:"
                f" {names_of(lambda known: known.least_step == 0.0)} have no such limit"
            )

    def build(self, chain: Chain, time_step: float, sensor: int, nodes_per_pitch: int, solver: Any = None) -> Advance:
        """The advance function, with its constant matrices and scratch prepared.

        ``sensor`` is the sensor's node; guide floats reach from the tip up to it. What the function is called with is
        checked once a call: an array that does not fit the chain is a ``ValueError`` that names it.

        Args:
            chain: what is advanced.
            time_step: [s].
            sensor: node.
            nodes_per_pitch: nodes in a float pitch.
            solver: one of ``SOLVERS`` for the linear system of a step; default: the method's own.

        Raises:
            ValueError: arrays of the chain that do not fit each other, a chain with what the method does not simulate,
                or a solver for a method that has no such system.
        """
        check_chain(chain, sensor, nodes_per_pitch)
        prepare = self.prepare
        if solver is not None:
            if self.solved_by is None:
                raise ValueError(
                    f"solver: {self.name} has its own;"
                    f" {names_of(lambda known: known.solved_by is not None)} take another"
                )
            prepare = self.solved_by(solver)
        advance = prepare(chain, time_step, sensor, nodes_per_pitch)
        return partial(_checked, advance, chain.node_count, self.memory)


def names_of(which: Callable[[Method], bool]) -> str:
    """Names of those methods, for an error that says which ones can do what another cannot."""
    from probe_env.physics.methods import METHODS  # which has them all, this module below it

    return ", ".join(name for name, method in METHODS.items() if which(method))


def _checked(
    advance: Advance, nodes: int, memory: int, inputs: FloatArray, root: int, state: State, sampling: Sampling
) -> tuple[int, int, int, int]:
    check_call(nodes, memory, inputs, root, state, sampling)
    return advance(inputs, root, state, sampling)


def lane_method(name: str, lanes: LaneKernel, **declared: Any) -> Method:
    """A method whose kernel advances several probes side by side; one probe is a group of one.

    ``declared`` are the other fields of ``Method``.
    """
    return Method(name, partial(_prepare_lane, name, lanes), lanes=lanes, **declared)


def _prepare_lane(
    name: str, kernel: LaneKernel, chain: Chain, time_step: float, sensor: int, nodes_per_pitch: int
) -> Advance:
    check_lane_chain(name, chain, sensor, nodes_per_pitch)
    parameters, factors = kernel.constants(chain, sensor, nodes_per_pitch, time_step)

    def advance(inputs: FloatArray, root: int, state: State, sampling: Sampling) -> tuple[int, int, int, int]:
        first, every, points, samples, tension_sum, _ = sampling
        rows = samples[: max(0, (len(inputs) - first) // every + 1)]
        lane = Lane(parameters, factors, state, root, points, inputs, rows)
        (failed,), _ = kernel.run([lane], time_step, nodes_per_pitch, first, every, tension_sum)
        status = ticm.DIVERGED if failed else ticm.OK
        return status, failed or len(inputs), -1, lane.root

    return advance


def check_lane_chain(method: str, chain: Chain, sensor: int, nodes_per_pitch: int) -> None:
    """Raise ValueError if a chain has what the kernels of the lanes do not look at.

    They know a float at every ``nodes_per_pitch``-th node from the tip, alike up to the sensor and alike behind it, and
    neither loads nor supports.
    """
    for field in ("load", "support_stiffness"):
        if getattr(chain, field).any():
            raise ValueError(
                f"chain.{field} is not zero: {method} does not simulate it;"
                f" {names_of(lambda known: known.lanes is None)} do"
            )
    index = np.arange(chain.node_count - 1)
    is_float, first = index % nodes_per_pitch == 0, (sensor // nodes_per_pitch + 1) * nodes_per_pitch
    alike = np.where(index <= sensor, 0, min(first, chain.node_count - 1))
    for field in ("contact_stiffness", "drag", "lever", "outer_gap"):
        values = getattr(chain, field)
        expected = values[alike if field != "contact_stiffness" else np.zeros_like(index)]
        bad = np.flatnonzero(is_float & (values[:-1] != expected))
        if not len(bad) and field in ("contact_stiffness", "drag"):
            bad = np.flatnonzero(~is_float & (values[:-1] != 0.0))
        if len(bad):
            raise ValueError(
                f"chain.{field}[{bad[0]}] = {values[bad[0]]:g}: {method} simulates floats at every"
                f" {nodes_per_pitch}th node from the tip that are alike up to the sensor and alike behind it;"
                f" {names_of(lambda known: known.lanes is None)} simulate any"
            )
