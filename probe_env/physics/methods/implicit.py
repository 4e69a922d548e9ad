"""The method that does not diverge: contact, friction and walls solved within the step, over the TICM recursion.

The elastic part is a theta rule: with v_m = (1 - theta) v + theta v_new and w = d + tau v_m a step reads
[M / (tau theta dt) + K] w = M (d / (tau theta dt) + v / (theta dt)) + f and d_new = d + dt v_m, with the weights of
``factors.implicit_weights``. So w is the solution of (17)-(18) without damping terms, and K w the elastic and
damping force. What is in f, and why a passive probe gains no energy from it:

* contact is the spring of (11), taken at d + zeta (d_new - d) where the step starts in the wall, zeta = 1/2 for short
  steps, and at d_new where it meets the wall: never more work than the potential that the step uses up. Between
  floats the cable itself meets the wall. Deeper than 10 mm a wall has 1e7 N/m;
* friction opposes the slide of the contact point during the step, u + v_m, with mu N at d_new. Below a slide of
  mu N / c it sticks: a linear law with c = 100 m / (theta dt), which creeps some micrometres per second;
* the couple V l theta of (9) with the axial force of the step before: a tension is taken at d_new (convex), a
  compression at d (concave), within ``couple_limits``: what V gains from step to step is all that it can feed;
* drag is linearised about the speed of the step before, Coriolis and centrifugal force use that speed.

Contact and friction make the system piecewise linear. A semi-smooth Newton iteration solves it with the flags of
the last iterate until no contact force is off by more than ``TOLERANCE``; from ``HALF_STEPS_FROM`` on the iterate goes
half way only. If ``FREEZE_AFTER`` iterations do not do it, friction is bounded by what it was then (Tresca's law, a
convex problem, dissipative too); after ``MOST_ITERATIONS`` the last solution is taken. Such steps are counted as
not converged.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from probe_env.arrays import FloatArray
from probe_env.physics.methods.factors import LONG_STEP, implicit_weights
from probe_env.physics.methods.method import Lane, Method
from probe_env.physics.methods.ticm import (
    DIVERGED,
    FASTMATH,
    OK,
    OVERFLOW,
    behind,
    move_root,
    record,
    through_point,
    to_node,
    turned,
)
from probe_env.physics.model.chain import Chain, most_pressure, most_tension
from probe_env.physics.model.drive import AIR, SLOPE, SPEED
from probe_env.physics.model.state import DIVERGED_RADIAL
from probe_env.scene import Scene

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


def couple_limits(chain: Chain, nodes_per_pitch: int) -> tuple[float, float]:
    """Greatest compression and tension [N] that the couple V l theta is given, see chain.py."""
    h = chain.element_length
    rigidity = h / chain.bending_compliance
    return most_pressure(rigidity, h, nodes_per_pitch * h), most_tension(rigidity, h)


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
    q[i, 0] -= turn * couple * (1.0 - at_end) * relative
    q[i, 2] -= (1.0 - half) * st * t + couple * (1.0 - at_end) * relative


class Workspace(NamedTuple):
    """Scratch of a step: T (n + 1, 9) and s (n + 1, 3) of the TICM, P (n + 1, 7) and q (n + 1, 3).

    P and q without and with contact; iterate and solution w (n + 1, 3); bounds of frozen friction (n + 1,); flags
    wall and slide (n + 1, 2).
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
    flags: npt.NDArray[np.int64]


def workspace(nodes: int) -> Workspace:
    """Scratch for a chain of ``nodes`` nodes."""
    T, p, free_p, q = np.zeros((nodes, 9)), np.zeros((nodes, 7)), np.zeros((nodes, 7)), np.zeros((nodes, 3))
    s, free_q, iterate, w = q.copy(), q.copy(), q.copy(), q.copy()
    return Workspace(T, s, free_p, free_q, p, q, iterate, w, np.zeros(nodes), np.zeros((nodes, 2), dtype=np.int64))


@njit(cache=True, nogil=True, error_model="numpy", fastmath=FASTMATH)
def solve(chain, root, places, law, state, work):
    """Solution w by the TICM with the present flags, and the axial forces; the first bad node or -1."""
    _, _, tau, stiction, speed, coefficient, frozen = law
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
            place = (places[i, 0], places[i, 1], places[i, 2], places[i, 3])
            side, n0, n1 = push(work.flags[i, 0], place, d[i, 1], moment_of_contact(place, law, d[i, 1]))
            arm, slide = side * place[ARM], work.flags[i, 1]
            p2 += n1
            q1 += side * n0
            if slide == 0:
                hold = stiction / tau
                held = hold * (d[i, 0] + arm * d[i, 2]) - stiction * speed
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


class Implicit(Method):
    """Contact, friction and walls solved within the step, see above."""

    name = "implicit"
    order = 2
    usual_step = 1e-4

    def stable_step(self, scene: Scene, nodes_per_pitch: int) -> float:
        """Infinite: every step holds."""
        return math.inf

    contact_step = stable_step

    def constants(self, chain: Chain, sensor: int, nodes_per_pitch: int, time_step: float) -> tuple[Any, ...]:
        """Chain, weights of the theta rule, limits of the couple and walls at every node."""
        weights = (time_step, *implicit_weights(chain.damping_time, time_step))
        return chain, weights, couple_limits(chain, nodes_per_pitch), contact_places(chain)

    def run(
        self, lanes: Sequence[Lane], time_step: float, nodes_per_pitch: int, first_sample: int, sample_every: int
    ) -> float:
        """See ``Method.run``; the group is one probe."""
        (lane,) = lanes
        nodes, counts = len(lane.state.d), np.zeros(2, dtype=np.int64)
        tension_sum = lane.tension_sum if len(lane.tension_sum) else np.zeros(nodes)
        begin = time.perf_counter()
        arguments = (
            *lane.constants, lane.inputs, lane.root, lane.state, workspace(nodes),
            first_sample, sample_every, lane.points, lane.samples, tension_sum, counts,
        )  # fmt: skip
        status, done, _, lane.root = advance(*arguments)
        seconds = time.perf_counter() - begin
        lane.failed = done if status == DIVERGED else 0
        lane.iterations, lane.unconverged = counts.tolist()
        return seconds
