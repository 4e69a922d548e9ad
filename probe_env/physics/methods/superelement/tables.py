"""Tables of a probe for the superelement kernel: constants of the pieces, factors, maps for a growing length.

A piece is a pitch, or at the root 1 to n nodes of it; the cable can be held at every node. All pieces are condensed
from one fine mesh and have equal numbers of even and odd modes.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.optimize import brentq

from probe_env.arrays import FloatArray
from probe_env.physics.methods.factors import linear_weights
from probe_env.physics.methods.superelement.contact import (
    PeriodicRow,
    contact_frequency,
    fitted_stiffness,
    max_tension,
)
from probe_env.physics.methods.superelement.pitch import ENDS, Pitch, condensed, halves, refined
from probe_env.physics.model.chain import Chain, cable_of, linear_part

HOLD = 0.25
"""Of m / dt^2, the stiffness with which friction holds. By the spectral radius of a step, over all phases, floats that
are all stuck are unstable from 0.69 (EI 0.25 N m2, 2e-4 s) to 3 (table 2, 5e-5 s) on."""
ELEMENTS = 16
"""Elements of the fine mesh per pitch."""
REACH = 1.8
"""Highest frequency of the modes divided by the contact frequency."""
MIN_MODES, MAX_MODES = (2, 1), 5
"""Least numbers of even and odd modes, and largest number of either kind."""

# constants of a piece: blocks of its ends' unknowns, axial force, mass and EA / 2 over its length, then its modes
K_EVEN, K_ODD, G_EVEN, G_ODD, AXIAL_EVEN, AXIAL_ODD, HALF_MASS, STRETCH = 0, 9, 15, 24, 33, 36, 39, 40
EVEN = 41
# of a mode: theta dt times its stiffness, dt times it, mass to the L end, couple with the L end and with the modes of
# its parity, axial force
ELASTIC, FORCE, CARRIED, COUPLE, AXIAL, TO_MODES = 0, 1, 2, 5, 8, 9
MODE = TO_MODES + MAX_MODES
ODD = EVEN + MAX_MODES * MODE
CONSTANTS = ODD + MAX_MODES * MODE
FACTORS = 27
SETTLED = 8.0 * np.finfo(float).eps
MAX_FACTORS = 1000


@dataclass(frozen=True, eq=False)
class Tables:
    """Tables of a probe with n nodes per pitch, e even and o odd modes, m = e + o.

    Attributes:
        even, odd: e and o.
        pieces: (n + 1, CONSTANTS) of the piece at the root with 1, ..., n nodes, and of a pitch between floats.
        factors: (k, 27) E, F, U of the first k floats from the tip; further floats use the last row.
        root_factors: (n, k, 27) factors if the next piece is at the root and has 1, ..., n nodes.
        growth: (n, 6 + 2 m, 6 + 2 m), see ``_growth``.
        shape: (n, n, 3, 6 + m) displacement at the nodes 0, ..., n - 1 from the L end of each piece.
        max_tension: largest tension at which the explicit couple is stable [N].
        stiffness: fitted contact stiffness for this step, see contact.py [N/m].
    """

    even: int
    odd: int
    pieces: FloatArray
    factors: FloatArray
    root_factors: FloatArray
    growth: FloatArray
    shape: FloatArray
    max_tension: float
    stiffness: float


def tables(chain: Chain, nodes_per_pitch: int, time_step: float) -> Tables:
    """Tables for a chain, with three or more modes according to its contact stiffness.

    Raises:
        ValueError: the nodes are not nodes of the fine mesh, or the contact needs too many modes.
    """
    if ELEMENTS % nodes_per_pitch:
        raise ValueError(
            f"nodes_per_pitch = {nodes_per_pitch!r} does not divide {ELEMENTS}, the elements in a pitch of superelement"
        )
    return _tables(linear_part(chain), float(chain.contact_stiffness.max()), nodes_per_pitch, time_step, ELEMENTS)


def max_step(chain: Chain, nodes_per_pitch: int, limit: float) -> float:
    """Step [s] at which omega dt of a float with its cable on the contact spring is ``limit``."""
    return _max_step(linear_part(chain), float(chain.contact_stiffness.max()), nodes_per_pitch, limit)


@lru_cache(maxsize=256)
def _max_step(linear: tuple[float, ...], stiffness: float, per_pitch: int, limit: float) -> float:
    chain = cable_of(linear)
    whole = _piece(linear, per_pitch, ELEMENTS, per_pitch)
    row = PeriodicRow(_chosen(whole, *_modes(whole, chain, stiffness, per_pitch, ELEMENTS), 0.0))

    def beyond(step: float) -> float:
        return step * math.sqrt(stiffness * row.min_mass(chain.damping_time, step) ** -1) - limit

    return float(brentq(beyond, 1e-8, 1.0, rtol=1e-6))


def _modes(whole: Pitch, chain: Chain, stiffness: float, per_pitch: int, elements: int) -> tuple[int, int]:
    """Numbers of even and odd modes for a contact stiffness, at least ``MIN_MODES``."""
    reach = REACH * contact_frequency(chain, stiffness)
    below, kinds = whole.frequencies[: whole.modes] <= reach, (whole.even, ~whole.even)
    even, odd = (
        min(max(n, int((below & kind).sum())), int(kind.sum())) for n, kind in zip(MIN_MODES, kinds, strict=True)
    )
    if max(even, odd) > MAX_MODES:
        raise ValueError(
            f"contact.stiffness asks for modes up to {reach:.0f} Hz, {even} even and {odd} odd ones: superelement has"
            f" room for {MAX_MODES} and {MAX_MODES}; imex with 8 or more nodes a pitch simulates it"
        )
    inner = 3 * (elements // per_pitch // 2)  # unknowns of half a piece; y of its middle is even, x and theta are odd
    if even > inner - 2 or odd > inner - 1:
        raise ValueError(
            f"nodes_per_pitch = {per_pitch!r}: a piece of {elements // per_pitch} elements at the root has fewer than"
            f" the {even} even and {odd} odd modes that contact.stiffness = {stiffness:g} N/m asks for;"
            " give fewer nodes a pitch, or imex"
        )
    return even, odd


@lru_cache(maxsize=1024)  # more than a batch has different tubes
def _tables(linear: tuple[float, ...], stiffness: float, per_pitch: int, time_step: float, elements: int) -> Tables:
    chain = cable_of(linear)
    theta, tau = linear_weights(chain.damping_time, time_step)
    whole = _piece(linear, per_pitch, elements, per_pitch)
    even, odd = _modes(whole, chain, stiffness, per_pitch, elements)
    pieces = [
        _chosen(_piece(linear, per_pitch, elements, count), even, odd, theta * time_step * tau)
        for count in range(1, per_pitch + 1)
    ]
    fine = refined(chain, per_pitch, elements, per_pitch)
    factors, root_factors = _factors(
        pieces, 0.5 * np.diag([fine.mass, fine.mass, fine.inertia]), theta * time_step * tau
    )
    at_root = [_constants(piece, even, piece.root_tension, time_step, theta, tau) for piece in pieces]
    means = [_mirrored(_constants(piece, even, piece.tension, time_step, theta, tau)) for piece in pieces]
    rows = np.array([*(means if chain.span else at_root), means[-1]])  # bending shortens a piece by its mean force
    counts = np.array([*range(1, per_pitch + 1), per_pitch])
    rows[:, STRETCH] = 0.5 / (chain.axial_compliance * counts)
    return Tables(
        even, odd, rows,
        factors, root_factors,
        np.array([_growth(chain, pieces, k, per_pitch, elements) for k in range(per_pitch)]),
        np.array([_shape(piece, per_pitch, elements) for piece in pieces]),
        max_tension(pieces[-1], time_step, theta, tau),
        fitted_stiffness(
            _chosen(whole, MAX_MODES, MAX_MODES, 0.0), pieces[-1], stiffness, chain.damping_time, time_step
        ),
    )  # fmt: skip


def held_stiffness(chain: Chain, nodes_per_pitch: int, time_step: float) -> float:
    """Stiffness [N/m] with which friction holds a float: that of its contact, or ``HOLD`` of m / dt^2 if this is less.

    m belongs to the point of contact and the cable that moves with it along the tube and turns.
    """
    stiffness, lever = float(chain.contact_stiffness.max()), float(chain.lever[:-1].max())
    mass = _contact_mass(linear_part(chain), stiffness, nodes_per_pitch, time_step, lever)
    return min(stiffness, HOLD * mass / time_step**2)


@lru_cache(maxsize=1024)
def _contact_mass(linear: tuple[float, ...], stiffness: float, per_pitch: int, time_step: float, lever: float) -> float:
    """Least effective mass of a point of contact along the tube [kg]."""
    chain = cable_of(linear)
    whole = _piece(linear, per_pitch, ELEMENTS, per_pitch)
    row = PeriodicRow(_chosen(whole, *_modes(whole, chain, stiffness, per_pitch, ELEMENTS), 0.0))
    return row.min_mass(chain.damping_time, time_step, (1.0, 0.0, lever))


@lru_cache(maxsize=64)
def _piece(linear: tuple[float, ...], per_pitch: int, elements: int, count: int) -> Pitch:
    """A piece of ``count`` nodes with all its modes; friction, contact and drag are not included."""
    mesh = refined(cable_of(linear), per_pitch, elements, count)
    return condensed(mesh, 3 * (mesh.node_count - 2))


def _chosen(piece: Pitch, even: int, odd: int, weight: float) -> Pitch:
    """The piece with its lowest modes, even ones first, scaled so that M + weight K of each mode is 1."""
    chosen = piece.select_modes([*np.flatnonzero(piece.even)[:even], *np.flatnonzero(~piece.even)[:odd]])
    scale = np.ones(ENDS + chosen.modes)
    scale[ENDS:] = 1.0 / np.sqrt(1.0 + weight * np.diag(chosen.stiffness)[ENDS:])
    both = np.outer(scale, scale)
    return chosen._replace(
        mass=chosen.mass * both, stiffness=chosen.stiffness * both, couple=chosen.couple * both,
        tension=chosen.tension * scale, root_tension=chosen.root_tension * scale, shape=chosen.shape * scale,
    )  # fmt: skip


def _constants(piece: Pitch, even: int, tension: FloatArray, time_step: float, theta: float, tau: float) -> FloatArray:
    """(CONSTANTS,) constants of a piece whose axial force is ``tension`` times its unknowns."""
    values = np.zeros(CONSTANTS)
    k_even, k_odd = halves(piece.stiffness[:3, :ENDS])
    size, vectors = np.linalg.eigh(k_odd)  # of rank one: two of three odd motions are rigid
    values[K_EVEN : K_EVEN + 9] = k_even.ravel()
    values[K_ODD : K_ODD + 3], values[K_ODD + 3 : K_ODD + 6] = vectors[:, -1], size[-1] * vectors[:, -1]
    for at, block in zip((G_EVEN, G_ODD), halves(piece.couple[:3, :ENDS]), strict=True):
        values[at : at + 9] = block.ravel()
    for at, row in zip((AXIAL_EVEN, AXIAL_ODD), halves(tension[:ENDS]), strict=True):
        values[at : at + 3] = row
    values[HALF_MASS] = 0.5 * piece.mass[1, 1]
    squares = np.diag(piece.stiffness)
    for first, modes in ((EVEN, range(even)), (ODD, range(even, piece.modes))):
        for k, mode in enumerate(modes):
            j, row = ENDS + mode, values[first + k * MODE : first + (k + 1) * MODE]
            row[ELASTIC], row[FORCE] = theta * time_step * squares[j], time_step * squares[j]
            row[CARRIED:COUPLE] = piece.mass[:3, j]
            row[COUPLE:AXIAL] = piece.couple[j, :3]
            row[AXIAL] = tension[j]
            row[TO_MODES : TO_MODES + len(modes)] = piece.couple[j, ENDS + modes.start : ENDS + modes.stop]
    return values


def _mirrored(values: FloatArray) -> FloatArray:
    """Constants of a pitch with the odd part of its mean axial force set to exactly zero."""
    values[AXIAL_ODD : AXIAL_ODD + 3] = 0.0
    values[ODD + AXIAL :: MODE] = 0.0
    return values


def _factors(pieces: list[Pitch], tip: FloatArray, weight: float) -> tuple[FloatArray, FloatArray]:
    """``factors`` and ``root_factors`` of A = M + theta dt tau K with the modes of each piece eliminated."""
    blocks = []
    for piece in pieces:
        A = piece.mass + weight * piece.stiffness
        ends, modes = slice(0, ENDS), slice(ENDS, None)
        blocks.append(A[ends, ends] - A[ends, modes] @ np.linalg.solve(A[modes, modes], A[modes, ends]))
    whole = blocks[-1]
    behind, ahead = whole[3:, :3], whole[:3, 3:]
    rows: list[FloatArray] = []
    roots: list[list[FloatArray]] = []
    rest = tip  # contribution to S from the side of the tip
    none = np.zeros((3, 3))
    while len(rows) < MAX_FACTORS:
        E = np.linalg.inv(rest + whole[:3, :3])
        rows.append(np.concatenate([E, E @ behind, E @ ahead]).ravel())
        held = [np.linalg.inv(rest + block[:3, :3]) for block in blocks]
        roots.append([np.concatenate([E_held, E_held @ behind, none]).ravel() for E_held in held])
        if len(rows) > 1 and np.abs(rows[-1] - rows[-2]).max() <= SETTLED * np.abs(rows[-1]).max():
            break
        rest = whole[3:, 3:] - behind @ E @ ahead
    return np.array(rows), np.array(roots).transpose(1, 0, 2)


def _growth(chain: Chain, pieces: list[Pitch], k: int, per_pitch: int, elements: int) -> FloatArray:
    """Matrix (6 + 2 m)^2 that maps (d, v, q, p) of the piece at the root when its k + 1 nodes become k + 2.

    d and v are of the float at its L end, q and p of its modes. Result: change of K d and of the momentum of the float
    at L, and q and p of the modes of the longer piece, whose motion is that of the shorter piece, at rest beyond it,
    projected by the mass. For a whole pitch, whose R end is released: K d and momentum of the float there.
    """
    m = pieces[0].modes
    old = pieces[k]
    result = np.zeros((ENDS + 2 * m, ENDS + 2 * m))
    columns = np.r_[0:3, ENDS : ENDS + m]
    # velocities of the unknowns from v of the float and momenta of the modes
    modal = np.diag(old.mass)[ENDS:, None]
    moving = np.zeros((3 + m, ENDS + 2 * m))
    moving[:3, 3:6], moving[3:, 3:6] = np.eye(3), -old.mass[ENDS:, :3] / modal
    moving[3:, ENDS + m :] = np.eye(m) / modal
    if k == per_pitch - 1:
        result[:3, :3] = old.stiffness[3:6, :3]
        result[3:6] = old.mass[3:6][:, columns] @ moving
        return result
    new = pieces[k + 1]
    mesh = refined(chain, per_pitch, elements, k + 2)
    mass = np.tile([mesh.mass, mesh.mass, mesh.inertia], mesh.node_count)
    mass[:3] *= 0.5
    mass[-3:] *= 0.5
    shape = np.zeros((len(mass), 3 + m))
    shape[: len(old.shape)] = old.shape[:, columns]
    shape[len(old.shape) - 3 :] = 0.0
    result[:3, :3] = new.stiffness[:3, :3] - old.stiffness[:3, :3]
    result[3:6] = (new.shape[:, :3].T * mass) @ shape @ moving - old.mass[:3][:, columns] @ moving
    placed = np.zeros((3 + m, ENDS + 2 * m))
    placed[:3, :3], placed[3:, ENDS : ENDS + m] = np.eye(3), np.eye(m)
    modes = new.shape[:, ENDS:].T * mass
    result[ENDS : ENDS + m] = modes @ (shape @ placed - new.shape[:, :3] @ placed[:3]) / np.diag(new.mass)[ENDS:, None]
    result[ENDS + m :] = modes @ shape @ moving
    return result


def _shape(piece: Pitch, per_pitch: int, elements: int) -> FloatArray:
    """(n, 3, 6 + m), zero beyond the piece."""
    nodes = piece.shape.reshape(-1, 3, ENDS + piece.modes)[: -1 : elements // per_pitch]
    result = np.zeros((per_pitch, 3, ENDS + piece.modes))
    result[: len(nodes)] = nodes
    return result
