"""Kernel of the superelement: the theta rule in momenta, for cable condensed to floats and modes.

With M, K of the condensed chain, d the unknowns, p = M v, and f contact, friction, drag, inertia forces and the couple,
the rule of ``imex``, multiplied by M, is

    kick        p* = p + dt f(d, v_m of the step before),
    elastic     (M + theta dt tau K) v_m = p* - theta dt K d,   d += dt v_m,   p = p* - dt K (d_before + tau v_m),

so neither M^-1 f nor M v is computed, and K d is the only product: K (d_before + tau v_m) = (1 - tau / dt) K d_before
+ tau / dt K d, the first term from the last step. Modes are eliminated in each piece, where the matrix is diagonal,
then the floats from the tip to the root: u_i = E_i r_i - F_i u_{i-1}, and back: v_i = u_i - U_i v_{i+1}.

Each symmetric matrix of a piece has an even and an odd block (see pitch.py). Lanes as in ``imex``, but a row of the
state is a float with the piece on its root side. The piece at the root is a part of a pitch, in different rows in each
lane: these rows have separate constants (see ``assign_roots``).
"""

from typing import NamedTuple

from probe_env.arrays import FloatArray
from probe_env.physics.methods.factors import linear_weights
from probe_env.physics.methods.imex import (
    float_at,
    float_forces,
    held_forces,
    less_product,
    load_floats,
    load_wall,
    magnitude,
    sample_due,
    weight_friction,
)
from probe_env.physics.methods.lane_group import CURVATURE, DAMPING, GRIP, PEAK, ROOT, TENSION, WEIGHT
from probe_env.physics.methods.lanes import (
    kernel,
    load,
    load3,
    multiply_add,
    part,
    splat,
    store,
    store3,
    traced,
    where_less,
)
from probe_env.physics.methods.superelement import tables as offset
from probe_env.physics.model.drive import AIR, APPEND, INPUTS, SLOPE, SPEED
from probe_env.physics.model.state import DIVERGED_RADIAL

# fields of a row: displacement, momentum + tau K d, mean velocity, axial force, N of the shortening, held friction;
# then q and p of each mode
X, Y, T, PX, PY, PT, VX, VY, VT, V, N, HELD = range(12)
MODES = 12


class RootTables(NamedTuple):
    """Tables of every lane, see ``Tables``, with the number of modes of the group; scratch for ``grow``.

    Attributes:
        pieces: (lanes, n + 1, CONSTANTS).
        factors: (lanes, k, 27).
        root_factors: (lanes, n, k, 27).
        growth: (lanes, n, 6 + 2 m, 6 + 2 m).
        shape: (lanes, n, n, 3, 6 + m).
        lag: (lanes,) tau of ``linear_weights``.
        old, change: (6 + 2 m,).
    """

    pieces: FloatArray
    factors: FloatArray
    root_factors: FloatArray
    growth: FloatArray
    shape: FloatArray
    lag: FloatArray
    old: FloatArray
    change: FloatArray


@part
def assign_roots(tables, constants, factors, at, last, roots):
    """Set constants and factors of rows with a root: those of the root piece in its lane, of a pitch in other lanes."""
    per_pitch, lanes = tables.pieces.shape[1] - 1, tables.pieces.shape[0]
    at[:] = 0
    for k in range(lanes):
        if roots[k] == 0:  # an idle lane
            continue
        i = (roots[k] - 1) // per_pitch
        at[i] = 1 + k
        for lane in range(lanes):
            has_root = roots[lane] > 0 and (roots[lane] - 1) // per_pitch == i
            kind = roots[lane] - i * per_pitch - 1 if has_root else per_pitch
            row = min(i, last)
            for c in range(offset.CONSTANTS):
                constants[(1 + k) * offset.CONSTANTS + c, lane] = tables.pieces[lane, kind, c]
            for f in range(offset.FACTORS):
                value = tables.root_factors[lane, kind, row, f] if has_root else tables.factors[lane, row, f]
                factors[(last + 1 + k) * offset.FACTORS + f, lane] = value


@part
def grow(tables, state, fields, wide, root, lane):
    """Append a node at the root of a probe: transfer the state of its last piece to a longer one.

    If the pitch is complete, its end becomes a free float at rest, and the next piece is at rest. Float i of the probe
    is in block i // wide of the state, lane ``lane`` + i % wide.
    """
    per_pitch, modes = tables.pieces.shape[1] - 1, (fields - MODES) // 2
    i = (root - 1) // per_pitch
    q, k, length = i // wide * fields, lane + i % wide, root - i * per_pitch
    old, change, matrix = tables.old, tables.change, tables.growth[lane, length - 1]
    for c in range(3):
        old[c], old[3 + c] = state[q + X + c, k], state[q + VX + c, k]
    for j in range(modes):
        old[6 + j], old[6 + modes + j] = state[q + MODES + 2 * j, k], state[q + MODES + 2 * j + 1, k]
    for r in range(len(change)):
        change[r] = 0.0
        for c in range(len(old)):
            change[r] += matrix[r, c] * old[c]
    if length == per_pitch:
        axial, pull = state[q + V, k], state[q + N, k]
        q, k = (i + 1) // wide * fields, lane + (i + 1) % wide
        for c in range(3):
            state[q + X + c, k], state[q + VX + c, k], state[q + PX + c, k] = 0.0, 0.0, 0.0
        state[q + HELD, k] = 0.0
        state[q + V, k], state[q + N, k] = axial, pull
    for c in range(3):
        state[q + PX + c, k] += change[3 + c] + tables.lag[lane] * change[c]
    for j in range(modes):
        state[q + MODES + 2 * j, k], state[q + MODES + 2 * j + 1, k] = change[6 + j], change[6 + modes + j]


@part
def displacement(tables, state, fields, lane, length, node, component, near, near_lane, far, far_lane):
    """X, y or theta at a node of a piece of ``length`` nodes; its floats have the rows near and far of the state."""
    row = tables.shape[lane, length - 1, node, component]
    value = 0.0
    for c in range(3):
        value += row[c] * state[near + X + c, near_lane] + row[3 + c] * state[far + X + c, far_lane]
    for j in range((fields - MODES) // 2):
        value += row[6 + j] * state[near + MODES + 2 * j, near_lane]
    return value


@kernel
def displacements(tables, state, fields, wide, root, lane, d):
    """Displacements at all nodes of a probe between floats; floats as in ``grow``."""
    per_pitch = tables.pieces.shape[1] - 1
    for i in range((root - 1) // per_pitch + 1):
        q, k = i // wide * fields, lane + i % wide
        far, far_lane = (i + 1) // wide * fields, lane + (i + 1) % wide
        length = min(root - i * per_pitch, per_pitch)
        for node in range(1, length):
            for c in range(3):
                d[i * per_pitch + node, c] = displacement(
                    tables, state, fields, lane, length, node, c, q, k, far, far_lane
                )


@part
def sample(tables, state, fields, wide, root, lane, row, sampling):
    """Store a sample of a probe; ``sampling`` as in ``imex.after_step``, floats as in ``grow``.

    The axial forces of the pieces are added to ``tension`` (rows, lanes), unless it is empty.
    """
    _, _, points, samples, tension = sampling
    per_pitch = tables.pieces.shape[1] - 1
    outermost = (root - 1) // per_pitch
    for p in range(len(points)):
        node = points[p, lane] if points[p, lane] >= 0 else root + 1 + points[p, lane]
        i = min(node // per_pitch, outermost)
        q, k = i // wide * fields, lane + i % wide
        far, far_lane = (i + 1) // wide * fields, lane + (i + 1) % wide
        length = min(root - i * per_pitch, per_pitch)
        for c in range(3):
            if node == root:
                samples[row, p, c, lane] = 0.0
            elif node == i * per_pitch:
                samples[row, p, c, lane] = state[q + X + c, k]
            else:
                samples[row, p, c, lane] = displacement(
                    tables, state, fields, lane, length, node - i * per_pitch, c, q, k, far, far_lane
                )
        samples[row, p, 3, lane] = state[q + V, k] + state[q + N, k]
    for i in range(min(len(tension), outermost + 1)):
        q, k = i // wide * fields, lane + i % wide
        tension[i, lane] += state[q + V, k] + state[q + N, k]


@part
def after_step(
    parameters, constants, factors, at, last, fields, state, inputs, step, tables, sampling, roots, failed
):  # fmt: skip
    """Sampling, failure and growth after a step; True if no lane is running."""
    per_pitch = tables.pieces.shape[1] - 1
    running, moved, row = 0, False, sample_due(step, sampling)
    for lane in range(len(failed)):
        if failed[lane] != 0:
            continue
        if not (abs(state[Y, lane]) <= DIVERGED_RADIAL and parameters[PEAK, lane] <= DIVERGED_RADIAL):
            failed[lane] = step + 1
            continue
        running += 1
        if row >= 0:
            sample(tables, state, fields, 1, roots[lane], lane, row, sampling)
        if inputs[step * INPUTS + APPEND, lane] > 0.0:
            grow(tables, state, fields, 1, roots[lane], lane)
            roots[lane] += 1
            parameters[ROOT, lane] = ((roots[lane] - 1) // per_pitch) + 1
            moved = True
    if moved:
        assign_roots(tables, constants, factors, at, last, roots)
    return running == 0


@traced
def even_odd(lx, ly, lt, rx, ry, rt):
    """Even and odd unknowns of two ends."""
    return lx - rx, ly + ry, lt - rt, lx + rx, ly - ry, lt + rt


@traced
def ends_of(ex, ey, et, ox, oy, ot):
    """Forces at the L end and the R end from an even and an odd force."""
    return ex + ox, ey + oy, et + ot, ox - ex, ey - oy, ot - et


@traced
def bend_modes(constants, c, count, state, q, ends):
    """Force of the couple, per axial force, of the modes of one parity on the ends and on each mode; also their q.

    ``ends`` are the unknowns of the ends.
    """
    ax, ay, at = ends
    zero = splat(ax, 0.0)
    hx = hy = ht = zero
    forces, places = [], [load(state, q + 2 * j) for j in range(count)]
    for j in range(count):
        m = c + j * offset.MODE
        gx, gy, gt = load3(constants, m + offset.COUPLE)
        hx, hy, ht = hx + gx * places[j], hy + gy * places[j], ht + gt * places[j]
        force = multiply_add(gx, ax, gy * ay) + gt * at
        for i in range(count):
            force = force + load(constants, m + offset.TO_MODES + i) * places[i]
        forces.append(force)
    return (hx, hy, ht), tuple(forces), tuple(places)


@traced
def kick_modes(constants, c, state, q, kicks, places):
    """Kick the modes of one parity; returns the terms of elimination on the ends."""
    sx = sy = st = splat(constants, 0.0)
    for j, (kick, position) in enumerate(zip(kicks, places, strict=True)):
        m, r = c + j * offset.MODE, q + 2 * j
        momentum = load(state, r + 1) + kick
        store(state, r + 1, momentum)
        left = momentum - load(constants, m + offset.ELASTIC) * position
        sx = sx - load(constants, m + offset.CARRIED) * left
        sy = sy - load(constants, m + offset.CARRIED + 1) * left
        st = st - load(constants, m + offset.CARRIED + 2) * left
    return sx, sy, st


@traced
def move_modes(constants, c, count, state, q, ux, uy, ut, dt, tau):
    """Update q and p of the modes of one parity from the velocities of the ends; returns their axial force."""
    force = splat(ux, 0.0)
    for j in range(count):
        m, r = c + j * offset.MODE, q + 2 * j
        position, momentum = load(state, r), load(state, r + 1)
        velocity = momentum - load(constants, m + offset.ELASTIC) * position
        velocity = velocity - load(constants, m + offset.CARRIED) * ux
        velocity = velocity - load(constants, m + offset.CARRIED + 1) * uy
        velocity = velocity - load(constants, m + offset.CARRIED + 2) * ut
        middle = position + tau * velocity
        store(state, r, position + dt * velocity)
        store(state, r + 1, momentum - load(constants, m + offset.FORCE) * middle)
        force = force + load(constants, m + offset.AXIAL) * middle
    return force


@traced
def symmetric(constants, c, x, y, t):
    """Symmetric (3, 3) matrix at ``c`` times (x, y, t)."""
    xy, xt, yt = load(constants, c + 1), load(constants, c + 2), load(constants, c + 5)
    return (
        multiply_add(xy, y, load(constants, c) * x) + xt * t,
        multiply_add(xy, x, load(constants, c + 4) * y) + yt * t,
        multiply_add(xt, x, yt * y) + load(constants, c + 8) * t,
    )


@traced
def dot(constants, c, x, y, t):
    """Three constants times (x, y, t)."""
    a, b, d = load3(constants, c)
    return multiply_add(a, x, b * y) + d * t


@traced
def float_kick(constants, c, state, q, float_, wall, options, friction, curvature, behind, speed, slope, air, y):
    """Contact, friction, drag and inertia of a float with half the cable on either side: x, y, moment.

    ``behind`` is half the mass of the piece behind it; ``options`` are two tuples: empty if weight is neglected, and if
    friction does not hold at rest; ``friction`` is weight and grip. The order of loads affects the rounding (fused
    multiply-add).
    """
    vx, vy = load(state, q + VX), load(state, q + VY)
    forward = speed + vx
    weighed, sticking = options
    if len(sticking) > 0:
        cx, cy, ct, held = held_forces(
            float_, wall, weighed, friction, forward, air, y, vy, forward, load(state, q + VT), load(state, q + HELD)
        )
        store(state, q + HELD, held)
    else:
        cx, cy, ct = float_forces(float_, wall, forward, air, y, vy, vx + speed, load(state, q + VT))
    mass = behind + load(constants, c + offset.HALF_MASS)
    turn = mass * curvature * forward
    cx = cx - 2.0 * turn * vy - mass * slope
    if len(weighed) > 0 and len(sticking) == 0:
        cx = cx - weight_friction(float_, wall, friction[0], forward, y, vy)
    return cx, cy + turn * forward, ct


@traced
def piece_forces(constants, c, evens, odds, shortened, state, q, here, ahead, limit, dt):
    """Couple, modes and K d of a piece between two floats with given displacements.

    With the shortening Q = z^T G z / 2 of a piece of length p, N = EA Q / p and the mean axial force V = a z, its
    energy is z^T K z / 2 + V Q + EA Q^2 / (2 p) (see ``ticm.shorten``), so its forces are -(V + N) G z and -Q a.
    ``shortened`` is an empty tuple if this is neglected; then N and Q a are zero.

    Returns:
        for this float: -dt V, force of the couple (to be multiplied by it), terms of the modes, K d; for the float
        ahead: K d, terms of the modes, kick of the couple.
    """
    (x, y, t), (nx, ny, nt), even, odd = here, ahead, len(evens), len(odds)
    ax, ay, aa, bx, by, bt = even_odd(x, y, t, nx, ny, nt)
    # couple and modes
    even_row, odd_row = q + MODES, q + MODES + 2 * even
    (gx, gy, gt), forces, places = bend_modes(constants, c + offset.EVEN, even, state, even_row, (ax, ay, aa))
    (mx, my, mt), odd_forces, odd_places = bend_modes(constants, c + offset.ODD, odd, state, odd_row, (bx, by, bt))
    cex, cey, cet = symmetric(constants, c + offset.G_EVEN, ax, ay, aa)
    cox, coy, cot = symmetric(constants, c + offset.G_ODD, bx, by, bt)
    gx, gy, gt, mx, my, mt = gx + cex, gy + cey, gt + cet, mx + cox, my + coy, mt + cot
    zero = splat(x, 0.0)
    axial = load(state, q + V)
    if len(shortened) > 0:
        modal = zero
        for force, place in zip(forces + odd_forces, places + odd_places, strict=True):
            modal = modal + force * place
        ends = multiply_add(ax, gx, ay * gy) + aa * gt
        square = ends + (modal + (multiply_add(bx, mx, by * my) + bt * mt))
        pull = load(constants, c + offset.STRETCH) * square
        store(state, q + N, pull)
        axial = axial + pull
    push = zero - dt * where_less(axial, limit, axial, limit)
    kicks, odd_kicks = [push * force for force in forces], [push * force for force in odd_forces]
    if len(shortened) > 0:
        shorten = (zero - 0.5 * dt) * square
        kicks = [
            multiply_add(shorten, load(constants, c + offset.EVEN + j * offset.MODE + offset.AXIAL), kick)
            for j, kick in enumerate(kicks)
        ]
        cex, cey, cet = load3(constants, c + offset.AXIAL_EVEN)
        gx, gy = multiply_add(shorten, cex, push * gx), multiply_add(shorten, cey, push * gy)
        gt = multiply_add(shorten, cet, push * gt)
        mx, my, mt, push = push * mx, push * my, push * mt, zero + 1.0
    jx, jy, jt = kick_modes(constants, c + offset.EVEN, state, even_row, kicks, places)
    ox, oy, ot = kick_modes(constants, c + offset.ODD, state, odd_row, odd_kicks, odd_places)
    gx, gy, gt, mx, my, mt = ends_of(gx, gy, gt, mx, my, mt)
    jx, jy, jt, ox, oy, ot = ends_of(jx, jy, jt, ox, oy, ot)
    # K d of the float: its share of this piece
    odd_strain = dot(constants, c + offset.K_ODD, bx, by, bt)
    cex, cey, cet = symmetric(constants, c + offset.K_EVEN, ax, ay, aa)
    ex, ey, et, dx, dy, dd = ends_of(
        cex, cey, cet,
        load(constants, c + offset.K_ODD + 3) * odd_strain,
        load(constants, c + offset.K_ODD + 4) * odd_strain,
        load(constants, c + offset.K_ODD + 5) * odd_strain,
    )  # fmt: skip
    return (push, gx, gy, gt, jx, jy, jt, ex, ey, et), (dx, dy, dd, ox, oy, ot, push * mx, push * my, push * mt)


@traced
def momentum_kick(state, q, kick, piece, behind, dt, before, now, weight):
    """Update the momentum of a float from its kick and the pieces on both sides; returns the right-hand side."""
    cx, cy, ct = kick
    push, gx, gy, gt, jx, jy, jt, ex, ey, et = piece
    kx, ky, kt, sx, sy, st, hx, hy, ht = behind
    ex, ey, et = ex + kx, ey + ky, et + kt
    px = load(state, q + PX) - now * ex + dt * cx + push * gx + hx
    py = load(state, q + PY) - now * ey + dt * cy + push * gy + hy
    pt = load(state, q + PT) - now * et - dt * ct + push * gt + ht
    store(state, q + PX, px + before * ex)
    store(state, q + PY, py + before * ey)
    store(state, q + PT, pt + before * et)
    return px - weight * ex + (jx + sx), py - weight * ey + (jy + sy), pt - weight * et + (jt + st)


@traced
def middle_of(state, q, velocity, tau):
    """D_before + tau v_m of a float."""
    ux, uy, ut = velocity
    x, y, t = load3(state, q + X)
    return x + tau * ux, y + tau * uy, t + tau * ut


@traced
def axial_force(constants, c, evens, odds, state, q, velocity, velocity_ahead, middle, middle_ahead, dt, tau):
    """Axial force of a piece from v_m and d_before + tau v_m of its two floats; updates its modes.

    Returns:
        axial force of a pitch between floats; additional force of the piece at the root, without ``root_force``.
    """
    (ux, uy, ut), (wx, wy, wt), (nx, ny, nt), (zx, zy, zt) = velocity, velocity_ahead, middle, middle_ahead
    even, odd = len(evens), len(odds)
    ax, ay, aa, bx, by, bt = even_odd(ux, uy, ut, wx, wy, wt)
    axial = dot(constants, c + offset.AXIAL_EVEN, nx - zx, ny + zy, nt - zt)
    axial = axial + move_modes(constants, c + offset.EVEN, even, state, q + MODES, ax, ay, aa, dt, tau)
    return axial, move_modes(constants, c + offset.ODD, odd, state, q + MODES + 2 * even, bx, by, bt, dt, tau)


@traced
def root_force(constants, c, middle, middle_ahead):
    """Contribution of the odd unknowns of the ends to the axial force of the piece at the root."""
    (nx, ny, nt), (zx, zy, zt) = middle, middle_ahead
    return dot(constants, c + offset.AXIAL_ODD, nx + zx, ny - zy, nt + zt)


@traced
def move_float(state, q, velocity, dt):
    """Update the displacement of a float; its mean velocity is stored for the direction of friction."""
    ux, uy, ut = velocity
    store(state, q + X, load(state, q + X) + dt * ux)
    store(state, q + Y, load(state, q + Y) + dt * uy)
    store(state, q + T, load(state, q + T) + dt * ut)
    store3(state, q + VX, ux, uy, ut)


@kernel
def superelement_advance(
    parameters, constants, factors, at, last, modes, options, drags, state, inputs, tops, bottoms, dt, tables, sampling,
    roots, failed,
):  # fmt: skip
    """Advance all lanes; returns the number of steps. ``sampling`` as in ``imex_advance``, growth as in ``after_step``.

    ``constants`` ((1 + lanes) CONSTANTS, lanes) are those of a pitch, then of rows with a root; ``factors`` are those
    of ``last`` + 1 rows, then of rows with a root; ``at[i]`` is the block of row i. A row is a float and the modes of
    the piece behind it. The lengths of the two tuples ``modes`` are the numbers of even and odd modes; numba compiles a
    kernel without loops for each length. Likewise ``options``, tuples that are empty or not: whether weight adds to
    friction, whether float i has the drag ``drags[i]`` (rows, lanes) instead of that of guide or carrier, whether
    bending shortens the cable, whether friction holds at rest, and whether contact is damped. ``tops``
    and ``bottoms`` (steps,) are the last floats of the longest and of the shortest probe.
    """
    assign_roots(tables, constants, factors, at, last, roots)
    zero = splat(parameters, 0.0)
    evens, odds = modes
    weighed, varied, shortened, sticking, damped = options
    even, odd = len(evens), len(odds)
    fields = MODES + 2 * (even + odd)
    theta, tau = linear_weights(load(parameters, DAMPING), dt)
    before, now, weight = tau - dt, tau, theta * dt  # p = (p* + before K d_before) - now K d
    curvature, limit = load(parameters, CURVATURE), load(parameters, TENSION)
    friction = load(parameters, WEIGHT), load(parameters, GRIP)
    floats, wall = load_floats(parameters), load_wall(parameters, damped)
    pitch_half = load(constants, offset.HALF_MASS)
    for step in range(len(tops)):
        k = step * INPUTS
        speed, slope, air = load(inputs, k + SPEED), load(inputs, k + SLOPE), load(inputs, k + AIR)
        top, peak = tops[step], zero
        ux = uy = ut = zero
        behind = (zero, zero, zero, zero, zero, zero, zero, zero, zero)
        mass = zero
        here = load3(state, X)
        for i in range(top + 1):
            q = i * fields
            c, f = at[i] * offset.CONSTANTS, (min(i, last) if at[i] == 0 else last + at[i]) * offset.FACTORS
            ahead = load3(state, q + fields + X)
            float_ = float_at(i, floats)
            if len(varied) > 0:
                float_ = float_[0], float_[1], load(drags, i)
            kick = float_kick(
                constants, c, state, q, float_, wall, (weighed, sticking), friction, curvature, mass, speed, slope, air,
                here[1],
            )  # fmt: skip
            height = magnitude(here[1])
            peak = where_less(peak, height, height, peak)
            mass = pitch_half
            done, carried = piece_forces(constants, c, evens, odds, shortened, state, q, here, ahead, limit, dt)
            rx, ry, rt = momentum_kick(state, q, kick, done, behind, dt, before, now, weight)
            rx, ry, rt = symmetric(factors, f, rx, ry, rt)
            ux, uy, ut = less_product((rx, ry, rt), factors, f + 9, (ux, uy, ut))
            store3(state, q + VX, ux, uy, ut)
            behind, here = carried, ahead
        store(parameters, PEAK, peak)
        velocity = middle = (zero, zero, zero)  # of the float ahead: v_m, d_before + tau v_m
        held = load(parameters, ROOT)
        for back in range(top + 1):
            i = top - back
            q = i * fields
            c, f = at[i] * offset.CONSTANTS, (min(i, last) if at[i] == 0 else last + at[i]) * offset.FACTORS
            ux, uy, ut = less_product(load3(state, q + VX), factors, f + 18, velocity)
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
        if after_step(
            parameters, constants, factors, at, last, fields, state, inputs, step, tables, sampling, roots, failed
        ):  # fmt: skip
            return step + 1
    return len(tops)
