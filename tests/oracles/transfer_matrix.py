"""Transfer-matrix method, the predecessor of the TICM: d and f are transferred from the root to the tip.

The three unknown root forces follow from the free tip. Growing solutions dominate decaying ones, so the method loses
accuracy on long or stiffly supported chains (Pestel and Leckie 1963); it is included for comparison.
"""

import numpy as np
from numba import njit

from oracles import banded
from probe_env.arrays import FloatArray
from probe_env.physics.methods.newmark import Scheme, Workspace
from probe_env.physics.model.chain import Chain
from probe_env.physics.model.state import State


def step(chain: Chain, scheme: Scheme, inputs: FloatArray, root: int, state: State, work: Workspace) -> int:
    """One step; returns the first diverged node or -1 (a lost solution counts as diverged: node 0)."""
    banded.node_equations(chain, scheme, inputs, root, state, work)
    h_v = scheme.v_d * state.d + scheme.v_v * state.v + scheme.v_a * state.memory
    h_v[root] = -scheme.B_v * state.d[root]  # the held root is at rest
    columns = np.empty((root + 1, 3, 4))
    axial = np.empty((root + 1, 4))
    tip_force = _sweep(chain, scheme.B_v, state.d[root], h_v, work.P, work.q, columns, axial)
    if not np.isfinite(tip_force).all():
        return 0
    try:
        root_force = np.linalg.solve(tip_force[:, :3], -tip_force[:, 3])
    except np.linalg.LinAlgError:
        return 0
    weights: FloatArray = np.append(root_force, 1.0)
    return int(banded.apply_solution(scheme, state, columns @ weights, (axial @ weights)[:root]))


@njit(error_model="numpy")
def _sweep(chain, B_v, held, h_v, P, q, columns, axial):
    """Displacements of all nodes and axial forces as linear functions of the root force and 1.

    The first three of the four columns belong to the root force, the last to the loads and the position of the root.
    Returns the force on the free side of the tip (3, 4).
    """
    c, s, h = chain.cos_phi, chain.sin_phi, chain.element_length
    damped = 1.0 + chain.damping_time * B_v
    delta = chain.damping_time / damped
    root = len(axial) - 1
    unit = np.eye(4)
    f_end = np.zeros((3, 4))
    columns[root] = 0.0
    columns[root, :, 3] = held
    axial[root] = 0.0
    for k in range(4):
        fx, fy, ft, loaded = unit[k, 0], unit[k, 1], unit[k, 2], unit[k, 3]
        x, y, t = loaded * held[0], loaded * held[1], loaded * held[2]
        for i in range(root - 1, -1, -1):
            x, y = c * x - s * y, s * x + c * y  # into the element's frame (26b)
            fx, fy = c * fx - s * fy, s * fx + c * fy
            ft -= h * fy  # fbar = L^-1 f, (6)
            wx = c * h_v[i + 1, 0] - s * h_v[i + 1, 1]
            wy = s * h_v[i + 1, 0] + c * h_v[i + 1, 1]
            wt = h_v[i + 1, 2]
            vx = c * h_v[i, 0] + s * h_v[i, 1]
            vy = c * h_v[i, 1] - s * h_v[i, 0]
            vt = h_v[i, 2]
            # (18): L^T d + F fbar / (1 + delta B_v) + history
            x += chain.axial_compliance / damped * fx + loaded * delta * (wx - vx)
            y += (
                h * t
                + (chain.shear_compliance * fy + chain.coupling_compliance * ft) / damped
                + loaded * delta * (wy + h * wt - vy)
            )
            t += (chain.coupling_compliance * fy + chain.bending_compliance * ft) / damped
            t += loaded * delta * (wt - vt)
            axial[i, k] = fx
            x, y = c * x - s * y, s * x + c * y  # into the node's frame (26a)
            fx, fy = c * fx - s * fy, s * fx + c * fy
            fx += P[i, 0] * x + P[i, 1] * y - loaded * q[i, 0]  # (17)
            fy += P[i, 2] * y - loaded * q[i, 1]
            ft += P[i, 3] * x + P[i, 4] * y + P[i, 5] * t - loaded * q[i, 2]
            columns[i, 0, k], columns[i, 1, k], columns[i, 2, k] = x, y, t
        f_end[0, k], f_end[1, k], f_end[2, k] = fx, fy, ft
    return f_end
