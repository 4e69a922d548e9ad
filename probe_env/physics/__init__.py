"""Simulation of the cable in the tube: scenes in; displacements, forces and statistics out. Knows no rewards."""

from typing import TYPE_CHECKING

from probe_env.lazy import lazy

if TYPE_CHECKING:
    from probe_env.physics.closed_forms import friction_from_tension, steady_root_tension
    from probe_env.physics.closed_forms.route import min_air, required_root_tension, route_forces
    from probe_env.physics.methods import METHODS, method_named
    from probe_env.physics.methods.method import Method
    from probe_env.physics.simulation.run import Shapes
    from probe_env.physics.simulation.signals import dominant_frequencies, point_statistics, window_statistics

__all__ = [
    "METHODS", "Method", "Shapes", "dominant_frequencies", "friction_from_tension", "method_named", "min_air",
    "point_statistics", "required_root_tension", "route_forces", "steady_root_tension", "window_statistics",
]  # fmt: skip
__getattr__, __dir__ = lazy(__name__)
