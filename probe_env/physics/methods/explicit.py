"""Central differences: no linear system, but a step about forty times smaller than that of ``imex``.

K (d + delta v) is part of the kick of ``imex``; the damping force lags half a step, so the order is one with damping.
"""

from probe_env.arrays import FloatArray
from probe_env.physics.methods import imex
from probe_env.physics.methods import lane_group as layout
from probe_env.physics.methods.factors import explicit_factors
from probe_env.physics.methods.lane_group import NodeLanes
from probe_env.physics.methods.lanes import any_less, kernel, load, load3, splat, store, store3, where_less
from probe_env.physics.methods.stability import explicit_step
from probe_env.physics.model.chain import Chain
from probe_env.physics.model.drive import AIR, INPUTS, SLOPE, SPEED
from probe_env.scene import Scene


@kernel
def explicit_advance(
    parameters, compressed, options, drags, factors, state, memory, inputs, tops, bottoms, dt, per_pitch, sampling,
    roots, failed,
):  # fmt: skip
    """Advance all lanes by central differences; arguments as in ``imex_advance``, without options."""
    zero = splat(parameters, 0.0)
    delta = load(parameters, layout.DAMPING)
    kappa, couple = load(parameters, layout.CURVATURE), load(parameters, layout.COUPLE)
    floats, wall = imex.load_floats(parameters), imex.load_wall(parameters, ())
    compressed_couple, cable = imex.load_compressed(parameters)
    walls = imex.cable_walls(imex.float_at(0, floats), cable)
    cosine, sine, axial = load(parameters, layout.COS), load(parameters, layout.SIN), load(parameters, layout.AXIAL)
    for step in range(len(tops)):
        k = step * INPUTS
        speed, slope, air = load(inputs, k + SPEED), load(inputs, k + SLOPE), load(inputs, k + AIR)
        held = load(parameters, layout.ROOT)
        to_float, peak = 0, zero
        bx, by, bt = zero, zero, zero  # d + delta v of the node on the tip side
        x, y, t = load3(state, layout.X)
        vx, vy, vt = load3(state, layout.VX)
        ex, ey, et = x + delta * vx, y + delta * vy, t + delta * vt
        for i in range(tops[step]):
            q, f = i * layout.FIELDS, min(i, 1) * layout.FACTORS
            ahead = q + layout.FIELDS
            nx, ny, nt = load3(state, ahead + layout.X)
            nvx, nvy, nvt = load3(state, ahead + layout.VX)
            aex, aey, aet = nx + delta * nvx, ny + delta * nvy, nt + delta * nvt
            force = axial * (cosine * (ex - aex) + sine * (ey + aey))
            forward = speed + vx
            if len(compressed) > 0:
                ax, ay, at = imex.compressed_forces(kappa, compressed_couple, forward, vy, x, t, force, dt)
            else:
                ax, ay, at = imex.inertia_forces(kappa, couple, forward, vy, t, force, dt)
            if len(compressed) > 1:
                if to_float == 0:
                    walls = imex.cable_walls(imex.float_at(i + 1, floats), cable)
                elif any_less(y, walls[0]) or any_less(walls[1], y):
                    cx, cy, ct = imex.cable_forces(walls, cable, y, forward, vt)
                    ax, ay, at = ax + cx, ay + cy, at - ct
            if to_float == 0:
                to_float = per_pitch
                cx, cy, ct = imex.float_forces(imex.float_at(i, floats), wall, forward, air, y, vy, forward, vt)
                ax, ay, at = ax + cx, ay + cy, at - ct
                height = imex.magnitude(y)
                peak = where_less(peak, height, height, peak)
            to_float -= 1
            # J (theta'' - x''/r) = moment: axial force turns the node too; the frame's own acceleration does not
            ax, at = ax - slope, at + kappa * ax
            ox, oy, ot = imex.product(factors, f + layout.A, (ex, ey, et))
            px, py, pt = imex.product(factors, f + layout.B, (bx, by, bt))
            sx, sy, st = imex.product(factors, f + layout.C, (aex, aey, aet))
            node = splat(parameters, float(i))
            vx = where_less(node, held, vx + dt * (ax - (ox + px + sx)), zero)
            vy = where_less(node, held, vy + dt * (ay - (oy + py + sy)), zero)
            vt = where_less(node, held, vt + dt * (at - (ot + pt + st)), zero)
            store3(state, q + layout.VX, vx, vy, vt)
            store(state, q + layout.X, x + dt * vx)
            store(state, q + layout.Y, y + dt * vy)
            store(state, q + layout.T, t + dt * vt)
            store(state, q + layout.V, where_less(node, held, force, zero))
            bx, by, bt = ex, ey, et
            ex, ey, et = aex, aey, aet
            x, y, t, vx, vy, vt = nx, ny, nt, nvx, nvy, nvt
        store(parameters, layout.PEAK, peak)
        if imex.after_step(parameters, state, memory, per_pitch, inputs, step, sampling, roots, failed):
            return step + 1
    return len(tops)


class Explicit(NodeLanes):
    """Central differences; groups of four probes."""

    name = "explicit"
    order = 1
    usual_step = 5e-6
    simulates_expansion = False
    simulates_weight = False
    simulates_terms = False
    kernel = staticmethod(explicit_advance)

    def stable_step(self, scene: Scene, nodes_per_pitch: int) -> float:
        """Largest stable step [s], from the fastest mode."""
        return explicit_step(scene, nodes_per_pitch)

    contact_step = stable_step

    def factors(self, chain: Chain, time_step: float) -> FloatArray:
        """(2, 27) blocks of M^-1 K."""
        return explicit_factors(chain)
