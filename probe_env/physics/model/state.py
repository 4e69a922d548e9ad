"""The state that every method advances, and that it fits a chain.

Kernels are compiled without bounds checks: no array of a caller may make one read or write outside it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from probe_env.arrays import FloatArray

DIVERGED_RADIAL = 1.0  # [m]; a tube is a few centimetres wide


class State(NamedTuple):
    """Displacement and velocity (n + 1, 3), memory of the last step (n + 1, w), axial force of each element (n + 1,).

    What ``memory`` is belongs to the method: the acceleration (Newmark, Wilson), the mean velocity of the last step
    (implicit), the fields GX, GY, GT of a lane (imex), momenta and modes in the rows of floats (superelement);
    ``explicit`` has none. Its width w is ``Method.memory``, 3 mostly.

    ``axial_force[i]`` is Vbar of (8) at node i, on its root side; the last entry is unused.
    """

    d: FloatArray
    v: FloatArray
    memory: FloatArray
    axial_force: FloatArray


def at_rest(nodes: int, memory: int = 3) -> State:
    """All zero, the study's start; ``memory`` of a method, see ``Method.memory``."""
    return State(np.zeros((nodes, 3)), np.zeros((nodes, 3)), np.zeros((nodes, memory)), np.zeros(nodes))


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
