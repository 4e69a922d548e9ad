"""The time step that is known to hold, for the study's scheme with its lagged contact flag.

Newmark and Wilson are unconditionally stable on a linear chain. What limits them is the flag of the step
before: a float meets the wall one step late, so it is pushed out from a depth that it reached unopposed
and leaves with more energy than it brought. That gain grows with omega dt, omega = sqrt(k / m) of a float
on its contact spring, and the cable's damping has to eat it. Measured on table 2 with k = 1e4 to 1e7 N/m,
l = 10 and 50 m, friction 0 to 1, damping times 0 to 1e-2 s and 1 to 16 nodes a pitch (480 + 160 runs):
omega dt <= 1.8 held wherever damping and mesh are as in the study, 3.0 broke Newmark and 6.0 broke both.
"""

from __future__ import annotations

import math

from probe_env.scene import Scene

FULL, REDUCED = 1.8, 0.6  # omega dt
TABLE_2_DAMPING = 5e-5  # [s]


def stable_time_step(scene: Scene, nodes_per_pitch: int, method: str = "newmark") -> float:
    """Largest time step [s] known to hold for a method; 0 where none is known."""
    mass = scene.probe.line_density * scene.probe.float_pitch / nodes_per_pitch
    omega = math.sqrt(scene.contact.stiffness / mass)
    delta, friction = scene.probe.damping_time, scene.contact.friction
    fine = nodes_per_pitch >= 4
    if fine and (delta >= TABLE_2_DAMPING or (delta >= 5e-6 and friction <= 0.5)):
        return FULL / omega
    if delta >= TABLE_2_DAMPING or (fine and delta >= 1e-6 and friction <= 0.5):
        return REDUCED / omega
    return 0.0
