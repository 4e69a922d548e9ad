"""Walls, pushes and friction of a node, and the flags by which an iteration takes them as linear."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from probe_env.arrays import FloatArray
from probe_env.physics.methods.ticm.after_step import FASTMATH
from probe_env.physics.model.chain import Chain

TOLERANCE, LEAST_FORCE = 1e-6, 1e-4  # relative to the largest contact force [N], at least the second

STICTION = 100.0  # c theta dt / m

HARD_DEPTH, HARD_STIFFNESS = 0.01, 1e7  # [m], [N/m]

INNER, OUTER, ARM, STIFFNESS = 0, 1, 2, 3


def contact_places(chain: Chain) -> FloatArray:
    """(n + 1, 4) heights y below and above which a node meets a wall, arm of friction, contact stiffness."""
    is_float = chain.contact_stiffness > 0.0
    if not is_float.any():
        return np.tile([-math.inf, math.inf, 0.0, 0.0], (chain.node_count, 1))
    clearance = np.where(is_float, 0.0, chain.lever - chain.cable_radius)  # of the cable, beyond that of a float
    arm = np.where(is_float, chain.lever, chain.cable_radius)
    stiffness = np.full(chain.node_count, chain.contact_stiffness.max())
    return np.column_stack([-clearance, chain.outer_gap + clearance, arm, stiffness])


@njit(nogil=True, error_model="numpy", fastmath=FASTMATH, forceinline=True)
def wall_at(y, place):
    """The wall that a node at the height y is in: 0 none, 1 inner, 2 outer, 3 and 4 deep in them."""
    if y < place[INNER]:
        return 3 if place[INNER] - y > HARD_DEPTH else 1
    if y > place[OUTER]:
        return 4 if y - place[OUTER] > HARD_DEPTH else 2
    return 0


@njit(nogil=True, error_model="numpy", fastmath=FASTMATH, forceinline=True)
def moment_of_contact(place, law, y):
    """Where between y (0) and w_y (1) contact is taken."""
    return law[1] if y < place[INNER] or y > place[OUTER] else law[0]


@njit(nogil=True, error_model="numpy", fastmath=FASTMATH, forceinline=True)
def push(wall, place, y, at):
    """(side, n0, n1) of a wall's push N = n0 - side n1 w_y, taken ``at`` a place between y and w_y."""
    if wall == 0:
        return 0.0, 0.0, 0.0
    k, offset = place[STIFFNESS], 0.0
    if wall > 2:
        k = max(k, HARD_STIFFNESS)
        offset = (k - place[STIFFNESS]) * HARD_DEPTH
    start = (1.0 - at) * y
    if wall % 2 == 1:
        return 1.0, k * (place[INNER] - start) - offset, k * at
    return -1.0, k * (start - place[OUTER]) - offset, k * at


@njit(nogil=True, error_model="numpy", fastmath=FASTMATH, forceinline=True)
def contact(wall, place, law, at, d, w):
    """Push N of a wall and slide of the contact point at w, for a node at d."""
    _, _, tau, _, speed, _, _ = law
    side, n0, n1 = push(wall, place, d[1], at)
    return n0 - side * n1 * w[1], speed + (w[0] - d[0] + side * place[ARM] * (w[2] - d[2])) / tau


@njit(nogil=True, error_model="numpy", fastmath=FASTMATH, forceinline=True)
def friction_force(slide, slip, most, stiction):
    """Friction for a given flag: at its most, or in proportion to the slip."""
    return slide * most if slide != 0 else stiction * slip


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH)
def renew_flags(root, places, law, share, first, state, work):
    """Flags for the next iteration; by how much the law changes the forces of the solution, and the largest push.

    The iterate moves by ``share`` towards the solution. ``law``: moments of contact of a node that was free and of
    one that was in a wall, tau, c, u, mu, whether friction is frozen.
    """
    _, _, _, stiction, _, coefficient, frozen = law
    worst, largest = 0.0, LEAST_FORCE
    for i in range(root):
        place = (places[i, 0], places[i, 1], places[i, 2], places[i, 3])
        d = (state.d[i, 0], state.d[i, 1], state.d[i, 2])
        w = (work.w[i, 0], work.w[i, 1], work.w[i, 2])
        at = moment_of_contact(place, law, d[1])
        wall, old_wall, old_slide = wall_at(d[1] + at * (w[1] - d[1]), place), work.flags[i, 0], work.flags[i, 1]
        if wall > 0 or (old_wall > 0 and not first):
            N, slip = contact(wall, place, law, at, d, w)
            most = work.bound[i] if frozen else coefficient * N
            slide = 0 if stiction * abs(slip) < most else (1 if slip >= 0.0 else -1)
            if not first:
                N_old, slip_old = contact(old_wall, place, law, at, d, w)
                F = friction_force(slide, slip, most, stiction)
                F_old = friction_force(old_slide, slip_old, work.bound[i] if frozen else coefficient * N_old, stiction)
                worst = max(worst, abs(N - N_old) + abs(F - F_old))
                largest = max(largest, N)
            if not frozen:
                work.bound[i] = coefficient * N
        elif not frozen:
            work.bound[i] = 0.0
        for k in range(3):
            work.iterate[i, k] += share * (w[k] - work.iterate[i, k])
        w = (work.iterate[i, 0], work.iterate[i, 1], work.iterate[i, 2])
        wall = wall_at(d[1] + at * (w[1] - d[1]), place)
        N, slip = contact(wall, place, law, at, d, w)
        most = work.bound[i] if frozen else coefficient * N
        slide = 0 if stiction * abs(slip) < most else (1 if slip >= 0.0 else -1)
        if slide * old_slide < 0 and not first:
            slide = 0  # a slide that turns round sticks first, else the iteration goes to and fro
        work.flags[i, 0], work.flags[i, 1] = wall, slide
    return worst, largest
