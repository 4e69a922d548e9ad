"""What an endless row of pieces does under a contact's spring, and how that sets modes, stiffness and step.

The step takes contact explicitly, a kick from the depth at its start. In steps the cable answers otherwise than it
does: implicit bending ties more of it to a float, modes that are left out tie less, and a kick once a step is a spring
that is too hard. The dynamic stiffness of float and spring together, per displacement e^{i omega t} of one float,

    k + 1 / C(i omega),        C = mean over phases of [(i omega)^2 M + (1 + i omega delta) K]^-1 at y of a float,

becomes, with z = e^{i omega dt} and a force at each step's start,

    k' + 1 / C'(z),            C' = z mean of [(z - 1)^2 / dt^2 A + K (theta (z - 1) + 1) + tau (z - 1) / dt K]^-1.

``fitted_stiffness`` gives the k' with which both agree where float and cable answer an impact at 45 degrees: where the
real part has fallen to the imaginary one (679 Hz on table 2). The difference there is complex: a spring, and a dashpot
(on v_m of the step before) that is not applied. It stands for what the rule takes off the cable's own damping, which
acts off the wall too; applied at the wall alone it takes a quarter off the vibration at 30 m.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from scipy.optimize import brentq

from probe_env.physics.methods.factors import linear_weights
from probe_env.physics.methods.superelement.pitch import ENDS, Pitch
from probe_env.physics.model.chain import Chain

PHASES = 32
"""Of the endless row's motion from piece to piece."""
LEAST = 0.8
"""Of the contact's stiffness: a step that would need less is too long for it, and none needs more."""


def contact_frequency(chain: Chain, stiffness: float) -> float:
    """Of a long bar on one contact spring [Hz]: |2 sqrt(2) EI beta^3| = k, beta^4 = rho omega^2 / EI.

    Up to about there the impact of a float on the wall has its force; half a pitch of cable swings with it.
    """
    rigidity = chain.element_length / chain.bending_compliance
    density = chain.mass / chain.element_length
    omega = math.sqrt(rigidity / density) * (stiffness / (2.0 * math.sqrt(2.0) * rigidity)) ** (2.0 / 3.0)
    return float(omega / (2.0 * math.pi))


class Endless:
    """Matrices of an endless row of a piece, one a phase from piece to piece: (PHASES, 3 + m, 3 + m)."""

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

    def least_mass(self, damping_time: float, time_step: float) -> float:
        """What a radial kick of a float meets in a step [kg], that of M + theta dt tau K; the least over all phases."""
        theta, tau = linear_weights(damping_time, time_step)
        return float(1.0 / _radial(self.mass + theta * time_step * tau * self.stiffness).real.max())

    def compliance(self, omega: float, damping_time: float) -> complex:
        """Of one float, radially: displacement by force at a frequency [m/N]."""
        whole = -(omega**2) * self.mass + (1.0 + 1j * omega * damping_time) * self.stiffness
        return complex(_radial(whole).mean())

    def stepped_compliance(self, omega: float, damping_time: float, time_step: float) -> complex:
        """The same of the chain in steps, kicked at each one's start."""
        theta, tau = linear_weights(damping_time, time_step)
        z = np.exp(1j * omega * time_step)
        rate = (z - 1.0) / time_step
        A = self.mass + theta * time_step * tau * self.stiffness
        whole = rate**2 * A + (theta * (z - 1.0) + 1.0 + tau * rate) * self.stiffness
        return complex(z * _radial(whole).mean())


def _radial(matrices: npt.NDArray[np.complex128]) -> npt.NDArray[np.complex128]:
    """(PHASES,) what y of the float is under a unit force on it."""
    force = np.zeros((matrices.shape[-1], 1))
    force[1] = 1.0
    return np.asarray(np.linalg.solve(matrices, force)[:, 1, 0])


def fitted_stiffness(whole: Pitch, kept: Pitch, stiffness: float, damping_time: float, time_step: float) -> float:
    """The contact's stiffness in steps [N/m], see above; ``whole`` with modes far beyond."""
    if stiffness == 0.0:
        return 0.0
    exact, own = Endless(whole), Endless(kept)

    def lead(frequency: float) -> float:
        total = stiffness + 1.0 / exact.compliance(2.0 * math.pi * frequency, damping_time)
        return total.real - total.imag

    high = 100.0
    while lead(high) > 0.0:
        high *= 1.5
    corner = 2.0 * math.pi * float(brentq(lead, 1.0, high, xtol=0.1))
    missing = stiffness + 1.0 / exact.compliance(corner, damping_time)
    missing -= 1.0 / own.stepped_compliance(corner, damping_time, time_step)
    behind = (1.0 - np.exp(-1j * corner * time_step)) / time_step
    dashpot = missing.imag / behind.imag
    return float(min(max(missing.real - dashpot * behind.real, LEAST * stiffness), stiffness))


def most_tension(piece: Pitch, time_step: float, theta: float, tau: float) -> float:
    """Nine tenths of where dt^2 V lambda = 4, lambda the largest eigenvalue of A^-1 times the couple's matrix [N]."""
    row = Endless(piece)
    both = np.linalg.solve(row.mass + theta * time_step * tau * row.stiffness, row.couple)
    largest = float(np.abs(np.linalg.eigvals(both)).max())
    return 3.6 / (time_step**2 * largest) if largest > 0.0 else math.inf
