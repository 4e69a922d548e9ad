"""The sweep of imex to the root: every node is kicked by what acts on it, then eliminated."""

from __future__ import annotations

from numba import njit

from probe_env.physics.methods.imex.elimination import less_product, product
from probe_env.physics.methods.imex.forces import (
    cable_forces,
    cable_walls,
    float_at,
    float_forces,
    inertia_forces,
    magnitude,
    pressed_forces,
)
from probe_env.physics.methods.lane_group import FACTORS, FIELDS, GT, GX, GY, VT, VX, VY, A, B, T, V, X, Y
from probe_env.physics.methods.lanes import any_less, load, splat, store, where_less


@njit(nogil=True, error_model="numpy", inline="always")
def to_root(state, factors, nodes, drive, rates, model, coupling, pressed):
    """Kick and elimination of all nodes; the root itself is kicked for its release. Returns the floats' largest |y|.

    ``pressed`` as in ``imex_advance``; one entry less where no cable is near a wall, so that no node has to look.
    """
    top, last, per_pitch = nodes
    speed, slope, air = drive
    dt, tau, rate = rates
    kappa, couple, floats, wall = model
    pressed_couple, cable = coupling
    zero = splat(speed, 0.0)
    gx, gy, gt = zero, zero, zero
    walls = cable_walls(float_at(0, floats), cable)
    to_float, peak = 0, zero
    for i in range(top + 1):
        q, f = i * FIELDS, min(i, last) * FACTORS
        x, y, t = load(state, q + X), load(state, q + Y), load(state, q + T)
        vx, vy, vt = load(state, q + VX), load(state, q + VY), load(state, q + VT)
        forward = speed + vx
        if len(pressed) > 0:
            ax, ay, at = pressed_forces(kappa, pressed_couple, forward, vy, x, t, load(state, q + V), dt)
        else:
            ax, ay, at = inertia_forces(kappa, couple, forward, vy, t, load(state, q + V), dt)
        if len(pressed) > 1:  # here, since an else below would make the compiler round the rest otherwise
            if to_float == 0:
                walls = cable_walls(float_at(i + 1, floats), cable)
            elif any_less(y, walls[0]) or any_less(walls[1], y):
                slide, turn = speed + rate * load(state, q + GX), rate * load(state, q + GT)
                cx, cy, ct = cable_forces(walls, cable, y, slide, turn)
                ax, ay, at = ax + cx, ay + cy, at - ct
        if to_float == 0:
            to_float = per_pitch
            slide, turn = speed + load(state, q + GX) / tau, load(state, q + GT) / tau
            cx, cy, ct = float_forces(float_at(i, floats), wall, forward, air, y, slide, turn)
            ax, ay, at = ax + cx, ay + cy, at - ct
            height = magnitude(y)
            peak = where_less(peak, height, height, peak)
        to_float -= 1
        # J (theta'' - x''/r) = moment: axial force turns the node too; the frame's own acceleration does not
        ax, at = ax - slope, at + kappa * ax
        vx, vy, vt = vx + dt * ax, vy + dt * ay, vt + dt * at
        ex, ey, et = product(factors, f + A, x + tau * vx, y + tau * vy, t + tau * vt)
        gx, gy, gt = less_product(ex, ey, et, factors, f + B, gx, gy, gt)
        store(state, q + VX, vx)
        store(state, q + VY, vy)
        store(state, q + VT, vt)
        store(state, q + GX, gx)
        store(state, q + GY, gy)
        store(state, q + GT, gt)
    return peak
