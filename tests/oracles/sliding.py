"""Small vibrations about steady sliding with every float on the inner wall, as one sparse linear system.

Written from (14) and the elements' matrices, not from the kernels. Friction does not change its sign, so it is a
coupling: what presses a float harder also holds it back and turns it.
"""

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import eigs

from oracles.chains import matrices
from probe_env.physics.closed_forms import steady_tensions
from probe_env.physics.model.chain import air_speed, build_chain


def sliding_system(scene, nodes_per_pitch, offset):
    """M (3 n,), C and K (3 n, 3 n) of a probe whose root is ``offset`` nodes beyond the last float's place."""
    length = scene.inserted_length + offset * scene.probe.float_pitch / nodes_per_pitch
    chain = build_chain(scene, nodes_per_pitch, length)
    mass, elastic = matrices(chain)
    elastic = sp.csr_matrix(elastic)
    stiffness, damping = elastic.tolil(), (chain.damping_time * elastic).tolil()
    tensions = steady_tensions(scene)
    wind = air_speed(scene, scene.air_supply_rate) - scene.feed_speed
    for i in range(chain.node_count - 1):
        x, y, theta = 3 * i, 3 * i + 1, 3 * i + 2
        k = chain.contact_stiffness[i]
        stiffness[y, y] += k
        stiffness[x, y] -= chain.friction * k
        stiffness[theta, y] -= chain.friction * k * chain.lever[i]
        stiffness[theta, theta] += tensions[min(i // nodes_per_pitch, len(tensions) - 1)] * chain.couple_length
        damping[x, x] += 2.0 * chain.drag[i] * wind
        turning = 2.0 * chain.mass * chain.curvature * scene.feed_speed
        damping[x, y] += turning
        damping[y, x] -= turning
    return np.diag(mass), damping.tocsr(), stiffness.tocsr()


def growth_rates(system, hertz, count=12):
    """Growth rates [1/s] and frequencies [Hz] of the modes nearest to a frequency, the fastest growing first."""
    mass, damping, stiffness = system
    inverse = sp.diags(1.0 / mass)
    blocks = [[None, sp.identity(len(mass))], [-inverse @ stiffness, -inverse @ damping]]
    matrix = sp.bmat(blocks).tocsc().astype(complex)
    start = np.random.default_rng(0).normal(size=2 * len(mass))
    values = eigs(matrix, count, sigma=2j * np.pi * hertz, v0=start, return_eigenvectors=False)
    values = values[np.argsort(-values.real)]
    return values.real, values.imag / (2.0 * np.pi)
