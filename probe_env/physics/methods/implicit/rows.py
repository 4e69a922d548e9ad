"""What acts on a node without contact: inertia, drag, Coriolis and centrifugal force, supports, the couple of (9)."""

from __future__ import annotations

from numba import njit

from probe_env.physics.methods.ticm.after_step import FASTMATH
from probe_env.physics.model.chain import Chain, most_pressure, most_tension


def couple_limits(chain: Chain, nodes_per_pitch: int) -> tuple[float, float]:
    """Greatest compression and tension [N] that the couple V l theta is given, see chain.py."""
    h = chain.element_length
    rigidity = h / chain.bending_compliance
    return most_pressure(rigidity, h, nodes_per_pitch * h), most_tension(rigidity, h)


@njit(nogil=True, error_model="numpy", fastmath=FASTMATH, forceinline=True)
def free_rows(chain, weights, limits, speed, slope, air, state, i, P, q):
    """P and q of node i without contact; P as (xx, xy, yy, tx, ty, tt, xt)."""
    dt, theta, tau = weights
    x, y, t = state.d[i, 0], state.d[i, 1], state.d[i, 2]
    forward = speed + state.v[i, 0]
    c = 1.0 / (tau * theta * dt)
    hx = c * x + state.v[i, 0] / (theta * dt) - slope  # the frame's own acceleration adds -M (du/dt, 0, 0)
    hy = c * y + state.v[i, 1] / (theta * dt) + chain.curvature * forward * forward
    ht = c * t + state.v[i, 2] / (theta * dt)
    coriolis = 2.0 * chain.mass * chain.curvature * forward / tau
    drag = chain.drag[i] * abs(air - forward)  # (10)
    couple = min(max(state.axial_force[i], -limits[0]), limits[1]) * chain.couple_length  # (9)
    at_end = dt / tau if couple > 0.0 else 0.0
    half = 0.5 * dt / tau  # supports act at the middle of the step
    sx, sy, st = chain.support_stiffness[i, 0], chain.support_stiffness[i, 1], chain.support_stiffness[i, 2]
    P[i, 0] = c * chain.mass + half * sx + drag / tau
    P[i, 1] = coriolis
    P[i, 2] = c * chain.mass + half * sy
    P[i, 3] = -c * chain.frame_inertia
    P[i, 4] = 0.0
    P[i, 5] = c * chain.inertia + half * st + couple * at_end
    P[i, 6] = 0.0
    relative, turn = t, chain.couple_turn
    if turn > 0.0:  # counted from the tangent at x, and its work on x
        relative += turn * x
        P[i, 0] += turn * turn * couple * at_end
        P[i, 3] += turn * couple * at_end
        P[i, 6] += turn * couple * at_end
    q[i, 0] = chain.load[i, 0] + chain.mass * hx + coriolis * y - (1.0 - half) * sx * x
    q[i, 0] += drag * (air - speed + x / tau)
    q[i, 1] = chain.load[i, 1] + chain.mass * hy - (1.0 - half) * sy * y
    q[i, 2] = chain.load[i, 2] + chain.inertia * ht - chain.frame_inertia * hx
    q[i, 0] -= turn * couple * (1.0 - at_end) * relative
    q[i, 2] -= (1.0 - half) * st * t + couple * (1.0 - at_end) * relative
