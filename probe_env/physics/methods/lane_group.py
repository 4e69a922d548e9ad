"""Probes of the fast scheme side by side, as many as there are lanes: packed, advanced, unpacked.

State lives with the probes, not in the lanes, so that any probes can share a group from one call to the next
and a probe's result does not depend on the company it keeps.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from probe_env.arrays import FloatArray
from probe_env.physics.methods.lanes import lane_count
from probe_env.physics.model.chain import Chain
from probe_env.physics.model.drive import APPEND, INPUTS
from probe_env.physics.model.state import State

# rows of the parameters; forces are per mass, moments per inertia
(
    ROOT, SENSOR, CURVATURE, STIFFNESS, FRICTION, GUIDE_DRAG, CARRIER_DRAG, GUIDE_LEVER, CARRIER_LEVER,
    GUIDE_GAP, CARRIER_GAP, COS, SIN, AXIAL, COUPLE, MASS_RATIO, DAMPING, PEAK, TURN, TURN_FORCE, CABLE, CABLE_RADIUS,
    PRESSURE, TENSION,
) = range(24)  # fmt: skip
PARAMETERS = 24
# fields of a node, rows of its state: displacement, velocity, partial solution, axial force
X, Y, T, VX, VY, VT, GX, GY, GT, V = range(10)
FIELDS = 10
# three matrices of a node, rows of its factors: E, F, U of imex, own, down, up of explicit
FACTORS = 27
A, B, C = 0, 9, 18


@dataclass(frozen=True)
class LaneKernel:
    """What advances a group of lanes.

    Attributes:
        advance: the kernel, see ``imex.imex_advance``.
        factors: (k, 27) of a chain and a time step [s].
        precision: of the numbers in a lane.
        alone_share: time that a probe by itself takes, of that of a full group.
    """

    advance: Callable[..., Any]
    factors: Callable[[Chain, float], FloatArray] | None
    precision: npt.DTypeLike
    alone_share: float = field(default=1.0, kw_only=True)

    @property
    def width(self) -> int:
        """Probes that share a group."""
        return lane_count(self.precision)

    def kind(self, factors: Any) -> Hashable:
        """Probes with the same can share a group."""
        return None

    def constants(self, chain: Chain, sensor: int, nodes_per_pitch: int, time_step: float) -> tuple[FloatArray, Any]:
        """Parameters and factors of a probe."""
        assert self.factors is not None
        return lane_parameters(chain, sensor, nodes_per_pitch), self.factors(chain, time_step)

    def run(
        self,
        lanes: Sequence[Lane],
        time_step: float,
        per_pitch: int,
        first_sample: int,
        sample_every: int,
        tension_sum: FloatArray | None = None,
    ) -> tuple[list[int], float]:
        """Advance as many probes as the kernel has lanes, or fewer, by the rows of their inputs.

        Args:
            lanes: the probes, with equally many steps and points.
            time_step: [s].
            per_pitch: nodes in a float pitch.
            first_sample: steps until the first sample.
            sample_every: steps between samples.
            tension_sum: (n + 1,) of the first probe, gains the axial force of every sample.

        Returns:
            for each probe the step at which it diverged, counted from 1, or 0; seconds that the kernel took.
        """
        used, width, precision = len(lanes), self.width, self.precision
        entered = Entered.of(lanes, width, precision)
        parameters, roots = entered.parameters, entered.roots
        held = entered.held_nodes(used)
        nodes = int(held.max()) + 3
        factors = np.zeros((max(len(lane.factors) for lane in lanes), FACTORS, width), dtype=precision)
        state = np.zeros((nodes, FIELDS, width), dtype=precision)
        for k, lane in enumerate(lanes):
            factors[: len(lane.factors), :, k] = lane.factors
            factors[len(lane.factors) :, :, k] = lane.factors[-1]
            state[: lane.root + 1, X : T + 1, k] = lane.state.d[: lane.root + 1]
            state[: lane.root, VX : VT + 1, k] = lane.state.v[: lane.root]
            state[: lane.root, GX : GT + 1, k] = lane.state.memory[: lane.root]
            state[: lane.root, V, k] = lane.state.axial_force[: lane.root]
        packed_samples = np.zeros((len(lanes[0].samples), len(lanes[0].points), 4, width))
        packed_tension = np.zeros((0 if tension_sum is None else nodes, width))
        pressed = (0, 0) if (parameters[CABLE] > 0.0).any() else (0,) if (parameters[TURN] > 0.0).any() else ()
        begin = time.perf_counter()
        self.advance(
            parameters, pressed, factors.reshape(-1, width), state.reshape(-1, width),
            entered.inputs.reshape(-1, width), held[:-1].max(axis=1), held[:-1].min(axis=1), time_step, per_pitch,
            (first_sample, sample_every, entered.points, packed_samples, packed_tension), roots, entered.failed,
        )  # fmt: skip
        seconds = time.perf_counter() - begin
        for k, lane in enumerate(lanes):
            lane.root = int(roots[k])
            own, free = lane.state, lane.root
            own.d[: free + 1], own.d[free + 1 :] = state[: free + 1, X : T + 1, k], 0.0
            own.v[:free], own.v[free:] = state[:free, VX : VT + 1, k], 0.0
            own.memory[:free], own.memory[free:] = state[:free, GX : GT + 1, k], 0.0
            own.axial_force[:free], own.axial_force[free:] = state[:free, V, k], 0.0
            lane.samples[...] = packed_samples[..., k]
        if tension_sum is not None:
            covered = min(nodes, len(tension_sum))
            tension_sum[:covered] += packed_tension[:covered, 0]
        return entered.failed[:used].tolist(), seconds


@dataclass
class Lane:
    """One probe as the lanes need it; ``state``, ``root`` and ``samples`` change in place.

    ``state.memory`` is what a kernel keeps of its last step (fields GX, GY, GT).

    Attributes:
        parameters, factors: see ``LaneKernel.constants``.
        state, root: of the probe.
        points: (p,) nodes that are sampled, -1 for the root.
        inputs: (steps, 4) of the coming steps, see model/drive.py.
        samples: (k, p, 4) of the coming steps.
    """

    parameters: FloatArray
    factors: Any
    state: State
    root: int
    points: npt.NDArray[np.int64]
    inputs: FloatArray
    samples: FloatArray


class Entered(NamedTuple):
    """What a group of probes is called with, side by side in ``width`` lanes; idle ones are marked in ``failed``.

    Attributes:
        parameters: (24, width), see ``lane_parameters``; ``ROOT`` is the held node.
        inputs: (steps, 4, width), see model/drive.py.
        points: (p, width) nodes that are sampled, -1 for the root.
        roots: (width,) held nodes.
        failed: (width,) 0, or -1 in an idle lane; a kernel writes the step at which a probe diverged.
    """

    parameters: FloatArray
    inputs: FloatArray
    points: npt.NDArray[np.int64]
    roots: npt.NDArray[np.int64]
    failed: npt.NDArray[np.int64]

    @classmethod
    def of(cls, lanes: Sequence[Lane], width: int, precision: npt.DTypeLike) -> Entered:
        """The probes in the first lanes, in a precision."""
        parameters = np.zeros((PARAMETERS, width), dtype=precision)
        parameters[DAMPING] = 1.0  # idle lanes divide by it
        inputs = np.zeros((len(lanes[0].inputs), INPUTS, width), dtype=precision)
        points = np.zeros((len(lanes[0].points), width), dtype=np.int64)
        roots, failed = np.zeros(width, dtype=np.int64), np.full(width, -1, dtype=np.int64)
        for k, lane in enumerate(lanes):
            parameters[:, k], inputs[:, :, k], points[:, k] = lane.parameters, lane.inputs, lane.points
            parameters[ROOT, k] = roots[k] = lane.root
            failed[k] = 0
        return cls(parameters, inputs, points, roots, failed)

    def held_nodes(self, used: int) -> npt.NDArray[np.int64]:
        """(steps + 1, used) node that each of the ``used`` probes holds in a step, and after the last."""
        held = np.tile(self.roots[:used], (len(self.inputs) + 1, 1))
        held[1:] += np.cumsum(self.inputs[:, APPEND, :used], axis=0).astype(np.int64)
        return held


def lane_parameters(chain: Chain, sensor: int, nodes_per_pitch: int) -> FloatArray:
    """(24,) parameters of a lane; ``ROOT`` and ``PEAK`` are set when it runs."""
    carrier = min((sensor // nodes_per_pitch + 1) * nodes_per_pitch, len(chain.drag) - 1)
    values = np.zeros(PARAMETERS)
    values[SENSOR] = sensor
    values[CURVATURE] = chain.curvature
    values[STIFFNESS] = chain.contact_stiffness[0] / chain.mass
    values[FRICTION] = chain.friction
    values[[GUIDE_DRAG, CARRIER_DRAG]] = chain.drag[0] / chain.mass, chain.drag[carrier] / chain.mass
    values[[GUIDE_LEVER, CARRIER_LEVER]] = chain.lever[0], chain.lever[carrier]
    values[[GUIDE_GAP, CARRIER_GAP]] = chain.outer_gap[0], chain.outer_gap[carrier]
    values[[COS, SIN]] = chain.cos_phi, chain.sin_phi
    values[AXIAL] = 1.0 / chain.axial_compliance
    values[COUPLE] = chain.couple_length / chain.inertia
    values[MASS_RATIO] = chain.mass / chain.inertia
    values[DAMPING] = chain.damping_time
    values[[TURN, TURN_FORCE]] = chain.couple_turn, chain.couple_turn * chain.inertia / chain.mass
    values[[CABLE, CABLE_RADIUS]] = chain.cable_stiffness / chain.mass, chain.cable_radius
    values[[PRESSURE, TENSION]] = chain.most_pressure, chain.most_tension
    return values
