"""What acts on a node at the start of a step, in lanes: inertia, the couple of (9), drag, contact and friction."""

from __future__ import annotations

from numba import njit

from probe_env.physics.methods.lane_group import (
    CABLE,
    CABLE_RADIUS,
    CARRIER_DRAG,
    CARRIER_GAP,
    CARRIER_LEVER,
    COUPLE,
    FRICTION,
    GUIDE_DRAG,
    GUIDE_GAP,
    GUIDE_LEVER,
    MASS_RATIO,
    PRESSURE,
    SENSOR,
    STIFFNESS,
    TENSION,
    TURN,
    TURN_FORCE,
)
from probe_env.physics.methods.lanes import load, splat, where_less


@njit(nogil=True, error_model="numpy", inline="always")
def magnitude(value):
    """Absolute value."""
    zero = splat(value, 0.0)
    return where_less(value, zero, zero - value, value)


@njit(nogil=True, error_model="numpy", inline="always")
def inertia_forces(kappa, couple, forward, vy, t, axial_force, dt):
    """Coriolis and centrifugal acceleration of (13) and the couple of (9) per inertia.

    The couple is a spring of stiffness V l, taken linearly implicit: explicit, a tension above 4 J / (l dt^2),
    640 N at 2e-4 s, makes neighbouring nodes turn against each other without bound; a hard start gets there.
    """
    zero = splat(t, 0.0)
    spring = couple * axial_force
    stiff = 1.0 + 0.25 * dt * dt * where_less(zero, spring, spring, zero)
    return -2.0 * kappa * forward * vy, kappa * forward * forward, zero - spring * t / stiff


@njit(nogil=True, error_model="numpy", inline="always")
def loaded_pressed(parameters):
    """What ``pressed_forces`` and ``cable_forces`` need: the couple's figures, and the cable's."""
    limits = load(parameters, PRESSURE), load(parameters, TENSION)
    couple = load(parameters, COUPLE), load(parameters, TURN), load(parameters, TURN_FORCE), limits
    radius, stiffness = load(parameters, CABLE_RADIUS), load(parameters, CABLE)
    return couple, (radius, stiffness, load(parameters, FRICTION) * stiffness, radius * load(parameters, MASS_RATIO))


@njit(nogil=True, error_model="numpy", inline="always")
def pressed_forces(kappa, coupling, forward, vy, x, t, axial_force, dt):
    """``inertia_forces`` of a cable that may be pressed.

    The couple may count from the tube's tangent where the node is, V l (theta + x / r), and does work on x then. Where
    the cable touches the walls, pressure and tension act in it up to ``chain.most_pressure`` and ``most_tension``: a
    cable that bounces is pulled as hard as it is pressed.
    """
    couple, tangent, work, (pressure, tension) = coupling
    zero = splat(t, 0.0)
    most = zero - pressure
    pulled = where_less(tension, axial_force, tension, axial_force)
    spring = couple * where_less(pulled, most, most, pulled)
    stiff = 1.0 + 0.25 * dt * dt * where_less(zero, spring, spring, zero)
    moment = zero - spring * (t + tangent * x) / stiff
    return work * moment - 2.0 * kappa * forward * vy, kappa * forward * forward, moment


@njit(nogil=True, error_model="numpy", inline="always")
def loaded_wall(parameters):
    """Contact stiffness, coefficient of friction and mass per inertia of the lanes."""
    return load(parameters, STIFFNESS), load(parameters, FRICTION), load(parameters, MASS_RATIO)


@njit(nogil=True, error_model="numpy", inline="always")
def loaded_floats(parameters):
    """The sensor's node, and lever, gap and drag of the guide's and of the carrier's floats."""
    return (
        load(parameters, SENSOR),
        load(parameters, GUIDE_LEVER),
        load(parameters, CARRIER_LEVER),
        load(parameters, GUIDE_GAP),
        load(parameters, CARRIER_GAP),
        load(parameters, GUIDE_DRAG),
        load(parameters, CARRIER_DRAG),
    )


@njit(nogil=True, error_model="numpy", inline="always")
def float_at(i, floats):
    """Lever, gap and drag of the float at node ``i``: the guide's up to the sensor, the carrier's beyond."""
    sensor, guide_lever, carrier_lever, guide_gap, carrier_gap, guide_drag, carrier_drag = floats
    place = splat(sensor, float(i) - 0.5)
    return (
        where_less(place, sensor, guide_lever, carrier_lever),
        where_less(place, sensor, guide_gap, carrier_gap),
        where_less(place, sensor, guide_drag, carrier_drag),
    )


@njit(nogil=True, error_model="numpy", inline="always")
def float_forces(own, wall, forward, air, y, slide, turn):
    """Drag, contact and friction of a float, (10)-(12) with both walls: x and y per mass, moment per inertia."""
    lever, gap, drag = own
    stiffness, coefficient, ratio = wall
    zero = splat(y, 0.0)
    relative = air - forward
    inner = where_less(y, zero, zero - y, zero)  # depth in the inner and in the outer wall
    beyond = y - gap
    outer = where_less(zero, beyond, beyond, zero)
    lever = where_less(y, zero, lever, zero - lever)  # of the contact point
    most = coefficient * stiffness * (inner + outer)
    friction = where_less(slide + turn * lever, zero, zero - most, most)  # against the slide; zero counts as forward
    return drag * relative * magnitude(relative) - friction, stiffness * (inner - outer), friction * lever * ratio


@njit(nogil=True, error_model="numpy", inline="always")
def cable_walls(own, cable):
    """Heights y below and above which the cable between floats is in a wall: thinner than a float on either side."""
    lever, gap, _ = own
    clearance = lever - cable[0]
    return splat(clearance, 0.0) - clearance, gap + clearance


@njit(nogil=True, error_model="numpy", inline="always")
def nearest_walls(floats, cable):
    """``cable_walls`` that hold all along a probe: those of the guide or of the carrier, whichever are nearer."""
    _, guide_lever, carrier_lever, guide_gap, carrier_gap, _, _ = floats
    low, high = cable_walls((guide_lever, guide_gap, guide_gap), cable)
    carrier_low, carrier_high = cable_walls((carrier_lever, carrier_gap, carrier_gap), cable)
    return where_less(low, carrier_low, carrier_low, low), where_less(high, carrier_high, high, carrier_high)


@njit(nogil=True, error_model="numpy", inline="always")
def widened(least, most, y):
    """A range of heights, with one more in it."""
    return where_less(y, least, y, least), where_less(most, y, y, most)


@njit(nogil=True, error_model="numpy", inline="always")
def cable_forces(walls, cable, y, slide, turn):
    """Contact and friction of the cable between floats; see ``cable_walls``."""
    low, high = walls
    radius, stiffness, grip, twist = cable
    zero = splat(y, 0.0)
    inner = where_less(y, low, low - y, zero)
    outer = where_less(high, y, y - high, zero)
    side = where_less(y, low, splat(y, 1.0), splat(y, -1.0))
    most = grip * (inner + outer)
    friction = where_less(slide + side * radius * turn, zero, zero - most, most)
    return zero - friction, stiffness * (inner - outer), side * friction * twist
