"""Where the probes of a group are held: the rows with a root, growth there, and what is sampled after a step."""

from __future__ import annotations

from typing import NamedTuple

from numba import njit

from probe_env.arrays import FloatArray
from probe_env.physics.methods.lane_group import PEAK, ROOT
from probe_env.physics.methods.superelement.tables import CONSTANTS, FACTORS
from probe_env.physics.model.drive import APPEND
from probe_env.physics.model.state import DIVERGED_RADIAL

# fields of a row: displacement, momentum but for the last share of K d, mean velocity, axial force; then q, p a mode
X, Y, T, PX, PY, PT, VX, VY, VT, V = range(10)
MODES = 10


class RootTables(NamedTuple):
    """Tables of every lane, see ``Tables``, with as many modes as the group has; scratch for one growth.

    Attributes:
        pieces: (lanes, n + 1, CONSTANTS).
        factors: (lanes, k, 27).
        root_factors: (lanes, n, k, 27).
        growth: (lanes, n, 6 + 2 m, 6 + 2 m).
        shape: (lanes, n, n, 3, 6 + m).
        given, gained: (6 + 2 m,).
    """

    pieces: FloatArray
    factors: FloatArray
    root_factors: FloatArray
    growth: FloatArray
    shape: FloatArray
    given: FloatArray
    gained: FloatArray


@njit(cache=True, nogil=True, error_model="numpy")
def place_roots(tables, constants, factors, at, last, roots):
    """Give the rows with a root their constants and factors: a lane's own where its root is, else those of a pitch."""
    places, lanes = tables.pieces.shape[1] - 1, tables.pieces.shape[0]
    at[:] = 0
    for k in range(lanes):
        if roots[k] == 0:  # an idle lane
            continue
        i = (roots[k] - 1) // places
        at[i] = 1 + k
        for lane in range(lanes):
            own = roots[lane] > 0 and (roots[lane] - 1) // places == i
            kind = roots[lane] - i * places - 1 if own else places
            row = min(i, last)
            for c in range(CONSTANTS):
                constants[(1 + k) * CONSTANTS + c, lane] = tables.pieces[lane, kind, c]
            for f in range(FACTORS):
                value = tables.root_factors[lane, kind, row, f] if own else tables.factors[lane, row, f]
                factors[(last + 1 + k) * FACTORS + f, lane] = value


@njit(cache=True, nogil=True, error_model="numpy")
def grow(tables, state, fields, root, lane, tau):
    """Hold a lane's cable one place further from the float: the state of its last piece goes over to the longer one.

    A pitch that is complete lets the float at its end go, at rest; what is beyond it rests too.
    """
    places, modes = tables.pieces.shape[1] - 1, (fields - MODES) // 2
    i = (root - 1) // places
    q, length = i * fields, root - i * places
    given, gained, matrix = tables.given, tables.gained, tables.growth[lane, length - 1]
    for c in range(3):
        given[c], given[3 + c] = state[q + X + c, lane], state[q + VX + c, lane]
    for j in range(modes):
        given[6 + j], given[6 + modes + j] = state[q + MODES + 2 * j, lane], state[q + MODES + 2 * j + 1, lane]
    for r in range(len(gained)):
        gained[r] = 0.0
        for c in range(len(given)):
            gained[r] += matrix[r, c] * given[c]
    if length == places:
        q += fields
        for c in range(3):
            state[q + X + c, lane], state[q + VX + c, lane], state[q + PX + c, lane] = 0.0, 0.0, 0.0
        state[q + V, lane] = state[q - fields + V, lane]
    for c in range(3):
        state[q + PX + c, lane] += gained[3 + c] + tau * gained[c]
    for j in range(modes):
        state[q + MODES + 2 * j, lane], state[q + MODES + 2 * j + 1, lane] = gained[6 + j], gained[6 + modes + j]


@njit(cache=True, nogil=True, error_model="numpy")
def displacement(tables, state, fields, root, lane, node, component):
    """X, y or theta at a place between two floats."""
    places, modes = tables.pieces.shape[1] - 1, (fields - MODES) // 2
    i = node // places
    q = i * fields
    kind = min(root - i * places, places) - 1
    row = tables.shape[lane, kind, node - i * places, component]
    value = 0.0
    for c in range(3):
        value += row[c] * state[q + X + c, lane] + row[3 + c] * state[q + fields + X + c, lane]
    for j in range(modes):
        value += row[6 + j] * state[q + MODES + 2 * j, lane]
    return value


@njit(cache=True, nogil=True, error_model="numpy")
def displacements(tables, state, fields, root, lane, d):
    """Displacements of all places between floats of a lane, from the state of the pieces."""
    places = tables.pieces.shape[1] - 1
    for node in range(root):
        if node % places:
            for c in range(3):
                d[node, c] = displacement(tables, state, fields, root, lane, node, c)


@njit(nogil=True, error_model="numpy")
def after_step(
    parameters, constants, factors, at, last, fields, state, inputs, k, step, due, row, tau, tables,
    points, roots, samples, tension, failed,
):  # fmt: skip
    """Sampling, failure and growth after a step; True if no lane is left. Arguments as in ``imex.after_step``.

    ``tension`` (rows, lanes), unless empty, gains the axial force of the pieces.
    """
    places = tables.pieces.shape[1] - 1
    running, moved = 0, False
    for lane in range(len(failed)):
        if failed[lane] != 0:
            continue
        if not (abs(state[Y, lane]) <= DIVERGED_RADIAL and parameters[PEAK, lane] <= DIVERGED_RADIAL):
            failed[lane] = step + 1
            continue
        running += 1
        root = roots[lane]
        outermost = (root - 1) // places
        if due == 0:
            for p in range(len(points)):
                node = points[p, lane] if points[p, lane] >= 0 else root
                i = min(node // places, outermost)
                for c in range(3):
                    if node >= root:
                        value = 0.0
                    elif node == i * places:
                        value = state[i * fields + X + c, lane]
                    else:
                        value = displacement(tables, state, fields, root, lane, node, c)
                    samples[row, p, c, lane] = value
                samples[row, p, 3, lane] = state[i * fields + V, lane]
            for i in range(min(len(tension), outermost + 1)):
                tension[i, lane] += state[i * fields + V, lane]
        if inputs[k + APPEND, lane] > 0.0:
            grow(tables, state, fields, root, lane, tau[lane])
            roots[lane] += 1
            parameters[ROOT, lane] = (root // places) + 1
            moved = True
    if moved:
        place_roots(tables, constants, factors, at, last, roots)
    return running == 0
