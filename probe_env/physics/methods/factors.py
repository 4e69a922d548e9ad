"""Linear part of a chain per mass, M^-1 K, and its elimination factors for ``imex`` and ``explicit``.

Factors in single precision are rounded so that rigid motion along the tube remains free.
"""

from functools import lru_cache
from typing import Any

import numpy as np

from probe_env.arrays import FloatArray
from probe_env.physics.methods.lanes import traced
from probe_env.physics.model.chain import Chain, cable_of, element_blocks, element_stiffness, linear_part

MAX_FACTORS = 4000
LONG_STEP = 5e-4  # [s]
ULPS = 128
"""Largest adjustment of an entry in units in the last place."""
FREE = 2e-9
"""Tolerance of the mismatch of rigid motion."""
SETTLED = 1e-10
"""Relative change of a row of factors below which the last row is used."""


def node_matrices(chain: Chain) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """(3, 3) blocks of M^-1 K: of the tip node, of an inner node, to the neighbour behind and ahead."""
    head, tail = element_blocks(chain)
    stiffness = element_stiffness(chain)
    mass = np.array([[chain.mass, 0, 0], [0, chain.mass, 0], [-chain.frame_inertia, 0, chain.inertia]])
    inverse = np.linalg.inv(mass)
    tip = inverse @ head.T @ stiffness @ head
    inner = tip + inverse @ tail.T @ stiffness @ tail
    return tip, inner, inverse @ head.T @ stiffness @ tail, inverse @ tail.T @ stiffness @ head


@traced
def linear_weights(damping_time: Any, time_step: float) -> tuple[Any, Any]:
    """Theta and tau of the linear part: w = d + tau v_theta, v_theta = (1 - theta) v* + theta v.

    A theta above 1/2 damps modes that the step does not resolve, whose velocity the midpoint rule reverses undamped in
    every step, and adds (theta - 1/2) omega dt to the damping of all other modes. Subtracting this from the damping of
    the cable, tau = delta + dt (1 - theta), keeps the damping of slow modes at delta omega / 2. With tau >= theta dt
    the scheme is unconditionally stable. theta - 1/2 vanishes with dt, so the linear part is of second order.

    Accepts numbers, and in kernels the damping times of the lanes.
    """
    delta, dt = damping_time, time_step
    theta = 0.5 + 0.5 * dt * delta / (delta * delta + dt * dt)
    return theta, delta + dt * (1.0 - theta)


def implicit_weights(damping_time: float, time_step: float) -> tuple[float, float]:
    """Theta and tau of ``implicit``: those of ``linear_weights`` with more dissipation at longer steps.

    Theta increases from 1/2 to 1 (backward Euler) around a step of 0.5 ms. If the damping of the cable is too small to
    compensate, tau = theta dt adds numerical damping.
    """
    theta = max(linear_weights(damping_time, time_step)[0], 0.5 + 0.5 * time_step / (time_step + LONG_STEP))
    return theta, max(damping_time + time_step * (1.0 - theta), theta * time_step)


def imex_factors(chain: Chain, time_step: float) -> FloatArray:
    """(k, 27) elimination factors E, F, U of the first k nodes from the tip; further nodes use the last row.

    S_0 = 1 + K_00, S_i = 1 + K_ii - K_i,i-1 U_{i-1}; E = S^-1, F = E K_i,i-1, U = E K_i,i+1 (of theta dt tau M^-1 K).
    Elimination towards the root: g_i = E_i z_i - F_i g_{i-1}; back substitution: w_i = g_i - U_i w_{i+1}.
    """
    return _imex_factors(linear_part(chain), time_step)


@lru_cache(maxsize=256)
def _imex_factors(linear: tuple[float, ...], time_step: float) -> FloatArray:
    chain = cable_of(linear)
    theta, tau = linear_weights(chain.damping_time, time_step)
    weight = theta * time_step * tau
    tip, inner, ahead, behind = (weight * block for block in node_matrices(chain))
    rows: list[FloatArray] = []
    S = np.eye(3) + tip
    # entries between lengths and angles compare once angles are taken times the element's length
    lengths = np.array([1.0, 1.0, 1.0 / chain.element_length])
    scale = lengths[None, :] / lengths[:, None]
    while len(rows) < MAX_FACTORS:
        E = np.linalg.inv(S)
        F, U = E @ behind, E @ ahead
        rows.append(np.concatenate([E.ravel(), F.ravel(), U.ravel()]))
        if len(rows) > 1 and _agree(rows[-1], rows[-2], scale):
            break
        S = np.eye(3) + inner - behind @ U
    table = np.array(rows)
    table.setflags(write=False)
    return table


def _agree(new: FloatArray, old: FloatArray, scale: FloatArray) -> bool:
    """Whether two rows of factors agree to rounding, relative to the largest entry of each matrix."""
    change, size = (np.abs(rows.reshape(3, 3, 3) / scale) for rows in (new - old, new))
    return bool((change.max(axis=(1, 2)) <= 8.0 * np.finfo(float).eps * size.max(axis=(1, 2))).all())


def explicit_factors(chain: Chain) -> FloatArray:
    """(2, 27) blocks of M^-1 K of the tip and of every other node: diagonal, to the node behind, to the node ahead."""
    tip, inner, ahead, behind = node_matrices(chain)
    rest = [behind.ravel(), ahead.ravel()]
    return np.array([np.concatenate([tip.ravel(), *rest]), np.concatenate([inner.ravel(), *rest])])


def single_factors(chain: Chain, time_step: float) -> FloatArray:
    """``imex_factors`` in single precision.

    The rigid motion ``free`` along the tube has K free = 0, so that w = d. Factors rounded to eps = 6e-8 give
    w = d (1 + m), a spring to the frame of m / dt^2 per mass. Because all nodes use one row, the errors add up over the
    length: m = 1.7e-7 at 1e-4 s lowers the first axial frequency of 60 m by 2 %. So F_xx, U_xx and E_xx are adjusted by
    units in the last place until |m| is below ``FREE``.
    """
    return _single_factors(linear_part(chain), time_step)


@lru_cache(maxsize=256)
def _single_factors(linear: tuple[float, ...], time_step: float) -> FloatArray:
    exact = _imex_factors(linear, time_step)
    sin_phi, element_length = (linear[Chain._fields.index(name)] for name in ("sin_phi", "element_length"))
    table = exact[: _settled(exact, element_length) + 1].astype(np.float32)
    table[-1] = exact[-1]
    free = np.array([1.0, 0.0, -2.0 * sin_phi / element_length])
    E, F, U = table[-1].reshape(3, 3, 3)
    steps = np.arange(-ULPS, ULPS + 1)
    shifted = np.tile(np.eye(3) + table[-1].reshape(3, 3, 3)[1:, None].astype(float), (1, len(steps), 1, 1))
    shifted[0, :, 0, 0] += steps * float(np.spacing(F[0, 0]))
    shifted[1, :, 0, 0] += steps * float(np.spacing(U[0, 0]))
    # w_x = p E free with p the first row of [(1 + F) (1 + U)]^-1; linear in E_xx
    p = np.linalg.inv(shifted[0] @ shifted[1])[:, 0]
    others = E.astype(float)
    others[0, 0] = 0.0
    exact_entry = (1.0 - p @ (others @ free)) / p[:, 0]
    mismatch = np.abs((exact_entry.astype(np.float32) - exact_entry) * p[:, 0])
    best = np.where(mismatch <= FREE, np.abs(steps), ULPS + mismatch).argmin()  # the least adjustment
    E[0, 0] = exact_entry[best]
    F[0, 0] += steps[best] * np.spacing(F[0, 0])
    U[0, 0] += steps[best] * np.spacing(U[0, 0])
    table.setflags(write=False)
    return np.asarray(table)


def _settled(exact: FloatArray, element_length: float) -> int:
    """First row that agrees with the last; angles are multiplied by the element length to compare with lengths."""
    lengths = np.array([1.0, 1.0, 1.0 / element_length])
    rows = exact.reshape(-1, 3, 3, 3) * (lengths[:, None] / lengths[None, :])
    change = np.abs(rows - rows[-1]).max(axis=(2, 3)) / np.abs(rows[-1]).max(axis=(1, 2))
    return int((change.max(axis=1) <= SETTLED).argmax())
