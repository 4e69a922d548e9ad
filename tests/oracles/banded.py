"""The system of (17)-(18) as a banded matrix, solved by LAPACK through SciPy.

A reference for accuracy and speed of the TICM: equal equations and update, another solver.
"""

from collections.abc import Callable

import numpy as np
from numba import njit
from scipy.linalg import solve_banded

from probe_env.arrays import FloatArray
from probe_env.physics.methods import ticm
from probe_env.physics.methods.newmark import Scheme, Workspace
from probe_env.physics.model.chain import Chain, element_blocks, element_stiffness
from probe_env.physics.model.drive import AIR, SLOPE, SPEED
from probe_env.physics.model.state import State


@njit(nogil=True, error_model="numpy", fastmath=ticm.FASTMATH)
def node_equations(chain, scheme, inputs, root, state, work):
    """All P_j and q_j of one step, for separate solvers."""
    for i in range(root):
        ticm.node_equation(chain, scheme, inputs[SPEED], inputs[SLOPE], inputs[AIR], state, i, work.P, work.q)


@njit(nogil=True, error_model="numpy", fastmath=ticm.FASTMATH)
def apply_solution(scheme, state, solution, axial_force):
    """Update the state from a solution (n, 3) of (17)-(18); returns the first diverged node or -1."""
    diverged = -1
    for i in range(len(axial_force)):
        x, y, t = solution[i, 0], solution[i, 1], solution[i, 2]
        if not ticm.update_node(scheme, state, i, x, y, t) and diverged < 0:
            diverged = i
        state.axial_force[i] = axial_force[i]
    return diverged


HALF_BANDWIDTH = 5  # three unknowns a node, coupled to the neighbours


def stepper(chain: Chain, scheme: Scheme) -> Callable[[FloatArray, int, State, Workspace], int]:
    """A step function (inputs, root, state, work) -> first diverged node or -1, constant matrices prepared."""
    head, tail = element_blocks(chain)
    stiffness = element_stiffness(chain)
    damped = (1.0 + chain.damping_time * scheme.B_v) * stiffness
    elastic = _elastic_band(head, tail, damped, chain.node_count - 1)  # of the longest probe

    def step(inputs: FloatArray, root: int, state: State, work: Workspace) -> int:
        node_equations(chain, scheme, inputs, root, state, work)
        d, v, a = state.d[: root + 1], state.v[: root + 1], state.memory[: root + 1]
        h_v = scheme.v_d * d + scheme.v_v * v + scheme.v_a * a
        h_v[-1] = -scheme.B_v * d[-1]  # the held root is at rest
        history = chain.damping_time * (h_v[:-1] @ head.T + h_v[1:] @ tail.T) @ stiffness.T
        history[-1] += damped @ tail @ d[-1]
        right = work.q[:root] - history @ head
        right[1:] -= history[:-1] @ tail
        band = elastic[:, : 3 * root].copy()
        _add_node_matrices(band, work.P[:root])
        solution = d.copy()
        solution[:-1] = solve_banded(
            (HALF_BANDWIDTH, HALF_BANDWIDTH), band, right.ravel(), overwrite_ab=True, check_finite=False
        ).reshape(-1, 3)
        deformation = solution[:-1] @ head.T + solution[1:] @ tail.T
        history[-1] -= damped @ tail @ d[-1]  # now included in the deformation
        axial = deformation @ damped[0] + history[:, 0]
        return int(apply_solution(scheme, state, solution, axial))

    return step


def _elastic_band(head: FloatArray, tail: FloatArray, stiffness: FloatArray, nodes: int) -> FloatArray:
    """Stiffness of all elements in the storage of ``solve_banded``, without the held root."""
    band = np.zeros((2 * HALF_BANDWIDTH + 1, 3 * nodes))
    first, second = head.T @ stiffness @ head, tail.T @ stiffness @ tail
    diagonal = np.repeat(first[None], nodes, axis=0)
    diagonal[1:] += second
    for row in range(3):
        for column in range(3):
            band[HALF_BANDWIDTH + row - column, column::3] += diagonal[:, row, column]
            upper = (head.T @ stiffness @ tail)[row, column]  # node i by node i + 1
            band[HALF_BANDWIDTH + row - column - 3, 3 + column :: 3] += upper
            lower = (tail.T @ stiffness @ head)[row, column]
            band[HALF_BANDWIDTH + row - column + 3, column:-3:3] += lower
    return band


def _add_node_matrices(band: FloatArray, P: FloatArray) -> None:
    entries = ((0, 0), (0, 1), (1, 1), (2, 0), (2, 1), (2, 2))
    for k, (row, column) in enumerate(entries):
        band[HALF_BANDWIDTH + row - column, column::3] += P[:, k]
