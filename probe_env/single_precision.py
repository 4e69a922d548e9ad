"""The factors of ``imex`` in single precision, so rounded that what is free along the tube stays free."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from probe_env.chain import Chain, FloatArray
from probe_env.linear_part import _imex_factors, _linear_part

ULPS = 128
"""Most units in the last place by which an entry is moved."""
FREE = 2e-9
"""Mismatch of the free motion to reach."""
SETTLED = 1e-10
"""Relative change of a row of factors, entry by matrix, from which on the last row serves."""


def single_factors(chain: Chain, time_step: float) -> FloatArray:
    """``imex_factors`` in single precision.

    Along the tube nothing holds the cable: the uniform motion ``free`` has K free = 0, and w = d there. Factors
    rounded to eps = 6e-8 make it w = d (1 + m), a spring to the frame of m / dt^2 a mass, and since one row serves
    all nodes, the whole length adds up to it: m = 1.7e-7 at 1e-4 s lowers the first axial frequency of 60 m by 2 %.
    So F_xx and U_xx are moved together by units in the last place, and E_xx with them, until |m| is below ``FREE``.
    """
    return _single_factors(_linear_part(chain), time_step)


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
