"""Craig-Bampton condensation of a piece of cable between two floats to the motion of its ends and a few modes.

Between floats the cable is linear, so a fine mesh can be condensed. The motion u of all nodes is u = T z,
z = (x, y, theta of the tip-side end, of the root-side end, m modal coordinates):

* six static shapes, psi = -K_ii^-1 K_ib: displacements of the inner nodes for a unit displacement of an end;
* the m lowest modes of the inner nodes with both ends held, K_ii phi = omega^2 M_ii phi, phi^T M_ii phi = 1.

With all modes T is an exact change of coordinates; frequencies decrease towards those of the mesh as modes are added
(Rayleigh and Ritz). K consists of a block of the ends and a diagonal of omega^2; M couples them.

The piece includes the curvature of the helix: tension changes its curvature, and the first mode, which changes the
length of the cable, has hoop stiffness (319 instead of 234 Hz for table 2).

A piece is symmetric under x -> -x, y -> y, theta -> -theta with exchanged ends. Every mode is even or odd, and in the
unknowns

    even (x_L - x_R, y_L + y_R, theta_L - theta_R) and the even modes, odd (x_L + x_R, y_L - y_R, theta_L + theta_R) and
    the odd modes, L the tip-side and R the root-side end,

each symmetric matrix has an even and an odd block. ``halves`` returns the part that acts on L; R has its mirror image.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.linalg import eigh

from probe_env.arrays import FloatArray
from probe_env.physics.model.chain import Chain, element_blocks, element_stiffness

ENDS = 6
"""Unknowns of the two ends; the modal coordinates follow."""
MIRROR = np.array([-1.0, 1.0, -1.0])
"""Signs of x, y and theta under reflection."""


class Pitch(NamedTuple):
    """Condensed matrices of a piece, unknowns z in the order above; SI units.

    Attributes:
        mass: (6 + m, 6 + m); rows of rotation include -J / r of (15).
        stiffness: (6 + m, 6 + m).
        couple: (6 + m, 6 + m) of (9); -V times it is the force of the couple for a mean axial force V.
        tension: (6 + m,); its product with z is the mean axial force.
        root_tension: (6 + m,); its product with z is the axial force of the element at the root-side end.
        shape: (3 (n + 1), 6 + m) T.
        frequencies: (3 (n - 1),) of all modes of the mesh with the ends held [Hz], ascending.
    """

    mass: FloatArray
    stiffness: FloatArray
    couple: FloatArray
    tension: FloatArray
    root_tension: FloatArray
    shape: FloatArray
    frequencies: FloatArray

    @property
    def modes(self) -> int:
        """Number m of modes."""
        return len(self.tension) - ENDS

    @property
    def even(self) -> npt.NDArray[np.bool_]:
        """(m,) whether a mode is even."""
        modes = self.shape[:, ENDS:].reshape(-1, 3, self.modes)
        mirrored = modes[::-1] * MIRROR[None, :, None]
        return np.asarray((modes * mirrored).sum(axis=(0, 1)) > 0.0)

    def select_modes(self, modes: npt.ArrayLike) -> Pitch:
        """The piece with some of its modes, in the order of ``modes``."""
        columns = np.r_[:ENDS, ENDS + np.asarray(modes, dtype=int)]
        square = np.ix_(columns, columns)
        return Pitch(
            self.mass[square], self.stiffness[square], self.couple[square], self.tension[columns],
            self.root_tension[columns], self.shape[:, columns], self.frequencies,
        )  # fmt: skip


def halves(rows: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Even and odd part of rows (..., 6) that act on the ends: rows times (d_L, d_R) is even a_even + odd a_odd.

    D_L = (a_even + a_odd) / 2 and d_R = J (a_odd - a_even) / 2 with J = diag(1, -1, 1).
    """
    left, right = rows[..., :3], rows[..., 3:6] * -MIRROR
    return 0.5 * (left - right), 0.5 * (left + right)


def refined(chain: Chain, nodes_per_pitch: int, elements: int, count: int) -> Chain:
    """The cable of ``count`` elements of a chain, refined to ``elements`` per float pitch; no contact, drag or loads.

    Lengths, masses and compliances follow (1), (2) and (5); rotary inertia includes the radius of the cable.
    """
    ratio = nodes_per_pitch / elements
    h, sin_phi = chain.element_length * ratio, chain.sin_phi * ratio
    section = chain.inertia / chain.mass - chain.element_length**2 / 12.0
    mass = chain.mass * ratio
    nodes = np.zeros(count * elements // nodes_per_pitch + 1)
    return chain._replace(
        element_length=h, sin_phi=sin_phi, cos_phi=float(np.sqrt(1.0 - sin_phi**2)),
        axial_compliance=chain.axial_compliance * ratio, shear_compliance=chain.shear_compliance * ratio**3,
        bending_compliance=chain.bending_compliance * ratio, coupling_compliance=chain.coupling_compliance * ratio**2,
        mass=mass, inertia=mass * (h**2 / 12.0 + section), couple_length=chain.couple_length * ratio, frame_inertia=0.0,
        contact_stiffness=nodes, outer_gap=nodes, lever=nodes, drag=nodes, support_stiffness=np.zeros((len(nodes), 3)),
        load=np.zeros((len(nodes), 3)),
    )  # fmt: skip


def condensed(chain: Chain, modes: int) -> Pitch:
    """A chain of n >= 2 elements condensed to one piece with a number of modes.

    The end nodes have half their mass, so that pieces in a row form a chain.
    """
    mass, stiffness, couple, axial = _mesh(chain)
    size = len(mass)
    inner, ends = slice(3, size - 3), [0, 1, 2, size - 3, size - 2, size - 1]
    if not 0 <= modes <= size - ENDS:
        raise ValueError(
            f"modes = {modes!r} is outside the accepted range 0 to {size - ENDS} of {size // 3 - 1} elements"
        )
    # modes of the symmetric part: -J / r is negligible, 1e-5 of J over an element
    squares, all_modes = eigh(stiffness[inner, inner], np.diag(np.diag(mass)[inner]))
    shape = np.zeros((size, ENDS + modes))
    shape[ends, range(ENDS)] = 1.0
    shape[inner, :ENDS] = -np.linalg.solve(stiffness[inner, inner], stiffness[inner][:, ends])
    shape[inner, ENDS:] = all_modes[:, :modes]
    reduced = shape.T @ stiffness @ shape
    reduced[:ENDS, ENDS:] = reduced[ENDS:, :ENDS] = 0.0  # but for rounding
    reduced[ENDS:, ENDS:] = np.diag(squares[:modes])
    return Pitch(
        shape.T @ mass @ shape,
        reduced,
        shape.T @ couple @ shape,
        axial.mean(axis=0) @ shape,
        axial[-1] @ shape,
        shape,
        np.sqrt(squares) / (2.0 * np.pi),
    )


def _mesh(chain: Chain) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Mass, stiffness and couple (3 (n + 1), 3 (n + 1)) of free nodes, and the elements' axial force (n, 3 (n + 1))."""
    n = chain.node_count - 1
    both = np.hstack(element_blocks(chain))
    element = both.T @ element_stiffness(chain) @ both
    node = np.diag([chain.mass, chain.mass, chain.inertia])
    node[2, 0] = -chain.frame_inertia
    mass, stiffness, couple = np.zeros((3, 3 * n + 3, 3 * n + 3))
    axial = np.zeros((n, 3 * n + 3))
    angle = np.array([chain.couple_turn, 0.0, 1.0])  # of the couple: theta, or theta + x / r
    cosine, sine = chain.cos_phi / chain.axial_compliance, chain.sin_phi / chain.axial_compliance
    for i in range(n):
        of_element = slice(3 * i, 3 * i + 6)
        stiffness[of_element, of_element] += element
        axial[i, of_element] = cosine, sine, 0.0, -cosine, sine, 0.0
        for k in (3 * i, 3 * i + 3):
            mass[k : k + 3, k : k + 3] += 0.5 * node
            couple[k : k + 3, k : k + 3] += 0.5 * chain.couple_length * np.outer(angle, angle)
    return mass, stiffness, couple, axial
