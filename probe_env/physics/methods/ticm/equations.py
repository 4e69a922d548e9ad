"""The equation (17) of a node from the state of the step before, and the state from its solution, (15)-(16)."""

from __future__ import annotations

from numba import njit

from probe_env.physics.methods.ticm.after_step import FASTMATH, OVERFLOW
from probe_env.physics.model.drive import AIR, SLOPE, SPEED
from probe_env.physics.model.state import DIVERGED_RADIAL


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH, inline="always")
def node_equation(chain, scheme, feed_speed, slope, air, state, i, P, q):
    """P_j and q_j of (17) from the state of the step before; P as (xx, xy, yy, tx, ty, tt)."""
    d, v, a = state.d, state.v, state.memory
    y = d[i, 1]
    speed = feed_speed + v[i, 0]
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
    q_x = chain.load[i, 0] - chain.mass * (ha_x + slope) - 2.0 * inertial * hv_y
    q_y = chain.load[i, 1] - chain.mass * ha_y + inertial * speed
    q_t = chain.load[i, 2] - chain.inertia * ha_t + chain.frame_inertia * (ha_x + slope)
    if chain.couple_turn > 0.0:  # the couple from the tangent at x: V l (theta + x / r), and its work on x
        turning = max(state.axial_force[i], -chain.most_pressure) * chain.couple_length * chain.couple_turn
        q_x -= turning * (d[i, 2] + chain.couple_turn * d[i, 0])
        q_t -= turning * d[i, 0]

    if state.axial_force[i] < -chain.most_pressure:  # more than the buckled cable takes
        P[i, 5] -= (state.axial_force[i] + chain.most_pressure) * chain.couple_length
    if chain.drag[i] > 0.0:  # (10)
        relative = air - speed
        q_x += chain.drag[i] * relative * abs(relative)
    k, lever, inner, outer = chain.contact_stiffness[i], chain.lever[i], 0.0, chain.outer_gap[i]
    if k == 0.0 and chain.cable_stiffness > 0.0:  # the cable between floats, further from both walls
        k, lever = chain.cable_stiffness, chain.cable_radius
        inner = lever - chain.lever[i]
        outer -= inner
    if k > 0.0:
        if y < inner:  # inner wall, (11)-(12)
            mu_k = k * chain.friction if speed + v[i, 2] * lever >= 0.0 else -k * chain.friction
            P_xy -= mu_k
            P_yy += k
            P_ty -= mu_k * lever
            q_x -= mu_k * inner
            q_y += k * inner
            q_t -= mu_k * lever * inner
        elif y > outer:  # outer wall: the contact point is on the other side of the float
            mu_k = k * chain.friction if speed - v[i, 2] * lever >= 0.0 else -k * chain.friction
            P_xy += mu_k
            P_yy += k
            P_ty -= mu_k * lever
            q_x += mu_k * outer
            q_y += k * outer
            q_t -= mu_k * lever * outer
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
        node_equation(chain, scheme, inputs[SPEED], inputs[SLOPE], inputs[AIR], state, i, work.P, work.q)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH, forceinline=True)
def update_node(scheme, state, i, x, y, t):
    """d, v and a of node i at the new time from the solution of (17)-(18); False if it has diverged."""
    for c in range(3):
        new = x if c == 0 else (y if c == 1 else t)
        d, v, a = state.d[i, c], state.v[i, c], state.memory[i, c]
        a_solved = scheme.B_a * new + (scheme.a_d * d + scheme.a_v * v + scheme.a_a * a)  # (16)
        if scheme.wilson:
            dt = scheme.time_step
            a_new = a + (a_solved - a) / scheme.theta
            state.d[i, c] = d + dt * v + dt * dt / 6.0 * (2.0 * a + a_new)
            state.v[i, c] = v + 0.5 * dt * (a + a_new)
            state.memory[i, c] = a_new
        else:
            state.d[i, c] = new
            state.v[i, c] = scheme.B_v * new + (scheme.v_d * d + scheme.v_v * v + scheme.v_a * a)  # (16)
            state.memory[i, c] = a_solved
    return abs(x) < OVERFLOW and abs(y) <= DIVERGED_RADIAL and abs(t) < OVERFLOW


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
