"""Lumped-mass chain of a scene: masses, element compliance, frame and floats as arrays for the kernels.

Nodes are numbered from the tip (0) to the held root (n), so that a longer probe appends nodes; node j of the study is
node n - j here. Element i joins nodes i and i + 1, the latter on the root side.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from probe_env.arrays import FloatArray
from probe_env.scene import Scene

GRAVITY = 9.80665
"""[m/s2]"""
RISE = 0.5
"""Length from the entrance over which a probe approaches the outer wall [m]."""


class Chain(NamedTuple):
    """A chain of equal elements with per-node contact, drag and support; SI units, arrays of n + 1 nodes.

    The last node is held. ``curvature`` (1/r) determines the inertia terms of (14), ``cos_phi`` and ``sin_phi`` the
    geometry; tests of closed forms set them independently.
    """

    element_length: float
    cos_phi: float
    sin_phi: float
    axial_compliance: float  # a_x [m/N], below (6)
    shear_compliance: float  # a_y [m/N]
    bending_compliance: float  # beta [rad/(N m)]
    coupling_compliance: float  # gamma [rad/N]
    damping_time: float
    mass: float
    inertia: float
    curvature: float
    couple_length: float  # l in V l theta of (9); 0 switches the couple off
    frame_inertia: float  # J / r of (15)
    couple_turn: float  # curvature if the couple counts from the tangent of the tube, else 0
    span: int  # elements between floats, whose bending shortens them; 0 neglects it
    friction: float
    friction_slope: float  # [s/m]
    contact_damping: float  # [N s/m]
    stiction: bool  # whether friction holds at rest
    float_weight: float  # of a pitch of cable, across the plane [N]; 0 neglects it
    cable_radius: float  # d_c / 2, for contact of the cable
    cable_stiffness: float  # of the wall for the cable; 0 if only floats touch
    max_pressure: float  # largest compression in the couple [N]; infinite if only floats touch
    max_tension: float  # largest tension in the couple [N]; infinite if only floats touch
    contact_stiffness: FloatArray  # 0 where there is no float
    outer_gap: FloatArray  # d_in - d_f; infinite with the inner wall alone
    lever: FloatArray  # d_f / 2
    drag: FloatArray  # c_D rho_f (A_f - A_c) / 2, 0 where there is no float
    drag_rate: FloatArray  # added to ``drag`` after each step, in place; empty: constant drag
    support_stiffness: FloatArray  # (n + 1, 3) springs to the moving frame
    load: FloatArray  # (n + 1, 3) constant external load

    @property
    def node_count(self) -> int:
        """Number of nodes, including the held root."""
        return len(self.drag)


def build_chain(scene: Scene, nodes_per_pitch: int = 4, length: float | None = None) -> Chain:
    """Lumped-mass chain of a scene after (1), (2) and (5)-(11); ``length`` [m] replaces the inserted length."""
    tube, probe, contact, air = scene.tube, scene.probe, scene.contact, scene.air
    h = probe.float_pitch / nodes_per_pitch
    nodes = round((scene.inserted_length if length is None else length) / h) + 1
    sensor = sensor_node(scene, nodes_per_pitch)
    index = np.arange(nodes)
    is_float = index % nodes_per_pitch == 0
    diameter = np.where(index <= sensor, probe.guide_float_diameter, probe.carrier_float_diameter)

    mass = probe.line_density * h  # (1)
    inertia = mass * (h**2 / 12.0 + probe.cable_diameter**2 / 16.0)  # (1)
    sin_phi = h / tube.helix_diameter  # (2)
    curvature = 2.0 / tube.helix_diameter
    cable_area = math.pi * probe.cable_diameter**2 / 4.0
    frontal_area = math.pi * diameter**2 / 4.0 - cable_area
    pressure = max_pressure(probe.flexural_rigidity, h, None if scene.terms.shortening else probe.float_pitch)
    gap = tube.clear_diameter - diameter if contact.walls == "both" else np.full(nodes, np.inf)
    return Chain(
        element_length=h,
        cos_phi=math.sqrt(1.0 - sin_phi**2),
        sin_phi=sin_phi,
        axial_compliance=h / probe.tensile_rigidity,
        shear_compliance=h**3 / (3.0 * probe.flexural_rigidity),
        bending_compliance=h / probe.flexural_rigidity,
        coupling_compliance=h**2 / (2.0 * probe.flexural_rigidity),
        damping_time=probe.damping_time,
        mass=mass,
        inertia=inertia,
        curvature=curvature,
        couple_length=h,
        frame_inertia=inertia * curvature,
        couple_turn=curvature if scene.couple == "tangent" else 0.0,
        span=nodes_per_pitch if scene.terms.shortening else 0,
        friction=contact.friction,
        friction_slope=contact.friction_slope,
        contact_damping=contact.damping,
        stiction=scene.terms.stiction,
        float_weight=probe.line_density * probe.float_pitch * GRAVITY if contact.weight else 0.0,
        cable_radius=probe.cable_diameter / 2.0,
        cable_stiffness=contact.stiffness if contact.cable else 0.0,
        max_pressure=pressure if contact.cable else math.inf,
        max_tension=max_tension(probe.flexural_rigidity, h)
        if contact.cable and not scene.terms.shortening
        else math.inf,
        contact_stiffness=np.where(is_float, contact.stiffness, 0.0),
        outer_gap=gap,
        lever=diameter / 2.0,
        drag=np.where(is_float, 0.5 * air.drag_coefficient * air.density * frontal_area, 0.0),
        drag_rate=np.zeros(0),
        support_stiffness=np.zeros((nodes, 3)),
        load=np.zeros((nodes, 3)),
    )


def air_speed(scene: Scene, air_supply_rate: float) -> float:
    """Air speed between cable and tube, Q / (a - A_c) of (10) [m/s]; of compressible air at the exit."""
    area = math.pi * (scene.tube.inner_diameter**2 - scene.probe.cable_diameter**2) / 4.0
    return air_supply_rate / area


def air_pressure(
    scene: Scene, distance: FloatArray, length: FloatArray | float, feed_speed: float, exit_speed: FloatArray | float
) -> FloatArray:
    """Absolute pressure of expanding air (n,) [Pa], in steady isothermal flow of constant mass.

    Density rho and air speed w follow the pressure p: rho = rho_e p / p_e and w = w_e p_e / p, with the values at the
    exit: ``air.density``, ``exit_speed`` and ``air.exit_pressure``. The air loses what it gives to the floats, q per
    metre, over the free cross-section a - A_c, and what the wall takes, whose shear f rho w^2 / 8 acts on pi d_in:

        -dp/dx = q / (a - A_c) + f rho w^2 / 2 * d_in / (d_in^2 - d_c^2),    q = q_e p_e / p.

    Both terms are proportional to 1 / p, so p^2 is linear along equal floats:

        p^2 = p_e^2 + 2 p_e * integral from the exit to x of the right-hand side with q_e, rho_e and w_e.

    The exit is the end of the helix; if the air flows towards the feed device, it is the entrance. Ahead of the tip
    only the wall takes pressure. Neglected are the acceleration of the air, rho w^2 / p of the pressure drop (2 % at 63
    m3/h), the change of u / w along the tube (2 u / w of the drag, 1 %), and the time in which pressure builds up.

    Args:
        scene: tube, probe and air; its length, feed speed and air supply are not used.
        distance: (n,) behind the tip, from 0 [m].
        length: of the cable in the helix [m], one or (n,).
        feed_speed: [m/s].
        exit_speed: air speed between cable and tube at the exit, see ``air_speed`` [m/s], one or (n,).
    """
    tube, probe, air = scene.tube, scene.probe, scene.air
    bore, cable = tube.inner_diameter**2, probe.cable_diameter**2
    wall, empty = wall_losses(scene, exit_speed)
    relative = exit_speed - feed_speed
    forward = np.greater_equal(exit_speed, 0.0)
    pull = 0.5 * air.drag_coefficient * air.density * relative * np.abs(relative) * np.where(forward, 1.0, -1.0)
    guide, carrier = (
        pull * (diameter**2 - cable) / (bore - cable) / probe.float_pitch + wall
        for diameter in (probe.guide_float_diameter, probe.carrier_float_diameter)
    )
    border = probe.guide_length + probe.float_pitch  # the float at the sensor is one of the guide

    def drop(x: FloatArray | float) -> FloatArray:
        return np.asarray(guide * np.minimum(x, border) + carrier * np.maximum(np.subtract(x, border), 0.0))

    here = drop(distance)
    dropped = np.where(forward, here + empty * (tube.helix_length - length), drop(length) - here)
    return np.asarray(np.sqrt(air.exit_pressure**2 + 2.0 * air.exit_pressure * np.maximum(dropped, 0.0)))


def wall_losses(scene: Scene, exit_speed: FloatArray | float) -> tuple[Any, Any]:
    """Loss of pressure per metre [Pa/m] at the wall, at the pressure of the exit, next to the cable and without it."""
    bore, cable = scene.tube.inner_diameter**2, scene.probe.cable_diameter**2
    friction = 0.5 * scene.air.darcy_factor * scene.air.density * exit_speed**2
    wall = friction * scene.tube.inner_diameter / (bore - cable)
    return wall, friction * ((bore - cable) / bore) ** 2 / scene.tube.inner_diameter


def drag_factors(scene: Scene, edges: FloatArray, length: float, feed_speed: float, exit_speed: float) -> FloatArray:
    """Mean of p_e / p (n,) between ascending distances from the tip (n + 1,), the drag there over that at the exit.

    As p^2 is linear, the mean is 2 p_e / (p_1 + p_2), and without friction of the wall the drag of all floats is
    exactly the pressure drop times the free cross-section. All 1 if the air is not compressible. Arguments as in
    ``air_pressure``.
    """
    if not scene.air.compressible:
        return np.ones(len(edges) - 1)
    pressure = air_pressure(scene, edges, length, feed_speed, exit_speed)
    return np.asarray(2.0 * scene.air.exit_pressure / (pressure[:-1] + pressure[1:]))


def sensor_node(scene: Scene, nodes_per_pitch: int) -> int:
    """Node of the sensor, counted from the tip."""
    return round(scene.probe.guide_length / scene.probe.float_pitch * nodes_per_pitch)


def element_blocks(chain: Chain) -> tuple[FloatArray, FloatArray]:
    """(3, 3) matrices G, H: the deformation of element i in its frame is G d_i + H d_{i+1}, after (5).

    The element's force on node i is -G^T fbar and on node i + 1 is -H^T fbar, with fbar from
    ``element_stiffness``.
    """
    c, s = chain.cos_phi, chain.sin_phi
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])  # Phi of (26)
    lever = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, chain.element_length, 1.0]])  # L of (6)
    return turn.T, -lever.T @ turn


def element_stiffness(chain: Chain) -> FloatArray:
    """(3, 3) inverse of the element's compliance F of (5)."""
    ax, ay = chain.axial_compliance, chain.shear_compliance
    b, g = chain.bending_compliance, chain.coupling_compliance
    determinant = ay * b - g * g
    return np.array(
        [
            [1.0 / ax, 0.0, 0.0],
            [0.0, b / determinant, -g / determinant],
            [0.0, -g / determinant, ay / determinant],
        ]
    )


def entrance_force(chain: Chain, ahead: FloatArray, root: FloatArray) -> FloatArray:
    """Axial force (...) [N] with which the bent cable at the entrance resists the feed: M^2 / (2 EI).

    Along a cable between walls without friction T - M^2 / (2 EI) is constant. M is zero behind the entrance, and ahead
    of it EI / r and the moment m of the held root: the feed device feels the root tension less (EI / r + m)^2 / (2 EI).

    Args:
        chain: the probe.
        ahead: (..., 3) displacement of the last free node.
        root: (..., 3) displacement of the held root.
    """
    head, tail = element_blocks(chain)
    force = (ahead @ head.T + root @ tail.T) @ element_stiffness(chain)
    rigidity = chain.element_length / chain.bending_compliance
    moment = rigidity * chain.curvature - (chain.element_length * force[..., 1] + force[..., 2])
    return np.asarray(0.5 * moment**2 / rigidity)


def max_pressure(flexural_rigidity: float, element_length: float, float_pitch: float | None) -> float:
    """Largest compression [N] in the couple V l theta if the cable touches the walls.

    Beyond EI / h^2 the mesh does not resolve bending. Beyond pi^2 EI / p^2 the cable has buckled between floats and
    lies against the walls; there is no such limit (None) if bending shortens the cable, which unloads it.
    """
    limit = 1.0 / element_length**2
    return flexural_rigidity * (limit if float_pitch is None else min(limit, (math.pi / float_pitch) ** 2))


def max_tension(flexural_rigidity: float, element_length: float) -> float:
    """Largest tension [N] in the couple V l theta: beyond 3 EI / h^2 the mesh does not resolve bending."""
    return 3.0 * flexural_rigidity / element_length**2


def outer_start(chain: Chain, root: int) -> FloatArray:
    """Displacements (n + 1, 3) of an unstretched probe on the outer wall, which it approaches from the root.

    The outer wall is longer: the probe is displaced backwards by the turned angle times the clearance.
    """
    d = np.zeros((chain.node_count, 3))
    floats = np.flatnonzero(chain.contact_stiffness[:root] > 0.0)
    index = np.arange(root + 1)
    fraction = np.clip((root - index) * chain.element_length / RISE, 0.0, 1.0)
    y = np.interp(index, floats, chain.outer_gap[floats]) * fraction**3 * (10.0 - 15.0 * fraction + 6.0 * fraction**2)
    lag = chain.sin_phi / chain.cos_phi * (y[:-1] + y[1:])
    d[:root, 0] = -np.cumsum(lag[::-1])[::-1]
    d[: root + 1, 1] = y
    d[:root, 2] = -chain.curvature * d[:root, 0] - np.gradient(y, chain.element_length)[:-1]
    return d


def linear_part(chain: Chain) -> tuple[float, ...]:
    """Parameters of the linear cable, the key of cached factors; see ``cable_of``."""
    return tuple(float(value) for value in chain[: Chain._fields.index("friction")])


def cable_of(linear: tuple[float, ...]) -> Chain:
    """A chain with a ``linear_part`` only."""
    none = np.zeros((2, 3))
    arrays = (*[none[:, 0]] * 5, none, none)  # from contact_stiffness on
    contact = [0.0] * (len(Chain._fields) - len(linear) - len(arrays))
    return Chain(*linear, *contact, *arrays)  # type: ignore[arg-type]
