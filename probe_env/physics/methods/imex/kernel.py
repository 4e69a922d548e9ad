"""The kernel of imex: kick and elimination to the root, solution and new state back to the tip."""

from __future__ import annotations

from numba import njit

from probe_env.physics.methods.factors import linear_weights
from probe_env.physics.methods.imex.after_step import after_step
from probe_env.physics.methods.imex.elimination import less_product, move_node, product, solve_node
from probe_env.physics.methods.imex.forces import (
    cable_forces,
    cable_walls,
    float_at,
    float_forces,
    inertia_forces,
    loaded_floats,
    loaded_pressed,
    loaded_wall,
    magnitude,
    pressed_forces,
)
from probe_env.physics.methods.lane_group import (
    AXIAL,
    COS,
    COUPLE,
    CURVATURE,
    DAMPING,
    FACTORS,
    FIELDS,
    GT,
    GX,
    GY,
    PEAK,
    ROOT,
    SIN,
    VT,
    VX,
    VY,
    A,
    B,
    C,
    T,
    V,
    X,
    Y,
)
from probe_env.physics.methods.lanes import any_less, load, splat, store, where_less
from probe_env.physics.model.drive import AIR, INPUTS, SLOPE, SPEED


@njit(cache=True, nogil=True, error_model="numpy")
def imex_advance(
    parameters,
    pressed,
    factors,
    state,
    inputs,
    tops,
    bottoms,
    dt,
    per_pitch,
    first,
    every,
    points,
    roots,
    samples,
    tension,
    failed,
):
    """Steps of all lanes by imex; see ``after_step`` for sampling and failure. Returns the steps done.

    ``pressed`` is a tuple whose length is part of its type, so what a scene does not need is not in the kernel: empty,
    or one entry where the couple counts from the tangent in some lane, or two where its cable touches the walls.
    """
    zero = splat(parameters, 0.0)
    last = len(factors) // FACTORS - 1
    theta, tau = linear_weights(load(parameters, DAMPING), dt)
    rate = 1.0 / tau
    drift, bounce, reflection = dt / tau, 1.0 / (tau * theta), (1.0 - theta) / theta
    kappa, couple = load(parameters, CURVATURE), load(parameters, COUPLE)
    floats, wall = loaded_floats(parameters), loaded_wall(parameters)
    pressed_couple, cable = loaded_pressed(parameters)
    walls = cable_walls(float_at(0, floats), cable)
    cosine = load(parameters, AXIAL) * load(parameters, COS)
    sine = load(parameters, AXIAL) * load(parameters, SIN)
    row, due = 0, first
    for step in range(len(tops)):
        k = step * INPUTS
        speed, slope, air = (
            load(inputs, k + SPEED),
            load(inputs, k + SLOPE),
            load(inputs, k + AIR),
        )
        gx, gy, gt = zero, zero, zero
        top, to_float, peak = tops[step], 0, zero
        for i in range(top + 1):  # to the root: kick and elimination; the root itself is kicked for its release
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
        # back to the tip: solution and new state; down to the shortest probe's root the lanes are masked
        wx, wy, wt = zero, zero, zero
        held = load(parameters, ROOT)
        bottom = bottoms[step]
        for back in range(top - bottom + 1):
            i = top - back
            q = i * FIELDS
            node = splat(parameters, float(i))
            ux, uy, ut = solve_node(state, q, factors, min(i, last) * FACTORS + C, wx, wy, wt)
            ux = where_less(node, held, ux, load(state, q + X))
            uy = where_less(node, held, uy, load(state, q + Y))
            ut = where_less(node, held, ut, load(state, q + T))
            store(state, q + V, where_less(node, held, cosine * (ux - wx) + sine * (uy + wy), zero))
            wx, wy, wt = ux, uy, ut
            vx, vy, vt = move_node(state, q, ux, uy, ut, drift, bounce, reflection)
            store(state, q + VX, where_less(node, held, vx, zero))
            store(state, q + VY, where_less(node, held, vy, zero))
            store(state, q + VT, where_less(node, held, vt, zero))
        for back in range(bottom):
            i = bottom - 1 - back
            q = i * FIELDS
            ux, uy, ut = solve_node(state, q, factors, min(i, last) * FACTORS + C, wx, wy, wt)
            store(state, q + V, cosine * (ux - wx) + sine * (uy + wy))
            wx, wy, wt = ux, uy, ut
            vx, vy, vt = move_node(state, q, ux, uy, ut, drift, bounce, reflection)
            store(state, q + VX, vx)
            store(state, q + VY, vy)
            store(state, q + VT, vt)
        store(parameters, PEAK, peak)
        due -= 1
        if after_step(parameters, state, inputs, k, step, due, row, points, roots, samples, tension, failed):
            return step + 1
        if due == 0:
            due = every
            row += 1
    return len(tops)
