"""The recursion (22)-(29) behind an element and behind a node, and back.

Its parts are forced inline by LLVM; inlined by numba the sweep is a sixth slower. What the loops of ``sweep.py`` and
``implicit.solution`` still both spell out, the turn of what is kept and the force on a node, rounds otherwise in a part
of its own (LLVM contracts otherwise), and in chaos that is another run.
"""

from __future__ import annotations

from numba import njit

from probe_env.physics.methods.ticm.after_step import FASTMATH


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
