"""Groups of probes in the lanes of vector registers: packing, advancing, unpacking.

Every call packs and unpacks the states of its probes. So any probes can share a group, and the result of a probe does
not depend on the other probes of its group.
"""

from __future__ import annotations

import time
from abc import abstractmethod
from collections.abc import Callable, Hashable, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from probe_env.arrays import FloatArray
from probe_env.physics.methods.lanes import lane_count
from probe_env.physics.methods.method import KernelArguments, Method
from probe_env.physics.model.chain import Chain
from probe_env.physics.model.drive import APPEND, INPUTS

# rows of the parameters; forces are per mass, moments per inertia
(
    ROOT, SENSOR, CURVATURE, STIFFNESS, FRICTION, GUIDE_DRAG, CARRIER_DRAG, GUIDE_LEVER, CARRIER_LEVER,
    GUIDE_GAP, CARRIER_GAP, COS, SIN, AXIAL, COUPLE, MASS_RATIO, DAMPING, PEAK, TURN, TURN_FORCE, CABLE, CABLE_RADIUS,
    PRESSURE, TENSION, WEIGHT, GRIP, STRETCH, MASS, DASHPOT, FRICTION_SLOPE,
) = range(30)  # fmt: skip
PARAMETERS = 30
# fields of a node, rows of its state: displacement, velocity, partial solution, axial force
X, Y, T, VX, VY, VT, GX, GY, GT, V = range(10)
FIELDS = 10
# rows of its memory, if options use it: of a float N of the shortening, held friction per mass, and V + N of its span
N, HELD, SPAN = range(3)
MEMORY = 3
# three matrices of a node, rows of its factors: E, F, U of imex, own, down, up of explicit
FACTORS = 27
A, B, C = 0, 9, 18


class LaneMethod(Method):
    """A method whose kernel advances several probes in vector lanes.

    Attributes:
        kernel: compiled function that advances a group.
    """

    kernel: Callable[..., Any]

    @property
    def width(self) -> int:
        """Probes that share a group."""
        return lane_count(self.precision)

    def check_chain(self, chain: Chain, sensor: int, nodes_per_pitch: int) -> None:
        """Raise ValueError if the kernels do not simulate a chain.

        They simulate a float at every ``nodes_per_pitch``-th node from the tip, with equal floats up to the sensor and
        equal floats behind it, and no loads or supports. Superelements also simulate a drag that differs.
        """
        for field in ("load", "support_stiffness"):
            if getattr(chain, field).any():
                raise ValueError(f"chain.{field} is not zero: {self.name} does not simulate it; newmark does")
        if chain.float_weight > 0.0 and not self.simulates_weight:
            raise ValueError(f"chain.float_weight is not zero: {self.name} does not simulate it; newmark does")
        index = np.arange(chain.node_count - 1)
        is_float, first = index % nodes_per_pitch == 0, (sensor // nodes_per_pitch + 1) * nodes_per_pitch
        equal = np.where(index <= sensor, 0, min(first, chain.node_count - 1))
        for field in ("contact_stiffness", "drag", "lever", "outer_gap"):
            values = getattr(chain, field)
            expected = values[equal if field != "contact_stiffness" else np.zeros_like(index)]
            bad = np.flatnonzero(is_float & (values[:-1] != expected))
            if field == "drag" and self.simulates_expansion:
                bad = bad[:0]
            if not len(bad) and field in ("contact_stiffness", "drag"):
                bad = np.flatnonzero(~is_float & (values[:-1] != 0.0))
            if len(bad):
                raise ValueError(
                    f"chain.{field}[{bad[0]}] = {values[bad[0]]:g}: {self.name} simulates floats at every"
                    f" {nodes_per_pitch}th node from the tip that are equal up to the sensor and equal behind it;"
                    " newmark simulates any"
                )


class NodeLanes(LaneMethod):
    """A lane method with one row of the state per node: ``imex`` and ``explicit``."""

    @abstractmethod
    def factors(self, chain: Chain, time_step: float) -> FloatArray:
        """(k, 27) matrices of the first k nodes from the tip; further nodes use the last row."""

    def constants(
        self, chain: Chain, sensor: int, nodes_per_pitch: int, time_step: float
    ) -> tuple[FloatArray, FloatArray, FloatArray | None]:
        """Parameters, factors, and drag per mass of each float with its rate if it differs, see ``own_drag``."""
        self.check_chain(chain, sensor, nodes_per_pitch)
        values = lane_parameters(chain, sensor, nodes_per_pitch)
        values[[WEIGHT, DASHPOT]] /= chain.mass
        if chain.stiction:
            lever = float(chain.lever[:-1].max())
            point = 1.0 / (1.0 + lever**2 * chain.mass / chain.inertia)  # mass of the point of contact over the node's
            values[GRIP] = min(values[STIFFNESS] * time_step, point / time_step)
        drag = own_drag(chain, sensor, nodes_per_pitch)
        drags = None if drag is None else np.stack([drag, np.zeros_like(drag)]) / chain.mass
        return values, self.factors(chain, time_step), drags

    def with_drag(self, constants: Any, chain: Chain, sensor: int, nodes_per_pitch: int, time_step: float) -> Any:
        """See ``Method.with_drag``; nothing else is computed again."""
        floats = slice(0, -1, nodes_per_pitch)
        return *constants[:2], np.stack([chain.drag[floats], chain.drag_rate[floats]]) / chain.mass

    def kind(self, constants: Any) -> Hashable:
        """Options of the kernel: other kernels round differently."""
        return tuple(map(bool, options_of(constants[0])))

    def run(
        self, lanes: Sequence[KernelArguments], time_step: float, per_pitch: int, first_sample: int, sample_every: int
    ) -> float:
        """See ``Method.run``."""
        width, precision = self.width, self.precision
        group = LaneGroup.pack(lanes, width, precision)
        parameters, roots = group.parameters, group.roots
        held = group.held_nodes(len(lanes))
        nodes = int(held.max()) + 3
        rows = max(len(lane.constants[1]) for lane in lanes)
        packed_factors = np.zeros((rows, FACTORS, width), dtype=precision)
        packed = np.zeros((nodes, FIELDS, width), dtype=precision)
        weighed, shortened, sticking, damped = options_of(lanes[0].constants[0])
        memory = np.zeros((nodes if shortened or sticking else 0, MEMORY, width), dtype=precision)
        for k, lane in enumerate(lanes):
            probe, factors = lane.state, lane.constants[1]
            packed_factors[: len(factors), :, k] = factors
            packed_factors[len(factors) :, :, k] = factors[-1]
            packed[: lane.root + 1, X : T + 1, k] = probe.d[: lane.root + 1]
            packed[: lane.root, VX : VT + 1, k] = probe.v[: lane.root]
            packed[: lane.root, GX : GT + 1, k] = probe.memory[: lane.root, :3]
            memory[: lane.root, :SPAN, k] = probe.memory[: min(lane.root, len(memory)), 3:]
            packed[: lane.root, V, k] = probe.axial_force[: lane.root]
        samples, tension = group.scratch(lanes, nodes)
        turned = (parameters[[TURN, STRETCH]] > 0.0).any()
        compressed = (0, 0) if (parameters[CABLE] > 0.0).any() else (0,) if turned else ()
        varied = (0,) * any(lane.constants[2] is not None for lane in lanes)
        drags = np.zeros((2, nodes if varied else 0, width), dtype=precision)
        for k, lane in enumerate(lanes if varied else ()):
            drag, rate = (None, ()) if lane.constants[2] is None else lane.constants[2]
            drags[0, :, k] = float_drags(lane.constants[0], drag, np.arange(nodes) * per_pitch)
            drags[1, : len(rate), k] = rate[:nodes]
        begin = time.perf_counter()
        self.kernel(
            parameters, compressed, (weighed, varied, shortened, sticking, damped), drags.reshape(-1, width),
            packed_factors.reshape(-1, width), packed.reshape(-1, width), memory.reshape(-1, width),
            group.inputs.reshape(-1, width), held[:-1].max(axis=1), held[:-1].min(axis=1), time_step, per_pitch,
            (first_sample, sample_every, group.points, samples, tension), roots, group.failed,
        )  # fmt: skip
        seconds = time.perf_counter() - begin
        group.unpack(lanes, samples)
        for k, lane in enumerate(lanes):
            probe, free = lane.state, lane.root
            probe.d[: free + 1], probe.d[free + 1 :] = packed[: free + 1, X : T + 1, k], 0.0
            probe.v[:free], probe.v[free:] = packed[:free, VX : VT + 1, k], 0.0
            probe.memory[:free, :3], probe.memory[free:] = packed[:free, GX : GT + 1, k], 0.0
            if len(memory):
                pulls = np.repeat(memory[:free:per_pitch, N, k], per_pitch)[:free]
                probe.memory[:free, 3], probe.memory[:free, 4] = pulls, memory[:free, HELD, k]
            probe.axial_force[:free], probe.axial_force[free:] = packed[:free, V, k], 0.0
            covered = min(len(tension), len(lane.tension_sum))
            lane.tension_sum[:covered] += tension[:covered, k]
        return seconds


class LaneGroup(NamedTuple):
    """Arguments of a kernel for a group of probes in ``width`` lanes; idle lanes are marked in ``failed``.

    Attributes:
        parameters: (30, width), see ``lane_parameters``; ``ROOT`` is the held node.
        inputs: (steps, 4, width), see model/drive.py.
        points: (p, width) sampled nodes, -1 for the root.
        roots: (width,) held nodes.
        failed: (width,) 0, or -1 in an idle lane; kernels store the step at which a probe diverged.
    """

    parameters: FloatArray
    inputs: FloatArray
    points: npt.NDArray[np.int64]
    roots: npt.NDArray[np.int64]
    failed: npt.NDArray[np.int64]

    @classmethod
    def pack(cls, lanes: Sequence[KernelArguments], width: int, precision: npt.DTypeLike) -> LaneGroup:
        """Pack probes into the first lanes with a floating-point type."""
        parameters = np.zeros((PARAMETERS, width), dtype=precision)
        parameters[[DAMPING, WEIGHT, MASS]] = 1.0  # idle lanes divide by them
        inputs = np.zeros((len(lanes[0].inputs), INPUTS, width), dtype=precision)
        points = np.zeros((len(lanes[0].points), width), dtype=np.int64)
        roots, failed = np.zeros(width, dtype=np.int64), np.full(width, -1, dtype=np.int64)
        for k, lane in enumerate(lanes):
            parameters[:, k], inputs[:, :, k], points[:, k] = lane.constants[0], lane.inputs, lane.points
            parameters[ROOT, k] = roots[k] = lane.root
            failed[k] = 0
        return cls(parameters, inputs, points, roots, failed)

    def held_nodes(self, used: int) -> npt.NDArray[np.int64]:
        """(steps + 1, used) held node of each of the ``used`` probes in every step, and after the last."""
        held = np.tile(self.roots[:used], (len(self.inputs) + 1, 1))
        held[1:] += np.cumsum(self.inputs[:, APPEND, :used], axis=0).astype(np.int64)
        return held

    def scratch(self, lanes: Sequence[KernelArguments], rows: int) -> tuple[FloatArray, FloatArray]:
        """Samples (k, p, 4, width), and sums of tension (rows, width), or (0, width) if no probe requests them."""
        first, width = lanes[0], len(self.roots)
        rows = rows if any(len(lane.tension_sum) for lane in lanes) else 0
        return np.zeros((len(first.samples), len(first.points), 4, width)), np.zeros((rows, width))

    def unpack(self, lanes: Sequence[KernelArguments], samples: FloatArray) -> None:
        """Store roots, samples and failures of a kernel in the probes."""
        for k, lane in enumerate(lanes):
            lane.root, lane.failed = int(self.roots[k]), int(self.failed[k])
            lane.samples[...] = samples[..., k]


def options_of(parameters: FloatArray) -> tuple[tuple[int, ...], ...]:
    """Options of the kernels for weight, shortening, held friction and damping: tuples that are empty or not."""
    groups = (WEIGHT, STRETCH, GRIP, [DASHPOT, FRICTION_SLOPE])
    return tuple((0,) * bool(np.any(parameters[rows] != 0.0)) for rows in groups)


def own_drag(chain: Chain, sensor: int, nodes_per_pitch: int) -> FloatArray | None:
    """Drag of every float (n,), or None if it is equal in the guide and in the carrier."""
    drag = chain.drag[:-1:nodes_per_pitch]
    first = sensor // nodes_per_pitch + 1  # float of the carrier
    equal = all(np.ptp(part) == 0.0 for part in (drag[:first], drag[first:]) if len(part))
    return None if equal else drag


def float_drags(parameters: FloatArray, drag: FloatArray | None, places: npt.NDArray[np.int64]) -> FloatArray:
    """Drag of the floats at some nodes (floats, if the sensor is one): ``drag`` or that of guide and carrier."""
    rows: FloatArray = np.where(places - 0.5 < parameters[SENSOR], parameters[GUIDE_DRAG], parameters[CARRIER_DRAG])
    if drag is not None:
        rows[: len(drag)] = drag[: len(rows)]
    return rows


def lane_parameters(chain: Chain, sensor: int, nodes_per_pitch: int) -> FloatArray:
    """(30,) parameters of a lane; ``ROOT`` and ``PEAK`` are set in each run, ``GRIP`` by the method."""
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
    values[[PRESSURE, TENSION]] = chain.max_pressure, chain.max_tension
    values[WEIGHT] = chain.float_weight
    values[STRETCH] = 0.5 * chain.element_length / chain.axial_compliance if chain.span else 0.0
    values[MASS] = chain.mass
    values[[DASHPOT, FRICTION_SLOPE]] = chain.contact_damping, chain.friction_slope
    return values
