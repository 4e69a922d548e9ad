"""Probes side by side in the lanes of the superelement's kernel: packed, advanced, unpacked; see lane_group.py."""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from probe_env.arrays import FloatArray
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
from probe_env.physics.methods.superelement.along_root import LINKS, OWN
from probe_env.physics.methods.superelement.packing import floats_of, in_blocks, pack, room, root_tables, unpack
from probe_env.physics.methods.superelement.roots import (
    MODES,
    RootTables,
    displacements,
    place_roots,
)  # fmt: skip
from probe_env.physics.methods.superelement.tables import CONSTANTS, FACTORS, Tables, tables
from probe_env.physics.model.chain import Chain
from probe_env.physics.model.drive import APPEND

INSTEAD = "imex with 8 nodes a pitch simulates it"


@dataclass(frozen=True)
class PieceKernel(LaneKernel):
    """What advances a group whose rows are floats with the piece of cable behind them.

    Attributes:
        along: the kernel of a probe alone, bit for bit the same.
    """

    along: Callable[..., Any] = field(kw_only=True)

    def kind(self, factors: Any) -> Hashable:
        """The kernel that has room for a probe's modes: compiled otherwise, it rounds otherwise."""
        return room(factors)

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
        if len(lanes) == 1:
            return self._run_alone(lanes[0], time_step, per_pitch, first_sample, sample_every, tension_sum)
        own: list[Tables] = [lane.factors for lane in lanes]
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
            unpack(state[:, :, k], lane.state, lane.root, per_pitch, table, even)
            displacements(stacked, state.reshape(-1, width), fields, lane.root, k, lane.state.d)
            lane.samples[...] = samples[..., k]
        if tension_sum is not None:
            covered = min(rows * per_pitch, lanes[0].root, len(tension_sum))
            tension_sum[:covered] += np.repeat(tension[:, 0], per_pitch)[:covered]
        return entered.failed[:used].tolist(), seconds

    def _run_alone(
        self,
        lane: Lane,
        time_step: float,
        per_pitch: int,
        first_sample: int,
        sample_every: int,
        tension_sum: FloatArray | None,
    ) -> tuple[list[int], float]:
        """``run`` of one probe that has no company: its floats are in the lanes."""
        table: Tables = lane.factors
        (even, odd), width, precision = room(table), self.width, self.precision
        fields = MODES + 2 * (even + odd)
        last_float = (lane.root + int(lane.inputs[:, APPEND].sum()) - 1) // per_pitch
        blocks = last_float // width + 2
        rows = np.zeros((blocks * width, fields))
        pack(rows, lane.state, lane.root, per_pitch, table, even)
        state = in_blocks(rows, width, precision)
        parameters = np.repeat(lane.parameters[:, None], width, axis=1).astype(precision)
        stacked = root_tables([table], 1, even, odd, len(table.factors))
        constants = np.zeros((2 * CONSTANTS, width), dtype=precision)
        constants[:CONSTANTS] = stacked.pieces[0, -1][:, None]
        settled = (len(table.factors) - 1) // width + 1  # first block whose floats share their factors
        row = np.minimum(np.arange((settled + 1) * width), len(table.factors) - 1)
        factors = np.zeros(((settled + 2) * OWN, width), dtype=precision)
        factors[: (settled + 1) * OWN] = in_blocks(table.factors[row, :OWN], width, precision)
        links = np.zeros((len(table.factors) + 1, LINKS), dtype=precision)
        links[:-1] = table.factors[:, OWN:]
        samples, tension = np.zeros(lane.samples.shape), np.zeros(0 if tension_sum is None else len(rows))
        floats = in_blocks(floats_of(lane.parameters, table, len(rows)), width, precision)
        begin = time.perf_counter()
        failed, lane.root = self.along(
            parameters, constants, factors, links, floats, (0,) * even, (0,) * odd, state,
            lane.inputs.astype(precision), lane.root, time_step, stacked, np.zeros((2 * fields, 1), dtype=precision),
            first_sample, sample_every, lane.points, samples, tension,
        )  # fmt: skip
        seconds = time.perf_counter() - begin
        after = state.reshape(blocks, fields, width).transpose(0, 2, 1).reshape(-1, fields)
        unpack(after, lane.state, lane.root, per_pitch, table, even)
        displacements(stacked, after.reshape(-1, 1), fields, lane.root, 0, lane.state.d)
        lane.samples[...] = samples
        if tension_sum is not None:
            covered = min(len(rows) * per_pitch, lane.root, len(tension_sum))
            tension_sum[:covered] += np.repeat(tension, per_pitch)[:covered]
        return [failed], seconds


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
