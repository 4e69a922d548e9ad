"""Response of a periodic row of pieces to a contact spring, from which modes, stiffness and time step follow.

Contact is explicit: a kick from the depth at the start of a step. The time-discrete response of the cable differs from
the exact one: implicit bending couples more cable to a float, omitted modes couple less, and one kick per step acts as
a stiffer spring. The dynamic stiffness of float and spring, per displacement e^{i omega t} of one float,

    k + 1 / C(i omega),        C = mean over phases of [(i omega)^2 M + (1 + i omega delta) K]^-1 at y of a float,

becomes, with z = e^{i omega dt} and a force at the start of each step,

    k' + 1 / C'(z),            C' = z mean of [(z - 1)^2 / dt^2 A + K (theta (z - 1) + 1) + tau (z - 1) / dt K]^-1.

``fitted_stiffness`` is the k' at which both agree at the frequency where the real part equals the imaginary part (679
Hz for table 2). Their difference there is complex: a spring, and a dashpot (on v_m of the last step) that is not
applied. The dashpot represents the damping that the rule subtracts from the cable, which also acts off the wall;
applied at the wall only, it reduces the vibration at 30 m by a quarter.
"""

import math

import numpy as np
import numpy.typing as npt
from scipy.optimize import brentq

from probe_env.physics.methods.factors import linear_weights
from probe_env.physics.methods.superelement.pitch import ENDS, Pitch
from probe_env.physics.model.chain import Chain

PHASES = 32
"""Number of phase differences between neighbouring pieces."""
MIN_FRACTION = 0.8
"""Least fitted stiffness divided by the contact stiffness."""


def contact_frequency(chain: Chain, stiffness: float) -> float:
    """Frequency of a long bar on one contact spring [Hz]: |2 sqrt(2) EI beta^3| = k, beta^4 = rho omega^2 / EI.

    The impact force of a float on the wall has frequencies up to about this one; half a pitch of cable moves with it.
    """
    rigidity = chain.element_length / chain.bending_compliance
    density = chain.mass / chain.element_length
    omega = math.sqrt(rigidity / density) * (stiffness / (2.0 * math.sqrt(2.0) * rigidity)) ** (2.0 / 3.0)
    return float(omega / (2.0 * math.pi))


class PeriodicRow:
    """Matrices of an infinite periodic row of pieces, one per phase difference: (PHASES, 3 + m, 3 + m)."""

    def __init__(self, piece: Pitch) -> None:
        turned = np.zeros((PHASES, ENDS + piece.modes, 3 + piece.modes), dtype=complex)
        phase = 2.0 * np.pi * (np.arange(PHASES) + 0.5) / PHASES
        turned[:, :3, :3] = np.eye(3)
        turned[:, 3:ENDS, :3] = np.exp(1j * phase)[:, None, None] * np.eye(3)
        turned[:, ENDS:, 3:] = np.eye(piece.modes)
        back = turned.conj().transpose(0, 2, 1)
        self.mass, self.stiffness, self.couple = (
            back @ matrix @ turned for matrix in (piece.mass, piece.stiffness, piece.couple)
        )

    def min_mass(self, damping_time: float, time_step: float, force: tuple[float, ...] = (0.0, 1.0, 0.0)) -> float:
        """Least effective mass [kg] for a kick of a float, that of M + theta dt tau K, over all phases.

        ``force`` is x, y and moment per kick; default: radial.
        """
        theta, tau = linear_weights(damping_time, time_step)
        return float(1.0 / _response(self.mass + theta * time_step * tau * self.stiffness, force).real.max())

    def compliance(self, omega: float, damping_time: float) -> complex:
        """Radial compliance of one float at an angular frequency [m/N]."""
        whole = -(omega**2) * self.mass + (1.0 + 1j * omega * damping_time) * self.stiffness
        return complex(_response(whole).mean())

    def stepped_compliance(self, omega: float, damping_time: float, time_step: float) -> complex:
        """Compliance of the time-discrete chain with a kick at the start of each step."""
        theta, tau = linear_weights(damping_time, time_step)
        z = np.exp(1j * omega * time_step)
        rate = (z - 1.0) / time_step
        A = self.mass + theta * time_step * tau * self.stiffness
        whole = rate**2 * A + (theta * (z - 1.0) + 1.0 + tau * rate) * self.stiffness
        return complex(z * _response(whole).mean())


def _response(
    matrices: npt.NDArray[np.complex128], force: tuple[float, ...] = (0.0, 1.0, 0.0)
) -> npt.NDArray[np.complex128]:
    """(PHASES,) displacement of the float along a force (x, y, moment) under it."""
    forces = np.zeros((matrices.shape[-1], 1))
    forces[:3, 0] = force
    return np.asarray(np.linalg.solve(matrices, forces)[:, :3, 0] @ np.array(force))


def fitted_stiffness(whole: Pitch, reduced: Pitch, stiffness: float, damping_time: float, time_step: float) -> float:
    """Contact stiffness of the time-discrete chain [N/m], see above; ``whole`` has modes of much higher frequency."""
    if stiffness == 0.0:
        return 0.0
    exact, row = PeriodicRow(whole), PeriodicRow(reduced)

    def lead(frequency: float) -> float:
        total = stiffness + 1.0 / exact.compliance(2.0 * math.pi * frequency, damping_time)
        return total.real - total.imag

    high = 100.0
    while lead(high) > 0.0:
        high *= 1.5
    corner = 2.0 * math.pi * float(brentq(lead, 1.0, high, xtol=0.1))
    missing = stiffness + 1.0 / exact.compliance(corner, damping_time)
    missing -= 1.0 / row.stepped_compliance(corner, damping_time, time_step)
    behind = (1.0 - np.exp(-1j * corner * time_step)) / time_step
    dashpot = missing.imag / behind.imag
    return float(min(max(missing.real - dashpot * behind.real, MIN_FRACTION * stiffness), stiffness))


def max_tension(piece: Pitch, time_step: float, theta: float, tau: float) -> float:
    """0.9 times the tension [N] at which dt^2 V lambda = 4, lambda the largest eigenvalue of A^-1 times ``couple``."""
    row = PeriodicRow(piece)
    both = np.linalg.solve(row.mass + theta * time_step * tau * row.stiffness, row.couple)
    largest = float(np.abs(np.linalg.eigvals(both)).max())
    return 3.6 / (time_step**2 * largest) if largest > 0.0 else math.inf
