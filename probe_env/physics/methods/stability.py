"""The time step that is known to hold.

Newmark and Wilson are unconditionally stable on a linear chain. What limits them is the contact flag of the
step before: a float meets the wall one step late, so it is pushed out from a depth that it reached unopposed
and leaves with more energy than it brought. That gain grows with omega dt, omega = sqrt(k / m) of a float on
its contact spring, and the cable's damping has to eat it. Measured on table 2 with k = 1e4 to 1e7 N/m,
l = 10 and 50 m, friction 0 to 1, damping times 0 to 1e-2 s and 1 to 16 nodes a pitch (480 + 160 runs):
omega dt <= 1.8 held wherever damping and mesh are as in the study, 3.0 broke Newmark and 6.0 broke both.

imex takes the contact explicitly: its limit is omega dt < 2 by theory, 1.8 with a margin. explicit is bound by
the fastest mode of the chain with its damping, see ``explicit_time_step``.

imex32 has a least step as well: rounding, eps = 6e-8, returns a displacement d as d (1 + eps) step for step, a spring
to the frame of eps m / dt^2 a mass, which grows as the step shrinks (see ``factors.single_factors``). The
statistics at 10 to 50 m were compared with those of imex down to 5e-5 s.
"""

from __future__ import annotations

import math

import numpy as np

from probe_env.physics.methods.factors import node_matrices
from probe_env.physics.model.chain import Chain, build_chain
from probe_env.scene import Scene

FULL, REDUCED = 1.8, 0.6  # omega dt
EXPLICIT_MARGIN = 0.95
TABLE_2_DAMPING = 5e-5  # [s]


def contact_step(scene: Scene, nodes_per_pitch: int) -> float:
    """Largest step [s] that explicit contact allows, whatever damping and mesh."""
    return FULL / _contact_frequency(scene, nodes_per_pitch)


def known_step(scene: Scene, nodes_per_pitch: int) -> float:
    """Largest step [s] known to hold where the contact flag is that of the step before; 0 where none is known."""
    omega = _contact_frequency(scene, nodes_per_pitch)
    delta, friction = scene.probe.damping_time, scene.contact.friction
    fine = nodes_per_pitch >= 4
    if fine and (delta >= TABLE_2_DAMPING or (delta >= 5e-6 and friction <= 0.5)):
        return FULL / omega
    if delta >= TABLE_2_DAMPING or (fine and delta >= 1e-6 and friction <= 0.5):
        return REDUCED / omega
    return 0.0


def explicit_step(scene: Scene, nodes_per_pitch: int) -> float:
    """Largest step [s] known to hold for ``explicit``."""
    return EXPLICIT_MARGIN * explicit_time_step(build_chain(scene, nodes_per_pitch))


def _contact_frequency(scene: Scene, nodes_per_pitch: int) -> float:
    """Of a float on its contact spring [rad/s]."""
    mass = scene.probe.line_density * scene.probe.float_pitch / nodes_per_pitch
    return math.sqrt(scene.contact.stiffness / mass)


def explicit_time_step(chain: Chain) -> float:
    """Stable step [s] of central differences whose damping force lags half a step.

    dt = (2 / omega) (sqrt(1 + xi^2) - xi), xi = delta omega / 2 (Belytschko and Hughes 1983), for the fastest
    mode: the largest eigenvalue of the endless chain's M^-1 K over all wave numbers, the contact spring added.
    """
    _, inner, ahead, behind = node_matrices(chain)
    contact = np.zeros((3, 3))
    contact[1, 1] = chain.contact_stiffness.max() / chain.mass
    fastest = 0.0
    for phase in np.linspace(0.0, math.pi, 181):
        block = inner + contact + ahead * np.exp(1j * phase) + behind * np.exp(-1j * phase)
        fastest = max(fastest, float(np.abs(np.linalg.eigvals(block)).max()))
    omega = math.sqrt(fastest)
    xi = chain.damping_time * omega / 2.0
    return 2.0 / omega * (math.sqrt(1.0 + xi * xi) - xi)
