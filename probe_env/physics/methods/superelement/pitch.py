"""A piece of cable between two floats, condensed by Craig and Bampton: its ends' motion and a few modes between them.

Between floats the cable is linear, so of a fine mesh only what the floats notice is kept. The motion u of all nodes is
u = T z, z = (x, y, theta of the tip-side end, of the root-side end, m modal coordinates):

* six static shapes, psi = -K_ii^-1 K_ib: what the inner nodes do when an end is moved slowly;
* the m lowest modes of the inner nodes with both ends held, K_ii phi = omega^2 M_ii phi, phi^T M_ii phi = 1.

With all modes T is a change of coordinates and nothing is lost; frequencies fall towards those of the mesh as modes are
added (Rayleigh and Ritz). K falls apart into a block of the ends and a diagonal of omega^2; M joins them.

The helix's curvature is in the piece: one that is stretched bulges, and the first mode, which changes the length of the
cable, has hoop stiffness (319 instead of 234 Hz on table 2).

A piece is its own mirror image: x -> -x, y -> y, theta -> -theta with the ends exchanged. Every mode is even or odd
under it, and in the unknowns

    even (x_L - x_R, y_L + y_R, theta_L - theta_R) and the even modes, odd (x_L + x_R, y_L - y_R, theta_L + theta_R) and
    the odd ones, L the tip-side and R the root-side end,

each symmetric matrix falls apart into an even and an odd block: ``halves`` gives what acts on L, R has its mirror
image.
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
"""Of x, y and theta."""


class Pitch(NamedTuple):
    """Condensed matrices of a piece, unknowns z in the order above; SI units.

    Attributes:
        mass: (6 + m, 6 + m); rows of rotation hold -J / r of (15) too.
        stiffness: (6 + m, 6 + m).
        couple: (6 + m, 6 + m) of (9), -V times it is the force of the axial force V, here the piece's mean.
        tension: (6 + m,) the mean axial force is its product with z.
        root_tension: (6 + m,) the same for the element at the root-side end.
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
        """M."""
        return len(self.tension) - ENDS

    @property
    def even(self) -> npt.NDArray[np.bool_]:
        """(m,) whether a mode is even."""
        modes = self.shape[:, ENDS:].reshape(-1, 3, self.modes)
        mirrored = modes[::-1] * MIRROR[None, :, None]
        return np.asarray((modes * mirrored).sum(axis=(0, 1)) > 0.0)

    def only(self, modes: npt.ArrayLike) -> Pitch:
        """The same with some of its modes, in the order of their indices."""
        kept = np.r_[:ENDS, ENDS + np.asarray(modes, dtype=int)]
        square = np.ix_(kept, kept)
        return Pitch(
            self.mass[square], self.stiffness[square], self.couple[square], self.tension[kept], self.root_tension[kept],
            self.shape[:, kept], self.frequencies,
        )  # fmt: skip


def halves(rows: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Even and odd part of rows (..., 6) that act on the ends: rows times (d_L, d_R) is even a_even + odd a_odd.

    D_L = (a_even + a_odd) / 2 and d_R = J (a_odd - a_even) / 2 with J = diag(1, -1, 1).
    """
    left, right = rows[..., :3], rows[..., 3:6] * -MIRROR
    return 0.5 * (left - right), 0.5 * (left + right)


def refined(chain: Chain, nodes_per_pitch: int, elements: int, places: int) -> Chain:
    """A piece of ``places`` elements of a chain, as one with ``elements`` in a float pitch; nothing but the cable.

    Lengths, masses and compliances after (1), (2) and (5), rotary inertia with the cable's radius as it is there.
    """
    ratio = nodes_per_pitch / elements
    h, sin_phi = chain.element_length * ratio, chain.sin_phi * ratio
    section = chain.inertia / chain.mass - chain.element_length**2 / 12.0
    mass = chain.mass * ratio
    nodes = np.zeros(places * elements // nodes_per_pitch + 1)
    return chain._replace(
        element_length=h, sin_phi=sin_phi, cos_phi=float(np.sqrt(1.0 - sin_phi**2)),
        axial_compliance=chain.axial_compliance * ratio, shear_compliance=chain.shear_compliance * ratio**3,
        bending_compliance=chain.bending_compliance * ratio, coupling_compliance=chain.coupling_compliance * ratio**2,
        mass=mass, inertia=mass * (h**2 / 12.0 + section), couple_length=chain.couple_length * ratio, frame_inertia=0.0,
        contact_stiffness=nodes, outer_gap=nodes, lever=nodes, drag=nodes, support_stiffness=np.zeros((len(nodes), 3)),
        load=np.zeros((len(nodes), 3)),
    )  # fmt: skip


def condensed(chain: Chain, modes: int) -> Pitch:
    """A whole chain of n elements, two at least, as one piece with so many modes.

    Its end nodes count with half their mass, so that pieces in a row are a chain.

    Raises:
        ValueError: more modes than the mesh has, or fewer than none.
    """
    mass, stiffness, couple, axial = _mesh(chain)
    size = len(mass)
    inner, ends = slice(3, size - 3), [0, 1, 2, size - 3, size - 2, size - 1]
    if not 0 <= modes <= size - ENDS:
        raise ValueError(
            f"modes = {modes!r} is outside the accepted range 0 to {size - ENDS} of {size // 3 - 1} elements"
        )
    # the modes are those of the symmetric part: -J / r is a part in 1e5 of J over an element
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
    cosine, sine = chain.cos_phi / chain.axial_compliance, chain.sin_phi / chain.axial_compliance
    for i in range(n):
        of_element = slice(3 * i, 3 * i + 6)
        stiffness[of_element, of_element] += element
        axial[i, of_element] = cosine, sine, 0.0, -cosine, sine, 0.0
        for k in (3 * i, 3 * i + 3):
            mass[k : k + 3, k : k + 3] += 0.5 * node
            couple[k + 2, k + 2] += 0.5 * chain.couple_length
    return mass, stiffness, couple, axial
