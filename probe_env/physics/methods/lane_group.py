"""Probes of the fast scheme side by side, as many as there are lanes: packed, advanced, unpacked.

State lives with the probes, not in the lanes, so that any probes can share a group from one call to the next
and a probe's result does not depend on the company it keeps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from probe_env.arrays import FloatArray
from probe_env.physics.chain import Chain
from probe_env.physics.methods import imex
from probe_env.physics.methods.factors import explicit_factors, imex_factors, single_factors
from probe_env.physics.methods.lanes import lane_count
from probe_env.physics.state import State

KERNELS: Final[dict[str, Callable[..., Any]]] = {
    "imex": imex.imex_advance, "imex32": imex.imex_advance, "explicit": imex.explicit_advance
}  # fmt: skip
FACTORS: Final[dict[str, Callable[[Chain, float], FloatArray]]] = {
    "imex": imex_factors, "imex32": single_factors, "explicit": lambda chain, _: explicit_factors(chain)
}  # fmt: skip
PRECISIONS: Final = {"imex": np.float64, "imex32": np.float32, "explicit": np.float64}
LANES: Final = {method: lane_count(precision) for method, precision in PRECISIONS.items()}
"""Probes that share a group."""


@dataclass
class Lane:
    """One probe as the lanes need it; ``state`` and ``root`` change in place.

    ``state.a`` holds no acceleration here but what a kernel keeps of its last step (fields GX, GY, GT).
    """

    parameters: FloatArray
    factors: FloatArray
    state: State
    root: int


def lane_constants(
    method: str, chain: Chain, sensor: int, per_pitch: int, time_step: float
) -> tuple[FloatArray, FloatArray]:
    """Parameters and factors of a probe for a method of ``KERNELS``."""
    return imex.lane_parameters(chain, sensor, per_pitch), FACTORS[method](chain, time_step)


def advance_group(
    method: str,
    lanes: Sequence[Lane],
    inputs: Sequence[FloatArray],
    time_step: float,
    per_pitch: int,
    first_sample: int,
    sample_every: int,
    points: Sequence[npt.NDArray[np.int64]],
    samples: Sequence[FloatArray],
    tension_sum: FloatArray | None = None,
) -> list[int]:
    """Advance as many probes as ``LANES`` of the method, or fewer, by the rows of their inputs.

    Args:
        method: a key of ``KERNELS``.
        lanes: the probes.
        inputs: (steps, 4) of each probe, see drive.py; equally many steps.
        time_step: [s].
        per_pitch: nodes in a float pitch.
        first_sample: steps until the first sample.
        sample_every: steps between samples.
        points: (p,) nodes of each probe, -1 for the root; equally many.
        samples: (k, p, 4) of each probe, written in place.
        tension_sum: (n + 1,) of the first probe, gains the axial force of every sample.

    Returns:
        for each probe the step at which it diverged, counted from 1, or 0.
    """
    steps, used, width, precision = len(inputs[0]), len(lanes), LANES[method], PRECISIONS[method]
    packed_inputs = np.zeros((steps, imex.INPUTS, width), dtype=precision)
    roots, failed = np.zeros(width, dtype=np.int64), np.full(width, -1, dtype=np.int64)
    packed_points = np.zeros((len(points[0]), width), dtype=np.int64)
    for k, (lane, rows) in enumerate(zip(lanes, inputs, strict=True)):
        packed_inputs[:, :, k] = rows
        roots[k], failed[k] = lane.root, 0
        packed_points[:, k] = points[k]
    appended = np.cumsum(packed_inputs[:, 3, :used], axis=0) - packed_inputs[:, 3, :used]  # before each step
    held = roots[:used] + appended.astype(np.int64)
    tops, bottoms = held.max(axis=1), held.min(axis=1)
    nodes = int(max(lane.root + rows[:, 3].sum() for lane, rows in zip(lanes, inputs, strict=True))) + 2

    parameters = np.zeros((imex.PARAMETERS, width), dtype=precision)
    parameters[imex.DAMPING] = 1.0  # idle lanes divide by it
    factors = np.zeros((max(len(lane.factors) for lane in lanes), imex.FACTORS, width), dtype=precision)
    state = np.zeros((nodes, imex.FIELDS, width), dtype=precision)
    for k, lane in enumerate(lanes):
        parameters[:, k] = lane.parameters
        parameters[imex.ROOT, k] = lane.root
        factors[: len(lane.factors), :, k] = lane.factors
        factors[len(lane.factors) :, :, k] = lane.factors[-1]
        state[: lane.root, 0:3, k] = lane.state.d[: lane.root]
        state[: lane.root, 3:6, k] = lane.state.v[: lane.root]
        state[: lane.root, 6:9, k] = lane.state.a[: lane.root]
        state[: lane.root, 9, k] = lane.state.axial_force[: lane.root]
    packed_samples = np.zeros((len(samples[0]), len(points[0]), 4, width))
    packed_tension = np.zeros((0 if tension_sum is None else nodes, width))
    KERNELS[method](
        parameters, factors.reshape(-1, width), state.reshape(-1, width), packed_inputs.reshape(-1, width),
        tops, bottoms, time_step, per_pitch, first_sample, sample_every, packed_points, roots, packed_samples,
        packed_tension, failed,
    )  # fmt: skip
    for k, lane in enumerate(lanes):
        lane.root = int(roots[k])
        lane.state.d[: lane.root] = state[: lane.root, 0:3, k]
        lane.state.v[: lane.root] = state[: lane.root, 3:6, k]
        lane.state.a[: lane.root] = state[: lane.root, 6:9, k]
        lane.state.axial_force[: lane.root] = state[: lane.root, 9, k]
        samples[k][...] = packed_samples[..., k]
    if tension_sum is not None:
        covered = min(nodes, len(tension_sum))
        tension_sum[:covered] += packed_tension[:covered, 0]
    return [int(failed[k]) for k in range(used)]
