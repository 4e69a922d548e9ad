"""State of a probe, and checks that it fits a chain.

Kernels are compiled without bounds checks, so arrays from callers must be checked here.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from probe_env.arrays import FloatArray

SHORTENING, HELD = 3, 4
DIVERGED_RADIAL = 1.0  # [m]; a tube is a few centimetres wide


class State(NamedTuple):
    """Displacement and velocity (n + 1, 3), memory of the last step (n + 1, w), axial force of each element (n + 1,).

    The first three columns of ``memory`` depend on the method: acceleration (Newmark, Wilson), mean velocity of the
    last step (implicit), the fields GX, GY, GT of a lane (imex), momenta in the rows of floats (superelement, whose
    modes follow in the last columns); ``explicit`` does not use them. Column ``SHORTENING`` is the tension N from the
    shortening of the bent span [N], column ``HELD`` the friction that resists sliding at the end of the last step [N].
    The width w is ``Method.memory``, usually 5.

    ``axial_force[i]`` is Vbar of (8) at node i, on its root side; the last entry is unused.
    """

    d: FloatArray
    v: FloatArray
    memory: FloatArray
    axial_force: FloatArray

    @property
    def tension(self) -> FloatArray:
        """(n + 1,) tension at every node, on its root side: axial force and N [N]."""
        return self.axial_force + self.memory[:, SHORTENING]


def at_rest(nodes: int, memory: int = 5) -> State:
    """All zero, the initial state of the study; ``memory`` is ``Method.memory``."""
    return State(np.zeros((nodes, 3)), np.zeros((nodes, 3)), np.zeros((nodes, memory)), np.zeros(nodes))


def check_array(name: str, array: object, shape: tuple[int, ...], dtype: type = np.float64) -> None:
    """Raise ValueError unless ``array`` is writable, contiguous and has a shape (-1: any) and a type."""
    if not isinstance(array, np.ndarray):
        raise ValueError(f"{name} is a {type(array).__name__}, not an array")
    if array.ndim != len(shape) or any(n not in (-1, size) for n, size in zip(shape, array.shape, strict=True)):
        accepted = ", ".join("any" if size < 0 else str(size) for size in shape)
        raise ValueError(f"{name} has shape {array.shape}; ({accepted}) is accepted")
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
