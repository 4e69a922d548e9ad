"""Soft-string model of the whole route: forces at the feed device and at the entrance of the helix, and least air.

The cable slides at constant speed and has no inertia or bending stiffness. Over a length ds of the route, towards the
feed device, the axial force T grows by (q - w sin a - mu N) ds on insertion, and by (q - w sin a + mu N) ds on
withdrawal: drag q per metre (in expanding air after ``air_pressure``), weight w per metre, slope a, friction mu. The
wall's force is N = sqrt((T (1 -+ d_f / 2R) / R)^2 + (w cos a)^2), because the normal of a curve with constant slope is
horizontal. Friction acts at the surface of the float (diameter d_f), on the inner wall under tension (-), on the outer
wall under compression (+). The feed device can hold the cable back but cannot push it: T must not be negative there.
"""

import math
from typing import Annotated, Final, NamedTuple, Self

import numpy as np
import numpy.typing as npt
from pydantic import Field, model_validator

from probe_env.arrays import FloatArray
from probe_env.physics.closed_forms import GRAVITY, LOCKED, drag_per_metre, rising_root
from probe_env.physics.model.chain import air_pressure, air_speed
from probe_env.scene import Scene
from probe_env.settings import Model, quantity

CELL: Final = 0.5
"""Longest step of the integration [m]; tips are at the ends of the steps."""
DECAY: Final = 0.25
"""Greatest mu ds / R of a step: the error of the Runge-Kutta step is then below 1e-5 of the force."""
MAX_STEPS: Final = 4000
"""Most steps of a route, about 2 km; the time grows with the square."""
MAX_AIR: Final = 0.2
"""Most air supply of a scene [m3/s]."""


class Segment(Model):
    """A part of the route with constant slope and curvature; ``helix = true``: the helix of the tube."""

    helix: bool = False
    """The helix, with length and diameter of the tube."""
    length: Annotated[float, quantity(1e-3, 1e3, "m")] | None = None
    """Length along the axis [m]."""
    slope: Annotated[float, quantity(-90.0, 90.0, "degrees")] = 0.0
    """Angle of the direction of insertion to the horizontal [degrees]; 90: rising, -90: falling."""
    bend_radius: Annotated[float, quantity(0.15, 1e4, "m")] | None = None
    """Radius of curvature [m]; default: straight."""

    @model_validator(mode="after")
    def _has_its_length(self) -> Self:
        if self.helix and (self.length is not None or self.bend_radius is not None):
            text = "helix = true has the length and the diameter of [tube]: leave out length and bend_radius"
            raise ValueError(text)
        if not self.helix and self.length is None:
            raise ValueError("length is missing: 0.001 to 1000 m, or helix = true")
        return self


def one_helix(route: tuple[Segment, ...]) -> tuple[Segment, ...]:
    """The route, if it is empty or has one helix, as a validator."""
    count = sum(segment.helix for segment in route)
    if route and count != 1:
        raise ValueError(f"{count} segments have helix = true; the accepted number is 1")
    return route


Route = Annotated[tuple[Segment, ...], Field(max_length=100)]
"""Segments from the feed device to the end of the tube."""


class RouteForces(NamedTuple):
    """Axial forces of the cable for k positions of the tip; negative: compression."""

    tip: FloatArray  # (k,) positions of the tip, from the feed device [m]
    feed: FloatArray  # (k,) force that the feed device holds [N]
    root: FloatArray  # (k,) force at the entrance of the helix [N]; NaN where the tip is before it
    in_helix: npt.NDArray[np.bool_]  # (k,) whether the tip is in the helix
    segment: npt.NDArray[np.int_]  # (k,) index of the segment of the tip


def route_forces(route: Route, scene: Scene, air: npt.ArrayLike | None = None) -> RouteForces:
    """Forces at the feed device and at the entrance of the helix for all positions of the tip.

    Args:
        route: segments; one of them is the helix.
        scene: probe, bore, helix, friction, whether air expands, from the feed device to the end of the route; the sign
            of the feed speed is the direction: negative is withdrawal.
        air: air supply rate [m3/s], one number or one for each tip (k,); default: that of the scene.
    """
    probe, mu = scene.probe, scene.contact.friction
    weight, friction = probe.line_density * GRAVITY, math.copysign(mu, -scene.feed_speed)
    lengths: list[float] = []
    slopes, radii, owner = [], [], []
    for k, segment in enumerate(route):
        length = scene.tube.helix_length if segment.helix else segment.length or 0.0
        radius = 0.5 * scene.tube.helix_diameter if segment.helix else segment.bend_radius or math.inf
        count = math.ceil(length / min(CELL, DECAY * radius / max(mu, 1e-3)) - 1e-9)
        if len(lengths) + count > MAX_STEPS:
            text = f"route.{k}: the route needs over {MAX_STEPS} steps"
            raise ValueError(f"{text}, of {CELL:g} m and less in bends with much friction: shorten it")
        lengths += [length / count] * count
        slopes += [math.radians(segment.slope)] * count
        radii += [radius] * count
        owner += [k] * count
    helix = next(k for k, segment in enumerate(route) if segment.helix)
    segment_of, tip = np.array(owner), np.cumsum(lengths)
    air = np.broadcast_to(scene.air_supply_rate if air is None else np.asarray(air, dtype=float), tip.shape)
    exit_speed = air * air_speed(scene, 1.0)
    wind, carrier = exit_speed - scene.feed_speed, drag_per_metre(scene)
    guide = drag_per_metre(scene.model_copy(update={"probe": {"carrier_float_diameter": probe.guide_float_diameter}}))
    # of a helix that ends with the route, if the air leaves there
    inserted = tip + np.where(exit_speed >= 0.0, scene.tube.helix_length - tip[-1], 0.0)
    force, root = np.zeros(len(tip)), np.full(len(tip), np.nan)
    for k in reversed(range(len(tip))):
        step, radius = lengths[k], radii[k]
        across = weight * math.cos(slopes[k])
        behind = tip[k:] - (tip[k] - 0.5 * step)
        drag = np.where(behind < probe.guide_length, guide, carrier) * wind[k:] * np.abs(wind[k:])
        if scene.air.compressible:
            pressure = air_pressure(scene, behind, inserted[k:], scene.feed_speed, exit_speed[k:])
            drag *= scene.air.exit_pressure / pressure
        along = drag - weight * math.sin(slopes[k])
        if math.isinf(radius):
            force[k:] += (along + friction * across) * step
        else:
            after = _through_bend(force[k:], along, across, friction, radius, scene, step)
            force[k:] = np.clip(after, -LOCKED, LOCKED)
        if segment_of[k] == helix and (k == 0 or segment_of[k - 1] != helix):
            root[k:] = force[k:]
    return RouteForces(tip, force, root, segment_of == helix, segment_of)


def _through_bend(
    force: FloatArray, along: FloatArray, across: float, friction: float, radius: float, scene: Scene, step: float
) -> FloatArray:
    """Force (k,) after a step through a bend, by Runge-Kutta's method of fourth order."""
    lever = 0.5 * scene.probe.carrier_float_diameter / radius

    def growth(tension: FloatArray) -> FloatArray:
        return np.asarray(along + friction * np.hypot((tension - lever * np.abs(tension)) / radius, across))

    first = growth(force)
    second = growth(force + 0.5 * step * first)
    third = growth(force + 0.5 * step * second)
    return np.asarray(force + step / 6.0 * (first + 2.0 * second + 2.0 * third + growth(force + step * third)))


def min_air(route: Route, scene: Scene) -> FloatArray:
    """Least air supply rate (k,) [m3/s] with which the feed device need not push, for each tip of ``route_forces``.

    Infinite where ``MAX_AIR`` is not enough. The force increases with the air, in a uniform stream nearly in proportion
    to its square.
    """

    def feed(square: FloatArray) -> FloatArray:
        # clipped: far from the root the steps are bisections
        return np.clip(route_forces(route, scene, np.sqrt(square)).feed, -1.0, 1.0)

    none = np.zeros_like(route_forces(route, scene, 0.0).tip)
    square = rising_root(feed, none, none + MAX_AIR**2)
    return np.where(square < MAX_AIR**2, np.sqrt(square), np.inf)


def required_root_tension(route: Route, scene: Scene) -> float:
    """Least root tension in the helix [N] with which the feed device need not push, at most over all inserted lengths.

    It is the root tension at ``min_air``. More air increases the root tension and reduces what the parts before the
    helix need, so a root tension above it is enough, and one below it is not. Without ``air.darcy_factor`` it depends
    neither on the drag coefficient nor on the feed speed.
    """
    air = min_air(route, scene)
    possible = np.isfinite(air)
    forces = route_forces(route, scene, np.where(possible, air, MAX_AIR))
    return float(forces.root[forces.in_helix & possible].max(initial=0.0))
