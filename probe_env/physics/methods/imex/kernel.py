"""The kernel of imex: kick and elimination to the root, solution and new state back to the tip."""

from __future__ import annotations

from numba import njit

from probe_env.physics.methods.factors import linear_weights
from probe_env.physics.methods.imex.after_step import after_step
from probe_env.physics.methods.imex.elimination import move_node, solve_node
from probe_env.physics.methods.imex.forces import loaded_floats, loaded_pressed, loaded_wall, nearest_walls, widened
from probe_env.physics.methods.imex.sweep import to_root
from probe_env.physics.methods.lane_group import (
    AXIAL,
    COS,
    COUPLE,
    CURVATURE,
    DAMPING,
    FACTORS,
    FIELDS,
    PEAK,
    ROOT,
    SIN,
    VT,
    VX,
    VY,
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
    coupling = loaded_pressed(parameters)
    low, high = nearest_walls(floats, coupling[1])
    rates, model = (dt, tau, rate), (kappa, couple, floats, wall)
    near = True  # whether cable was near a wall when the last step ended, so that the sweep to the root has to look
    cosine = load(parameters, AXIAL) * load(parameters, COS)
    sine = load(parameters, AXIAL) * load(parameters, SIN)
    row, due = 0, first
    for step in range(len(tops)):
        k = step * INPUTS
        drive = load(inputs, k + SPEED), load(inputs, k + SLOPE), load(inputs, k + AIR)
        top, bottom = tops[step], bottoms[step]
        nodes = top, last, per_pitch
        if len(pressed) > 1 and (near or top != tops[step - 1]):  # a node that came at the root was not looked at
            peak = to_root(state, factors, nodes, drive, rates, model, coupling, pressed)
        else:
            peak = to_root(state, factors, nodes, drive, rates, model, coupling, pressed[:1])
        # back to the tip: solution and new state; down to the shortest probe's root the lanes are masked
        wx, wy, wt = zero, zero, zero
        least, most = low, high
        held = load(parameters, ROOT)
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
            if len(pressed) > 1:
                least, most = widened(least, most, load(state, q + Y))
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
            if len(pressed) > 1:
                least, most = widened(least, most, load(state, q + Y))
        near = len(pressed) > 1 and (any_less(least, low) or any_less(high, most))
        store(parameters, PEAK, peak)
        due -= 1
        if after_step(parameters, state, inputs, k, step, due, row, points, roots, samples, tension, failed):
            return step + 1
        if due == 0:
            due = every
            row += 1
    return len(tops)
