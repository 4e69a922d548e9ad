"""Stability limits of the time step.

Newmark and Wilson are unconditionally stable for a linear chain. Contact limits them, because they use the contact
flag of the last step: a float touches the wall one step late, is pushed back from a depth that it reached without
force, and leaves with more energy. The gain increases with omega dt, omega = sqrt(k / m) of a float on its contact
spring, and must be dissipated by the cable. Measured for table 2 with k = 1e4 to 1e7 N/m, l = 10 and 50 m, friction 0
to 1, damping times 0 to 1e-2 s and 1 to 16 nodes per pitch (480 + 160 runs): with damping and mesh of the study, runs
were stable at omega dt <= 1.8; Newmark diverged at 3.0 and both at 6.0.

imex treats contact explicitly: its theoretical limit is omega dt < 2, used with a margin as 1.8. The limit of explicit
is given by the fastest mode of the chain with its damping, see ``explicit_time_step``.

imex32 also has a least step: rounding with eps = 6e-8 acts as a spring to the frame of eps m / dt^2 per mass, which
increases for shorter steps (see ``factors.single_factors``). Its statistics at 10 to 50 m were compared with those of
imex down to 5e-5 s.
"""

import math

import numpy as np

from probe_env.physics.methods.factors import node_matrices
from probe_env.physics.model.chain import Chain, build_chain
from probe_env.scene import Scene

MEASURED = ("newmark", "wilson", "imex", "imex32")
"""Methods that ``known_step`` was measured for; others declare their own ``stable_step``."""
FULL, REDUCED = 1.8, 0.6  # omega dt
EXPLICIT_MARGIN = 0.95
TABLE_2_DAMPING = 5e-5  # [s]
SHORTENING_STEP = 2.5e-4
"""Largest step with ``terms.shortening``, whose force lags a step [s]; at 3e-4 s runs with 1e4 N/m diverge."""


def contact_step(scene: Scene, nodes_per_pitch: int) -> float:
    """Largest step [s] that explicit contact allows for any damping and mesh."""
    return FULL / _contact_frequency(scene, nodes_per_pitch)


def known_step(scene: Scene, nodes_per_pitch: int) -> float:
    """Largest step [s] known to be stable with the contact flag of the last step; 0 if none is known."""
    omega, longest = _contact_frequency(scene, nodes_per_pitch), SHORTENING_STEP if scene.terms.shortening else math.inf
    delta, friction = scene.probe.damping_time, scene.contact.friction
    fine = nodes_per_pitch >= 4
    if fine and (delta >= TABLE_2_DAMPING or (delta >= 5e-6 and friction <= 0.5)):
        return min(FULL / omega, longest)
    if delta >= TABLE_2_DAMPING or (fine and delta >= 1e-6 and friction <= 0.5):
        return min(REDUCED / omega, longest)
    return 0.0


def damped_step(step: float, scene: Scene) -> float:
    """A stable step [s] with the damping of the contact, whose force lags a step: omega dt < 2 (sqrt(1 + z^2) - z).

    z = c omega / 2 k is the damping ratio, with the omega that limits the step without damping.
    """
    ratio = 0.5 * FULL * scene.contact.damping / (scene.contact.stiffness * step) if step else 0.0
    return step * (math.hypot(1.0, ratio) - ratio)


def explicit_step(scene: Scene, nodes_per_pitch: int) -> float:
    """Largest stable step [s] of ``explicit``."""
    return EXPLICIT_MARGIN * explicit_time_step(build_chain(scene, nodes_per_pitch))


def _contact_frequency(scene: Scene, nodes_per_pitch: int) -> float:
    """Angular frequency of a float on its contact spring [rad/s]."""
    mass = scene.probe.line_density * scene.probe.float_pitch / nodes_per_pitch
    return math.sqrt(scene.contact.stiffness / mass)


def explicit_time_step(chain: Chain) -> float:
    """Stable step [s] of central differences whose damping force lags half a step.

    dt = (2 / omega) (sqrt(1 + xi^2) - xi), xi = delta omega / 2 (Belytschko and Hughes 1983), for the fastest
    mode: the largest eigenvalue of M^-1 K of an infinite chain over all wave numbers, with the contact spring.
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
