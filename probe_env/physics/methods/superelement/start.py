"""A state at rest with given displacements: modes and momenta follow from what is seen at the places."""

from __future__ import annotations

import numpy as np

from probe_env.arrays import FloatArray
from probe_env.physics.methods.factors import linear_weights
from probe_env.physics.methods.superelement.packing import MEMORY, MOMENTUM
from probe_env.physics.methods.superelement.pitch import ENDS, MIRROR
from probe_env.physics.methods.superelement.tables import K_EVEN, K_ODD, tables
from probe_env.physics.model.chain import Chain
from probe_env.physics.model.state import State, at_rest


def released(chain: Chain, nodes_per_pitch: int, time_step: float, root: int, d: FloatArray) -> State:
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


def _elastic(constants: FloatArray, ends: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Elastic force of a piece at its L and its R end."""
    flip = -MIRROR  # R's share of an even unknown, and of an odd one but for the sign
    even, odd = ends[:3] - flip * ends[3:], ends[:3] + flip * ends[3:]
    from_even = constants[K_EVEN : K_EVEN + 9].reshape(3, 3) @ even
    from_odd = constants[K_ODD + 3 : K_ODD + 6] * (constants[K_ODD : K_ODD + 3] @ odd)
    return from_even + from_odd, flip * (from_odd - from_even)
