"""The state that every method advances."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

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
