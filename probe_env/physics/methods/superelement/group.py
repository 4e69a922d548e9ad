"""Probes side by side in the lanes of the superelement's kernel: packed, advanced, unpacked; see lane_group.py."""

from __future__ import annotations

import time
from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from probe_env.arrays import FloatArray
from probe_env.physics.chain import Chain
from probe_env.physics.methods.lane_group import (
    CARRIER_DRAG,
    GUIDE_DRAG,
    MASS_RATIO,
    ROOT,
    SENSOR,
    STIFFNESS,
    TENSION,
    Entered,
    Lane,
    LaneKernel,
    lane_parameters,
)  # fmt: skip
from probe_env.physics.methods.superelement.pitch import ENDS
from probe_env.physics.methods.superelement.roots import (
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
)  # fmt: skip
from probe_env.physics.methods.superelement.tables import CONSTANTS, FACTORS, LEAST, MOST, Tables, tables
from probe_env.physics.state import State

MOMENTUM = 3
MEMORY = MOMENTUM + 4 * MOST
"""Momentum, then q and p of the even and of the odd modes; rows of floats alone are in use."""


INSTEAD = "imex with 8 nodes a pitch simulates it"
ROOMS = (LEAST, (3, 3), (MOST, MOST))
"""Even and odd modes of which there is a kernel."""


@dataclass(frozen=True)
class PieceKernel(LaneKernel):
    """What advances a group whose rows are floats with the piece of cable behind them."""

    def kind(self, factors: Any) -> Hashable:
        """The kernel that has room for a probe's modes: compiled otherwise, it rounds otherwise."""
        return _room(factors)

    def constants(self, chain: Chain, sensor: int, nodes_per_pitch: int, time_step: float) -> tuple[FloatArray, Any]:
        """Parameters and tables of a probe.

        Raises:
            ValueError: a scene in which the cable between floats is more than elastic.
        """
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

    def run(
        self,
        lanes: Sequence[Lane],
        time_step: float,
        per_pitch: int,
        first_sample: int,
        sample_every: int,
        tension_sum: FloatArray | None = None,
    ) -> tuple[list[int], float]:
        """See ``LaneKernel.run``."""
        own: list[Tables] = [lane.factors for lane in lanes]
        even, odd = _room(own[0])
        used, width, precision = len(lanes), self.width, self.precision
        fields, last = MODES + 2 * (even + odd), max(len(t.factors) for t in own) - 1
        entered = Entered.of(lanes, width, precision)
        roots = entered.roots
        last_float = (entered.held_nodes(used) - 1) // per_pitch
        entered.parameters[ROOT, :used] = last_float[0] + 1
        rows = int(last_float[-1].max()) + 2
        state = np.zeros((rows, fields, width), dtype=precision)
        for k, (lane, table) in enumerate(zip(lanes, own, strict=True)):
            _pack(state[:, :, k], lane.state, lane.root, per_pitch, table, even)
        stacked = _root_tables(own, width, even, odd, last + 1)
        constants, factors, at = _placed(stacked, roots, rows, precision)
        samples = np.zeros((len(lanes[0].samples), len(lanes[0].points), 4, width))
        tension = np.zeros((0 if tension_sum is None else rows, width))
        begin = time.perf_counter()
        self.advance(
            entered.parameters, constants, factors, at, last, (0,) * even, (0,) * odd, state.reshape(-1, width),
            entered.inputs.reshape(-1, width), last_float[:-1].max(axis=1), last_float[:-1].min(axis=1), time_step,
            stacked, first_sample, sample_every, entered.points, roots, samples, tension, entered.failed,
        )  # fmt: skip
        seconds = time.perf_counter() - begin
        for k, (lane, table) in enumerate(zip(lanes, own, strict=True)):
            lane.root = int(roots[k])
            _unpack(state[:, :, k], lane.state, lane.root, per_pitch, table, even)
            displacements(stacked, state.reshape(-1, width), fields, lane.root, k, lane.state.d)
            lane.samples[...] = samples[..., k]
        if tension_sum is not None:
            covered = min(rows * per_pitch, lanes[0].root, len(tension_sum))
            tension_sum[:covered] += np.repeat(tension[:, 0], per_pitch)[:covered]
        return entered.failed[:used].tolist(), seconds


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


def _room(table: Tables) -> tuple[int, int]:
    """Least of ``ROOMS`` that holds a probe's even and odd modes."""
    return next(room for room in ROOMS if table.even <= room[0] and table.odd <= room[1])


def _modes(table: Tables, even: int) -> list[tuple[int, int]]:
    """Where a probe's modes are: column of the memory and field of q; p follows."""
    evens = [(MOMENTUM + 2 * j, MODES + 2 * j) for j in range(table.even)]
    return evens + [(MOMENTUM + 2 * (table.even + j), MODES + 2 * (even + j)) for j in range(table.odd)]


def _pack(rows: FloatArray, state: State, root: int, per_pitch: int, table: Tables, even: int) -> None:
    count = (root - 1) // per_pitch + 1
    floats = slice(0, root, per_pitch)
    rows[:count, X : T + 1] = state.d[floats]
    rows[:count, VX : VT + 1] = state.v[floats]
    rows[:count, V] = state.axial_force[floats]
    memory = state.memory[floats]
    rows[:count, PX : PT + 1] = memory[:, :3]
    for column, field in _modes(table, even):
        rows[:count, field : field + 2] = memory[:, column : column + 2]


def _unpack(rows: FloatArray, state: State, root: int, per_pitch: int, table: Tables, even: int) -> None:
    """``_pack`` backwards; the axial force is that of the piece at all its places."""
    count = (root - 1) // per_pitch + 1
    floats = slice(0, root, per_pitch)
    state.d[floats], state.v[floats] = rows[:count, X : T + 1], rows[:count, VX : VT + 1]
    state.axial_force[:root] = np.repeat(rows[:count, V], per_pitch)[:root]
    memory = state.memory[floats]
    memory[:, :3] = rows[:count, PX : PT + 1]
    for column, field in _modes(table, even):
        memory[:, column : column + 2] = rows[:count, field : field + 2]


def _root_tables(own: Sequence[Tables], width: int, even: int, odd: int, rows: int) -> RootTables:
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
