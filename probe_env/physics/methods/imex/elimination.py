"""What the elimination does at a node, in lanes: products with its factors, its solution, its new state."""

from __future__ import annotations

from numba import njit

from probe_env.physics.methods.lane_group import GT, GX, GY, VT, VX, VY, T, X, Y
from probe_env.physics.methods.lanes import load, store


@njit(nogil=True, error_model="numpy", inline="always")
def product(factors, f, x, y, t):
    """(3, 3) matrix at ``f`` times (x, y, t)."""
    return (
        load(factors, f) * x + load(factors, f + 1) * y + load(factors, f + 2) * t,
        load(factors, f + 3) * x + load(factors, f + 4) * y + load(factors, f + 5) * t,
        load(factors, f + 6) * x + load(factors, f + 7) * y + load(factors, f + 8) * t,
    )


@njit(nogil=True, error_model="numpy", inline="always")
def less_product(a, b, c, factors, f, x, y, t):
    """(a, b, c) less the (3, 3) matrix at ``f`` times (x, y, t)."""
    return (
        ((a - load(factors, f + 2) * t) - load(factors, f + 1) * y) - load(factors, f) * x,
        ((b - load(factors, f + 5) * t) - load(factors, f + 4) * y) - load(factors, f + 3) * x,
        ((c - load(factors, f + 8) * t) - load(factors, f + 7) * y) - load(factors, f + 6) * x,
    )


@njit(nogil=True, error_model="numpy", inline="always")
def solve_node(state, q, factors, f, wx, wy, wt):
    """W of a node on the way back, from that of its neighbour on the root side."""
    gx, gy, gt = load(state, q + GX), load(state, q + GY), load(state, q + GT)
    return less_product(gx, gy, gt, factors, f, wx, wy, wt)


@njit(nogil=True, error_model="numpy", inline="always")
def move_node(state, q, wx, wy, wt, drift, bounce, reflection):
    """New displacement of a node from w, and its velocity, which is returned."""
    ux, uy, ut = wx - load(state, q + X), wy - load(state, q + Y), wt - load(state, q + T)
    store(state, q + GX, ux)  # the last step's motion, by which friction knows the slide
    store(state, q + GT, ut)
    store(state, q + X, load(state, q + X) + drift * ux)
    store(state, q + Y, load(state, q + Y) + drift * uy)
    store(state, q + T, load(state, q + T) + drift * ut)
    return (
        bounce * ux - reflection * load(state, q + VX),
        bounce * uy - reflection * load(state, q + VY),
        bounce * ut - reflection * load(state, q + VT),
    )
