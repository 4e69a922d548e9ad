"""Kernel of the superelement for a single probe, with neighbouring floats in the lanes; equal bits as ``kernel.py``.

The run time of a group does not depend on how many lanes are used. Here the lanes are neighbouring floats of one probe:
the forces of a block of floats and pieces are computed at once, and only the two sweeps, u_i = E_i r_i - F_i u_{i-1}
and v_i = u_i - U_i v_{i+1}, go from float to float. All numbers come from the same functions with the same arguments.

Field f of float i is in row (i // lanes) fields + f of the state, lane i % lanes.
"""

from probe_env.physics.methods.factors import linear_weights
from probe_env.physics.methods.imex import load_wall, magnitude, sample_due
from probe_env.physics.methods.lane_group import CURVATURE, DAMPING, GRIP, PEAK, TENSION, WEIGHT
from probe_env.physics.methods.lanes import (
    PART,
    compiled,
    from_ahead,
    from_behind,
    kernel,
    load,
    load3,
    part,
    splat,
    store,
    store3,
    traced,
    where_less,
)
from probe_env.physics.methods.superelement.kernel import (
    MODES,
    VT,
    VX,
    VY,
    V,
    X,
    Y,
    axial_force,
    float_kick,
    grow,
    middle_of,
    momentum_kick,
    move_float,
    piece_forces,
    root_force,
    sample,
    symmetric,
)
from probe_env.physics.methods.superelement.tables import CONSTANTS
from probe_env.physics.model.drive import AIR, APPEND, SLOPE, SPEED
from probe_env.physics.model.state import DIVERGED_RADIAL

E_SIZE = 9
"""Entries of the factor E of a float, in lanes; the entries of F and U, ``LINKS`` numbers, are in separate rows."""
LINKS = 18


@part
def assign_root(tables, constants, factors, links, root):
    """Set constants and factors of the block of the root; the last float has those of a shorter piece."""
    per_pitch, lanes = tables.pieces.shape[1] - 1, constants.shape[1]
    top, f, settled = (root - 1) // per_pitch, len(factors) - E_SIZE, tables.factors.shape[1] - 1
    for lane in range(lanes):
        i = (top // lanes) * lanes + lane
        row = min(i, settled)
        kind = root - top * per_pitch - 1 if i == top else per_pitch
        for c in range(CONSTANTS):
            constants[CONSTANTS + c, lane] = tables.pieces[0, kind, c]
        for k in range(E_SIZE):
            value = tables.root_factors[0, kind, row, k] if i == top else tables.factors[0, row, k]
            factors[f + k, lane] = value
    for k in range(LINKS):
        links[k // 9, links.shape[1] - 1, k % 9] = tables.root_factors[
            0, root - top * per_pitch - 1, min(top, settled), E_SIZE + k
        ]


LEVER, GAP, DRAG, BEHIND = range(4)
FLOATS = 4
"""Parameters of a float: lever, gap, drag, and half the mass of the piece behind it."""


@traced
def all_from_behind(a, b):
    """``from_behind`` of the nine values that a piece passes to the float ahead."""
    return tuple(map(from_behind, a, b))


@traced
def all_from_ahead(a, b):
    """``from_ahead`` of x, y and theta."""
    return tuple(map(from_ahead, a, b))


@compiled(fastmath={"contract"}, **PART)
def link(a, b, c, links, row, x, y, t):
    """``less_product`` of one float."""
    return (
        ((a - links[row, 2] * t) - links[row, 1] * y) - links[row, 0] * x,
        ((b - links[row, 5] * t) - links[row, 4] * y) - links[row, 3] * x,
        ((c - links[row, 8] * t) - links[row, 7] * y) - links[row, 6] * x,
    )


@kernel
def superelement_advance_single(
    parameters, constants, factors, links, floats, modes, options, state, inputs, root, dt, tables, sampling
):
    """Advance one probe that is held at ``root``; see ``kernel.superelement_advance``.

    Args:
        parameters: (30, lanes) of the probe, equal in all lanes.
        constants: (2 CONSTANTS, lanes) of a pitch, and of the block with the root.
        factors: ((blocks + 1) E_SIZE, lanes) E of the floats; further floats use the last block but one; last: root.
        links: (2, k + 1, 9) F and U of the floats; further floats use the last row but one; last: root.
        floats: (blocks FLOATS, lanes).
        modes: two tuples with the lengths of the numbers of even and odd modes.
        options: of ``kernel.superelement_advance`` without the second.
        state: (blocks fields, lanes), with a block at rest after the last one.
        inputs: (steps, 4), see model/drive.py.
        root: node that is held.
        dt: [s].
        tables: of the probe alone.
        sampling: as in ``kernel.sample``, of one lane.

    Returns:
        step at which the probe diverged, counted from 1, or 0; held node.
    """
    zero = splat(parameters, 0.0)
    to_root, to_tip = links[0], links[1]
    rest = to_root[0, 0] - to_root[0, 0]
    evens, odds = modes
    lanes, fields = state.shape[1], MODES + 2 * (len(evens) + len(odds))
    beyond, per_pitch = len(factors) // E_SIZE - 2, tables.pieces.shape[1] - 1
    theta, tau = linear_weights(load(parameters, DAMPING), dt)
    before, now, weight = tau - dt, tau, theta * dt  # p = (p* + before K d_before) - now K d
    curvature, limit = load(parameters, CURVATURE), load(parameters, TENSION)
    weighed, shortened, sticking, damped = options
    friction = load(parameters, WEIGHT), load(parameters, GRIP)
    wall = load_wall(parameters, damped)
    held = len(to_root) - 1
    assign_root(tables, constants, factors, links, root)
    for step in range(len(inputs)):
        speed, slope = splat(parameters, inputs[step, SPEED]), splat(parameters, inputs[step, SLOPE])
        air = splat(parameters, inputs[step, AIR])
        top, peak = (root - 1) // per_pitch, zero
        last = top // lanes
        ux = uy = ut = rest
        behind = (zero, zero, zero, zero, zero, zero, zero, zero, zero)
        here = load3(state, X)
        for b in range(last + 1):
            q, c = b * fields, CONSTANTS if b == last else 0
            f = (beyond + 1 if b == last else min(b, beyond)) * E_SIZE
            further = load3(state, q + fields + X)
            ahead = all_from_ahead(here, further)
            float_ = load(floats, b * FLOATS + LEVER), load(floats, b * FLOATS + GAP), load(floats, b * FLOATS + DRAG)
            half = load(floats, b * FLOATS + BEHIND)
            kick = float_kick(
                constants, c, state, q, float_, wall, (weighed, sticking), friction, curvature, half, speed, slope, air,
                here[1],
            )  # fmt: skip
            height = magnitude(here[1])
            peak = where_less(peak, height, height, peak)
            done, carried = piece_forces(constants, c, evens, odds, shortened, state, q, here, ahead, limit, dt)
            nearer = all_from_behind(behind, carried)
            rx, ry, rt = momentum_kick(state, q, kick, done, nearer, dt, before, now, weight)
            rx, ry, rt = symmetric(factors, f, rx, ry, rt)
            store3(state, q + VX, rx, ry, rt)
            for lane in range(min(lanes, top + 1 - b * lanes)):
                i = b * lanes + lane
                r = held if i == top else min(i, held - 1)
                ux, uy, ut = link(state[q + VX, lane], state[q + VY, lane], state[q + VT, lane], to_root, r, ux, uy, ut)
                state[q + VX, lane], state[q + VY, lane], state[q + VT, lane] = ux, uy, ut
            behind, here = carried, further
        q = last * fields
        for lane in range(top + 1 - last * lanes, lanes):  # beyond the root nothing moves
            state[q + VX, lane], state[q + VY, lane], state[q + VT, lane] = 0.0, 0.0, 0.0
        ux = uy = ut = rest
        velocity = middle = (zero, zero, zero)  # of the block ahead: v_m, d_before + tau v_m
        for back in range(last + 1):
            b = last - back
            q = b * fields
            for up in range(max(0, (b + 1) * lanes - 1 - top), lanes):
                lane = lanes - 1 - up
                i = b * lanes + lane
                r = held if i == top else min(i, held - 1)
                ux, uy, ut = link(state[q + VX, lane], state[q + VY, lane], state[q + VT, lane], to_tip, r, ux, uy, ut)
                state[q + VX, lane], state[q + VY, lane], state[q + VT, lane] = ux, uy, ut
            moved = load3(state, q + VX)
            ux, uy, ut = state[q + VX, 0], state[q + VY, 0], state[q + VT, 0]
            half_way = middle_of(state, q, moved, tau)
            velocity, middle = all_from_ahead(moved, velocity), all_from_ahead(half_way, middle)
            c = CONSTANTS if b == last else 0
            axial, more = axial_force(constants, c, evens, odds, state, q, moved, velocity, half_way, middle, dt, tau)
            if b == last:
                axial = axial + more + root_force(constants, c, half_way, middle)
            store(state, q + V, axial)
            move_float(state, q, moved, dt)
            velocity, middle = moved, half_way
        store(parameters, PEAK, peak)
        inside = abs(state[Y, 0]) <= DIVERGED_RADIAL
        for lane in range(lanes):
            inside = inside and parameters[PEAK, lane] <= DIVERGED_RADIAL
        if not inside:
            return step + 1, root
        row = sample_due(step, sampling)
        if row >= 0:
            sample(tables, state, fields, lanes, root, 0, row, sampling)
        if inputs[step, APPEND] > 0.0:
            grow(tables, state, fields, lanes, root, 0)
            root += 1
            assign_root(tables, constants, factors, links, root)
    return 0, root
