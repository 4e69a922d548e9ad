"""Implicit method that does not diverge: contact and friction are solved in each step with the TICM recursion.

The elastic part is a theta rule: with v_m = (1 - theta) v + theta v_new and w = d + tau v_m a step reads
[M / (tau theta dt) + K] w = M (d / (tau theta dt) + v / (theta dt)) + f and d_new = d + dt v_m, with the weights of
``factors.implicit_weights``. So w is the solution of (17)-(18) without damping terms, and K w the elastic and
damping force. The terms of f do not add energy to a passive probe:

* contact is the spring of (11), evaluated at d + zeta (d_new - d) if the step starts in the wall, zeta = 1/2 for short
  steps, and at d_new if the step ends there: its work is at most the decrease of its potential. Between floats the
  cable itself touches the wall. At depths of more than 10 mm the stiffness of a wall is 1e7 N/m;
* friction opposes the sliding velocity of the contact point during the step, u + v_m, with mu N at d_new. Below a
  velocity of mu N / c it sticks: a linear law with c = 100 m / (theta dt), which creeps some micrometres per second.
  With ``terms.stiction`` the friction of the last step is added to it, so that it does not creep;
* weight adds mu (sqrt(N^2 + w^2) - N) against the motion u + v_m of a float, with N of the last iterate; it sticks in
  the same way;
* the couple V l theta of (9) uses the axial force of the last step: tension is evaluated at d_new (convex), compression
  at d (concave), within ``couple_limits``; only changes of V between steps can add energy;
* drag is linearised about the speed of the last step; Coriolis and centrifugal force use that speed.

Contact and friction make the system piecewise linear. A semi-smooth Newton iteration solves it with the flags of
the last iterate until the error of all contact forces is below ``TOLERANCE``; from ``HALF_STEPS_FROM`` on it takes half
steps. After ``FREEZE_AFTER`` iterations friction is bounded by its present value (Tresca's law, a convex and
dissipative problem); after ``MAX_ITERATIONS`` the last solution is used. Such steps count as not converged.
"""

import math
import time
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from probe_env.arrays import FloatArray
from probe_env.physics.methods.factors import LONG_STEP, implicit_weights
from probe_env.physics.methods.method import KernelArguments, Method
from probe_env.physics.methods.ticm import (
    DIVERGED,
    FASTMATH,
    OK,
    OVERFLOW,
    behind,
    move_root,
    record,
    shorten,
    span_force,
    through_point,
    to_node,
    turned,
)
from probe_env.physics.model.chain import Chain, max_pressure, max_tension
from probe_env.physics.model.drive import AIR, SLOPE, SPEED
from probe_env.physics.model.state import DIVERGED_RADIAL, HELD
from probe_env.scene import Scene

TOLERANCE, MIN_FORCE = 1e-6, 1e-4  # relative to the largest contact force [N], at least the second

STICTION = 100.0  # c theta dt / m

HARD_DEPTH, HARD_STIFFNESS = 0.01, 1e7  # [m], [N/m]

INNER, OUTER, ARM, STIFFNESS, WEIGHT, HELD_SLIP = range(6)


def contact_walls(chain: Chain) -> FloatArray:
    """(n + 1, 6) y below and above which a node touches a wall, lever arm of friction, contact stiffness, weight.

    The last column, held friction over c, changes in every step.
    """
    is_float = chain.contact_stiffness > 0.0
    if not is_float.any():
        return np.tile([-math.inf, math.inf, 0.0, 0.0, 0.0, 0.0], (chain.node_count, 1))
    clearance = np.where(is_float, 0.0, chain.lever - chain.cable_radius)  # of the cable, beyond that of a float
    arm = np.where(is_float, chain.lever, chain.cable_radius)
    stiffness = np.full(chain.node_count, chain.contact_stiffness.max())
    weight = np.where(is_float, chain.float_weight, 0.0)
    return np.column_stack([-clearance, chain.outer_gap + clearance, arm, stiffness, weight, 0.0 * weight])


@njit(nogil=True, error_model="numpy", fastmath=FASTMATH, forceinline=True)
def geometry_of(walls, i):
    """Row i of ``contact_walls``."""
    return walls[i, 0], walls[i, 1], walls[i, 2], walls[i, 3], walls[i, 4], walls[i, 5]


@njit(nogil=True, error_model="numpy", fastmath=FASTMATH, forceinline=True)
def wall_at(y, geometry):
    """Wall that a node at y touches: 0 none, 1 inner, 2 outer, 3 and 4 if deep in them."""
    if y < geometry[INNER]:
        return 3 if geometry[INNER] - y > HARD_DEPTH else 1
    if y > geometry[OUTER]:
        return 4 if y - geometry[OUTER] > HARD_DEPTH else 2
    return 0


@njit(nogil=True, error_model="numpy", fastmath=FASTMATH, forceinline=True)
def moment_of_contact(geometry, law, y):
    """Point between y (0) and w_y (1) at which contact is evaluated."""
    return law[1] if y < geometry[INNER] or y > geometry[OUTER] else law[0]


@njit(nogil=True, error_model="numpy", fastmath=FASTMATH, forceinline=True)
def push(wall, geometry, y, at):
    """(side, n0, n1) of the normal force N = n0 - side n1 w_y, evaluated ``at`` a point between y (0) and w_y (1)."""
    if wall == 0:
        return 0.0, 0.0, 0.0
    k, offset = geometry[STIFFNESS], 0.0
    if wall > 2:
        k = max(k, HARD_STIFFNESS)
        offset = (k - geometry[STIFFNESS]) * HARD_DEPTH
    start = (1.0 - at) * y
    if wall % 2 == 1:
        return 1.0, k * (geometry[INNER] - start) - offset, k * at
    return -1.0, k * (start - geometry[OUTER]) - offset, k * at


@njit(nogil=True, error_model="numpy", fastmath=FASTMATH, forceinline=True)
def contact(wall, geometry, law, at, d, w):
    """Normal force N and sliding velocity of the contact point at w, for a node at d."""
    _, _, tau, _, speed, _, _, _ = law
    side, n0, n1 = push(wall, geometry, d[1], at)
    return n0 - side * n1 * w[1], speed + geometry[HELD_SLIP] + (
        w[0] - d[0] + side * geometry[ARM] * (w[2] - d[2])
    ) / tau


@njit(nogil=True, error_model="numpy", fastmath=FASTMATH, forceinline=True)
def friction_force(slide, slip, maximum, stiction):
    """Friction for a flag: largest value when sliding, proportional to the slip when sticking."""
    return slide * maximum if slide != 0 else stiction * slip


@njit(nogil=True, error_model="numpy", fastmath=FASTMATH, forceinline=True)
def slide_of(slip, maximum, stiction):
    """Flag of friction: 0 if it sticks, else the sign of the slip."""
    return 0 if stiction * abs(slip) < maximum else (1 if slip >= 0.0 else -1)


@njit(nogil=True, error_model="numpy", fastmath=FASTMATH)
def renew_weight(i, walls, law, first, state, work):
    """``renew_flags`` for the friction that weight adds at node i; returns the change of its force."""
    _, _, tau, stiction, speed, coefficient, frozen, _ = law
    geometry, weight = geometry_of(walls, i), walls[i, WEIGHT]
    d, change, old, slip = (state.d[i, 0], state.d[i, 1], state.d[i, 2]), 0.0, work.flags[i, 2], 0.0
    at = moment_of_contact(geometry, law, d[1])
    maximum = work.rest[i]
    for k in range(2):  # solution, then iterate
        w = (work.w[i, 0], work.w[i, 1], work.w[i, 2])
        if k == 1:
            w = (work.iterate[i, 0], work.iterate[i, 1], work.iterate[i, 2])
        slip = speed + (w[0] - d[0]) / tau
        if not frozen:
            N, _ = contact(wall_at(d[1] + at * (w[1] - d[1]), geometry), geometry, law, at, d, w)
            maximum = coefficient * (math.hypot(N, weight) - N)
        if k == 0 and not first:
            F = friction_force(slide_of(slip, maximum, stiction), slip, maximum, stiction)
            change = abs(F - friction_force(old, slip, work.rest[i], stiction))
    slide = slide_of(slip, maximum, stiction)
    work.rest[i] = maximum
    work.flags[i, 2] = 0 if slide * old < 0 and not first else slide
    return change


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH)
def renew_flags(root, walls, law, fraction, first, state, work):
    """Update the flags for the next iteration; returns the largest change of forces and the largest normal force.

    The iterate moves by ``fraction`` towards the solution. ``law``: points of evaluation for free nodes and for nodes
    in a wall, tau, c, u, mu, whether friction is frozen, and a tuple that is empty if weight is neglected.
    """
    _, _, _, stiction, _, coefficient, frozen, weighed = law
    worst, largest = 0.0, MIN_FORCE
    for i in range(root):
        geometry = geometry_of(walls, i)
        d = (state.d[i, 0], state.d[i, 1], state.d[i, 2])
        w = (work.w[i, 0], work.w[i, 1], work.w[i, 2])
        at = moment_of_contact(geometry, law, d[1])
        wall, old_wall, old_slide = wall_at(d[1] + at * (w[1] - d[1]), geometry), work.flags[i, 0], work.flags[i, 1]
        if wall > 0 or (old_wall > 0 and not first):
            N, slip = contact(wall, geometry, law, at, d, w)
            maximum = work.bound[i] if frozen else coefficient * N
            slide = 0 if stiction * abs(slip) < maximum else (1 if slip >= 0.0 else -1)
            if not first:
                N_old, slip_old = contact(old_wall, geometry, law, at, d, w)
                F = friction_force(slide, slip, maximum, stiction)
                F_old = friction_force(old_slide, slip_old, work.bound[i] if frozen else coefficient * N_old, stiction)
                worst = max(worst, abs(N - N_old) + abs(F - F_old))
                largest = max(largest, N)
            if not frozen:
                work.bound[i] = coefficient * N
        elif not frozen:
            work.bound[i] = 0.0
        for k in range(3):
            work.iterate[i, k] += fraction * (w[k] - work.iterate[i, k])
        w = (work.iterate[i, 0], work.iterate[i, 1], work.iterate[i, 2])
        wall = wall_at(d[1] + at * (w[1] - d[1]), geometry)
        N, slip = contact(wall, geometry, law, at, d, w)
        maximum = work.bound[i] if frozen else coefficient * N
        slide = 0 if stiction * abs(slip) < maximum else (1 if slip >= 0.0 else -1)
        if slide * old_slide < 0 and not first:
            slide = 0  # stick before sliding the other way; otherwise the iteration oscillates
        work.flags[i, 0], work.flags[i, 1] = wall, slide
        if len(weighed) > 0 and walls[i, WEIGHT] > 0.0:
            worst = max(worst, renew_weight(i, walls, law, first, state, work))
    return worst, largest


@njit(nogil=True, error_model="numpy", fastmath=FASTMATH)
def hold(i, walls, law, state, work):
    """Store the friction of node i at the end of a step, which the next step begins with."""
    geometry, wall = geometry_of(walls, i), work.flags[i, 0]
    state.memory[i, HELD] = 0.0
    if wall > 0:
        d, w = (state.d[i, 0], state.d[i, 1], state.d[i, 2]), (work.w[i, 0], work.w[i, 1], work.w[i, 2])
        N, slip = contact(wall, geometry, law, moment_of_contact(geometry, law, d[1]), d, w)
        maximum = work.bound[i] if law[6] else law[5] * max(N, 0.0)
        state.memory[i, HELD] = min(max(law[3] * slip, -maximum), maximum)


def couple_limits(chain: Chain, nodes_per_pitch: int) -> tuple[float, float]:
    """Largest compression and tension [N] in the couple V l theta, see chain.py."""
    h = chain.element_length
    rigidity = h / chain.bending_compliance
    if chain.span:  # a clipped couple would not be the conjugate of N
        return max_pressure(rigidity, h, None), math.inf
    return max_pressure(rigidity, h, nodes_per_pitch * h), max_tension(rigidity, h)


@njit(nogil=True, error_model="numpy", fastmath=FASTMATH, forceinline=True)
def free_rows(chain, weights, limits, speed, slope, air, state, i, P, q):
    """P and q of node i without contact; P as (xx, xy, yy, tx, ty, tt, xt)."""
    dt, theta, tau = weights
    x, y, t = state.d[i, 0], state.d[i, 1], state.d[i, 2]
    forward = speed + state.v[i, 0]
    c = 1.0 / (tau * theta * dt)
    hx = c * x + state.v[i, 0] / (theta * dt) - slope  # the frame's own acceleration adds -M (du/dt, 0, 0)
    hy = c * y + state.v[i, 1] / (theta * dt) + chain.curvature * forward * forward
    ht = c * t + state.v[i, 2] / (theta * dt)
    coriolis = 2.0 * chain.mass * chain.curvature * forward / tau
    drag = chain.drag[i] * abs(air - forward)  # (10)
    couple = min(max(state.axial_force[i], -limits[0]), limits[1]) * chain.couple_length  # (9)
    at_end = dt / tau if couple > 0.0 else 0.0
    half = 0.5 * dt / tau  # supports act at the middle of the step
    sx, sy, st = chain.support_stiffness[i, 0], chain.support_stiffness[i, 1], chain.support_stiffness[i, 2]
    P[i, 0] = c * chain.mass + half * sx + drag / tau
    P[i, 1] = coriolis
    P[i, 2] = c * chain.mass + half * sy
    P[i, 3] = -c * chain.frame_inertia
    P[i, 4] = 0.0
    P[i, 5] = c * chain.inertia + half * st + couple * at_end
    P[i, 6] = 0.0
    relative, turn = t, chain.couple_turn
    if turn > 0.0:  # counted from the tangent at x, and its work on x
        relative += turn * x
        P[i, 0] += turn * turn * couple * at_end
        P[i, 3] += turn * couple * at_end
        P[i, 6] += turn * couple * at_end
    q[i, 0] = chain.load[i, 0] + chain.mass * hx + coriolis * y - (1.0 - half) * sx * x
    q[i, 0] += drag * (air - speed + x / tau)
    q[i, 1] = chain.load[i, 1] + chain.mass * hy - (1.0 - half) * sy * y
    q[i, 2] = chain.load[i, 2] + chain.inertia * ht - chain.frame_inertia * hx
    if chain.span > 0:
        pull_x, pull_y = span_force(chain, state, i)
        q[i, 0] += pull_x
        q[i, 1] += pull_y
    q[i, 0] -= turn * couple * (1.0 - at_end) * relative
    q[i, 2] -= (1.0 - half) * st * t + couple * (1.0 - at_end) * relative


class Workspace(NamedTuple):
    """Scratch of a step: T (n + 1, 9) and s (n + 1, 3) of the TICM, P (n + 1, 7) and q (n + 1, 3).

    P and q without and with contact; iterate and solution w (n + 1, 3); bounds of frozen friction and of that from
    weight (n + 1,); flags wall, slide and slide of the friction from weight (n + 1, 3).
    """

    T: FloatArray
    s: FloatArray
    free_p: FloatArray
    free_q: FloatArray
    P: FloatArray
    q: FloatArray
    iterate: FloatArray
    w: FloatArray
    bound: FloatArray
    rest: FloatArray
    flags: npt.NDArray[np.int64]


def workspace(nodes: int) -> Workspace:
    """Scratch arrays for a chain of ``nodes`` nodes."""
    T, p, free_p, q = np.zeros((nodes, 9)), np.zeros((nodes, 7)), np.zeros((nodes, 7)), np.zeros((nodes, 3))
    s, free_q, iterate, w = q.copy(), q.copy(), q.copy(), q.copy()
    bound, rest, flags = np.zeros(nodes), np.zeros(nodes), np.zeros((nodes, 3), dtype=np.int64)
    return Workspace(T, s, free_p, free_q, p, q, iterate, w, bound, rest, flags)


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH)
def solve(chain, root, walls, law, state, work):
    """Solve for w and the axial forces by the TICM with the present flags; returns the first invalid node or -1."""
    _, _, tau, stiction, speed, coefficient, frozen, weighed = law
    d, P, q, T, s, w = state.d, work.P, work.q, work.T, work.s, work.w
    c, sn, h = chain.cos_phi, chain.sin_phi, chain.element_length
    F = chain.axial_compliance, chain.shear_compliance, chain.bending_compliance, chain.coupling_compliance
    Tj = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    T[root, :] = 0.0
    x, y, t = d[root, 0], d[root, 1], d[root, 2]
    s[root, 0], s[root, 1], s[root, 2] = x, y, t
    sx, sy, st = c * x - sn * y, sn * x + c * y, t
    for back in range(root):
        i = root - 1 - back
        p0, p1, p2, p3 = work.free_p[i, 0], work.free_p[i, 1], work.free_p[i, 2], work.free_p[i, 3]
        p4, p5, p6 = work.free_p[i, 4], work.free_p[i, 5], work.free_p[i, 6]
        q0, q1, q2 = work.free_q[i, 0], work.free_q[i, 1], work.free_q[i, 2]
        if work.flags[i, 0] > 0:  # (11)-(12)
            geometry = geometry_of(walls, i)
            side, n0, n1 = push(work.flags[i, 0], geometry, d[i, 1], moment_of_contact(geometry, law, d[i, 1]))
            arm, slide = side * geometry[ARM], work.flags[i, 1]
            p2 += n1
            q1 += side * n0
            if slide == 0:
                hold = stiction / tau
                held = hold * (d[i, 0] + arm * d[i, 2]) - stiction * (speed + geometry[HELD_SLIP])
                p0 += hold
                p3 += hold * arm
                p5 += hold * arm * arm
                p6 += hold * arm
                q0 += held
                q2 += arm * held
            else:
                grip = 0.0 if frozen else slide * coefficient
                force = slide * work.bound[i] if frozen else grip * n0
                p1 -= grip * side * n1
                p4 -= grip * side * n1 * arm
                q0 -= force
                q2 -= force * arm
        if len(weighed) > 0 and walls[i, WEIGHT] > 0.0:
            slide = work.flags[i, 2]
            if slide == 0:
                p0 += stiction / tau
                q0 += stiction * (d[i, 0] / tau - speed)
            else:
                q0 -= slide * work.rest[i]
        P[i, 0], P[i, 1], P[i, 2], P[i, 3], P[i, 4], P[i, 5], P[i, 6] = p0, p1, p2, p3, p4, p5, p6
        q[i, 0], q[i, 1], q[i, 2] = q0, q1, q2
        # (22b) without damping: L^T s
        Tj, sj = to_node(Tj, (sx, sy + h * st, st), c, sn, h, F)
        (sx, sy, st), Tj = through_point(Tj, sj, (p0, p1, p2, p3, p4, p5, p6), (q0, q1, q2))
        if i == 0:
            break  # the tip: (27) needs no turn
        Tj = turned(Tj, c, sn)
        sx, sy = c * sx - sn * sy, sn * sx + c * sy
        T[i, 0], T[i, 1], T[i, 2], T[i, 3], T[i, 4], T[i, 5], T[i, 6], T[i, 7], T[i, 8] = Tj
        s[i, 0], s[i, 1], s[i, 2] = sx, sy, st

    # back from the tip (27) to the root by (28)-(29)
    x, y, t = sx, sy, st
    fx = fy = ft = 0.0
    for i in range(root):
        if not (abs(x) < OVERFLOW and abs(y) < OVERFLOW and abs(t) < OVERFLOW):
            return i
        w[i, 0], w[i, 1], w[i, 2] = x, y, t
        gx = fx + q[i, 0] - P[i, 0] * x - P[i, 1] * y - P[i, 6] * t
        gy = fy + q[i, 1] - P[i, 2] * y
        gt = ft + q[i, 2] - P[i, 3] * x - P[i, 4] * y - P[i, 5] * t
        state.axial_force[i], x, y, t, fx, fy, ft = behind(T, s, i + 1, gx, gy, gt, c, sn, h)
    return -1


HALF_STEPS_FROM, FREEZE_AFTER, MAX_ITERATIONS = 8, 25, 40


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH)
def implicit_step(chain, weights, limits, walls, weighed, inputs, root, state, work):
    """One step with node ``root`` held; returns iterations, whether they converged, and an invalid node or -1."""
    dt, theta, tau = weights
    speed, w = inputs[SPEED], work.w
    stiction = STICTION * chain.mass / (theta * dt)
    if chain.span > 0:
        shorten(chain, root, tau, state.memory, state)
    for i in range(root):
        walls[i, HELD_SLIP] = state.memory[i, HELD] / stiction
        free_rows(chain, weights, limits, speed, inputs[SLOPE], inputs[AIR], state, i, work.free_p, work.free_q)
        for k in range(3):  # the first iterate uses the mean velocity of the last step
            w[i, k] = state.d[i, k] + tau * state.memory[i, k]
            work.iterate[i, k] = w[i, k]
    zeta = 0.5 + 0.5 * dt / (dt + LONG_STEP)
    law = (dt / tau, zeta * dt / tau, tau, stiction, speed, chain.friction, False, weighed)
    renew_flags(root, walls, law, 1.0, True, state, work)
    iterations, converged, bad = 0, False, -1
    while not converged and iterations < MAX_ITERATIONS:
        iterations += 1
        node = solve(chain, root, walls, law, state, work)
        if node >= 0:
            return iterations, False, node
        fraction = 1.0 if iterations < HALF_STEPS_FROM else 0.5
        worst, largest = renew_flags(root, walls, law, fraction, False, state, work)
        converged = worst <= TOLERANCE * largest
        if iterations == FREEZE_AFTER:
            law = (dt / tau, zeta * dt / tau, tau, stiction, speed, chain.friction, True, weighed)
    for i in range(root):
        if chain.stiction:
            hold(i, walls, law, state, work)
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
    chain, weights, limits, walls, weighed, inputs, root, state, work,
    first_sample, every, points, samples, tension_sum, counts,
):  # fmt: skip
    """``ticm.advance`` with ``implicit_step``; adds iterations and steps that did not converge to ``counts`` (2,).

    ``weighed`` is an empty tuple if weight is neglected; numba compiles a kernel for either.
    """
    row = 0
    due = first_sample
    for step in range(len(inputs)):
        iterations, converged, node = implicit_step(
            chain, weights, limits, walls, weighed, inputs[step], root, state, work
        )
        if len(chain.drag_rate) > 0:
            chain.drag[:] += chain.drag_rate
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


class Implicit(Method):
    """Contact and friction solved in each step, see the module."""

    name = "implicit"
    order = 2
    usual_step = 1e-4

    def stable_step(self, scene: Scene, nodes_per_pitch: int) -> float:
        """Infinite: the method is stable at every step."""
        return math.inf

    contact_step = stable_step

    def constants(self, chain: Chain, sensor: int, nodes_per_pitch: int, time_step: float) -> tuple[Any, ...]:
        """Chain, weights of the theta rule, limits of the couple, walls at every node, and whether there is weight."""
        weights = (time_step, *implicit_weights(chain.damping_time, time_step))
        weighed = (0,) * (chain.float_weight > 0.0)
        return chain, weights, couple_limits(chain, nodes_per_pitch), contact_walls(chain), weighed

    def run(
        self, lanes: Sequence[KernelArguments], time_step: float, per_pitch: int, first_sample: int, sample_every: int
    ) -> float:
        """See ``Method.run``; the group is one probe."""
        (lane,) = lanes
        nodes, counts = len(lane.state.d), np.zeros(2, dtype=np.int64)
        tension_sum = lane.tension_sum if len(lane.tension_sum) else np.zeros(nodes)
        begin = time.perf_counter()
        chain, weights, limits, walls, weighed = lane.constants  # walls change, and copies of a probe share them
        arguments = (
            chain, weights, limits, walls.copy(), weighed, lane.inputs, lane.root, lane.state, workspace(nodes),
            first_sample, sample_every, lane.points, lane.samples, tension_sum, counts,
        )  # fmt: skip
        status, done, _, lane.root = advance(*arguments)
        seconds = time.perf_counter() - begin
        lane.failed = done if status == DIVERGED else 0
        lane.iterations, lane.unconverged = counts.tolist()
        return seconds
