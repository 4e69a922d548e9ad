"""TICM recursion (17)-(29) and time stepping of the study's methods with it; ``implicit`` also uses its parts."""

import math

from numba import njit

from probe_env.physics.model.drive import AIR, APPEND, SLOPE, SPEED
from probe_env.physics.model.state import DIVERGED_RADIAL, HELD, SHORTENING

FASTMATH = {"contract"}

OVERFLOW = 1e100  # beyond it the next product may be infinite

LEAVING = 0.1  # [m]

OK, DIVERGED = 0, 1


@njit(cache=True, nogil=True)
def move_root(chain, inputs, root, state):
    """Append or remove a node at the root if the inputs say so; returns the held node.

    In withdrawal a node is held with its displacement at the entrance, so that a compressed probe leaves along the
    outer wall; moving it to the inner wall would cause vibration at every float. In insertion a new node has the axial
    displacement of the old root, without strain, and a radial one that decays to the inner wall over ``LEAVING``.
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
    """Store one sample of all points (point < 0: from the held root, -1) and add the tensions to ``tension_sum``."""
    for p in range(len(points)):
        i = points[p] if points[p] >= 0 else root + 1 + points[p]
        samples[row, p, 0] = state.d[i, 0]
        samples[row, p, 1] = state.d[i, 1]
        samples[row, p, 2] = state.d[i, 2]
        i = min(i, root - 1)
        samples[row, p, 3] = state.axial_force[i] + state.memory[i, SHORTENING]
    for i in range(root):
        tension_sum[i] += state.axial_force[i] + state.memory[i, SHORTENING]


@njit(cache=True, nogil=True)
def shorten(chain, root, lag, velocity, state):
    """N of every element (``SHORTENING`` of the memory) and V + N of the couple, in place of its axial force.

    The bent span is shortened by theta^2 / 2, so its axial strain is x' + y / r + theta^2 / 2. With the square taken as
    uniform over a span of p, which axial waves cross in 0.1 ms, its energy is

        sum of V^2 h / (2 EA) + N p mean(V) / EA + N^2 p / (2 EA),    N = (EA / p) sum of theta^2 h / 2.

    Its derivatives are a couple (mean(V) + N) l theta at every node, and the force of an axial force N on the ends of
    every element. theta is that of the couple, extrapolated by ``lag`` [s] with a velocity (n + 1, 3).
    """
    before = 0.0  # V + N of the span on the tip side
    for first in range(0, root, chain.span):
        count = min(chain.span, root - first)
        squares = force = 0.0
        for i in range(first, first + count + 1):
            angle = state.d[i, 2] + lag * velocity[i, 2] + chain.couple_turn * (state.d[i, 0] + lag * velocity[i, 0])
            squares += (0.5 if i in (first, first + count) else 1.0) * angle * angle
            if i < first + count:
                force += state.axial_force[i]
        pull = 0.5 * chain.element_length / chain.axial_compliance * squares / count
        tension = force / count + pull
        for i in range(first, first + count):
            state.memory[i, SHORTENING] = pull
            state.axial_force[i] = tension
        state.axial_force[first] = 0.5 * (tension + before)  # half an element of either span
        before = tension


@njit(nogil=True, error_model="numpy", fastmath=FASTMATH, forceinline=True)
def span_force(chain, state, i):
    """Axial and radial force of N of the elements on both sides of node i."""
    on_root_side, on_tip_side = state.memory[i, SHORTENING], state.memory[i - 1, SHORTENING] if i > 0 else 0.0
    return chain.cos_phi * (on_tip_side - on_root_side), -chain.sin_phi * (on_tip_side + on_root_side)


@njit(nogil=True, error_model="numpy", fastmath=FASTMATH, forceinline=True)
def node_contact(chain, i):
    """Stiffness and lever of the contact at node i, and y below and above which it touches a wall."""
    k, lever, inner, outer = chain.contact_stiffness[i], chain.lever[i], 0.0, chain.outer_gap[i]
    if k == 0.0 and chain.cable_stiffness > 0.0:  # the cable between floats, further from both walls
        k, lever = chain.cable_stiffness, chain.cable_radius
        inner = lever - chain.lever[i]
        outer -= inner
    return k, lever, inner, outer


@njit(nogil=True, error_model="numpy", fastmath=FASTMATH, forceinline=True)
def grip(chain, i, y):
    """Largest friction at node i, mu sqrt(N^2 + w^2), and the lever arm of the friction."""
    k, lever, inner, outer = node_contact(chain, i)
    depth = max(inner - y, y - outer, 0.0)
    total = math.hypot(k * depth, chain.float_weight if chain.contact_stiffness[i] > 0.0 else 0.0)
    arm = lever * k * depth / total if total > 0.0 else 0.0
    return chain.friction * total, arm if y < inner else -arm


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH, inline="always")
def node_equation(chain, scheme, feed_speed, slope, air, state, i, P, q):
    """P_j and q_j of (17) from the last state; P as (xx, xy, yy, tx, ty, tt, xt)."""
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
        turning = max(state.axial_force[i], -chain.max_pressure) * chain.couple_length * chain.couple_turn
        q_x -= turning * (d[i, 2] + chain.couple_turn * d[i, 0])
        q_t -= turning * d[i, 0]

    if state.axial_force[i] < -chain.max_pressure:  # more than the buckled cable takes
        P[i, 5] -= (state.axial_force[i] + chain.max_pressure) * chain.couple_length
    if chain.span > 0:
        pull_x, pull_y = span_force(chain, state, i)
        q_x += pull_x
        q_y += pull_y
    if chain.drag[i] > 0.0:  # (10)
        relative = air - speed
        q_x += chain.drag[i] * relative * abs(relative)
    k, lever, inner, outer = node_contact(chain, i)
    P_xt, stuck, inner_slip, outer_slip = 0.0, False, speed + v[i, 2] * lever, speed - v[i, 2] * lever
    if chain.stiction and k > 0.0:
        limit, arm = grip(chain, i, y)
        step = scheme.theta * scheme.time_step
        trial = state.memory[i, HELD] + k * step * (speed + v[i, 2] * arm)
        inner_slip = outer_slip = trial
        stuck = abs(trial) < limit
        if stuck:
            P[i, 0] += k
            P_xt = k * arm
            P[i, 3] += k * arm
            P[i, 5] += k * arm * arm
            held = state.memory[i, HELD] + k * (feed_speed * step - d[i, 0] - arm * d[i, 2])
            q_x -= held
            q_t -= arm * held
    if k > 0.0:
        if y < inner:  # inner wall, (11)-(12)
            mu_k = k * chain.friction if inner_slip >= 0.0 else -k * chain.friction
            if stuck:
                mu_k = 0.0
            P_xy -= mu_k
            P_yy += k
            P_ty -= mu_k * lever
            q_x -= mu_k * inner
            q_y += k * inner
            q_t -= mu_k * lever * inner
        elif y > outer:  # outer wall: the contact point is on the other side of the float
            mu_k = k * chain.friction if outer_slip >= 0.0 else -k * chain.friction
            if stuck:
                mu_k = 0.0
            P_xy += mu_k
            P_yy += k
            P_ty -= mu_k * lever
            q_x += mu_k * outer
            q_y += k * outer
            q_t -= mu_k * lever * outer
    if (
        chain.float_weight > 0.0 and chain.contact_stiffness[i] > 0.0 and not stuck
    ):  # mu sqrt(N^2 + w^2) instead of mu N
        normal = chain.contact_stiffness[i] * max(-y, y - chain.outer_gap[i], 0.0)
        more = chain.friction * (math.hypot(normal, chain.float_weight) - normal)
        q_x -= more if (inner_slip if chain.stiction else speed) >= 0.0 else -more
    P[i, 1] = P_xy
    P[i, 2] = P_yy
    P[i, 4] = P_ty
    P[i, 6] = P_xt
    q[i, 0] = q_x
    q[i, 1] = q_y
    q[i, 2] = q_t


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


@njit(nogil=True, error_model="numpy", fastmath=FASTMATH, forceinline=True)
def through_field(T, h, F_xx, F_yy, F_tt, F_yt):
    """T behind an element, (22a): L^T T L + F."""
    xx, xy, xt, yx, yy, yt, tx, ty, tt = T
    xy += h * xt
    yy += h * (yt + ty + h * tt)
    ty += h * tt
    yx += h * tx
    yt += h * tt
    return xx + F_xx, xy, xt, yx, yy + F_yy, yt + F_yt, tx, ty + F_yt, tt + F_tt


@njit(nogil=True, error_model="numpy", fastmath=FASTMATH, forceinline=True)
def turned(T, c, sn):
    """T in the next frame, (26): Phi T Phi^T; the same turn leads into the node's frame and out of it."""
    xx, xy, xt, yx, yy, yt, tx, ty, tt = T
    cc, ss, cs = c * c, sn * sn, c * sn
    b = cs * (xy + yx)
    dif = cs * (xx - yy)
    return (
        cc * xx - b + ss * yy, dif + cc * xy - ss * yx, c * xt - sn * yt,
        dif + cc * yx - ss * xy, ss * xx + b + cc * yy, sn * xt + c * yt,
        c * tx - sn * ty, sn * tx + c * ty, tt,
    )  # fmt: skip


@njit(nogil=True, error_model="numpy", fastmath=FASTMATH, forceinline=True)
def to_node(T, s, c, sn, h, F):
    """T behind an element, (22a), and s there, (22b), both in the frame of the node, (26); F as (xx, yy, tt, yt)."""
    T_j = turned(through_field(T, h, F[0], F[1], F[2], F[3]), c, sn)
    return T_j, (c * s[0] - sn * s[1], sn * s[0] + c * s[1], s[2])


@njit(nogil=True, error_model="numpy", fastmath=FASTMATH, forceinline=True)
def through_point(T, s, P, q):
    """S and T behind a node, (24): A = I + T P, then A T' = T and A s' = s + T q; P as in ``Workspace``, then xt."""
    xx, xy, xt, yx, yy, yt, tx, ty, tt = T
    p0, p1, p2, p3, p4, p5, p6 = P
    axx = 1.0 + xx * p0 + xt * p3
    ayx = yx * p0 + yt * p3
    atx = tx * p0 + tt * p3
    axy = xx * p1 + xy * p2 + xt * p4
    ayy = 1.0 + yx * p1 + yy * p2 + yt * p4
    aty = tx * p1 + ty * p2 + tt * p4
    axt = xx * p6 + xt * p5
    ayt = yx * p6 + yt * p5
    att = 1.0 + tx * p6 + tt * p5
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
    bx = s[0] + xx * q[0] + xy * q[1] + xt * q[2]
    by = s[1] + yx * q[0] + yy * q[1] + yt * q[2]
    bt = s[2] + tx * q[0] + ty * q[1] + tt * q[2]
    new = ixx * bx + ixy * by + ixt * bt, iyx * bx + iyy * by + iyt * bt, itx * bx + ity * by + itt * bt
    return new, (
        ixx * xx + ixy * yx + ixt * tx, ixx * xy + ixy * yy + ixt * ty, ixx * xt + ixy * yt + ixt * tt,
        iyx * xx + iyy * yx + iyt * tx, iyx * xy + iyy * yy + iyt * ty, iyx * xt + iyy * yt + iyt * tt,
        itx * xx + ity * yx + itt * tx, itx * xy + ity * yy + itt * ty, itx * xt + ity * yt + itt * tt,
    )  # fmt: skip


@njit(nogil=True, error_model="numpy", fastmath=FASTMATH, forceinline=True)
def behind(T, s, j, gx, gy, gt, c, sn, h):
    """Axial force of the element to node j, d of that node and the force on it, (28)-(29), from the force ahead."""
    fx = c * gx + sn * gy  # Phi^T fbar: the element's frame (29)
    fy = c * gy - sn * gx
    ft = gt + h * fy  # L of (6)
    bx = T[j, 0] * fx + T[j, 1] * fy + T[j, 2] * ft + s[j, 0]
    by = T[j, 3] * fx + T[j, 4] * fy + T[j, 5] * ft + s[j, 1]
    t = T[j, 6] * fx + T[j, 7] * fy + T[j, 8] * ft + s[j, 2]
    # d_{j-1} stands in the element's frame: turn it back too (erratum of (29))
    return fx, c * bx + sn * by, c * by - sn * bx, t, c * fx + sn * fy, c * fy - sn * fx, ft


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH)
def ticm_step(chain, scheme, inputs, root, state, work):
    """One step by the TICM with node ``root`` held; the first diverged node counted from the tip, or -1."""
    P, q, T, s = work.P, work.q, work.T, work.s
    c, sn, h = chain.cos_phi, chain.sin_phi, chain.element_length
    # scalars before the loop: numba would load the inputs again for every node
    speed, slope, air = inputs[SPEED], inputs[SLOPE], inputs[AIR]
    if chain.span > 0:
        shorten(chain, root, scheme.theta * scheme.time_step, state.v, state)
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

        # (22b), corrected: L^T s + delta/(1 + delta B_v) [L^T Phi h_v,j-1 - Phi^T h_v,j]
        sx += delta * (wx - (c * vx + sn * vy))
        sy += h * st + delta * (wy + h * wt - (c * vy - sn * vx))
        st += delta * (wt - vt)
        Tj, sj = to_node(Tj, (sx, sy, st), c, sn, h, F)
        p = (P[i, 0], P[i, 1], P[i, 2], P[i, 3], P[i, 4], P[i, 5], P[i, 6])
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
        gx = fx + q[i, 0] - P[i, 0] * x - P[i, 1] * y - P[i, 6] * t
        gy = fy + q[i, 1] - P[i, 2] * y
        gt = ft + q[i, 2] - P[i, 3] * x - P[i, 4] * y - P[i, 5] * t
        old_x, old_t = state.d[i, 0], state.d[i, 2]
        if not update_node(scheme, state, i, x, y, t) and diverged < 0:
            diverged = i
        if chain.stiction:
            limit, arm = grip(chain, i, state.d[i, 1])
            slip = speed * scheme.time_step + state.d[i, 0] - old_x + arm * (state.d[i, 2] - old_t)
            held = state.memory[i, HELD] + node_contact(chain, i)[0] * slip
            state.memory[i, HELD] = min(max(held, -limit), limit)
        state.axial_force[i], x, y, t, fx, fy, ft = behind(T, s, i + 1, gx, gy, gt, c, sn, h)
    return diverged


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH)
def advance(chain, scheme, inputs, root, state, work, first_sample, sample_every, points, samples, tension_sum):
    """One step for every row of ``inputs`` (see model/drive.py), with samples of ``points``.

    ``first_sample`` is the number of steps until the next sample. ``samples`` is (k, p, 4): x, y, theta, V; the axial
    forces of every sample are added to ``tension_sum`` (n + 1,).

    Returns:
        status, number of steps, diverged node or -1, held node.
    """
    row = 0
    due = first_sample
    for step in range(len(inputs)):
        node = ticm_step(chain, scheme, inputs[step], root, state, work)
        if len(chain.drag_rate) > 0:
            chain.drag[:] += chain.drag_rate
        if node >= 0:
            return DIVERGED, step + 1, node, root
        root = move_root(chain, inputs[step], root, state)
        due -= 1
        if due == 0:
            due = sample_every
            record(state, root, points, samples, row, tension_sum)
            row += 1
    return OK, len(inputs), -1, root
