"""The semi-smooth Newton iteration of a step, and many steps."""

from __future__ import annotations

from numba import njit

from probe_env.physics.methods.factors import LONG_STEP
from probe_env.physics.methods.implicit.contact import STICTION, TOLERANCE, renew_flags
from probe_env.physics.methods.implicit.rows import free_rows
from probe_env.physics.methods.implicit.solution import solve
from probe_env.physics.methods.ticm.after_step import DIVERGED, FASTMATH, OK, move_root, record
from probe_env.physics.model.drive import AIR, SLOPE, SPEED
from probe_env.physics.model.state import DIVERGED_RADIAL

HALF_STEPS_FROM, FREEZE_AFTER, MOST_ITERATIONS = 8, 25, 40


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH)
def implicit_step(chain, weights, limits, places, inputs, root, state, work):
    """One step with node ``root`` held: iterations, whether they converged, and a bad node or -1."""
    dt, theta, tau = weights
    speed, w = inputs[SPEED], work.w
    stiction = STICTION * chain.mass / (theta * dt)
    for i in range(root):
        free_rows(chain, weights, limits, speed, inputs[SLOPE], inputs[AIR], state, i, work.free_p, work.free_q)
        for k in range(3):  # the first iterate goes on as the last step went, whose mean velocity is kept in a
            w[i, k] = state.d[i, k] + tau * state.memory[i, k]
            work.iterate[i, k] = w[i, k]
    zeta = 0.5 + 0.5 * dt / (dt + LONG_STEP)
    law = (dt / tau, zeta * dt / tau, tau, stiction, speed, chain.friction, False)
    renew_flags(root, places, law, 1.0, True, state, work)
    iterations, converged, bad = 0, False, -1
    while not converged and iterations < MOST_ITERATIONS:
        iterations += 1
        node = solve(chain, root, places, law, state, work)
        if node >= 0:
            return iterations, False, node
        share = 1.0 if iterations < HALF_STEPS_FROM else 0.5
        worst, largest = renew_flags(root, places, law, share, False, state, work)
        converged = worst <= TOLERANCE * largest
        if iterations == FREEZE_AFTER:
            law = (dt / tau, zeta * dt / tau, tau, stiction, speed, chain.friction, True)
    for i in range(root):
        for k in range(3):
            mean = (w[i, k] - state.d[i, k]) / tau
            state.d[i, k] += dt * mean
            state.v[i, k] = (mean - (1.0 - theta) * state.v[i, k]) / theta
            state.memory[i, k] = mean
        if bad < 0 and not abs(state.d[i, 1]) <= DIVERGED_RADIAL:
            bad = i
    return iterations, converged and iterations <= FREEZE_AFTER, bad


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH)
def advance(
    chain, weights, limits, places, inputs, root, state, work, first_sample, every, points, samples, tension_sum, counts
):
    """``ticm.advance`` by ``implicit_step``; ``counts`` (2,) gains iterations and steps that did not converge."""
    row = 0
    due = first_sample
    for step in range(len(inputs)):
        iterations, converged, node = implicit_step(chain, weights, limits, places, inputs[step], root, state, work)
        counts[0] += iterations
        counts[1] += 0 if converged else 1
        if node >= 0:
            return DIVERGED, step + 1, node, root
        root = move_root(chain, inputs[step], root, state)
        due -= 1
        if due == 0:
            due = every
            record(state, root, points, samples, row, tension_sum)
            row += 1
    return OK, len(inputs), -1, root
