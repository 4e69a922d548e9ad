"""What a float and the piece of cable on its root side do in a step, in lanes; see kernel.py for the rule.

The lanes are probes in ``kernel.py`` and neighbouring floats of one probe in ``along.py``. A row of the state is a
float with its piece. Each symmetric matrix of a piece falls into an even and an odd block (see pitch.py).
"""

from __future__ import annotations

from numba import njit

from probe_env.physics.methods.imex.forces import float_forces
from probe_env.physics.methods.lanes import load, splat, store, where_less
from probe_env.physics.methods.superelement.roots import MODES, PT, PX, PY, VT, VX, VY, T, V, X, Y
from probe_env.physics.methods.superelement.tables import (
    AXIAL,
    AXIAL_EVEN,
    AXIAL_ODD,
    CARRIED,
    COUPLE,
    ELASTIC,
    EVEN,
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


@njit(nogil=True, error_model="numpy", inline="always")
def float_kick(constants, c, state, q, own, wall, curvature, behind, speed, slope, air, y):
    """Contact, friction, drag and inertia of a float with half the cable on either side: x, y, moment.

    ``behind`` is half the mass of the piece behind it. Which of two products is fused with their sum hangs on the
    order in which things are loaded here.
    """
    vx, vy = load(state, q + VX), load(state, q + VY)
    forward = speed + vx
    cx, cy, ct = float_forces(own, wall, forward, air, y, vx + speed, load(state, q + VT))
    mass = behind + load(constants, c + HALF_MASS)
    turn = mass * curvature * forward
    cx = cx - 2.0 * turn * vy - mass * slope
    return cx, cy + turn * forward, ct


@njit(nogil=True, error_model="numpy", inline="always")
def piece_forces(constants, c, evens, odds, state, q, here, ahead, limit, dt):
    """Couple, modes and K d of a piece between two floats, whose displacements are given.

    Returns:
        what it does to the float here: -dt V, the couple's force (to be multiplied by it), what the modes leave, K d;
        and to the one ahead: K d, what the modes leave, the couple's kick.
    """
    (x, y, t), (nx, ny, nt), even, odd = here, ahead, len(evens), len(odds)
    ax, ay, aa, bx, by, bt = even_odd(x, y, t, nx, ny, nt)
    # couple and modes
    axial = load(state, q + V)
    push = splat(x, 0.0) - dt * where_less(axial, limit, axial, limit)
    gx, gy, gt, jx, jy, jt = push_modes(constants, c + EVEN, even, state, q + MODES, ax, ay, aa, push)
    mx, my, mt, ox, oy, ot = push_modes(constants, c + ODD, odd, state, q + MODES + 2 * even, bx, by, bt, push)
    cex, cey, cet = symmetric(constants, c + G_EVEN, ax, ay, aa)
    cox, coy, cot = symmetric(constants, c + G_ODD, bx, by, bt)
    gx, gy, gt, mx, my, mt = gx + cex, gy + cey, gt + cet, mx + cox, my + coy, mt + cot
    gx, gy, gt, mx, my, mt = ends_of(gx, gy, gt, mx, my, mt)
    jx, jy, jt, ox, oy, ot = ends_of(jx, jy, jt, ox, oy, ot)
    # K d of the float: its share of this piece
    odd_strain = dot(constants, c + K_ODD, bx, by, bt)
    cex, cey, cet = symmetric(constants, c + K_EVEN, ax, ay, aa)
    ex, ey, et, dx, dy, dd = ends_of(
        cex, cey, cet,
        load(constants, c + K_ODD + 3) * odd_strain,
        load(constants, c + K_ODD + 4) * odd_strain,
        load(constants, c + K_ODD + 5) * odd_strain,
    )  # fmt: skip
    return (push, gx, gy, gt, jx, jy, jt, ex, ey, et), (dx, dy, dd, ox, oy, ot, push * mx, push * my, push * mt)


@njit(nogil=True, error_model="numpy", inline="always")
def momentum_kick(state, q, kick, own, behind, dt, before, now, weight):
    """New momentum of a float from what acts on it and from the pieces on both sides; what is to be solved for."""
    cx, cy, ct = kick
    push, gx, gy, gt, jx, jy, jt, ex, ey, et = own
    kx, ky, kt, sx, sy, st, hx, hy, ht = behind
    ex, ey, et = ex + kx, ey + ky, et + kt
    px = load(state, q + PX) - now * ex + dt * cx + push * gx + hx
    py = load(state, q + PY) - now * ey + dt * cy + push * gy + hy
    pt = load(state, q + PT) - now * et - dt * ct + push * gt + ht
    store(state, q + PX, px + before * ex)
    store(state, q + PY, py + before * ey)
    store(state, q + PT, pt + before * et)
    return px - weight * ex + (jx + sx), py - weight * ey + (jy + sy), pt - weight * et + (jt + st)


@njit(nogil=True, error_model="numpy", inline="always")
def middle_of(state, q, velocity, tau):
    """D_before + tau v_m of a float."""
    ux, uy, ut = velocity
    x, y, t = load(state, q + X), load(state, q + Y), load(state, q + T)
    return x + tau * ux, y + tau * uy, t + tau * ut


@njit(nogil=True, error_model="numpy", inline="always")
def axial_force(constants, c, evens, odds, state, q, velocity, velocity_ahead, middle, middle_ahead, dt, tau):
    """Axial force of a piece from v_m and d_before + tau v_m of its two floats; its modes are moved.

    Returns:
        that of a pitch between floats; what a piece with the root has besides, together with ``root_force``.
    """
    (ux, uy, ut), (wx, wy, wt), (nx, ny, nt), (zx, zy, zt) = velocity, velocity_ahead, middle, middle_ahead
    even, odd = len(evens), len(odds)
    ax, ay, aa, bx, by, bt = even_odd(ux, uy, ut, wx, wy, wt)
    axial = load(constants, c + AXIAL_EVEN) * (nx - zx)
    axial = axial + load(constants, c + AXIAL_EVEN + 1) * (ny + zy)
    axial = axial + load(constants, c + AXIAL_EVEN + 2) * (nt - zt)
    axial = axial + move_modes(constants, c + EVEN, even, state, q + MODES, ax, ay, aa, dt, tau)
    return axial, move_modes(constants, c + ODD, odd, state, q + MODES + 2 * even, bx, by, bt, dt, tau)


@njit(nogil=True, error_model="numpy", inline="always")
def root_force(constants, c, middle, middle_ahead):
    """What the ends' odd unknowns add to the axial force of a piece with the root."""
    (nx, ny, nt), (zx, zy, zt) = middle, middle_ahead
    return dot(constants, c + AXIAL_ODD, nx + zx, ny - zy, nt + zt)


@njit(nogil=True, error_model="numpy", inline="always")
def move_float(state, q, velocity, dt):
    """New displacement of a float from its mean velocity, which is kept: friction goes by it."""
    ux, uy, ut = velocity
    store(state, q + X, load(state, q + X) + dt * ux)
    store(state, q + Y, load(state, q + Y) + dt * uy)
    store(state, q + T, load(state, q + T) + dt * ut)
    store(state, q + VX, ux)
    store(state, q + VY, uy)
    store(state, q + VT, ut)
