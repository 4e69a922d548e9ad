"""The TICM sweep with the flags of an iteration, and the scratch of a step."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from probe_env.arrays import FloatArray
from probe_env.physics.methods.implicit.contact import ARM, moment_of_contact, push
from probe_env.physics.methods.ticm.after_step import FASTMATH, OVERFLOW
from probe_env.physics.methods.ticm.recursion import behind, through_point, to_node, turned


class Workspace(NamedTuple):
    """Scratch of a step: T (n + 1, 9) and s (n + 1, 3) of the TICM, P (n + 1, 7) and q (n + 1, 3).

    P and q without and with contact; iterate and solution w (n + 1, 3); bounds of frozen friction (n + 1,); flags
    wall and slide (n + 1, 2).
    """

    T: FloatArray
    s: FloatArray
    free_p: FloatArray
    free_q: FloatArray
    P: FloatArray
    q: FloatArray
    iterate: FloatArray
    w: FloatArray
    bound: FloatArray
    flags: npt.NDArray[np.int64]


def workspace(nodes: int) -> Workspace:
    """Scratch for a chain of ``nodes`` nodes."""
    T, p, free_p, q = np.zeros((nodes, 9)), np.zeros((nodes, 7)), np.zeros((nodes, 7)), np.zeros((nodes, 3))
    s, free_q, iterate, w = q.copy(), q.copy(), q.copy(), q.copy()
    return Workspace(T, s, free_p, free_q, p, q, iterate, w, np.zeros(nodes), np.zeros((nodes, 2), dtype=np.int64))


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH)
def solve(chain, root, places, law, state, work):
    """Solution w by the TICM with the present flags, and the axial forces; the first bad node or -1."""
    _, _, tau, stiction, speed, coefficient, frozen = law
    d, P, q, T, s, w = state.d, work.P, work.q, work.T, work.s, work.w
    c, sn, h = chain.cos_phi, chain.sin_phi, chain.element_length
    F = chain.axial_compliance, chain.shear_compliance, chain.bending_compliance, chain.coupling_compliance
    Tj = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    T[root, :] = 0.0
    x, y, t = d[root, 0], d[root, 1], d[root, 2]
    s[root, 0], s[root, 1], s[root, 2] = x, y, t
    sx, sy, st = c * x - sn * y, sn * x + c * y, t
    for back in range(root):
        i = root - 1 - back
        p0, p1, p2, p3 = work.free_p[i, 0], work.free_p[i, 1], work.free_p[i, 2], work.free_p[i, 3]
        p4, p5, p6 = work.free_p[i, 4], work.free_p[i, 5], work.free_p[i, 6]
        q0, q1, q2 = work.free_q[i, 0], work.free_q[i, 1], work.free_q[i, 2]
        if work.flags[i, 0] > 0:  # (11)-(12)
            place = (places[i, 0], places[i, 1], places[i, 2], places[i, 3])
            side, n0, n1 = push(work.flags[i, 0], place, d[i, 1], moment_of_contact(place, law, d[i, 1]))
            arm, slide = side * place[ARM], work.flags[i, 1]
            p2 += n1
            q1 += side * n0
            if slide == 0:
                hold = stiction / tau
                held = hold * (d[i, 0] + arm * d[i, 2]) - stiction * speed
                p0 += hold
                p3 += hold * arm
                p5 += hold * arm * arm
                p6 += hold * arm
                q0 += held
                q2 += arm * held
            else:
                grip = 0.0 if frozen else slide * coefficient
                force = slide * work.bound[i] if frozen else grip * n0
                p1 -= grip * side * n1
                p4 -= grip * side * n1 * arm
                q0 -= force
                q2 -= force * arm
        P[i, 0], P[i, 1], P[i, 2], P[i, 3], P[i, 4], P[i, 5], P[i, 6] = p0, p1, p2, p3, p4, p5, p6
        q[i, 0], q[i, 1], q[i, 2] = q0, q1, q2
        # (22b) without damping: L^T s
        Tj, sj = to_node(Tj, (sx, sy + h * st, st), c, sn, h, F)
        (sx, sy, st), Tj = through_point(Tj, sj, (p0, p1, p2, p3, p4, p5, p6), (q0, q1, q2))
        if i == 0:
            break  # the tip: (27) needs no turn
        Tj = turned(Tj, c, sn)
        sx, sy = c * sx - sn * sy, sn * sx + c * sy
        T[i, 0], T[i, 1], T[i, 2], T[i, 3], T[i, 4], T[i, 5], T[i, 6], T[i, 7], T[i, 8] = Tj
        s[i, 0], s[i, 1], s[i, 2] = sx, sy, st

    # back from the tip (27) to the root by (28)-(29)
    x, y, t = sx, sy, st
    fx = fy = ft = 0.0
    for i in range(root):
        if not (abs(x) < OVERFLOW and abs(y) < OVERFLOW and abs(t) < OVERFLOW):
            return i
        w[i, 0], w[i, 1], w[i, 2] = x, y, t
        gx = fx + q[i, 0] - P[i, 0] * x - P[i, 1] * y - P[i, 6] * t
        gy = fy + q[i, 1] - P[i, 2] * y
        gt = ft + q[i, 2] - P[i, 3] * x - P[i, 4] * y - P[i, 5] * t
        state.axial_force[i], x, y, t, fx, fy, ft = behind(T, s, i + 1, gx, gy, gt, c, sn, h)
    return -1
