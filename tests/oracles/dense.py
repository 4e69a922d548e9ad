"""An independent step for the tests: (6), (17) and (18) as one dense system, in the study's own numbering.

Written from the equations and not from the kernels: node 0 is the root, n the tip; unknowns are all d_j
(j = 1..n) and all fbar_j. Nothing is shared with ``probe_env`` but the chain's numbers.
"""

import numpy as np


def dense_step(chain, B_a, B_v, inputs, h_a, h_v, d, v, axial_force):
    """Displacements (n + 1, 3) and axial forces of (17)-(18) at the new time, tip first like the kernels."""
    n = chain.node_count - 1
    u, du_dt, air = inputs[:3]
    flip = slice(None, None, -1)
    h_a, h_v, d, v = h_a[flip], h_v[flip], d[flip], v[flip]
    V_bar = axial_force[flip]
    k_c, gap, lever, drag = (
        np.asarray(a)[flip] for a in (chain.contact_stiffness, chain.outer_gap, chain.lever, chain.drag)
    )
    support, load = chain.support_stiffness[flip], chain.load[flip]
    l = chain.element_length
    L = np.array([[1, 0, 0], [0, 1, 0], [0, l, 1.0]])
    F = np.array(
        [
            [chain.axial_compliance, 0, 0],
            [0, chain.shear_compliance, chain.coupling_compliance],
            [0, chain.coupling_compliance, chain.bending_compliance],
        ]
    )
    c, s = chain.cos_phi, chain.sin_phi
    Phi = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    M = np.array([[chain.mass, 0, 0], [0, chain.mass, 0], [-chain.frame_inertia, 0, chain.inertia]])
    delta = chain.damping_time
    A = np.zeros((6 * n, 6 * n))
    b = np.zeros(6 * n)

    def D(j):  # columns of d_j, j = 1..n
        return slice(3 * (j - 1), 3 * j)

    def Fb(j):  # columns of fbar_j, in element j's frame
        return slice(3 * n + 3 * (j - 1), 3 * n + 3 * j)

    for j in range(1, n + 1):
        omega_r = u + v[j, 0]
        C = np.zeros((3, 3))
        C[0, 1] = 2 * chain.mass * omega_r * chain.curvature
        K = np.diag(support[j]).astype(float)
        V = max(V_bar[j], -chain.max_pressure) * chain.couple_length
        K[2, 2] += V
        q = load[j].astype(float).copy()
        # V l (theta + x / r)^2 / 2 for the whole of it, but for V l theta^2 / 2, which is in K; x, theta as they were
        turn = chain.couple_turn
        q[0] -= V * turn * (d[j, 2] + turn * d[j, 0])
        q[2] -= V * turn * d[j, 0]
        q[1] += chain.mass * chain.curvature * omega_r**2
        rel = air - omega_r
        q[0] += drag[j] * rel * abs(rel)
        y, k, arm, low, high = d[j, 1], k_c[j], lever[j], 0.0, gap[j]
        if k == 0:  # the cable: thinner than a float by this on either side
            k, arm, thinner = chain.cable_stiffness, chain.cable_radius, lever[j] - chain.cable_radius
            low, high = -thinner, gap[j] + thinner
        if k > 0 and y < low:
            mu = chain.friction * (1 if omega_r + v[j, 2] * arm >= 0 else -1)
            column = k * np.array([-mu, 1, -mu * arm])
            K[:, 1] += column
            q += column * low
        elif k > 0 and y > high:
            mu = chain.friction * (1 if omega_r - v[j, 2] * arm >= 0 else -1)
            # normal force N = k (y - gap) inwards; friction -mu N at the outer contact point (0, +lever)
            column = k * np.array([mu, 1, -mu * arm])
            K[:, 1] += column
            q += column * high
        P = B_a * M + B_v * C + K
        q = q - M @ (h_a[j] + [du_dt, 0.0, 0.0]) - C @ h_v[j]  # the frame's acceleration
        # (17): P d_j = q + f_j - fbar_j, all in node j's frame
        row = slice(6 * (j - 1), 6 * (j - 1) + 3)
        A[row, D(j)] += P
        A[row, Fb(j)] += Phi
        if j < n:
            A[row, Fb(j + 1)] -= Phi.T @ L  # (6)
        b[row] = q
        # (18) in element j's frame
        row = slice(6 * (j - 1) + 3, 6 * j)
        A[row, D(j)] += Phi.T
        if j > 1:
            A[row, D(j - 1)] -= L.T @ Phi
        A[row, Fb(j)] -= F / (1 + delta * B_v)
        b[row] = delta / (1 + delta * B_v) * (L.T @ Phi @ h_v[j - 1] - Phi.T @ h_v[j])
        if j == 1:  # the root is held where it is
            b[row] += L.T @ Phi @ d[0]

    # row and column scaling, so that the dense solution itself keeps its digits
    rows = 1 / np.abs(A).max(axis=1)
    A, b = A * rows[:, None], b * rows
    columns = 1 / np.abs(A).max(axis=0)
    lu = np.linalg.solve(A * columns, b)
    residual = b - (A * columns) @ lu
    x = columns * (lu + np.linalg.solve(A * columns, residual))
    d_new = np.zeros((n + 1, 3))
    d_new[0] = d[0]
    d_new[1:] = x[: 3 * n].reshape(n, 3)
    V_new = np.zeros(n + 1)
    V_new[1:] = x[3 * n :].reshape(n, 3)[:, 0]
    return d_new[flip], V_new[flip]
