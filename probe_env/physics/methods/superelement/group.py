"""Superelement methods: cable condensed to floats and a few modes, with probes or floats in the lanes.

The state is packed into lanes, advanced by a kernel and unpacked; see lane_group.py.
"""

import time
from collections.abc import Callable, Hashable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from probe_env.arrays import FloatArray
from probe_env.physics.methods import lane_group as layout
from probe_env.physics.methods.factors import linear_weights
from probe_env.physics.methods.imex import Imex, Imex32
from probe_env.physics.methods.lane_group import (
    LaneGroup,
    LaneMethod,
    float_drags,
    lane_parameters,
    options_of,
    own_drag,
)
from probe_env.physics.methods.method import KernelArguments, Method
from probe_env.physics.methods.stability import TABLE_2_DAMPING, damped_step
from probe_env.physics.methods.superelement.kernel import (
    HELD,
    MODES,
    PT,
    PX,
    VT,
    VX,
    N,
    RootTables,
    T,
    V,
    X,
    displacements,
    superelement_advance,
)
from probe_env.physics.methods.superelement.pitch import ENDS, MIRROR
from probe_env.physics.methods.superelement.single_probe import (
    BEHIND,
    DRAG,
    E_SIZE,
    FLOATS,
    GAP,
    LEVER,
    LINKS,
    superelement_advance_single,
)
from probe_env.physics.methods.superelement.tables import (
    CONSTANTS,
    FACTORS,
    HALF_MASS,
    K_EVEN,
    K_ODD,
    MAX_MODES,
    MIN_MODES,
    Tables,
    held_stiffness,
    max_step,
    tables,
)
from probe_env.physics.model.chain import Chain, build_chain
from probe_env.physics.model.drive import APPEND
from probe_env.physics.model.state import State, at_rest
from probe_env.scene import Scene

MODAL = 5
MEMORY = MODAL + 4 * MAX_MODES
"""Momentum, N and held friction, then q and p of the even and of the odd modes; only rows of floats are used."""
ROOMS = (MIN_MODES, (3, 3), (MAX_MODES, MAX_MODES))
"""Numbers of even and odd modes of the kernels."""


def room(table: Tables) -> tuple[int, int]:
    """Smallest of ``ROOMS`` for the modes of a probe."""
    return next(room for room in ROOMS if table.even <= room[0] and table.odd <= room[1])


def mode_fields(table: Tables, even: int) -> list[tuple[int, int]]:
    """Column of the memory and field of q for each mode; p follows."""
    evens = [(MODAL + 2 * j, MODES + 2 * j) for j in range(table.even)]
    return evens + [(MODAL + 2 * (table.even + j), MODES + 2 * (even + j)) for j in range(table.odd)]


def pack(rows: FloatArray, state: State, root: int, per_pitch: int, table: Tables, even: int) -> None:
    """Copy the state of a probe to rows (floats, fields)."""
    count = (root - 1) // per_pitch + 1
    floats = slice(0, root, per_pitch)
    rows[:count, X : T + 1] = state.d[floats]
    rows[:count, VX : VT + 1] = state.v[floats]
    rows[:count, V] = state.axial_force[floats]
    memory = state.memory[floats]
    rows[:count, PX : PT + 1] = memory[:, :3]
    rows[:count, N], rows[:count, HELD] = memory[:, 3], memory[:, 4]
    for column, at in mode_fields(table, even):
        rows[:count, at : at + 2] = memory[:, column : column + 2]


def unpack(rows: FloatArray, state: State, root: int, per_pitch: int, table: Tables, even: int) -> None:
    """Inverse of ``pack``; all nodes of a piece have its axial force."""
    count = (root - 1) // per_pitch + 1
    floats = slice(0, root, per_pitch)
    state.d[floats], state.v[floats] = rows[:count, X : T + 1], rows[:count, VX : VT + 1]
    state.axial_force[:root] = np.repeat(rows[:count, V], per_pitch)[:root]
    state.memory[:root, 3] = np.repeat(rows[:count, N], per_pitch)[:root]
    memory = state.memory[floats]
    memory[:, :3], memory[:, 4] = rows[:count, PX : PT + 1], rows[:count, HELD]
    for column, at in mode_fields(table, even):
        memory[:, column : column + 2] = rows[:count, at : at + 2]


def root_tables(
    group: Sequence[Tables], damping_time: FloatArray, time_step: float, even: int, odd: int, rows: int
) -> RootTables:
    """Tables of a group of probes, padded to equal numbers of modes and rows of factors; ``damping_time`` (lanes,)."""
    width = len(damping_time)
    modes, per_pitch = even + odd, len(group[0].root_factors)
    size = ENDS + 2 * modes
    stacked = RootTables(
        np.zeros((width, per_pitch + 1, CONSTANTS)), np.zeros((width, rows, FACTORS)),
        np.zeros((width, per_pitch, rows, FACTORS)), np.zeros((width, per_pitch, size, size)),
        np.zeros((width, per_pitch, per_pitch, 3, ENDS + modes)),
        linear_weights(damping_time, np.float64(time_step))[1], np.zeros(size), np.zeros(size),
    )  # fmt: skip
    for k, table in enumerate(group):
        stacked.pieces[k] = table.pieces
        row = np.minimum(np.arange(rows), len(table.factors) - 1)
        stacked.factors[k], stacked.root_factors[k] = table.factors[row], table.root_factors[:, row]
        mode = np.r_[: table.even, even : even + table.odd]
        columns = np.r_[:ENDS, ENDS + mode, ENDS + modes + mode]
        stacked.growth[k][:, columns[:, None], columns] = table.growth
        stacked.shape[k][..., np.r_[:ENDS, ENDS + mode]] = table.shape
    return stacked


def floats_of(parameters: FloatArray, drag: FloatArray | None, table: Tables, count: int) -> FloatArray:
    """(count, FLOATS) parameters of floats from the tip: guide floats up to the sensor, carrier floats beyond.

    ``drag`` is that of every float (n,), or None if it is equal within guide and carrier.
    """
    guide = np.arange(count) - 0.5 < parameters[layout.SENSOR]
    rows = np.zeros((count, FLOATS))
    kinds = (
        (layout.GUIDE_LEVER, layout.CARRIER_LEVER),
        (layout.GUIDE_GAP, layout.CARRIER_GAP),
    )
    for at, (near, far) in zip((LEVER, GAP), kinds, strict=True):
        rows[:, at] = np.where(guide, parameters[near], parameters[far])
    rows[:, DRAG] = float_drags(parameters, drag, np.arange(count))
    rows[1:, BEHIND] = table.pieces[-1, HALF_MASS]
    return rows


def in_blocks(rows: FloatArray, width: int, precision: npt.DTypeLike) -> FloatArray:
    """Reorder (blocks width, f) to (blocks f, width): neighbouring rows in neighbouring lanes."""
    blocks = rows.reshape(-1, width, rows.shape[1]).transpose(0, 2, 1)
    return np.ascontiguousarray(blocks.reshape(-1, width), dtype=precision)


def _elastic(constants: FloatArray, ends: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Elastic force of a piece at its L and its R end."""
    flip = -MIRROR  # sign of R in even unknowns, opposite in odd ones
    even, odd = ends[:3] - flip * ends[3:], ends[:3] + flip * ends[3:]
    from_even = constants[K_EVEN : K_EVEN + 9].reshape(3, 3) @ even
    from_odd = constants[K_ODD + 3 : K_ODD + 6] * (constants[K_ODD : K_ODD + 3] @ odd)
    return from_even + from_odd, flip * (from_odd - from_even)


INSTEAD = "imex with 8 nodes a pitch simulates it"
STABLE, UNSTABLE = 1.65, 1.8
"""Largest omega dt of a float on its contact spring at which runs were stable (including 96 random probes and tubes of
10 to 50 m), and least at which they diverge."""
MAX_STEP = 5e-4
"""Largest step with soft contact [s]; at 1e-3 s runs with 1e4 N/m diverge."""


class Superelement(LaneMethod):
    """A converged mesh condensed to its floats and a few modes of the cable between them; groups of four probes.

    Attributes:
        single: kernel of a single probe, with equal results bit for bit.
    """

    name = "superelement"
    order = 2
    usual_step = 2e-4
    single_fraction = 0.5
    memory = MEMORY
    on_nodes = False
    simulates_withdrawal = False
    simulates_damping = True
    kernel = staticmethod(superelement_advance)
    single: Callable[..., Any] = staticmethod(superelement_advance_single)

    @property
    def on_nodes_as(self) -> Method:
        """See ``Method.on_nodes_as``."""
        return Imex()

    def stable_step(self, scene: Scene, nodes_per_pitch: int) -> float:
        """Largest step [s] known to be stable; 0 for a cable with less damping than in the study."""
        damped = scene.probe.damping_time >= TABLE_2_DAMPING
        step = max_step(build_chain(scene, nodes_per_pitch), nodes_per_pitch, STABLE)
        return damped_step(min(step, MAX_STEP), scene) if damped else 0.0

    def contact_step(self, scene: Scene, nodes_per_pitch: int) -> float:
        """Largest step [s] that explicit contact allows."""
        return damped_step(max_step(build_chain(scene, nodes_per_pitch), nodes_per_pitch, UNSTABLE), scene)

    def at_rest(self, chain: Chain, nodes_per_pitch: int, time_step: float, root: int, d: FloatArray) -> State:
        """A state at rest with displacements d (n + 1, 3) [m, rad]; q is a least-squares fit, p is zero.

        The momentum of the kernel is p + tau K d.
        """
        table = tables(chain, nodes_per_pitch, time_step)
        tau = linear_weights(chain.damping_time, time_step)[1]
        state = at_rest(len(d), MEMORY)
        floats = range(0, root, nodes_per_pitch)
        state.d[:root] = d[:root]
        for first in floats:
            count = min(nodes_per_pitch, root - first)
            behind = d[first + count] if first + count < root else np.zeros(3)
            ends = np.concatenate([d[first], behind])
            shape = table.shape[count - 1, 1:count].reshape(-1, ENDS + table.even + table.odd)
            rest = d[first + 1 : first + count].ravel() - shape[:, :ENDS] @ ends
            q = np.linalg.lstsq(shape[:, ENDS:], rest, rcond=None)[0]
            state.memory[first, MODAL : MODAL + 2 * len(q) : 2] = q
            constants = table.pieces[-1] if first + count < root else table.pieces[count - 1]
            left, right = _elastic(constants, ends)
            state.memory[first, :3] += tau * left
            if first + count < root:
                state.memory[first + count, :3] += tau * right
        return state

    def constants(
        self, chain: Chain, sensor: int, nodes_per_pitch: int, time_step: float
    ) -> tuple[FloatArray, Tables, FloatArray | None]:
        """Parameters and tables of a probe, and the drag of each float if it differs within guide or carrier."""
        self.check_chain(chain, sensor, nodes_per_pitch)
        if chain.cable_stiffness > 0.0:
            raise ValueError(f"contact.cable = true: superelement has no nodes between floats; {INSTEAD}")
        table = tables(chain, nodes_per_pitch, time_step)
        values = lane_parameters(chain, sensor, nodes_per_pitch)
        values[[layout.GUIDE_DRAG, layout.CARRIER_DRAG]] *= chain.mass  # forces, not per mass
        values[layout.STIFFNESS], values[layout.MASS_RATIO], values[layout.TENSION] = (
            table.stiffness,
            1.0,
            table.max_tension,
        )
        values[layout.SENSOR] = sensor // nodes_per_pitch
        if chain.stiction:
            values[layout.GRIP] = time_step * held_stiffness(chain, nodes_per_pitch, time_step)
        return values, table, own_drag(chain, sensor, nodes_per_pitch)

    def with_drag(
        self,
        constants: tuple[FloatArray, Tables, FloatArray | None],
        chain: Chain,
        sensor: int,
        nodes_per_pitch: int,
        time_step: float,
    ) -> tuple[FloatArray, Tables, FloatArray]:
        """See ``Method.with_drag``; nothing else is computed again."""
        return constants[0], constants[1], chain.drag[:-1:nodes_per_pitch]

    def kind(self, constants: tuple[FloatArray, Tables, FloatArray | None]) -> Hashable:
        """Numbers of modes and options of the kernel: other kernels round differently."""
        return *room(constants[1]), *map(bool, options_of(constants[0]))

    def run(
        self, lanes: Sequence[KernelArguments], time_step: float, per_pitch: int, first_sample: int, sample_every: int
    ) -> float:
        """See ``Method.run``."""
        if len(lanes) == 1:
            return self._run_single(lanes[0], time_step, per_pitch, first_sample, sample_every)
        members = [lane.constants[1] for lane in lanes]
        even, odd = room(members[0])
        used, width, precision = len(lanes), self.width, self.precision
        fields, last = MODES + 2 * (even + odd), max(len(t.factors) for t in members) - 1
        group = LaneGroup.pack(lanes, width, precision)
        roots = group.roots
        last_float = (group.held_nodes(used) - 1) // per_pitch
        group.parameters[layout.ROOT, :used] = last_float[0] + 1
        rows = int(last_float[-1].max()) + 2
        state = np.zeros((rows, fields, width), dtype=precision)
        for k, (lane, table) in enumerate(zip(lanes, members, strict=True)):
            pack(state[:, :, k], lane.state, lane.root, per_pitch, table, even)
        varied = any(lane.constants[2] is not None for lane in lanes)
        drags = np.zeros((rows if varied else 0, width), dtype=precision)
        for k, lane in enumerate(lanes if varied else ()):
            drags[:, k] = float_drags(lane.constants[0], lane.constants[2], np.arange(rows))
        weighed, shortened, sticking, damped = options_of(lanes[0].constants[0])
        options = weighed, (0,) * varied, shortened, sticking, damped
        stacked = root_tables(members, group.parameters[layout.DAMPING], time_step, even, odd, last + 1)
        constants = np.zeros(((1 + width) * CONSTANTS, width), dtype=precision)
        factors = np.zeros(((last + 1 + width) * FACTORS, width), dtype=precision)
        constants[:CONSTANTS] = stacked.pieces[:, -1].T
        factors[: (last + 1) * FACTORS] = stacked.factors.reshape(width, -1).T
        samples, tension = group.scratch(lanes, rows)
        begin = time.perf_counter()
        self.kernel(
            group.parameters, constants, factors, np.zeros(rows, dtype=np.int64), last, ((0,) * even, (0,) * odd),
            options, drags,
            state.reshape(-1, width), group.inputs.reshape(-1, width), last_float[:-1].max(axis=1),
            last_float[:-1].min(axis=1), time_step, stacked,
            (first_sample, sample_every, group.points, samples, tension), roots, group.failed,
        )  # fmt: skip
        seconds = time.perf_counter() - begin
        group.unpack(lanes, samples)
        for k, (lane, table) in enumerate(zip(lanes, members, strict=True)):
            unpack(state[:, :, k], lane.state, lane.root, per_pitch, table, even)
            displacements(stacked, state.reshape(-1, width), fields, 1, lane.root, k, lane.state.d)
            add_tension(lane, tension[:, k], per_pitch)
        return seconds

    def _run_single(
        self, lane: KernelArguments, time_step: float, per_pitch: int, first_sample: int, sample_every: int
    ) -> float:
        """``run`` for a single probe, whose floats are in the lanes."""
        values, table, drag = lane.constants
        (even, odd), width, precision = room(table), self.width, self.precision
        fields = MODES + 2 * (even + odd)
        last_float = (lane.root + int(lane.inputs[:, APPEND].sum()) - 1) // per_pitch
        blocks = last_float // width + 2
        rows = np.zeros((blocks * width, fields))
        pack(rows, lane.state, lane.root, per_pitch, table, even)
        state = in_blocks(rows, width, precision)
        parameters = np.repeat(values[:, None], width, axis=1).astype(precision)
        stacked = root_tables([table], parameters[layout.DAMPING, :1], time_step, even, odd, len(table.factors))
        constants = np.zeros((2 * CONSTANTS, width), dtype=precision)
        constants[:CONSTANTS] = stacked.pieces[0, -1][:, None]
        settled = (len(table.factors) - 1) // width + 1  # first block whose floats share their factors
        row = np.minimum(np.arange((settled + 1) * width), len(table.factors) - 1)
        factors = np.zeros(((settled + 2) * E_SIZE, width), dtype=precision)
        factors[: (settled + 1) * E_SIZE] = in_blocks(table.factors[row, :E_SIZE], width, precision)
        links = np.zeros((2, len(table.factors) + 1, LINKS // 2), dtype=precision)
        links[0, :-1], links[1, :-1] = np.hsplit(table.factors[:, E_SIZE:], 2)
        tension = np.zeros((len(rows) if len(lane.tension_sum) else 0, 1))
        floats = in_blocks(floats_of(values, drag, table, len(rows)), width, precision)
        begin = time.perf_counter()
        lane.failed, lane.root = self.single(
            parameters, constants, factors, links, floats, ((0,) * even, (0,) * odd), options_of(values), state,
            lane.inputs.astype(precision), lane.root, time_step, stacked,
            (first_sample, sample_every, lane.points[:, None], lane.samples[..., None], tension),
        )  # fmt: skip
        seconds = time.perf_counter() - begin
        after = state.reshape(blocks, fields, width).transpose(0, 2, 1).reshape(-1, fields)
        unpack(after, lane.state, lane.root, per_pitch, table, even)
        displacements(stacked, state, fields, width, lane.root, 0, lane.state.d)
        add_tension(lane, tension[:, 0], per_pitch)
        return seconds


class Superelement32(Superelement):
    """``Superelement`` in single precision; groups of eight probes."""

    name = "superelement32"
    min_step = 5e-5
    precision = np.float32
    single_fraction = 0.33

    @property
    def in_double(self) -> Method:
        """See ``Method.in_double``."""
        return Superelement()

    @property
    def on_nodes_as(self) -> Method:
        """See ``Method.on_nodes_as``."""
        return Imex32()


def add_tension(lane: KernelArguments, tension: FloatArray, per_pitch: int) -> None:
    """Add the axial forces of pieces to the sums at the nodes of a probe."""
    covered = min(len(tension) * per_pitch, lane.root, len(lane.tension_sum))
    lane.tension_sum[:covered] += np.repeat(tension, per_pitch)[:covered]
