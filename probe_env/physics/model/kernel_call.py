"""What a kernel is called with, and that it fits: no array of a caller may make one read or write outside it.

Kernels are compiled without bounds checks; these are made once a call, where Python enters.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from probe_env.arrays import FloatArray
from probe_env.physics.model.chain import Chain
from probe_env.physics.model.drive import APPEND, INPUTS
from probe_env.physics.model.state import State

CHANNELS = 4


class Sampling(NamedTuple):
    """What to record during a call, see ``ticm.advance``: (p,) nodes, -1 for the root; (k, p, 4); (n + 1,).

    ``counts`` (2,) gains the iterations of ``implicit`` and its steps that did not converge.
    """

    first: int
    every: int
    points: npt.NDArray[np.int64]
    samples: FloatArray
    tension_sum: FloatArray
    counts: npt.NDArray[np.int64]


def check_array(name: str, array: object, shape: tuple[int, ...], dtype: type = np.float64) -> None:
    """Raise ValueError unless this is a writable, contiguous array of a shape (-1: any) and a type."""
    if not isinstance(array, np.ndarray):
        raise ValueError(f"{name} is a {type(array).__name__}, not an array")
    fits = array.ndim == len(shape) and all(want in (-1, have) for want, have in zip(shape, array.shape, strict=True))
    if not fits:
        wanted = ", ".join("any" if size < 0 else str(size) for size in shape)
        raise ValueError(f"{name} has shape {array.shape}; ({wanted}) is accepted")
    if array.dtype != dtype:
        raise ValueError(f"{name} has type {array.dtype}; {np.dtype(dtype)} is accepted")
    if not (array.flags.c_contiguous and array.flags.writeable):
        raise ValueError(f"{name} is not contiguous and writable: give a copy")


def check_state(state: State, root: int, nodes: int, memory: int, name: str = "state") -> None:
    """Raise ValueError unless a state is that of a chain of ``nodes`` nodes, held at ``root``, and its method's."""
    if not isinstance(state, State):
        raise ValueError(f"{name} is a {type(state).__name__}, not a State of d, v, memory and axial_force")
    for field, width in (("d", 3), ("v", 3), ("memory", memory)):
        check_array(f"{name}.{field}", getattr(state, field), (nodes, width))
    check_array(f"{name}.axial_force", state.axial_force, (nodes,))
    if not 1 <= root <= nodes - 1:
        raise ValueError(f"root = {root!r} is outside the accepted range 1 to {nodes - 1} of a chain of {nodes} nodes")


def check_points(points: npt.NDArray[np.int64], root: int) -> None:
    """Raise ValueError unless all points are nodes up to the root, or -1."""
    check_array("points", points, (-1,), np.int64)
    bad = points[(points < -1) | (points > root)]
    if len(bad):
        raise ValueError(f"points: {bad[0]} is not a node from the tip, 0, to the root, {root}, nor -1 for the root")


def check_call(nodes: int, memory: int, inputs: FloatArray, root: int, state: State, sampling: Sampling) -> None:
    """Raise ValueError, naming the array, unless everything fits a chain of ``nodes`` nodes and a method's memory."""
    check_state(state, root, nodes, memory)
    check_array("inputs", inputs, (-1, INPUTS))
    first, every, points, samples, tension_sum, counts = sampling
    appended = inputs[:, APPEND]
    if not ((appended == 0.0) | (np.abs(appended) == 1.0)).all():  # also NaN
        raise ValueError(
            "inputs: the last column must be 0, 1 where a node is appended after the step, or -1 where one is held"
        )
    roots = root + np.cumsum(appended)
    if len(roots) and roots.max() > nodes - 1:
        more = int(roots.max()) - root
        raise ValueError(f"inputs append {more} nodes to {root}: the chain has room for {nodes - 1 - root}")
    if first < 1 or every < 1:
        raise ValueError(f"sampling: first = {first!r} and every = {every!r} must be 1 or more")
    check_points(points, root)
    least = int(max(1, *points)) if len(points) else 1
    if len(roots) and roots.min() < least:
        raise ValueError(f"inputs draw the root back to node {int(roots.min())}; {least} is the least here")
    check_array("samples", samples, (-1, len(points), CHANNELS))
    due = max(0, (len(inputs) - first) // every + 1)
    if len(samples) < due:
        raise ValueError(f"samples has {len(samples)} rows; {due} fall due in {len(inputs)} steps")
    check_array("tension_sum", tension_sum, (nodes,))
    check_array("counts", counts, (2,), np.int64)


def check_chain(chain: Chain, sensor: int, nodes_per_pitch: int) -> None:
    """Raise ValueError unless all arrays of a chain are as long as it, and the sensor is one of its nodes."""
    nodes = chain.node_count
    for field in ("contact_stiffness", "outer_gap", "lever", "drag"):
        check_array(f"chain.{field}", getattr(chain, field), (nodes,))
    for field in ("support_stiffness", "load"):
        check_array(f"chain.{field}", getattr(chain, field), (nodes, 3))
    if nodes < 2:
        raise ValueError(f"chain has {nodes} node; at least 2 are needed, the last of them held")
    if not 0 <= sensor < nodes:
        raise ValueError(f"sensor = {sensor!r} is not a node from 0 to {nodes - 1}")
    if nodes_per_pitch < 1:
        raise ValueError(f"nodes_per_pitch = {nodes_per_pitch!r} is outside the accepted range 1 and more")
