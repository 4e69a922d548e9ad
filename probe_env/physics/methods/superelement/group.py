"""The superelement methods: pieces of cable condensed to their floats and a few modes, probes or floats in the lanes.

State is packed into the lanes of a kernel, advanced and unpacked; see lane_group.py.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from probe_env.arrays import FloatArray
from probe_env.physics.methods.factors import linear_weights
from probe_env.physics.methods.lane_group import (
    CARRIER_DRAG,
    CARRIER_GAP,
    CARRIER_LEVER,
    GUIDE_DRAG,
    GUIDE_GAP,
    GUIDE_LEVER,
    MASS_RATIO,
    ROOT,
    SENSOR,
    STIFFNESS,
    TENSION,
    Entered,
    LaneMethod,
    lane_parameters,
)
from probe_env.physics.methods.method import Lane
from probe_env.physics.methods.stability import TABLE_2_DAMPING
from probe_env.physics.methods.superelement.kernel import (
    MODES,
    PT,
    PX,
    VT,
    VX,
    RootTables,
    T,
    V,
    X,
    displacements,
    place_roots,
    superelement_advance,
)
from probe_env.physics.methods.superelement.pitch import ENDS, MIRROR
from probe_env.physics.methods.superelement.single_probe import (
    BEHIND,
    DRAG,
    FLOATS,
    GAP,
    LEVER,
    LINKS,
    OWN,
    superelement_advance_single,
)
from probe_env.physics.methods.superelement.tables import (
    CONSTANTS,
    FACTORS,
    HALF_MASS,
    K_EVEN,
    K_ODD,
    LEAST,
    MOST,
    Tables,
    longest_step,
    tables,
)
from probe_env.physics.model.chain import Chain, build_chain
from probe_env.physics.model.drive import APPEND
from probe_env.physics.model.state import State, at_rest
from probe_env.scene import Scene

MOMENTUM = 3
MEMORY = MOMENTUM + 4 * MOST
"""Momentum, then q and p of the even and of the odd modes; rows of floats alone are in use."""
ROOMS = (LEAST, (3, 3), (MOST, MOST))
"""Even and odd modes of which there is a kernel."""


def room(table: Tables) -> tuple[int, int]:
    """Least of ``ROOMS`` that holds a probe's even and odd modes."""
    return next(room for room in ROOMS if table.even <= room[0] and table.odd <= room[1])


def mode_fields(table: Tables, even: int) -> list[tuple[int, int]]:
    """Where a probe's modes are: column of the memory and field of q; p follows."""
    evens = [(MOMENTUM + 2 * j, MODES + 2 * j) for j in range(table.even)]
    return evens + [(MOMENTUM + 2 * (table.even + j), MODES + 2 * (even + j)) for j in range(table.odd)]


def pack(rows: FloatArray, state: State, root: int, per_pitch: int, table: Tables, even: int) -> None:
    """A probe's state to rows (floats, fields)."""
    count = (root - 1) // per_pitch + 1
    floats = slice(0, root, per_pitch)
    rows[:count, X : T + 1] = state.d[floats]
    rows[:count, VX : VT + 1] = state.v[floats]
    rows[:count, V] = state.axial_force[floats]
    memory = state.memory[floats]
    rows[:count, PX : PT + 1] = memory[:, :3]
    for column, at in mode_fields(table, even):
        rows[:count, at : at + 2] = memory[:, column : column + 2]


def unpack(rows: FloatArray, state: State, root: int, per_pitch: int, table: Tables, even: int) -> None:
    """``pack`` backwards; the axial force is that of the piece at all its places."""
    count = (root - 1) // per_pitch + 1
    floats = slice(0, root, per_pitch)
    state.d[floats], state.v[floats] = rows[:count, X : T + 1], rows[:count, VX : VT + 1]
    state.axial_force[:root] = np.repeat(rows[:count, V], per_pitch)[:root]
    memory = state.memory[floats]
    memory[:, :3] = rows[:count, PX : PT + 1]
    for column, at in mode_fields(table, even):
        memory[:, column : column + 2] = rows[:count, at : at + 2]


def root_tables(own: Sequence[Tables], width: int, even: int, odd: int, rows: int) -> RootTables:
    """Tables side by side, those with fewer modes or rows of factors than the group filled up."""
    modes, places = even + odd, len(own[0].root_factors)
    size = ENDS + 2 * modes
    stacked = RootTables(
        np.zeros((width, places + 1, CONSTANTS)), np.zeros((width, rows, FACTORS)),
        np.zeros((width, places, rows, FACTORS)), np.zeros((width, places, size, size)),
        np.zeros((width, places, places, 3, ENDS + modes)), np.zeros(size), np.zeros(size),
    )  # fmt: skip
    for k, table in enumerate(own):
        stacked.pieces[k] = table.pieces
        row = np.minimum(np.arange(rows), len(table.factors) - 1)
        stacked.factors[k], stacked.root_factors[k] = table.factors[row], table.root_factors[:, row]
        mode = np.r_[: table.even, even : even + table.odd]
        kept = np.r_[:ENDS, ENDS + mode, ENDS + modes + mode]
        stacked.growth[k][:, kept[:, None], kept] = table.growth
        stacked.shape[k][..., np.r_[:ENDS, ENDS + mode]] = table.shape
    return stacked


def floats_of(parameters: FloatArray, table: Tables, count: int) -> FloatArray:
    """(count, FLOATS) of floats from the tip: the guide's up to the sensor, the carrier's beyond."""
    guide = np.arange(count) - 0.5 < parameters[SENSOR]
    rows = np.zeros((count, FLOATS))
    kinds = ((GUIDE_LEVER, CARRIER_LEVER), (GUIDE_GAP, CARRIER_GAP), (GUIDE_DRAG, CARRIER_DRAG))
    for at, (near, far) in zip((LEVER, GAP, DRAG), kinds, strict=True):
        rows[:, at] = np.where(guide, parameters[near], parameters[far])
    rows[1:, BEHIND] = table.pieces[-1, HALF_MASS]
    return rows


def in_blocks(rows: FloatArray, width: int, precision: npt.DTypeLike) -> FloatArray:
    """(blocks f, width) of (blocks width, f): neighbouring rows side by side."""
    blocks = rows.reshape(-1, width, rows.shape[1]).transpose(0, 2, 1)
    return np.ascontiguousarray(blocks.reshape(-1, width), dtype=precision)


def _elastic(constants: FloatArray, ends: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Elastic force of a piece at its L and its R end."""
    flip = -MIRROR  # R's share of an even unknown, and of an odd one but for the sign
    even, odd = ends[:3] - flip * ends[3:], ends[:3] + flip * ends[3:]
    from_even = constants[K_EVEN : K_EVEN + 9].reshape(3, 3) @ even
    from_odd = constants[K_ODD + 3 : K_ODD + 6] * (constants[K_ODD : K_ODD + 3] @ odd)
    return from_even + from_odd, flip * (from_odd - from_even)


INSTEAD = "imex with 8 nodes a pitch simulates it"
STABLE, UNSTABLE = 1.65, 1.8
"""Omega dt of a float on its contact spring: up to which runs held (96 random probes and tubes of 10 to 50 m among
them), and from which they diverge."""
LONGEST_STEP = 5e-4
"""[s] Soft contact would allow more; at 1e-3 s runs of 1e4 N/m diverge."""


class Superelement(LaneMethod):
    """A converged mesh condensed to its floats and a few modes of the cable between them; four probes side by side.

    Attributes:
        single: the kernel of one probe by itself, bit for bit the same.
    """

    name = "superelement"
    order = 2
    usual_step = 2e-4
    alone_share = 0.5
    memory = MEMORY
    on_nodes = False
    draws_back = False
    kernel = staticmethod(superelement_advance)
    single: Callable[..., Any] = staticmethod(superelement_advance_single)

    def stable_step(self, scene: Scene, nodes_per_pitch: int) -> float:
        """Largest step [s] known to hold; 0: a cable with less damping than in the study's ensemble."""
        damped = scene.probe.damping_time >= TABLE_2_DAMPING
        step = longest_step(build_chain(scene, nodes_per_pitch), nodes_per_pitch, STABLE)
        return min(step, LONGEST_STEP) if damped else 0.0

    def contact_step(self, scene: Scene, nodes_per_pitch: int) -> float:
        """Largest step [s] that explicit contact allows."""
        return longest_step(build_chain(scene, nodes_per_pitch), nodes_per_pitch, UNSTABLE)

    def at_rest(self, chain: Chain, nodes_per_pitch: int, time_step: float, root: int, d: FloatArray) -> State:
        """At rest with displacements d (n + 1, 3) [m, rad]; q is what fits best between the floats, p is zero.

        The kernel's momentum still lacks tau K d, the last share of the elastic force.
        """
        own = tables(chain, nodes_per_pitch, time_step)
        tau = linear_weights(chain.damping_time, time_step)[1]
        state = at_rest(len(d), MEMORY)
        floats = range(0, root, nodes_per_pitch)
        state.d[:root] = d[:root]
        for first in floats:
            count = min(nodes_per_pitch, root - first)
            behind = d[first + count] if first + count < root else np.zeros(3)
            ends = np.concatenate([d[first], behind])
            shape = own.shape[count - 1, 1:count].reshape(-1, ENDS + own.even + own.odd)
            rest = d[first + 1 : first + count].ravel() - shape[:, :ENDS] @ ends
            q = np.linalg.lstsq(shape[:, ENDS:], rest, rcond=None)[0]
            state.memory[first, MOMENTUM : MOMENTUM + 2 * len(q) : 2] = q
            constants = own.pieces[-1] if first + count < root else own.pieces[count - 1]
            left, right = _elastic(constants, ends)
            state.memory[first, :MOMENTUM] += tau * left
            if first + count < root:
                state.memory[first + count, :MOMENTUM] += tau * right
        return state

    def constants(self, chain: Chain, sensor: int, nodes_per_pitch: int, time_step: float) -> tuple[FloatArray, Tables]:
        """Parameters and tables of a probe.

        Raises:
            ValueError: a scene in which the cable between floats is more than elastic.
        """
        self.check_chain(chain, sensor, nodes_per_pitch)
        if chain.cable_stiffness > 0.0:
            raise ValueError(f"contact.cable = true: superelement has no nodes between floats; {INSTEAD}")
        if chain.couple_turn > 0.0:
            raise ValueError(f'couple = "tangent": superelement knows "frame" only; {INSTEAD}')
        own = tables(chain, nodes_per_pitch, time_step)
        values = lane_parameters(chain, sensor, nodes_per_pitch)
        values[[GUIDE_DRAG, CARRIER_DRAG]] *= chain.mass  # forces, not per mass
        values[STIFFNESS], values[MASS_RATIO], values[TENSION] = own.stiffness, 1.0, own.most_tension
        values[SENSOR] = sensor // nodes_per_pitch
        return values, own

    def kind(self, constants: tuple[FloatArray, Tables]) -> Hashable:
        """The kernel that has room for a probe's modes: compiled otherwise, it rounds otherwise."""
        return room(constants[1])

    def run(
        self, lanes: Sequence[Lane], time_step: float, nodes_per_pitch: int, first_sample: int, sample_every: int
    ) -> float:
        """See ``Method.run``."""
        if len(lanes) == 1:
            return self._run_alone(lanes[0], time_step, nodes_per_pitch, first_sample, sample_every)
        per_pitch, own = nodes_per_pitch, [lane.constants[1] for lane in lanes]
        even, odd = room(own[0])
        used, width, precision = len(lanes), self.width, self.precision
        fields, last = MODES + 2 * (even + odd), max(len(t.factors) for t in own) - 1
        entered = Entered.of(lanes, width, precision)
        roots = entered.roots
        last_float = (entered.held_nodes(used) - 1) // per_pitch
        entered.parameters[ROOT, :used] = last_float[0] + 1
        rows = int(last_float[-1].max()) + 2
        state = np.zeros((rows, fields, width), dtype=precision)
        for k, (lane, table) in enumerate(zip(lanes, own, strict=True)):
            pack(state[:, :, k], lane.state, lane.root, per_pitch, table, even)
        stacked = root_tables(own, width, even, odd, last + 1)
        constants, factors, at = _placed(stacked, roots, rows, precision)
        samples, tension = entered.scratch(lanes, rows)
        begin = time.perf_counter()
        self.kernel(
            entered.parameters, constants, factors, at, last, ((0,) * even, (0,) * odd), state.reshape(-1, width),
            entered.inputs.reshape(-1, width), last_float[:-1].max(axis=1), last_float[:-1].min(axis=1), time_step,
            stacked, (first_sample, sample_every, entered.points, samples, tension), roots, entered.failed,
        )  # fmt: skip
        seconds = time.perf_counter() - begin
        entered.leave(lanes, samples)
        for k, (lane, table) in enumerate(zip(lanes, own, strict=True)):
            unpack(state[:, :, k], lane.state, lane.root, per_pitch, table, even)
            displacements(stacked, state.reshape(-1, width), fields, lane.root, k, lane.state.d)
            add_tension(lane, tension[:, k], per_pitch)
        return seconds

    def _run_alone(self, lane: Lane, time_step: float, per_pitch: int, first_sample: int, sample_every: int) -> float:
        """``run`` of one probe that has no company: its floats are in the lanes."""
        own, table = lane.constants
        (even, odd), width, precision = room(table), self.width, self.precision
        fields = MODES + 2 * (even + odd)
        last_float = (lane.root + int(lane.inputs[:, APPEND].sum()) - 1) // per_pitch
        blocks = last_float // width + 2
        rows = np.zeros((blocks * width, fields))
        pack(rows, lane.state, lane.root, per_pitch, table, even)
        state = in_blocks(rows, width, precision)
        parameters = np.repeat(own[:, None], width, axis=1).astype(precision)
        stacked = root_tables([table], 1, even, odd, len(table.factors))
        constants = np.zeros((2 * CONSTANTS, width), dtype=precision)
        constants[:CONSTANTS] = stacked.pieces[0, -1][:, None]
        settled = (len(table.factors) - 1) // width + 1  # first block whose floats share their factors
        row = np.minimum(np.arange((settled + 1) * width), len(table.factors) - 1)
        factors = np.zeros(((settled + 2) * OWN, width), dtype=precision)
        factors[: (settled + 1) * OWN] = in_blocks(table.factors[row, :OWN], width, precision)
        links = np.zeros((len(table.factors) + 1, LINKS), dtype=precision)
        links[:-1] = table.factors[:, OWN:]
        tension = np.zeros(len(rows) if len(lane.tension_sum) else 0)
        floats = in_blocks(floats_of(own, table, len(rows)), width, precision)
        begin = time.perf_counter()
        lane.failed, lane.root = self.single(
            parameters, constants, factors, links, floats, ((0,) * even, (0,) * odd), state,
            lane.inputs.astype(precision), lane.root, time_step, stacked, np.zeros((2 * fields, 1), dtype=precision),
            (first_sample, sample_every, lane.points, lane.samples, tension),
        )  # fmt: skip
        seconds = time.perf_counter() - begin
        after = state.reshape(blocks, fields, width).transpose(0, 2, 1).reshape(-1, fields)
        unpack(after, lane.state, lane.root, per_pitch, table, even)
        displacements(stacked, after.reshape(-1, 1), fields, lane.root, 0, lane.state.d)
        add_tension(lane, tension, per_pitch)
        return seconds


class Superelement32(Superelement):
    """The same in single precision; eight probes side by side."""

    name = "superelement32"
    least_step = 5e-5
    precision = np.float32
    alone_share = 0.33


def add_tension(lane: Lane, tension: FloatArray, per_pitch: int) -> None:
    """Add the axial forces of a probe's pieces to the sum at its nodes."""
    covered = min(len(tension) * per_pitch, lane.root, len(lane.tension_sum))
    lane.tension_sum[:covered] += np.repeat(tension, per_pitch)[:covered]


def _placed(
    stacked: RootTables, roots: npt.NDArray[np.int64], rows: int, precision: npt.DTypeLike
) -> tuple[FloatArray, FloatArray, npt.NDArray[np.int64]]:
    """Constants, factors and the block of each row, see ``superelement_advance``."""
    width, last = len(roots), stacked.factors.shape[1] - 1
    constants = np.zeros(((1 + width) * CONSTANTS, width), dtype=precision)
    factors = np.zeros(((last + 1 + width) * FACTORS, width), dtype=precision)
    constants[:CONSTANTS] = stacked.pieces[:, -1].T
    factors[: (last + 1) * FACTORS] = stacked.factors.reshape(width, -1).T
    at = np.zeros(rows, dtype=np.int64)
    place_roots(stacked, constants, factors, at, last, roots)
    return constants, factors, at
