"""Closed forms: steady sliding, buckling between floats, a straight part, the linear chain, an impact.

Scenes, chains and measured tensions enter, what must come of them leaves. Policies read friction from them, and runs
are tested against them; ``bare_chains`` are the chains without a tube of such tests, and run. Imports the model,
scenes and settings, and the methods for bare chains.
"""

from probe_env.physics.closed_forms.sliding import (
    GRAVITY,
    MEASURED,
    SHAPE,
    buckling_load,
    drag_per_metre,
    friction_from_tension,
    sliding_tension,
    steady_root_tension,
    steady_tensions,
    tension_for_straight,
)
from probe_env.physics.closed_forms.vibration import impact, linear_chain

__all__ = [
    "GRAVITY",
    "MEASURED",
    "SHAPE",
    "buckling_load",
    "drag_per_metre",
    "friction_from_tension",
    "impact",
    "linear_chain",
    "sliding_tension",
    "steady_root_tension",
    "steady_tensions",
    "tension_for_straight",
]
