"""Implicit-explicit method "imex": linear part implicit with constant factors; contact, friction and drag explicit.

One step, from displacements d and velocities v at its start:

1. kick: v* = v + dt M^-1 f with f = contact, friction, drag, centrifugal and Coriolis force, the acceleration of the
   frame and the couple of (9), all at the present state. Friction opposes the mean velocity of the last step,
   (d - d_before) / dt: v contains oscillations that the step does not resolve, and friction by the sign of v
   amplifies them (at u = 0.05 m/s, mu = 0.25, 130 m3/h, l = 30 m the root tension is 1,800 N instead of 12 N);
2. theta rule for M d'' + K (d + delta d') = 0 from (d, v*), theta and tau from ``linear_weights``: with
   w = d + tau v_m, v_m = (1 - theta) v* + theta v, it reads [1 + theta dt tau M^-1 K] w = d + tau v*; then
   v_m = (w - d) / tau, d += dt v_m, v = (v_m - (1 - theta) v*) / theta. K w is the elastic and damping force.

The matrix is constant and is eliminated once, from the tip to the root: the factors depend only on the distance from
the tip, converge after some dozen nodes, and are valid for probes of any length. The method is of first order in the
explicit part and of second order in the linear part. ``explicit`` uses the same forces and the same ``after_step``.

Vector lanes compute several probes at once (see lanes.py): four in double precision (imex), eight in single precision
(imex32), according to the type of the arrays. Parameters, factors, length and inputs differ between lanes; step size,
nodes per pitch and number of steps are common.
"""

import math

import numpy as np
from numba import njit

from probe_env.physics.methods import lane_group as layout
from probe_env.physics.methods.factors import imex_factors, linear_weights, single_factors
from probe_env.physics.methods.lanes import (
    any_less,
    kernel,
    load,
    load3,
    multiply_add,
    part,
    splat,
    square_root,
    store,
    store3,
    traced,
    where_less,
)
from probe_env.physics.methods.ticm import LEAVING
from probe_env.physics.model.drive import AIR, APPEND, INPUTS, SLOPE, SPEED
from probe_env.physics.model.state import DIVERGED_RADIAL
from probe_env.scene import FRICTION_SPEED

SLOW = 2e-2
"""Sliding velocity [m/s] from which on friction is mu N against it at once, see ``held_forces``."""


@part
def sample_due(step, sampling):
    """Row of the sample that is due after a step, or -1."""
    done = step + 1 - sampling[0]
    return done // sampling[1] if done >= 0 and done % sampling[1] == 0 else -1


@part
def tension_at(state, memory, i, per_pitch, lane):
    """Tension of the element behind node i: its axial force and N of its span."""
    pull = memory[i // per_pitch * per_pitch * layout.MEMORY + layout.N, lane] if len(memory) > 0 else 0.0
    return state[i * layout.FIELDS + layout.V, lane] + pull


@part
def after_step(parameters, state, memory, per_pitch, inputs, step, sampling, roots, failed):
    """Sampling, failure and growth after a step; returns True if no lane is running.

    ``sampling``: steps until the first sample, steps between samples, nodes ``points`` (p, lanes), -1 for the root,
    ``samples`` (rows, p, 4, lanes) of x, y, theta and V at these nodes, and ``tension`` (n, lanes), or empty, to which
    V is added. ``failed`` (lanes,) is the step at which a lane diverged, counted from 1, 0 before, -1 for an idle lane.
    ``roots`` (lanes,) change.
    """
    _, _, points, samples, tension = sampling
    row, k, running = sample_due(step, sampling), step * INPUTS, 0
    for lane in range(len(failed)):
        if failed[lane] != 0:
            continue
        if not (abs(state[layout.Y, lane]) <= DIVERGED_RADIAL and parameters[layout.PEAK, lane] <= DIVERGED_RADIAL):
            failed[lane] = step + 1
            continue
        running += 1
        if row >= 0:
            for p in range(len(points)):
                node = points[p, lane] if points[p, lane] >= 0 else roots[lane] + 1 + points[p, lane]
                for field in range(3):
                    samples[row, p, field, lane] = state[node * layout.FIELDS + field, lane]
                samples[row, p, 3, lane] = tension_at(state, memory, min(node, roots[lane] - 1), per_pitch, lane)
            for i in range(min(len(tension), roots[lane])):
                tension[i, lane] += tension_at(state, memory, i, per_pitch, lane)
        if inputs[k + APPEND, lane] != 0.0:
            move_root(parameters, state, memory, inputs, k, roots, lane)
    return running == 0


@part
def move_root(parameters, state, memory, inputs, k, roots, lane):
    """``ticm.move_root`` for a lane."""
    q = roots[lane] * layout.FIELDS
    if len(memory) > 0 and inputs[k + APPEND, lane] != 0.0:  # of the present root and of the next one
        first = min(roots[lane], roots[lane] + int(inputs[k + APPEND, lane])) * layout.MEMORY
        memory[first : first + 2 * layout.MEMORY, lane] = 0.0
    length = 2.0 * parameters[layout.SIN, lane] / parameters[layout.CURVATURE, lane]  # of an element, (2)
    if inputs[k + APPEND, lane] > 0.0:
        x, y = state[q + layout.X, lane], state[q + layout.Y, lane] * math.exp(-length / LEAVING)
        roots[lane] += 1
        q += layout.FIELDS
        state[q + layout.X, lane], state[q + layout.Y, lane] = x, y
        state[q + layout.T, lane] = y / LEAVING - parameters[layout.CURVATURE, lane] * x
        for field in range(layout.VX, layout.FIELDS):
            state[q + field, lane] = 0.0
    elif inputs[k + APPEND, lane] < 0.0:
        for field in range(layout.FIELDS):
            state[q + field, lane] = 0.0
        roots[lane] -= 1
        for field in range(layout.VX, layout.FIELDS):
            state[q - layout.FIELDS + field, lane] = 0.0
    parameters[layout.ROOT, lane] = roots[lane]


@traced
def product(factors, f, vector):
    """(3, 3) matrix at ``f`` times a vector (x, y, t)."""
    x, y, t = vector
    return (
        load(factors, f) * x + load(factors, f + 1) * y + load(factors, f + 2) * t,
        load(factors, f + 3) * x + load(factors, f + 4) * y + load(factors, f + 5) * t,
        load(factors, f + 6) * x + load(factors, f + 7) * y + load(factors, f + 8) * t,
    )


@traced
def less_product(minuend, factors, f, vector):
    """A vector minus the (3, 3) matrix at ``f`` times another vector."""
    (a, b, c), (x, y, t) = minuend, vector
    return (
        ((a - load(factors, f + 2) * t) - load(factors, f + 1) * y) - load(factors, f) * x,
        ((b - load(factors, f + 5) * t) - load(factors, f + 4) * y) - load(factors, f + 3) * x,
        ((c - load(factors, f + 8) * t) - load(factors, f + 7) * y) - load(factors, f + 6) * x,
    )


@traced
def solve_node(state, q, factors, f, wx, wy, wt):
    """Back substitution: w of a node from w of its neighbour on the root side."""
    return less_product(load3(state, q + layout.GX), factors, f, (wx, wy, wt))


@traced
def move_node(state, q, wx, wy, wt, drift, bounce, reflection, damped):
    """Update the displacement of a node from w; returns its velocity."""
    ux, uy, ut = wx - load(state, q + layout.X), wy - load(state, q + layout.Y), wt - load(state, q + layout.T)
    store(state, q + layout.GX, ux)  # motion of the last step, for the direction of friction
    if len(damped) > 0:
        store(state, q + layout.GY, uy)
    store(state, q + layout.GT, ut)
    store(state, q + layout.X, load(state, q + layout.X) + drift * ux)
    store(state, q + layout.Y, load(state, q + layout.Y) + drift * uy)
    store(state, q + layout.T, load(state, q + layout.T) + drift * ut)
    return (
        bounce * ux - reflection * load(state, q + layout.VX),
        bounce * uy - reflection * load(state, q + layout.VY),
        bounce * ut - reflection * load(state, q + layout.VT),
    )


@traced
def magnitude(value):
    """Absolute value."""
    zero = splat(value, 0.0)
    return where_less(value, zero, zero - value, value)


@traced
def inertia_forces(kappa, couple, forward, vy, t, axial_force, dt):
    """Coriolis and centrifugal acceleration of (13) and the couple of (9) per inertia.

    The couple is a spring of stiffness V l, treated linearly implicit: if explicit, rotations of neighbouring nodes are
    unstable at tensions above 4 J / (l dt^2), 640 N at 2e-4 s, which a hard start reaches.
    """
    zero = splat(t, 0.0)
    spring = couple * axial_force
    stiff = 1.0 + 0.25 * dt * dt * where_less(zero, spring, spring, zero)
    return -2.0 * kappa * forward * vy, kappa * forward * forward, zero - spring * t / stiff


@traced
def load_compressed(parameters):
    """Parameters of the couple and of the cable for ``compressed_forces`` and ``cable_forces``."""
    limits = load(parameters, layout.PRESSURE), load(parameters, layout.TENSION)
    couple = load(parameters, layout.COUPLE), load(parameters, layout.TURN), load(parameters, layout.TURN_FORCE), limits
    radius, stiffness = load(parameters, layout.CABLE_RADIUS), load(parameters, layout.CABLE)
    grip, twist = load(parameters, layout.FRICTION) * stiffness, radius * load(parameters, layout.MASS_RATIO)
    return couple, (radius, stiffness, grip, twist)


@traced
def compressed_forces(kappa, coupling, forward, vy, x, t, axial_force, dt):
    """``inertia_forces`` for a cable under compression.

    The couple may count from the tangent of the tube at the node, V l (theta + x / r), and then also acts on x. If the
    cable touches the walls, its compression and tension are limited to ``chain.max_pressure`` and ``max_tension`` in
    the couple, because a bouncing cable has equally large tensions.
    """
    couple, tangent, work, (pressure, tension) = coupling
    zero = splat(t, 0.0)
    maximum = zero - pressure
    pulled = where_less(tension, axial_force, tension, axial_force)
    spring = couple * where_less(pulled, maximum, maximum, pulled)
    stiff = 1.0 + 0.25 * dt * dt * where_less(zero, spring, spring, zero)
    moment = zero - spring * (t + tangent * x) / stiff
    return work * moment - 2.0 * kappa * forward * vy, kappa * forward * forward, moment


@traced
def load_wall(parameters, damped):
    """Contact stiffness, coefficient of friction and mass per inertia of the lanes; damping and slope of friction."""
    wall = load(parameters, layout.STIFFNESS), load(parameters, layout.FRICTION), load(parameters, layout.MASS_RATIO)
    return wall + tuple(load(parameters, row) for row in (layout.DASHPOT, layout.FRICTION_SLOPE)[: 2 * len(damped)])


@traced
def load_floats(parameters):
    """Node of the sensor, and lever, gap and drag of the floats of guide and carrier."""
    return (
        load(parameters, layout.SENSOR),
        load(parameters, layout.GUIDE_LEVER),
        load(parameters, layout.CARRIER_LEVER),
        load(parameters, layout.GUIDE_GAP),
        load(parameters, layout.CARRIER_GAP),
        load(parameters, layout.GUIDE_DRAG),
        load(parameters, layout.CARRIER_DRAG),
    )


@traced
def float_at(i, floats):
    """Lever, gap and drag of the float at node ``i``: the guide's up to the sensor, the carrier's beyond."""
    sensor, guide_lever, carrier_lever, guide_gap, carrier_gap, guide_drag, carrier_drag = floats
    index = splat(sensor, i - 0.5)
    return (
        where_less(index, sensor, guide_lever, carrier_lever),
        where_less(index, sensor, guide_gap, carrier_gap),
        where_less(index, sensor, guide_drag, carrier_drag),
    )


@traced
def damped_contact(wall, depth, inwards, slip):
    """Normal force of a float at a depth in a wall, into which it moves, and its coefficient of friction at a slip."""
    stiffness, coefficient, _, damping, slope = wall
    zero = splat(depth, 0.0)
    push = multiply_add(damping, inwards, stiffness * depth)
    normal = where_less(zero, depth, where_less(zero, push, push, zero), zero)
    coefficient = multiply_add(slope, magnitude(slip) - FRICTION_SPEED, coefficient)
    return normal, where_less(zero, coefficient, coefficient, zero)


@traced
def float_forces(float_, wall, forward, air, y, vy, slide, turn):
    """Drag, contact and friction of a float, (10)-(12) with both walls: x and y per mass, moment per inertia."""
    lever, gap, drag = float_
    stiffness, coefficient, ratio = wall[:3]
    zero = splat(y, 0.0)
    relative = air - forward
    inner = where_less(y, zero, zero - y, zero)  # depth in the inner and in the outer wall
    beyond = y - gap
    outer = where_less(zero, beyond, beyond, zero)
    lever = where_less(y, zero, lever, zero - lever)  # of the contact point
    slip, push = slide + turn * lever, stiffness * (inner - outer)
    maximum = coefficient * stiffness * (inner + outer)
    if len(wall) > 3:
        normal, coefficient = damped_contact(wall, inner + outer, where_less(y, zero, zero - vy, vy), slip)
        maximum, push = coefficient * normal, where_less(y, zero, normal, zero - normal)
    friction = where_less(slip, zero, zero - maximum, maximum)  # against the slide; zero counts as forward
    return drag * relative * magnitude(relative) - friction, push, friction * lever * ratio


@traced
def weight_friction(float_, wall, weight, forward, y, vy):
    """Friction of a float beyond mu N, along the tube: mu (sqrt(N^2 + w^2) - N).

    Its moment remains that of mu N, because the contact point moves out of the plane.
    """
    _, gap, _ = float_
    stiffness, coefficient, _ = wall[:3]
    zero = splat(y, 0.0)
    beyond = y - gap
    depth = where_less(y, zero, zero - y, zero) + where_less(zero, beyond, beyond, zero)
    normal = stiffness * depth
    if len(wall) > 3:
        normal, coefficient = damped_contact(wall, depth, where_less(y, zero, zero - vy, vy), forward)
    more = coefficient * (square_root(multiply_add(normal, normal, weight * weight)) - normal)
    return where_less(forward, zero, zero - more, more)


@traced
def held_forces(float_, wall, weighed, friction, forward, air, y, vy, slide, turn, held):
    """``float_forces`` with friction that also holds at rest, by a spring that yields at mu N; also the friction.

    R = R_before + k_t slip dt, at most mu N; with a weight w across the plane mu sqrt(N^2 + w^2), of which at most mu N
    turns the float, because the contact point moves out of the plane. From ``SLOW`` on R has its maximum at once.
    ``friction`` is w and k_t dt, ``held`` is R_before; ``weighed`` is an empty tuple if weight is neglected.
    """
    (lever, gap, drag), (stiffness, coefficient, ratio), (weight, grip) = float_, wall[:3], friction
    zero = splat(y, 0.0)
    relative = air - forward
    beyond = y - gap
    inner, outer = where_less(y, zero, zero - y, zero), where_less(zero, beyond, beyond, zero)
    lever = where_less(y, zero, lever, zero - lever)
    total, push = stiffness * (inner + outer), stiffness * (inner - outer)
    if len(wall) > 3:
        total, coefficient = damped_contact(
            wall, inner + outer, where_less(y, zero, zero - vy, vy), slide + turn * lever
        )
        push = where_less(y, zero, total, zero - total)
    normal = total
    if len(weighed) > 0:
        total = square_root(multiply_add(normal, normal, weight * weight))
        lever = where_less(zero, normal, lever, zero)
    maximum, turning = coefficient * total, coefficient * normal
    slip, slow = slide + turn * lever, splat(y, SLOW)
    held = held + grip * slip
    held = where_less(slip, slow, where_less(held, maximum, held, maximum), maximum)
    held = where_less(zero - slow, slip, where_less(zero - maximum, held, held, zero - maximum), zero - maximum)
    arm = held  # in the plane, at most mu N
    if len(weighed) > 0:
        arm = where_less(held, turning, held, turning)
        arm = where_less(zero - turning, arm, arm, zero - turning)
    return drag * relative * magnitude(relative) - held, push, arm * lever * ratio, held


@traced
def cable_walls(float_, cable):
    """Radial displacements below and above which the cable between floats, thinner than a float, touches a wall."""
    lever, gap, _ = float_
    clearance = lever - cable[0]
    return splat(clearance, 0.0) - clearance, gap + clearance


@traced
def nearest_walls(floats, cable):
    """``cable_walls`` of the guide or the carrier, whichever is nearer."""
    _, guide_lever, carrier_lever, guide_gap, carrier_gap, _, _ = floats
    low, high = cable_walls((guide_lever, guide_gap, guide_gap), cable)
    carrier_low, carrier_high = cable_walls((carrier_lever, carrier_gap, carrier_gap), cable)
    return where_less(low, carrier_low, carrier_low, low), where_less(high, carrier_high, high, carrier_high)


@traced
def extended_range(minimum, maximum, y):
    """A range extended to include y."""
    return where_less(y, minimum, y, minimum), where_less(maximum, y, y, maximum)


@traced
def cable_forces(walls, cable, y, slide, turn):
    """Contact and friction of the cable between floats; see ``cable_walls``."""
    low, high = walls
    radius, stiffness, grip, twist = cable
    zero = splat(y, 0.0)
    inner = where_less(y, low, low - y, zero)
    outer = where_less(high, y, y - high, zero)
    side = where_less(y, low, splat(y, 1.0), splat(y, -1.0))
    maximum = grip * (inner + outer)
    friction = where_less(slide + side * radius * turn, zero, zero - maximum, maximum)
    return zero - friction, stiffness * (inner - outer), side * friction * twist


@njit(nogil=True, error_model="numpy", forceinline=True)
def shorten_spans(state, memory, nodes, held, rigidity, turn):
    """N of every span, and V + N with its mean axial force, see ``ticm.shorten``.

    ``held`` are the roots of the lanes, ``rigidity`` is EA / 2. Apart from ``to_root``, which would wait for the sums.
    """
    top, bottom, _, per_pitch = nodes
    zero, one = splat(held, 0.0), splat(held, 1.0)
    whole = one / splat(held, float(per_pitch))
    for first in range(0, top, per_pitch):
        last, q, share = min(first + per_pitch, top), first * layout.FIELDS, whole
        squares, force, count = zero, zero, zero
        angle = load(state, q + layout.T) + turn * load(state, q + layout.X)
        for i in range(first, last):
            q = i * layout.FIELDS
            ahead, axial = angle, load(state, q + layout.V)
            angle = load(state, q + layout.FIELDS + layout.T) + turn * load(state, q + layout.FIELDS + layout.X)
            both = ahead * ahead + angle * angle
            if last > bottom:  # a root is among the nodes, behind which there is no cable
                node = splat(held, float(i))
                both, axial = where_less(node, held, both, zero), where_less(node, held, axial, zero)
                count = count + where_less(node, held, one, zero)
            squares, force = squares + both, force + axial
        if last > bottom:
            share = one / where_less(count, one, one, count)
        elif last < first + per_pitch:
            share = one / splat(held, float(last - first))
        pull = 0.5 * rigidity * squares * share
        store(memory, first * layout.MEMORY + layout.SPAN, force * share + pull)
        store(memory, first * layout.MEMORY + layout.N, pull)


@njit(nogil=True, error_model="numpy", forceinline=True)
def to_root(state, memory, factors, nodes, drive, rates, model, coupling, compressed, options, terms):
    """Kick and elimination of all nodes, including the root; returns the largest |y| of the floats.

    ``compressed`` and ``options`` as in ``imex_advance``, the former with one entry less if no cable is near a wall,
    which skips contact checks. ``terms``: the drags of floats and the steps that they have changed for, weight and grip
    of friction, and for the shortening the roots, EA / 2 and cosine and sine of the frame angle over the mass.
    """
    top, _, last, per_pitch = nodes
    weighed, varied, shortened, sticking, _ = options
    (drags, steps), friction, (held, rigidity, cosine, sine) = terms
    speed, slope, air = drive
    dt, tau, rate = rates
    kappa, couple, floats, wall = model
    compressed_couple, cable = coupling
    zero = splat(speed, 0.0)
    gx, gy, gt = zero, zero, zero
    walls = cable_walls(float_at(0, floats), cable)
    to_float, peak = 0, zero
    if len(shortened) > 0:
        shorten_spans(state, memory, nodes, held, rigidity, compressed_couple[1])
    pull, pull_ahead, tension = zero, zero, zero
    for i in range(top + 1):
        q, f = i * layout.FIELDS, min(i, last) * layout.FACTORS
        x, y, t = load3(state, q + layout.X)
        vx, vy, vt = load3(state, q + layout.VX)
        forward = speed + vx
        if len(shortened) > 0:
            axial = tension
            if to_float == 0:  # a float has half an element of either span
                pull, tension = (
                    load(memory, i * layout.MEMORY + layout.N),
                    load(memory, i * layout.MEMORY + layout.SPAN),
                )
                axial = 0.5 * (axial + tension)
            ax, ay, at = compressed_forces(kappa, compressed_couple, forward, vy, x, t, axial, dt)
            ax, ay = ax + cosine * (pull_ahead - pull), ay - sine * (pull_ahead + pull)
            pull_ahead = pull
        elif len(compressed) > 0:
            ax, ay, at = compressed_forces(kappa, compressed_couple, forward, vy, x, t, load(state, q + layout.V), dt)
        else:
            ax, ay, at = inertia_forces(kappa, couple, forward, vy, t, load(state, q + layout.V), dt)
        if len(compressed) > 1:  # here, since an else below would make the compiler round the rest otherwise
            if to_float == 0:
                walls = cable_walls(float_at(i + 1, floats), cable)
            elif any_less(y, walls[0]) or any_less(walls[1], y):
                slide, turn = speed + rate * load(state, q + layout.GX), rate * load(state, q + layout.GT)
                cx, cy, ct = cable_forces(walls, cable, y, slide, turn)
                ax, ay, at = ax + cx, ay + cy, at - ct
        if to_float == 0:
            to_float = per_pitch
            slide, turn = speed + load(state, q + layout.GX) / tau, load(state, q + layout.GT) / tau
            rise = load(state, q + layout.GY) / tau  # stored if contact is damped
            float_ = float_at(i, floats)
            if len(varied) > 0:
                number = i // per_pitch
                float_ = float_[0], float_[1], load(drags, number) + steps * load(drags, len(drags) // 2 + number)
            if len(sticking) > 0:
                at_held = i * layout.MEMORY + layout.HELD
                cx, cy, ct, grip = held_forces(
                    float_, wall, weighed, friction, forward, air, y, rise, slide, turn, load(memory, at_held)
                )
                store(memory, at_held, grip)
            else:
                cx, cy, ct = float_forces(float_, wall, forward, air, y, rise, slide, turn)
                if len(weighed) > 0:
                    cx = cx - weight_friction(float_, wall, friction[0], slide, y, rise)
            ax, ay, at = ax + cx, ay + cy, at - ct
            height = magnitude(y)
            peak = where_less(peak, height, height, peak)
        to_float -= 1
        # J (theta'' - x''/r) = moment: axial force turns the node too; the frame's own acceleration does not
        ax, at = ax - slope, at + kappa * ax
        vx, vy, vt = vx + dt * ax, vy + dt * ay, vt + dt * at
        pushed = product(factors, f + layout.A, (x + tau * vx, y + tau * vy, t + tau * vt))
        gx, gy, gt = less_product(pushed, factors, f + layout.B, (gx, gy, gt))
        store3(state, q + layout.VX, vx, vy, vt)
        store3(state, q + layout.GX, gx, gy, gt)
    return peak


@kernel
def imex_advance(
    parameters, compressed, options, drags, factors, state, memory, inputs, tops, bottoms, dt, per_pitch, sampling,
    roots, failed,
):  # fmt: skip
    """Advance all lanes; returns the number of steps.

    ``sampling``, ``roots`` and ``failed`` as in ``after_step``.

    ``compressed`` is a tuple; numba compiles a kernel for each length. Empty: neither of these; one entry:
    the couple counts from the tangent in some lane; two entries: also the cable touches the walls. ``options`` and
    ``drags`` as in ``superelement_advance``, ``drags`` per mass, followed by their change in each step.
    ``memory`` (3 n, lanes) has ``layout.MEMORY`` rows for each node, and is empty without shortening and held friction.
    """
    zero = splat(parameters, 0.0)
    last = len(factors) // layout.FACTORS - 1
    theta, tau = linear_weights(load(parameters, layout.DAMPING), dt)
    rate = 1.0 / tau
    drift, bounce, reflection = dt / tau, 1.0 / (tau * theta), (1.0 - theta) / theta
    kappa, couple = load(parameters, layout.CURVATURE), load(parameters, layout.COUPLE)
    floats, wall = load_floats(parameters), load_wall(parameters, options[4])
    coupling = load_compressed(parameters)
    low, high = nearest_walls(floats, coupling[1])
    rates, model = (dt, tau, rate), (kappa, couple, floats, wall)
    near = True  # whether cable was near a wall at the end of the last step, so that contact must be checked
    cosine = load(parameters, layout.AXIAL) * load(parameters, layout.COS)
    sine = load(parameters, layout.AXIAL) * load(parameters, layout.SIN)
    friction = load(parameters, layout.WEIGHT), load(parameters, layout.GRIP)
    mass = load(parameters, layout.MASS)
    frame_cosine, frame_sine = load(parameters, layout.COS) / mass, load(parameters, layout.SIN) / mass
    for step in range(len(tops)):
        k = step * INPUTS
        drive = load(inputs, k + SPEED), load(inputs, k + SLOPE), load(inputs, k + AIR)
        top, bottom = tops[step], bottoms[step]
        nodes = top, bottom, last, per_pitch
        held = load(parameters, layout.ROOT)
        stretch = held, load(parameters, layout.STRETCH), frame_cosine, frame_sine
        terms = (drags, splat(parameters, float(step))), friction, stretch
        if len(compressed) > 1 and (near or top != tops[step - 1]):  # a node appended at the root was not checked
            peak = to_root(state, memory, factors, nodes, drive, rates, model, coupling, compressed, options, terms)
        else:
            peak = to_root(state, memory, factors, nodes, drive, rates, model, coupling, compressed[:1], options, terms)
        # back to the tip: solution and new state; down to the shortest probe's root the lanes are masked
        wx, wy, wt = zero, zero, zero
        minimum, maximum = low, high
        for back in range(top - bottom + 1):
            i = top - back
            q = i * layout.FIELDS
            node = splat(parameters, float(i))
            ux, uy, ut = solve_node(state, q, factors, min(i, last) * layout.FACTORS + layout.C, wx, wy, wt)
            ux = where_less(node, held, ux, load(state, q + layout.X))
            uy = where_less(node, held, uy, load(state, q + layout.Y))
            ut = where_less(node, held, ut, load(state, q + layout.T))
            store(state, q + layout.V, where_less(node, held, cosine * (ux - wx) + sine * (uy + wy), zero))
            wx, wy, wt = ux, uy, ut
            vx, vy, vt = move_node(state, q, ux, uy, ut, drift, bounce, reflection, options[4])
            store(state, q + layout.VX, where_less(node, held, vx, zero))
            store(state, q + layout.VY, where_less(node, held, vy, zero))
            store(state, q + layout.VT, where_less(node, held, vt, zero))
            if len(compressed) > 1:
                minimum, maximum = extended_range(minimum, maximum, load(state, q + layout.Y))
        for back in range(bottom):
            i = bottom - 1 - back
            q = i * layout.FIELDS
            ux, uy, ut = solve_node(state, q, factors, min(i, last) * layout.FACTORS + layout.C, wx, wy, wt)
            store(state, q + layout.V, cosine * (ux - wx) + sine * (uy + wy))
            wx, wy, wt = ux, uy, ut
            vx, vy, vt = move_node(state, q, ux, uy, ut, drift, bounce, reflection, options[4])
            store3(state, q + layout.VX, vx, vy, vt)
            if len(compressed) > 1:
                minimum, maximum = extended_range(minimum, maximum, load(state, q + layout.Y))
        near = len(compressed) > 1 and (any_less(minimum, low) or any_less(high, maximum))
        store(parameters, layout.PEAK, peak)
        if after_step(parameters, state, memory, per_pitch, inputs, step, sampling, roots, failed):
            return step + 1
    return len(tops)


class Imex(layout.NodeLanes):
    """Implicit-explicit method: linear part implicit, contact, friction and drag explicit; groups of four probes."""

    name = "imex"
    order = 2
    usual_step = 2e-4
    simulates_damping = True
    kernel = staticmethod(imex_advance)
    factors = staticmethod(imex_factors)


class Imex32(Imex):
    """``Imex`` in single precision; groups of eight probes.

    During withdrawal a probe is displaced by about 0.4 m; its rounding in single precision is 0.1 mm radially.
    """

    name = "imex32"
    min_step = 5e-5
    precision = np.float32
    simulates_withdrawal = False
    factors = staticmethod(single_factors)

    @property
    def in_double(self) -> Imex:
        """See ``Method.in_double``."""
        return Imex()
