"""What every method of the study's family does after a step: the root that moves, samples, statuses.

A kernel returns a status and never raises. Of fastmath only contraction (fused multiply-add): it keeps NaN checks
alive, and reassociation made the sweep 15 % slower (LLVM spills more).
"""

from __future__ import annotations

import math

from numba import njit

from probe_env.physics.model.drive import APPEND

FASTMATH = {"contract"}

OVERFLOW = 1e100  # beyond it the next product may be infinite

LEAVING = 0.1  # [m]

OK, DIVERGED = 0, 1


@njit(cache=True, nogil=True)
def move_root(chain, inputs, root, state):
    """Hold another node if one is due; the node that is held now.

    What is drawn back is held as it is when it comes to the entrance, so that a pressed probe is drawn out along the
    outer wall: brought to the inner one there, every float would shake it, and the shaking grows on the way to the tip.
    What comes in is as far back as the root was, unstretched, on a line that leaves where the root was held for the
    inner wall within some ``LEAVING``.
    """
    if inputs[APPEND] > 0.0:
        x, y = state.d[root, 0], state.d[root, 1] * math.exp(-chain.element_length / LEAVING)
        root += 1
        state.d[root, 0], state.d[root, 1], state.d[root, 2] = x, y, y / LEAVING - chain.curvature * x
    elif inputs[APPEND] < 0.0:
        state.d[root, :] = 0.0
        root -= 1
        state.v[root, :] = 0.0
        state.memory[root, :] = 0.0
        state.axial_force[root] = 0.0
    return root


@njit(cache=True, nogil=True)
def record(state, root, points, samples, row, tension_sum):
    """Write one sample of all points (the held root: point < 0) and add up the axial forces."""
    for p in range(len(points)):
        i = points[p] if points[p] >= 0 else root
        samples[row, p, 0] = state.d[i, 0]
        samples[row, p, 1] = state.d[i, 1]
        samples[row, p, 2] = state.d[i, 2]
        samples[row, p, 3] = state.axial_force[min(i, root - 1)]
    for i in range(root):
        tension_sum[i] += state.axial_force[i]
