"""One step by the recursion, from the root to the tip and back, and many of them."""

from __future__ import annotations

from numba import njit

from probe_env.physics.methods.ticm.after_step import DIVERGED, FASTMATH, OK, move_root, record
from probe_env.physics.methods.ticm.equations import node_equation, update_node
from probe_env.physics.methods.ticm.recursion import behind, through_point, to_node, turned
from probe_env.physics.model.drive import AIR, SLOPE, SPEED


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH)
def ticm_step(chain, scheme, inputs, root, state, work):
    """One step by the TICM with node ``root`` held; the first diverged node counted from the tip, or -1."""
    P, q, T, s = work.P, work.q, work.T, work.s
    c, sn, h = chain.cos_phi, chain.sin_phi, chain.element_length
    # scalars before the loop: numba would load the inputs again for every node
    speed, slope, air = inputs[SPEED], inputs[SLOPE], inputs[AIR]
    damped = 1.0 + chain.damping_time * scheme.B_v
    delta = chain.damping_time / damped
    F = (
        chain.axial_compliance / damped, chain.shear_compliance / damped,
        chain.bending_compliance / damped, chain.coupling_compliance / damped,
    )  # fmt: skip

    # T and s of the node on the root side, already turned into the frame of the element ahead, (25)
    Tj = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    x, y, t = state.d[root, 0], state.d[root, 1], state.d[root, 2]
    T[root, :] = 0.0
    s[root, 0], s[root, 1], s[root, 2] = x, y, t
    sx, sy, st = c * x - sn * y, sn * x + c * y, t
    # its h_v, turned likewise; the held root is at rest: v = B_v d + h_v = 0
    wx, wy, wt = -scheme.B_v * sx, -scheme.B_v * sy, -scheme.B_v * st
    for back in range(root):  # counting down costs a sixth more: numba checks for negative indices
        i = root - 1 - back
        node_equation(chain, scheme, speed, slope, air, state, i, P, q)
        vx = scheme.v_d * state.d[i, 0] + scheme.v_v * state.v[i, 0] + scheme.v_a * state.memory[i, 0]
        vy = scheme.v_d * state.d[i, 1] + scheme.v_v * state.v[i, 1] + scheme.v_a * state.memory[i, 1]
        vt = scheme.v_d * state.d[i, 2] + scheme.v_v * state.v[i, 2] + scheme.v_a * state.memory[i, 2]

        # (22b), mended: L^T s + delta/(1 + delta B_v) [L^T Phi h_v,j-1 - Phi^T h_v,j]
        sx += delta * (wx - (c * vx + sn * vy))
        sy += h * st + delta * (wy + h * wt - (c * vy - sn * vx))
        st += delta * (wt - vt)
        Tj, sj = to_node(Tj, (sx, sy, st), c, sn, h, F)
        p = (P[i, 0], P[i, 1], P[i, 2], P[i, 3], P[i, 4], P[i, 5], 0.0)
        (sx, sy, st), Tj = through_point(Tj, sj, p, (q[i, 0], q[i, 1], q[i, 2]))
        if i == 0:
            break  # the tip: (27) needs no turn
        Tj = turned(Tj, c, sn)
        sx, sy = c * sx - sn * sy, sn * sx + c * sy
        T[i, 0], T[i, 1], T[i, 2], T[i, 3], T[i, 4], T[i, 5], T[i, 6], T[i, 7], T[i, 8] = Tj
        s[i, 0], s[i, 1], s[i, 2] = sx, sy, st
        wx, wy, wt = c * vx - sn * vy, sn * vx + c * vy, vt

    # back from the tip (27) to the root by (28)-(29)
    diverged = -1
    x, y, t = sx, sy, st
    fx = fy = ft = 0.0
    for i in range(root):
        gx = fx + q[i, 0] - P[i, 0] * x - P[i, 1] * y
        gy = fy + q[i, 1] - P[i, 2] * y
        gt = ft + q[i, 2] - P[i, 3] * x - P[i, 4] * y - P[i, 5] * t
        if not update_node(scheme, state, i, x, y, t) and diverged < 0:
            diverged = i
        state.axial_force[i], x, y, t, fx, fy, ft = behind(T, s, i + 1, gx, gy, gt, c, sn, h)
    return diverged


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH)
def advance(chain, scheme, inputs, root, state, work, first_sample, sample_every, points, samples, tension_sum):
    """A step for every row of ``inputs`` (see model/drive.py), and a record of ``points`` whenever a sample falls due.

    ``first_sample`` is the number of steps until the next sample. ``samples`` is (k, p, 4): x, y, theta, V;
    ``tension_sum`` (n + 1,) gains the axial force at every sample.

    Returns:
        status, steps done, diverged node or -1, node that is held now.
    """
    row = 0
    due = first_sample
    for step in range(len(inputs)):
        node = ticm_step(chain, scheme, inputs[step], root, state, work)
        if node >= 0:
            return DIVERGED, step + 1, node, root
        root = move_root(chain, inputs[step], root, state)
        due -= 1
        if due == 0:
            due = sample_every
            record(state, root, points, samples, row, tension_sum)
            row += 1
    return OK, len(inputs), -1, root
