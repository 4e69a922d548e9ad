"""State and tables of probes as the superelement's kernels hold them, and back."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from probe_env.arrays import FloatArray
from probe_env.physics.methods.lane_group import (
    CARRIER_DRAG,
    CARRIER_GAP,
    CARRIER_LEVER,
    GUIDE_DRAG,
    GUIDE_GAP,
    GUIDE_LEVER,
    SENSOR,
)
from probe_env.physics.methods.superelement.along import BEHIND, DRAG, FLOATS, GAP, LEVER
from probe_env.physics.methods.superelement.pitch import ENDS
from probe_env.physics.methods.superelement.roots import MODES, PT, PX, VT, VX, RootTables, T, V, X
from probe_env.physics.methods.superelement.tables import CONSTANTS, FACTORS, HALF_MASS, LEAST, MOST, Tables
from probe_env.physics.model.state import State

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
    for column, field in mode_fields(table, even):
        rows[:count, field : field + 2] = memory[:, column : column + 2]


def unpack(rows: FloatArray, state: State, root: int, per_pitch: int, table: Tables, even: int) -> None:
    """``pack`` backwards; the axial force is that of the piece at all its places."""
    count = (root - 1) // per_pitch + 1
    floats = slice(0, root, per_pitch)
    state.d[floats], state.v[floats] = rows[:count, X : T + 1], rows[:count, VX : VT + 1]
    state.axial_force[:root] = np.repeat(rows[:count, V], per_pitch)[:root]
    memory = state.memory[floats]
    memory[:, :3] = rows[:count, PX : PT + 1]
    for column, field in mode_fields(table, even):
        memory[:, column : column + 2] = rows[:count, field : field + 2]


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
    for field, (near, far) in zip((LEVER, GAP, DRAG), kinds, strict=True):
        rows[:, field] = np.where(guide, parameters[near], parameters[far])
    rows[1:, BEHIND] = table.pieces[-1, HALF_MASS]
    return rows


def in_blocks(rows: FloatArray, width: int, precision: npt.DTypeLike) -> FloatArray:
    """(blocks f, width) of (blocks width, f): neighbouring rows side by side."""
    blocks = rows.reshape(-1, width, rows.shape[1]).transpose(0, 2, 1)
    return np.ascontiguousarray(blocks.reshape(-1, width), dtype=precision)
