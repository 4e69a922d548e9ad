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

from probe_env.physics.methods.factors import linear_weights
from probe_env.physics.methods.imex.elimination import less_product
from probe_env.physics.methods.imex.forces import float_at, loaded_floats, loaded_wall, magnitude
from probe_env.physics.methods.lane_group import CURVATURE, DAMPING, PEAK, ROOT, TENSION
from probe_env.physics.methods.lanes import load, splat, store, where_less
from probe_env.physics.methods.superelement.roots import (
    MODES,
    VT,
    VX,
    VY,
    T,
    V,
    X,
    Y,
    after_step,
)  # fmt: skip
from probe_env.physics.methods.superelement.step import (
    axial_force,
    float_kick,
    middle_of,
    momentum_kick,
    move_float,
    piece_forces,
    root_force,
    symmetric,
)
from probe_env.physics.methods.superelement.tables import (
    CONSTANTS,
    FACTORS,
    HALF_MASS,
)
from probe_env.physics.model.drive import AIR, INPUTS, SLOPE, SPEED


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
    before, now, weight = tau - dt, tau, theta * dt  # p = (p* + before K d_before) - now K d
    curvature, limit = load(parameters, CURVATURE), load(parameters, TENSION)
    floats, wall = loaded_floats(parameters), loaded_wall(parameters)
    pitch_half = load(constants, HALF_MASS)
    row, due = 0, first
    for step in range(len(tops)):
        k = step * INPUTS
        speed, slope, air = load(inputs, k + SPEED), load(inputs, k + SLOPE), load(inputs, k + AIR)
        top, peak = tops[step], zero
        ux = uy = ut = zero
        behind = (zero, zero, zero, zero, zero, zero, zero, zero, zero)
        mass = zero
        here = load(state, X), load(state, Y), load(state, T)
        for i in range(top + 1):
            q = i * fields
            c, f = at[i] * CONSTANTS, (min(i, last) if at[i] == 0 else last + at[i]) * FACTORS
            ahead = load(state, q + fields + X), load(state, q + fields + Y), load(state, q + fields + T)
            kick = float_kick(
                constants, c, state, q, float_at(i, floats), wall, curvature, mass, speed, slope, air, here[1]
            )
            height = magnitude(here[1])
            peak = where_less(peak, height, height, peak)
            mass = pitch_half
            done, carried = piece_forces(constants, c, evens, odds, state, q, here, ahead, limit, dt)
            rx, ry, rt = momentum_kick(state, q, kick, done, behind, dt, before, now, weight)
            rx, ry, rt = symmetric(factors, f, rx, ry, rt)
            ux, uy, ut = less_product(rx, ry, rt, factors, f + 9, ux, uy, ut)
            store(state, q + VX, ux)
            store(state, q + VY, uy)
            store(state, q + VT, ut)
            behind, here = carried, ahead
        store(parameters, PEAK, peak)
        velocity = middle = (zero, zero, zero)  # of the float ahead: v_m, d_before + tau v_m
        held = load(parameters, ROOT)
        for back in range(top + 1):
            i = top - back
            q = i * fields
            c, f = at[i] * CONSTANTS, (min(i, last) if at[i] == 0 else last + at[i]) * FACTORS
            ux, uy, ut = less_product(
                load(state, q + VX), load(state, q + VY), load(state, q + VT), factors, f + 18,
                velocity[0], velocity[1], velocity[2],
            )  # fmt: skip
            if i >= bottoms[step]:  # beyond a lane's root nothing moves
                node = splat(parameters, float(i))
                ux, uy, ut = (
                    where_less(node, held, ux, zero),
                    where_less(node, held, uy, zero),
                    where_less(node, held, ut, zero),
                )
            moved = ux, uy, ut
            half_way = middle_of(state, q, moved, tau)
            axial, more = axial_force(constants, c, evens, odds, state, q, moved, velocity, half_way, middle, dt, tau)
            if at[i] > 0:  # not in the functions: there it costs the kernel a third more
                axial = axial + more + root_force(constants, c, half_way, middle)
            store(state, q + V, axial)
            move_float(state, q, moved, dt)
            velocity, middle = moved, half_way
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
