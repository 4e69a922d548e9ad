"""What the methods in lanes do after a step: samples, failures, the root that moves."""

from __future__ import annotations

import math

from numba import njit

from probe_env.physics.methods.lane_group import CURVATURE, FIELDS, PEAK, ROOT, SIN, VX, T, V, X, Y
from probe_env.physics.methods.ticm.after_step import LEAVING
from probe_env.physics.model.drive import APPEND
from probe_env.physics.model.state import DIVERGED_RADIAL


@njit(nogil=True, error_model="numpy")
def after_step(parameters, state, inputs, k, step, due, row, points, roots, samples, tension, failed):
    """Sampling, failure and growth after a step; True if no lane is left.

    ``points`` (p, lanes) are nodes, -1 the root; ``samples`` (rows, p, 4, lanes) get x, y, theta and V when
    ``due`` is zero, and ``tension`` (n, lanes), unless empty, gains V. ``failed`` (lanes,) is the step at which
    a lane diverged, counted from 1; 0 while it has not, -1 for an idle lane. ``roots`` (lanes,) grow.
    """
    running = 0
    for lane in range(len(failed)):
        if failed[lane] != 0:
            continue
        if not (abs(state[Y, lane]) <= DIVERGED_RADIAL and parameters[PEAK, lane] <= DIVERGED_RADIAL):
            failed[lane] = step + 1
            continue
        running += 1
        if due == 0:
            for p in range(len(points)):
                node = points[p, lane] if points[p, lane] >= 0 else roots[lane]
                q = node * FIELDS
                samples[row, p, 0, lane] = state[q + X, lane]
                samples[row, p, 1, lane] = state[q + Y, lane]
                samples[row, p, 2, lane] = state[q + T, lane]
                samples[row, p, 3, lane] = state[min(node, roots[lane] - 1) * FIELDS + V, lane]
            for i in range(min(len(tension), roots[lane])):
                tension[i, lane] += state[i * FIELDS + V, lane]
        if inputs[k + APPEND, lane] != 0.0:
            move_root(parameters, state, inputs, k, roots, lane)
    return running == 0


@njit(nogil=True, error_model="numpy")
def move_root(parameters, state, inputs, k, roots, lane):
    """``ticm.move_root`` of a lane."""
    q = roots[lane] * FIELDS
    length = 2.0 * parameters[SIN, lane] / parameters[CURVATURE, lane]  # of an element, (2)
    if inputs[k + APPEND, lane] > 0.0:
        x, y = state[q + X, lane], state[q + Y, lane] * math.exp(-length / LEAVING)
        roots[lane] += 1
        q += FIELDS
        state[q + X, lane], state[q + Y, lane] = x, y
        state[q + T, lane] = y / LEAVING - parameters[CURVATURE, lane] * x
        for field in range(VX, FIELDS):
            state[q + field, lane] = 0.0
    elif inputs[k + APPEND, lane] < 0.0:
        for field in range(FIELDS):
            state[q + field, lane] = 0.0
        roots[lane] -= 1
        for field in range(VX, FIELDS):
            state[q - FIELDS + field, lane] = 0.0
    parameters[ROOT, lane] = roots[lane]
