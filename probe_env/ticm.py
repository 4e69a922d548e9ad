"""The study's scheme: Newmark-beta or Wilson-theta, each step solved by the TICM recursion (16)-(29).

All kernels that call each other live in this file, because numba's cache does not see edits elsewhere.
A kernel returns a status and never raises. Of fastmath only contraction (fused multiply-add): it keeps NaN
checks alive, and reassociation made the sweep 15 % slower (LLVM spills more).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from probe_env.chain import FloatArray
from probe_env.drive import AIR, APPEND, SLOPE, SPEED

FASTMATH = {"contract"}
DIVERGED_RADIAL = 1.0  # [m]; a tube is a few centimetres wide
OVERFLOW = 1e100  # beyond it the next product may be infinite

OK, DIVERGED = 0, 1


class Scheme(NamedTuple):
    """Coefficients of (16) and table 1, with h_a and h_v as combinations of the last d, v and a."""

    time_step: float
    theta: float
    wilson: bool
    B_a: float
    B_v: float
    a_d: float
    a_v: float
    a_a: float
    v_d: float
    v_v: float
    v_a: float


def newmark(time_step: float, beta: float = 0.25, gamma: float = 0.5) -> Scheme:
    """Newmark-beta of table 1."""
    dt = time_step
    a_d, a_v, a_a = -1.0 / (beta * dt**2), -1.0 / (beta * dt), -(0.5 - beta) / beta
    return Scheme(
        dt, 1.0, False, -a_d, gamma / (beta * dt),
        a_d, a_v, a_a,
        dt * gamma * a_d, 1.0 + dt * gamma * a_v, dt * (1.0 - gamma + gamma * a_a),
    )  # fmt: skip


def wilson(time_step: float, theta: float = 1.4) -> Scheme:
    """Wilson-theta of table 1: the system is solved at t + theta dt."""
    dt = theta * time_step
    return Scheme(
        time_step, theta, True, 6.0 / dt**2, 3.0 / dt,
        -6.0 / dt**2, -6.0 / dt, -2.0,
        -3.0 / dt, -2.0, -dt / 2.0,
    )  # fmt: skip


class State(NamedTuple):
    """Displacement, velocity, acceleration (n + 1, 3) and the axial force of each element (n + 1,).

    ``axial_force[i]`` is Vbar of (8) at node i, on its root side; the last entry is unused.
    """

    d: FloatArray
    v: FloatArray
    a: FloatArray
    axial_force: FloatArray


class Work(NamedTuple):
    """Scratch of one step: node equations P (n + 1, 6), q (n + 1, 3) and T (n + 1, 9), s (n + 1, 3)."""

    P: FloatArray
    q: FloatArray
    T: FloatArray
    s: FloatArray


def at_rest(nodes: int) -> State:
    """All zero, the study's start."""
    return State(np.zeros((nodes, 3)), np.zeros((nodes, 3)), np.zeros((nodes, 3)), np.zeros(nodes))


def workspace(nodes: int) -> Work:
    """Scratch arrays for a chain of ``nodes`` nodes."""
    return Work(np.zeros((nodes, 6)), np.zeros((nodes, 3)), np.zeros((nodes, 9)), np.zeros((nodes, 3)))


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH, inline="always")
def node_equation(chain, scheme, inputs, state, i, P, q):
    """P_j and q_j of (17) from the state of the step before; P as (xx, xy, yy, tx, ty, tt)."""
    d, v, a = state.d, state.v, state.a
    y = d[i, 1]
    speed = inputs[SPEED] + v[i, 0]
    inertial = chain.mass * chain.curvature * speed  # m omega_j, (13)
    ha_x = scheme.a_d * d[i, 0] + scheme.a_v * v[i, 0] + scheme.a_a * a[i, 0]
    ha_y = scheme.a_d * y + scheme.a_v * v[i, 1] + scheme.a_a * a[i, 1]
    ha_t = scheme.a_d * d[i, 2] + scheme.a_v * v[i, 2] + scheme.a_a * a[i, 2]
    hv_y = scheme.v_d * y + scheme.v_v * v[i, 1] + scheme.v_a * a[i, 1]

    # M, C and the inertia part of q, (15) and (17)
    P[i, 0] = scheme.B_a * chain.mass + chain.support_stiffness[i, 0]
    P_xy = 2.0 * inertial * scheme.B_v
    P_yy = scheme.B_a * chain.mass + chain.support_stiffness[i, 1]
    P[i, 3] = -scheme.B_a * chain.frame_inertia
    P_ty = 0.0
    P[i, 5] = (
        scheme.B_a * chain.inertia + chain.support_stiffness[i, 2] + state.axial_force[i] * chain.couple_length  # (9)
    )
    # the frame's own acceleration adds -M (du/dt, 0, 0)
    slope = inputs[SLOPE]
    q_x = chain.load[i, 0] - chain.mass * (ha_x + slope) - 2.0 * inertial * hv_y
    q_y = chain.load[i, 1] - chain.mass * ha_y + inertial * speed
    q_t = chain.load[i, 2] - chain.inertia * ha_t + chain.frame_inertia * (ha_x + slope)

    if chain.drag[i] > 0.0:  # (10)
        relative = inputs[AIR] - speed
        q_x += chain.drag[i] * relative * abs(relative)
    k = chain.contact_stiffness[i]
    if k > 0.0:
        lever = chain.lever[i]
        if y < 0.0:  # inner wall, (11)-(12)
            mu_k = k * chain.friction if speed + v[i, 2] * lever >= 0.0 else -k * chain.friction
            P_xy -= mu_k
            P_yy += k
            P_ty -= mu_k * lever
        elif y > chain.outer_gap[i]:  # outer wall: the contact point is on the other side of the float
            mu_k = k * chain.friction if speed - v[i, 2] * lever >= 0.0 else -k * chain.friction
            P_xy += mu_k
            P_yy += k
            P_ty -= mu_k * lever
            q_x += mu_k * chain.outer_gap[i]
            q_y += k * chain.outer_gap[i]
            q_t -= mu_k * lever * chain.outer_gap[i]
    P[i, 1] = P_xy
    P[i, 2] = P_yy
    P[i, 4] = P_ty
    q[i, 0] = q_x
    q[i, 1] = q_y
    q[i, 2] = q_t


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH)
def node_equations(chain, scheme, inputs, root, state, work):
    """All P_j and q_j of one step, for the solvers that are not fused with them."""
    for i in range(root):
        node_equation(chain, scheme, inputs, state, i, work.P, work.q)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH, inline="always")
def update_node(scheme, state, i, x, y, t):
    """d, v and a of node i at the new time from the solution of (17)-(18); False if it has diverged."""
    for c in range(3):
        new = x if c == 0 else (y if c == 1 else t)
        d, v, a = state.d[i, c], state.v[i, c], state.a[i, c]
        a_solved = scheme.B_a * new + (scheme.a_d * d + scheme.a_v * v + scheme.a_a * a)  # (16)
        if scheme.wilson:
            dt = scheme.time_step
            a_new = a + (a_solved - a) / scheme.theta
            state.d[i, c] = d + dt * v + dt * dt / 6.0 * (2.0 * a + a_new)
            state.v[i, c] = v + 0.5 * dt * (a + a_new)
            state.a[i, c] = a_new
        else:
            state.d[i, c] = new
            state.v[i, c] = scheme.B_v * new + (scheme.v_d * d + scheme.v_v * v + scheme.v_a * a)  # (16)
            state.a[i, c] = a_solved
    return abs(x) < OVERFLOW and abs(y) <= DIVERGED_RADIAL and abs(t) < OVERFLOW


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH)
def ticm_step(chain, scheme, inputs, root, state, work):
    """One step by the TICM with node ``root`` held; the first diverged node counted from the tip, or -1."""
    P, q, T, s = work.P, work.q, work.T, work.s
    c, sn, h = chain.cos_phi, chain.sin_phi, chain.element_length
    cc, ss, cs = c * c, sn * sn, c * sn
    damped = 1.0 + chain.damping_time * scheme.B_v
    delta = chain.damping_time / damped
    F_xx = chain.axial_compliance / damped
    F_yy = chain.shear_compliance / damped
    F_tt = chain.bending_compliance / damped
    F_yt = chain.coupling_compliance / damped

    # T and s of the node on the root side, already turned into the frame of the element ahead, (25)
    txx = txy = txt = tyx = tyy = tyt = ttx = tty = ttt = 0.0
    sx = sy = st = 0.0
    # its h_v, turned likewise; the held root has none
    wx = wy = wt = 0.0
    T[root, :] = 0.0
    s[root, :] = 0.0
    for back in range(root):  # counting down costs a sixth more: numba checks for negative indices
        i = root - 1 - back
        node_equation(chain, scheme, inputs, state, i, P, q)
        vx = scheme.v_d * state.d[i, 0] + scheme.v_v * state.v[i, 0] + scheme.v_a * state.a[i, 0]
        vy = scheme.v_d * state.d[i, 1] + scheme.v_v * state.v[i, 1] + scheme.v_a * state.a[i, 1]
        vt = scheme.v_d * state.d[i, 2] + scheme.v_v * state.v[i, 2] + scheme.v_a * state.a[i, 2]

        # field transmission (22a): L^T T L + F / (1 + delta B_v)
        txy += h * txt
        tyy += h * (tyt + tty + h * ttt)
        tty += h * ttt
        tyx += h * ttx
        tyt += h * ttt
        txx += F_xx
        tyy += F_yy
        ttt += F_tt
        tyt += F_yt
        tty += F_yt
        # (22b), mended: L^T s + delta/(1 + delta B_v) [L^T Phi h_v,j-1 - Phi^T h_v,j]
        sx += delta * (wx - (c * vx + sn * vy))
        sy += h * st + delta * (wy + h * wt - (c * vy - sn * vx))
        st += delta * (wt - vt)

        # turn into the node's frame (26a)
        b = cs * (txy + tyx)
        dif = cs * (txx - tyy)
        uxx = cc * txx - b + ss * tyy
        uyy = ss * txx + b + cc * tyy
        uxy = dif + cc * txy - ss * tyx
        uyx = dif + cc * tyx - ss * txy
        uxt = c * txt - sn * tyt
        uyt = sn * txt + c * tyt
        utx = c * ttx - sn * tty
        uty = sn * ttx + c * tty
        utt = ttt
        bx = c * sx - sn * sy
        by = sn * sx + c * sy
        bt = st

        # point transmission (24): A = I + T P, then A T' = T and A s' = s + T q
        p0, p1, p2, p3, p4, p5 = P[i, 0], P[i, 1], P[i, 2], P[i, 3], P[i, 4], P[i, 5]
        axx = 1.0 + uxx * p0 + uxt * p3
        ayx = uyx * p0 + uyt * p3
        atx = utx * p0 + utt * p3
        axy = uxx * p1 + uxy * p2 + uxt * p4
        ayy = 1.0 + uyx * p1 + uyy * p2 + uyt * p4
        aty = utx * p1 + uty * p2 + utt * p4
        axt = uxt * p5
        ayt = uyt * p5
        att = 1.0 + utt * p5
        ixx = ayy * att - ayt * aty
        ixy = axt * aty - axy * att
        ixt = axy * ayt - axt * ayy
        inverse = 1.0 / (axx * ixx + ayx * ixy + atx * ixt)
        iyx = (ayt * atx - ayx * att) * inverse
        iyy = (axx * att - axt * atx) * inverse
        iyt = (axt * ayx - axx * ayt) * inverse
        itx = (ayx * aty - ayy * atx) * inverse
        ity = (axy * atx - axx * aty) * inverse
        itt = (axx * ayy - axy * ayx) * inverse
        ixx *= inverse
        ixy *= inverse
        ixt *= inverse
        q0, q1, q2 = q[i, 0], q[i, 1], q[i, 2]
        bx += uxx * q0 + uxy * q1 + uxt * q2
        by += uyx * q0 + uyy * q1 + uyt * q2
        bt += utx * q0 + uty * q1 + utt * q2
        sx = ixx * bx + ixy * by + ixt * bt
        sy = iyx * bx + iyy * by + iyt * bt
        st = itx * bx + ity * by + itt * bt
        if i == 0:
            break  # the tip: (27) needs no T and no turn
        txx = ixx * uxx + ixy * uyx + ixt * utx
        txy = ixx * uxy + ixy * uyy + ixt * uty
        txt = ixx * uxt + ixy * uyt + ixt * utt
        tyx = iyx * uxx + iyy * uyx + iyt * utx
        tyy = iyx * uxy + iyy * uyy + iyt * uty
        tyt = iyx * uxt + iyy * uyt + iyt * utt
        ttx = itx * uxx + ity * uyx + itt * utx
        tty = itx * uxy + ity * uyy + itt * uty
        ttt = itx * uxt + ity * uyt + itt * utt

        # turn into the frame of the element ahead (26b)
        b = cs * (txy + tyx)
        dif = cs * (txx - tyy)
        uxx = cc * txx - b + ss * tyy
        tyy = ss * txx + b + cc * tyy
        txx = uxx
        uxy = dif + cc * txy - ss * tyx
        tyx = dif + cc * tyx - ss * txy
        txy = uxy
        uxt = c * txt - sn * tyt
        tyt = sn * txt + c * tyt
        txt = uxt
        utx = c * ttx - sn * tty
        tty = sn * ttx + c * tty
        ttx = utx
        bx = c * sx - sn * sy
        sy = sn * sx + c * sy
        sx = bx
        wx = c * vx - sn * vy
        wy = sn * vx + c * vy
        wt = vt
        T[i, 0], T[i, 1], T[i, 2] = txx, txy, txt
        T[i, 3], T[i, 4], T[i, 5] = tyx, tyy, tyt
        T[i, 6], T[i, 7], T[i, 8] = ttx, tty, ttt
        s[i, 0], s[i, 1], s[i, 2] = sx, sy, st

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
        fx = c * gx + sn * gy  # Phi^T fbar: the element's frame (29)
        fy = c * gy - sn * gx
        ft = gt + h * fy  # L of (6)
        state.axial_force[i] = fx
        j = i + 1
        bx = T[j, 0] * fx + T[j, 1] * fy + T[j, 2] * ft + s[j, 0]
        by = T[j, 3] * fx + T[j, 4] * fy + T[j, 5] * ft + s[j, 1]
        t = T[j, 6] * fx + T[j, 7] * fy + T[j, 8] * ft + s[j, 2]
        x = c * bx + sn * by  # d_{j-1} stands in the element's frame: turn it back too (erratum of (29))
        y = c * by - sn * bx
        gx = c * fx + sn * fy
        fy = c * fy - sn * fx
        fx = gx
    return diverged


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH)
def advance(chain, scheme, inputs, root, state, work, first_sample, sample_every, points, samples, tension_sum):
    """A step for every row of ``inputs`` (see drive.py), and a record of ``points`` whenever a sample falls due.

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
        root += int(inputs[step, APPEND])
        due -= 1
        if due == 0:
            due = sample_every
            record(state, root, points, samples, row, tension_sum)
            row += 1
    return OK, len(inputs), -1, root


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


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH)
def apply_solution(scheme, state, solution, axial_force):
    """New state from a solution (n, 3) of (17)-(18) found by another solver; diverged node or -1."""
    diverged = -1
    for i in range(len(axial_force)):
        x, y, t = solution[i, 0], solution[i, 1], solution[i, 2]
        if not update_node(scheme, state, i, x, y, t) and diverged < 0:
            diverged = i
        state.axial_force[i] = axial_force[i]
    return diverged
