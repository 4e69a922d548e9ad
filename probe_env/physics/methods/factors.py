"""The chain's linear part per mass, M^-1 K, and its factors for the kernels of the fast schemes.

In single precision they are so rounded that what is free along the tube stays free.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from numba.extending import register_jitable

from probe_env.arrays import FloatArray
from probe_env.physics.model.chain import Chain, cable_of, element_blocks, element_stiffness, linear_part

MOST_FACTORS = 4000
LONG_STEP = 5e-4  # [s]
ULPS = 128
"""Most units in the last place by which an entry is moved."""
FREE = 2e-9
"""Mismatch of the free motion to reach."""
SETTLED = 1e-10
"""Relative change of a row of factors, entry by matrix, from which on the last row serves."""


def node_matrices(chain: Chain) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """(3, 3) blocks of M^-1 K: of the tip node, of an inner node, to the neighbour behind and ahead."""
    head, tail = element_blocks(chain)
    stiffness = element_stiffness(chain)
    mass = np.array([[chain.mass, 0, 0], [0, chain.mass, 0], [-chain.frame_inertia, 0, chain.inertia]])
    inverse = np.linalg.inv(mass)
    tip = inverse @ head.T @ stiffness @ head
    inner = tip + inverse @ tail.T @ stiffness @ tail
    return tip, inner, inverse @ head.T @ stiffness @ tail, inverse @ tail.T @ stiffness @ head


@register_jitable(inline="always")  # type: ignore[untyped-decorator]
def linear_weights(damping_time: Any, time_step: float) -> tuple[Any, Any]:
    """Theta and tau of the linear part: w = d + tau v_theta, v_theta = (1 - theta) v* + theta v.

    A theta above 1/2 damps what is too fast for the step, whose velocity the midpoint rule flips undamped from
    step to step, and by (theta - 1/2) omega dt everything else. Taking that share off the cable's own damping,
    tau = delta + dt (1 - theta), keeps the damping of slow modes at delta omega / 2, and tau >= theta dt keeps
    the scheme unconditionally stable. theta - 1/2 vanishes with dt, so the linear part stays second order.

    For numbers, and in kernels for the damping times of the lanes.
    """
    delta, dt = damping_time, time_step
    theta = 0.5 + 0.5 * dt * delta / (delta * delta + dt * dt)
    return theta, delta + dt * (1.0 - theta)


def implicit_weights(damping_time: float, time_step: float) -> tuple[float, float]:
    """Theta and tau of ``implicit``: those of ``linear_weights``, but more dissipative the longer the step.

    Theta grows from 1/2 to 1 (backward Euler) around a step of 0.5 ms, damped or not; where the cable's damping
    cannot pay for it, tau = theta dt adds numerical damping.
    """
    theta = max(linear_weights(damping_time, time_step)[0], 0.5 + 0.5 * time_step / (time_step + LONG_STEP))
    return theta, max(damping_time + time_step * (1.0 - theta), theta * time_step)


def imex_factors(chain: Chain, time_step: float) -> FloatArray:
    """(k, 27) elimination factors E, F, U of the first k nodes from the tip; the last row serves all beyond.

    S_0 = 1 + K_00, S_i = 1 + K_ii - K_i,i-1 U_{i-1}; E = S^-1, F = E K_i,i-1, U = E K_i,i+1 (of theta dt tau M^-1 K).
    Going up to the root g_i = E_i z_i - F_i g_{i-1}, coming back w_i = g_i - U_i w_{i+1}.
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
    while len(rows) < MOST_FACTORS:
        E = np.linalg.inv(S)
        F, U = E @ behind, E @ ahead
        rows.append(np.concatenate([E.ravel(), F.ravel(), U.ravel()]))
        if len(rows) > 1 and _alike(rows[-1], rows[-2], scale):
            break
        S = np.eye(3) + inner - behind @ U
    table = np.array(rows)
    table.setflags(write=False)
    return table


def _alike(new: FloatArray, old: FloatArray, scale: FloatArray) -> bool:
    """Whether two rows of factors agree to rounding, each matrix measured by its largest entry."""
    change, size = (np.abs(rows.reshape(3, 3, 3) / scale) for rows in (new - old, new))
    return bool((change.max(axis=(1, 2)) <= 8.0 * np.finfo(float).eps * size.max(axis=(1, 2))).all())


def explicit_factors(chain: Chain) -> FloatArray:
    """(2, 27) blocks of M^-1 K of the tip and of every other node: own, to the node behind, to that ahead."""
    tip, inner, ahead, behind = node_matrices(chain)
    rest = [behind.ravel(), ahead.ravel()]
    return np.array([np.concatenate([tip.ravel(), *rest]), np.concatenate([inner.ravel(), *rest])])


def single_factors(chain: Chain, time_step: float) -> FloatArray:
    """``imex_factors`` in single precision.

    Along the tube nothing holds the cable: the uniform motion ``free`` has K free = 0, and w = d there. Factors
    rounded to eps = 6e-8 make it w = d (1 + m), a spring to the frame of m / dt^2 a mass, and since one row serves
    all nodes, the whole length adds up to it: m = 1.7e-7 at 1e-4 s lowers the first axial frequency of 60 m by 2 %.
    So F_xx and U_xx are moved together by units in the last place, and E_xx with them, until |m| is below ``FREE``.
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
    moved = np.tile(np.eye(3) + table[-1].reshape(3, 3, 3)[1:, None].astype(float), (1, len(steps), 1, 1))
    moved[0, :, 0, 0] += steps * float(np.spacing(F[0, 0]))
    moved[1, :, 0, 0] += steps * float(np.spacing(U[0, 0]))
    # w_x = p E free with p the first row of [(1 + F) (1 + U)]^-1; linear in E_xx
    p = np.linalg.inv(moved[0] @ moved[1])[:, 0]
    others = E.astype(float)
    others[0, 0] = 0.0
    wanted = (1.0 - p @ (others @ free)) / p[:, 0]
    mismatch = np.abs((wanted.astype(np.float32) - wanted) * p[:, 0])
    best = np.where(mismatch <= FREE, np.abs(steps), ULPS + mismatch).argmin()  # the nearest that will do
    E[0, 0] = wanted[best]
    F[0, 0] += steps[best] * np.spacing(F[0, 0])
    U[0, 0] += steps[best] * np.spacing(U[0, 0])
    table.setflags(write=False)
    return np.asarray(table)


def _settled(exact: FloatArray, element_length: float) -> int:
    """First row that agrees with the last; angles are taken times the element's length to compare with lengths."""
    lengths = np.array([1.0, 1.0, 1.0 / element_length])
    rows = exact.reshape(-1, 3, 3, 3) * (lengths[:, None] / lengths[None, :])
    change = np.abs(rows - rows[-1]).max(axis=(2, 3)) / np.abs(rows[-1]).max(axis=(1, 2))
    return int((change.max(axis=1) <= SETTLED).argmax())
