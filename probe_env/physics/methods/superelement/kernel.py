"""The superelement's step: the theta rule in momenta, on pieces of cable condensed to their floats and some modes.

With M, K of the condensed chain, d the unknowns, p = M v, and f contact, friction, drag, inertia forces and the couple,
the rule of ``imex``, multiplied by M, is

    kick        p* = p + dt f(d, v_m of the step before),
    elastic     (M + theta dt tau K) v_m = p* - theta dt K d,   d += dt v_m,   p = p* - dt K (d_before + tau v_m),

so neither M^-1 f nor M v is ever formed, and K d alone is multiplied: K (d_before + tau v_m) is (1 - tau / dt) K
d_before + tau / dt K d, the first of them from the step before. Modes are eliminated piece by piece, where the matrix
is diagonal, then the floats from the tip to the root: u_i = E_i r_i - F_i u_{i-1}, coming back v_i = u_i - U_i v_{i+1}.

Each symmetric matrix of a piece falls into an even and an odd block (see pitch.py). Lanes as in ``imex``, but a row of
the state is a float with the piece on its root side. The root's piece is a part of a pitch and lies elsewhere in each
lane: those rows have constants of their own (see roots.py).
"""

from __future__ import annotations

import numpy as np
from numba import njit

from probe_env.physics.drive import AIR, INPUTS, SLOPE, SPEED
from probe_env.physics.methods.factors import linear_weights
from probe_env.physics.methods.imex.elimination import less_product
from probe_env.physics.methods.imex.forces import float_at, float_forces, loaded_floats, loaded_wall, magnitude
from probe_env.physics.methods.lane_group import CURVATURE, DAMPING, PEAK, ROOT, TENSION
from probe_env.physics.methods.lanes import load, splat, store, where_less
from probe_env.physics.methods.superelement.roots import (
    MODES,
    PT,
    PX,
    PY,
    VT,
    VX,
    VY,
    T,
    V,
    X,
    Y,
    after_step,
)  # fmt: skip
from probe_env.physics.methods.superelement.tables import (
    AXIAL,
    AXIAL_EVEN,
    AXIAL_ODD,
    CARRIED,
    CONSTANTS,
    COUPLE,
    ELASTIC,
    EVEN,
    FACTORS,
    FORCE,
    G_EVEN,
    G_ODD,
    HALF_MASS,
    K_EVEN,
    K_ODD,
    MODE,
    ODD,
    TO_MODES,
)


@njit(nogil=True, error_model="numpy", inline="always")
def even_odd(lx, ly, lt, rx, ry, rt):
    """Even and odd unknowns of two ends."""
    return lx - rx, ly + ry, lt - rt, lx + rx, ly - ry, lt + rt


@njit(nogil=True, error_model="numpy", inline="always")
def ends_of(ex, ey, et, ox, oy, ot):
    """What an even and an odd force are at the L end and at the R end."""
    return ex + ox, ey + oy, et + ot, ox - ex, ey - oy, ot - et


@njit(nogil=True, error_model="numpy", inline="always")
def push_modes(constants, c, count, state, q, ax, ay, at, push):
    """The couple's kick of the modes of one parity; its force on their ends, and what their elimination leaves there.

    ``push`` is -dt V, (ax, ay, at) are the ends' unknowns; the forces are still to be multiplied by it.
    """
    zero = splat(push, 0.0)
    hx = hy = ht = sx = sy = st = zero
    for j in range(count):
        m, r = c + j * MODE, q + 2 * j
        position = load(state, r)
        gx, gy, gt = load(constants, m + COUPLE), load(constants, m + COUPLE + 1), load(constants, m + COUPLE + 2)
        hx, hy, ht = hx + gx * position, hy + gy * position, ht + gt * position
        force = gx * ax + gy * ay + gt * at
        for i in range(count):
            force = force + load(constants, m + TO_MODES + i) * load(state, q + 2 * i)
        momentum = load(state, r + 1) + push * force
        store(state, r + 1, momentum)
        left = momentum - load(constants, m + ELASTIC) * position
        sx = sx - load(constants, m + CARRIED) * left
        sy = sy - load(constants, m + CARRIED + 1) * left
        st = st - load(constants, m + CARRIED + 2) * left
    return hx, hy, ht, sx, sy, st


@njit(nogil=True, error_model="numpy", inline="always")
def move_modes(constants, c, count, state, q, ux, uy, ut, dt, tau):
    """New q and p of the modes of one parity from their ends' velocities; returns the axial force that they add."""
    force = splat(ux, 0.0)
    for j in range(count):
        m, r = c + j * MODE, q + 2 * j
        position, momentum = load(state, r), load(state, r + 1)
        velocity = momentum - load(constants, m + ELASTIC) * position
        velocity = velocity - load(constants, m + CARRIED) * ux
        velocity = velocity - load(constants, m + CARRIED + 1) * uy
        velocity = velocity - load(constants, m + CARRIED + 2) * ut
        middle = position + tau * velocity
        store(state, r, position + dt * velocity)
        store(state, r + 1, momentum - load(constants, m + FORCE) * middle)
        force = force + load(constants, m + AXIAL) * middle
    return force


@njit(nogil=True, error_model="numpy", inline="always")
def symmetric(constants, c, x, y, t):
    """Symmetric (3, 3) matrix at ``c`` times (x, y, t)."""
    xy, xt, yt = load(constants, c + 1), load(constants, c + 2), load(constants, c + 5)
    return (
        load(constants, c) * x + xy * y + xt * t,
        xy * x + load(constants, c + 4) * y + yt * t,
        xt * x + yt * y + load(constants, c + 8) * t,
    )


@njit(nogil=True, error_model="numpy", inline="always")
def dot(constants, c, x, y, t):
    """Three constants times (x, y, t)."""
    return load(constants, c) * x + load(constants, c + 1) * y + load(constants, c + 2) * t


@njit(cache=True, nogil=True, error_model="numpy")
def superelement_advance(
    parameters,
    constants,
    factors,
    at,
    last,
    evens,
    odds,
    state,
    inputs,
    tops,
    bottoms,
    dt,
    root_tables,
    first,
    every,
    points,
    roots,
    samples,
    tension,
    failed,
):
    """Steps of all lanes; see ``roots.after_step`` for sampling, failure and growth. Returns the steps done.

    ``constants`` ((1 + lanes) CONSTANTS, lanes) are those of a pitch, then of the rows with a root; ``factors`` have
    ``last`` + 1 rows of the chain, then those with a root; ``at[i]`` says which block row i uses. A row is a float and
    the modes of the piece behind it, as many even and odd ones as ``evens`` and ``odds`` are long: a tuple's length is
    part of its type, so a kernel is compiled for each number and has no loops over them. ``tops`` and ``bottoms``
    (steps,) are the last floats of the longest and of the shortest probe.
    """
    zero = splat(parameters, 0.0)
    lag = np.empty(len(failed))
    for lane in range(len(failed)):
        lag[lane] = linear_weights(float(parameters[DAMPING, lane]), dt)[1]
    even, odd = len(evens), len(odds)
    fields = MODES + 2 * (even + odd)
    theta, tau = linear_weights(load(parameters, DAMPING), dt)
    before, now = tau - dt, tau  # p = (p* + before K d_before) - now K d
    curvature, limit = load(parameters, CURVATURE), load(parameters, TENSION)
    floats, wall = loaded_floats(parameters), loaded_wall(parameters)
    pitch_half = load(constants, HALF_MASS)
    weight = theta * dt
    row, due = 0, first
    for step in range(len(tops)):
        k = step * INPUTS
        speed, slope, air = load(inputs, k + SPEED), load(inputs, k + SLOPE), load(inputs, k + AIR)
        top, peak = tops[step], zero
        ux = uy = ut = zero
        kx = ky = kt = hx = hy = ht = sx = sy = st = zero  # from the piece before
        mass = zero
        x, y, t = load(state, X), load(state, Y), load(state, T)
        for i in range(top + 1):
            q = i * fields
            c, f = at[i] * CONSTANTS, (min(i, last) if at[i] == 0 else last + at[i]) * FACTORS
            nx, ny, nt = load(state, q + fields + X), load(state, q + fields + Y), load(state, q + fields + T)
            vx, vy = load(state, q + VX), load(state, q + VY)
            forward = speed + vx
            cx, cy, ct = float_forces(float_at(i, floats), wall, forward, air, y, vx + speed, load(state, q + VT))
            height = magnitude(y)
            peak = where_less(peak, height, height, peak)
            mass = mass + load(constants, c + HALF_MASS)
            turn = mass * curvature * forward
            cx = cx - 2.0 * turn * vy - mass * slope
            cy = cy + turn * forward
            mass = pitch_half
            ax, ay, aa, bx, by, bt = even_odd(x, y, t, nx, ny, nt)
            # couple and modes
            axial = load(state, q + V)
            push = zero - dt * where_less(axial, limit, axial, limit)
            gx, gy, gt, jx, jy, jt = push_modes(constants, c + EVEN, even, state, q + MODES, ax, ay, aa, push)
            mx, my, mt, ox, oy, ot = push_modes(constants, c + ODD, odd, state, q + MODES + 2 * even, bx, by, bt, push)
            cex, cey, cet = symmetric(constants, c + G_EVEN, ax, ay, aa)
            cox, coy, cot = symmetric(constants, c + G_ODD, bx, by, bt)
            gx, gy, gt, mx, my, mt = gx + cex, gy + cey, gt + cet, mx + cox, my + coy, mt + cot
            gx, gy, gt, mx, my, mt = ends_of(gx, gy, gt, mx, my, mt)
            jx, jy, jt, ox, oy, ot = ends_of(jx, jy, jt, ox, oy, ot)
            # K d of the float: its share of this piece, and that of the piece before
            odd_strain = dot(constants, c + K_ODD, bx, by, bt)
            cex, cey, cet = symmetric(constants, c + K_EVEN, ax, ay, aa)
            ex, ey, et, dx, dy, dd = ends_of(
                cex, cey, cet,
                load(constants, c + K_ODD + 3) * odd_strain,
                load(constants, c + K_ODD + 4) * odd_strain,
                load(constants, c + K_ODD + 5) * odd_strain,
            )  # fmt: skip
            ex, ey, et = ex + kx, ey + ky, et + kt
            px = load(state, q + PX) - now * ex + dt * cx + push * gx + hx
            py = load(state, q + PY) - now * ey + dt * cy + push * gy + hy
            pt = load(state, q + PT) - now * et - dt * ct + push * gt + ht
            store(state, q + PX, px + before * ex)
            store(state, q + PY, py + before * ey)
            store(state, q + PT, pt + before * et)
            rx, ry, rt = symmetric(
                factors, f, px - weight * ex + (jx + sx), py - weight * ey + (jy + sy), pt - weight * et + (jt + st)
            )
            ux, uy, ut = less_product(rx, ry, rt, factors, f + 9, ux, uy, ut)
            store(state, q + VX, ux)
            store(state, q + VY, uy)
            store(state, q + VT, ut)
            kx, ky, kt, sx, sy, st = dx, dy, dd, ox, oy, ot
            hx, hy, ht = push * mx, push * my, push * mt
            x, y, t = nx, ny, nt
        store(parameters, PEAK, peak)
        wx = wy = wt = zx = zy = zt = zero  # of the float behind: v_m, d_before + tau v_m
        held = load(parameters, ROOT)
        for back in range(top + 1):
            i = top - back
            q = i * fields
            c, f = at[i] * CONSTANTS, (min(i, last) if at[i] == 0 else last + at[i]) * FACTORS
            ux, uy, ut = less_product(
                load(state, q + VX), load(state, q + VY), load(state, q + VT), factors, f + 18, wx, wy, wt
            )
            if i >= bottoms[step]:  # beyond a lane's root nothing moves
                node = splat(parameters, float(i))
                ux, uy, ut = (
                    where_less(node, held, ux, zero),
                    where_less(node, held, uy, zero),
                    where_less(node, held, ut, zero),
                )
            ax, ay, aa, bx, by, bt = even_odd(ux, uy, ut, wx, wy, wt)
            x, y, t = load(state, q + X), load(state, q + Y), load(state, q + T)
            nx, ny, nt = x + tau * ux, y + tau * uy, t + tau * ut
            axial = load(constants, c + AXIAL_EVEN) * (nx - zx)
            axial = axial + load(constants, c + AXIAL_EVEN + 1) * (ny + zy)
            axial = axial + load(constants, c + AXIAL_EVEN + 2) * (nt - zt)
            axial = axial + move_modes(constants, c + EVEN, even, state, q + MODES, ax, ay, aa, dt, tau)
            more = move_modes(constants, c + ODD, odd, state, q + MODES + 2 * even, bx, by, bt, dt, tau)
            if at[i] > 0:
                axial = axial + more + dot(constants, c + AXIAL_ODD, nx + zx, ny - zy, nt + zt)
            store(state, q + V, axial)
            store(state, q + X, x + dt * ux)
            store(state, q + Y, y + dt * uy)
            store(state, q + T, t + dt * ut)
            store(state, q + VX, ux)
            store(state, q + VY, uy)
            store(state, q + VT, ut)
            wx, wy, wt, zx, zy, zt = ux, uy, ut, nx, ny, nt
        due -= 1
        if after_step(
            parameters, constants, factors, at, last, fields, state, inputs, k, step, due, row, lag, root_tables,
            points, roots, samples, tension, failed,
        ):  # fmt: skip
            return step + 1
        if due == 0:
            due = every
            row += 1
    return len(tops)
