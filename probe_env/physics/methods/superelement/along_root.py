"""Where a probe with its floats in the lanes is held: the root's constants, growth there, and what is sampled."""

from __future__ import annotations

from numba import njit

from probe_env.physics.methods.superelement.roots import V, X, displacement
from probe_env.physics.methods.superelement.tables import CONSTANTS

OWN = 9
"""Of a float's factors E, in lanes; F and U, ``LINKS`` numbers, are in rows of their own."""
LINKS = 18


@njit(nogil=True, error_model="numpy")
def place_root(tables, constants, factors, links, root):
    """Give the root's block its constants and factors, the float before the root those of a shorter piece."""
    places, lanes = tables.pieces.shape[1] - 1, constants.shape[1]
    top, f, settled = (root - 1) // places, len(factors) - OWN, tables.factors.shape[1] - 1
    for lane in range(lanes):
        i = (top // lanes) * lanes + lane
        row = min(i, settled)
        kind = root - top * places - 1 if i == top else places
        for c in range(CONSTANTS):
            constants[CONSTANTS + c, lane] = tables.pieces[0, kind, c]
        for k in range(OWN):
            value = tables.root_factors[0, kind, row, k] if i == top else tables.factors[0, row, k]
            factors[f + k, lane] = value
    for k in range(LINKS):
        links[len(links) - 1, k] = tables.root_factors[0, root - top * places - 1, min(top, settled), OWN + k]


@njit(nogil=True, error_model="numpy")
def bring(state, fields, i, near):
    """Copy float i and the one on its root side to ``near``."""
    lanes = state.shape[1]
    for k in range(2):
        for field in range(fields):
            near[k * fields + field, 0] = state[(i + k) // lanes * fields + field, (i + k) % lanes]


@njit(nogil=True, error_model="numpy")
def take_back(state, fields, i, near):
    """``bring`` backwards."""
    lanes = state.shape[1]
    for k in range(2):
        for field in range(fields):
            state[(i + k) // lanes * fields + field, (i + k) % lanes] = near[k * fields + field, 0]


@njit(nogil=True, error_model="numpy")
def sample(tables, state, fields, root, near, points, samples):
    """Write x, y, theta and the axial force at some nodes; see ``roots.after_step``."""
    places = tables.pieces.shape[1] - 1
    for p in range(len(points)):
        node = points[p] if points[p] >= 0 else root
        i = min(node // places, (root - 1) // places)
        bring(state, fields, i, near)
        for c in range(3):
            if node >= root:
                value = 0.0
            elif node == i * places:
                value = float(near[X + c, 0])
            else:
                value = displacement(tables, near, fields, root - i * places, 0, node - i * places, c)
            samples[p, c] = value
        samples[p, 3] = near[V, 0]
