"""Central differences: no linear system, but a step about forty times smaller than that of ``imex``.

K (d + delta v) is part of the kick of ``imex``; the damping force lags half a step, so the order is one with damping.
"""

from __future__ import annotations

from probe_env.arrays import FloatArray
from probe_env.physics.methods.factors import explicit_factors
from probe_env.physics.methods.imex import (
    after_step,
    cable_forces,
    cable_walls,
    compressed_forces,
    float_at,
    float_forces,
    inertia_forces,
    load_compressed,
    load_floats,
    load_wall,
    magnitude,
    product,
)
from probe_env.physics.methods.lane_group import (
    AXIAL,
    COS,
    COUPLE,
    CURVATURE,
    DAMPING,
    FACTORS,
    FIELDS,
    PEAK,
    ROOT,
    SIN,
    VT,
    VX,
    VY,
    A,
    B,
    C,
    NodeLanes,
    T,
    V,
    X,
    Y,
)  # fmt: skip
from probe_env.physics.methods.lanes import any_less, kernel, load, splat, store, where_less
from probe_env.physics.methods.stability import explicit_step
from probe_env.physics.model.chain import Chain
from probe_env.physics.model.drive import AIR, INPUTS, SLOPE, SPEED
from probe_env.scene import Scene


@kernel
def explicit_advance(
    parameters, compressed, factors, state, inputs, tops, bottoms, dt, per_pitch, sampling, roots, failed
):
    """Advance all lanes by central differences; arguments as in ``imex_advance``."""
    first, every, points, samples, tension = sampling
    zero = splat(parameters, 0.0)
    delta = load(parameters, DAMPING)
    kappa, couple = load(parameters, CURVATURE), load(parameters, COUPLE)
    floats, wall = load_floats(parameters), load_wall(parameters)
    compressed_couple, cable = load_compressed(parameters)
    walls = cable_walls(float_at(0, floats), cable)
    cosine, sine, axial = load(parameters, COS), load(parameters, SIN), load(parameters, AXIAL)
    row, due = 0, first
    for step in range(len(tops)):
        k = step * INPUTS
        speed, slope, air = load(inputs, k + SPEED), load(inputs, k + SLOPE), load(inputs, k + AIR)
        held = load(parameters, ROOT)
        to_float, peak = 0, zero
        bx, by, bt = zero, zero, zero  # d + delta v of the node on the tip side
        x, y, t = load(state, X), load(state, Y), load(state, T)
        vx, vy, vt = load(state, VX), load(state, VY), load(state, VT)
        ex, ey, et = x + delta * vx, y + delta * vy, t + delta * vt
        for i in range(tops[step]):
            q, f = i * FIELDS, min(i, 1) * FACTORS
            nx, ny, nt = load(state, q + FIELDS + X), load(state, q + FIELDS + Y), load(state, q + FIELDS + T)
            nvx, nvy, nvt = load(state, q + FIELDS + VX), load(state, q + FIELDS + VY), load(state, q + FIELDS + VT)
            aex, aey, aet = nx + delta * nvx, ny + delta * nvy, nt + delta * nvt
            force = axial * (cosine * (ex - aex) + sine * (ey + aey))
            forward = speed + vx
            if len(compressed) > 0:
                ax, ay, at = compressed_forces(kappa, compressed_couple, forward, vy, x, t, force, dt)
            else:
                ax, ay, at = inertia_forces(kappa, couple, forward, vy, t, force, dt)
            if len(compressed) > 1:
                if to_float == 0:
                    walls = cable_walls(float_at(i + 1, floats), cable)
                elif any_less(y, walls[0]) or any_less(walls[1], y):
                    cx, cy, ct = cable_forces(walls, cable, y, forward, vt)
                    ax, ay, at = ax + cx, ay + cy, at - ct
            if to_float == 0:
                to_float = per_pitch
                cx, cy, ct = float_forces(float_at(i, floats), wall, forward, air, y, forward, vt)
                ax, ay, at = ax + cx, ay + cy, at - ct
                height = magnitude(y)
                peak = where_less(peak, height, height, peak)
            to_float -= 1
            # J (theta'' - x''/r) = moment: axial force turns the node too; the frame's own acceleration does not
            ax, at = ax - slope, at + kappa * ax
            ox, oy, ot = product(factors, f + A, ex, ey, et)
            px, py, pt = product(factors, f + B, bx, by, bt)
            sx, sy, st = product(factors, f + C, aex, aey, aet)
            node = splat(parameters, float(i))
            vx = where_less(node, held, vx + dt * (ax - (ox + px + sx)), zero)
            vy = where_less(node, held, vy + dt * (ay - (oy + py + sy)), zero)
            vt = where_less(node, held, vt + dt * (at - (ot + pt + st)), zero)
            store(state, q + VX, vx)
            store(state, q + VY, vy)
            store(state, q + VT, vt)
            store(state, q + X, x + dt * vx)
            store(state, q + Y, y + dt * vy)
            store(state, q + T, t + dt * vt)
            store(state, q + V, where_less(node, held, force, zero))
            bx, by, bt = ex, ey, et
            ex, ey, et = aex, aey, aet
            x, y, t, vx, vy, vt = nx, ny, nt, nvx, nvy, nvt
        store(parameters, PEAK, peak)
        due -= 1
        if after_step(parameters, state, inputs, k, step, due, row, points, roots, samples, tension, failed):
            return step + 1
        if due == 0:
            due = every
            row += 1
    return len(tops)


class Explicit(NodeLanes):
    """Central differences; groups of four probes."""

    name = "explicit"
    order = 1
    usual_step = 5e-6
    kernel = staticmethod(explicit_advance)

    def stable_step(self, scene: Scene, nodes_per_pitch: int) -> float:
        """Largest stable step [s], from the fastest mode."""
        return explicit_step(scene, nodes_per_pitch)

    contact_step = stable_step

    def factors(self, chain: Chain, time_step: float) -> FloatArray:
        """(2, 27) blocks of M^-1 K."""
        return explicit_factors(chain)
