"""Chains with closed-form solutions, run on the kernels of the simulator; no scene describes them."""

import numpy as np

from probe_env.physics.closed_forms import bare_chains
from probe_env.physics.methods import ticm
from probe_env.physics.methods.newmark import newmark, workspace
from probe_env.physics.model.chain import element_blocks, element_stiffness
from probe_env.physics.model.drive import Drive
from probe_env.physics.model.state import at_rest


def uniform_chain(elements, **changes):
    """A straight chain of the cable of table 2 with elasticity only, without damping."""
    return bare_chains.uniform_chain(elements, **({"damping_time": 0.0} | changes))


def bent(chain, helix_diameter=1.2):
    """The same chain with the frame angle of a helix, but without its inertia terms."""
    sin_phi = chain.element_length / helix_diameter
    return chain._replace(sin_phi=sin_phi, cos_phi=np.sqrt(1.0 - sin_phi**2))


def advance(chain, scheme, state, steps, every, points=(0,), feed=0.0, air=0.0, work=None):
    """Kernel call with constant inputs and samples (k, p, 4); returns status and samples."""
    nodes = chain.node_count
    inputs = Drive(feed, air).inputs_of_steps(steps, scheme.time_step, chain.element_length, 0)
    samples = np.zeros((steps // every, len(points), 4))
    points = np.array(points, dtype=np.int64)
    work = workspace(nodes) if work is None else work
    sums = np.zeros(nodes)
    status, *_ = ticm.advance(chain, scheme, inputs, nodes - 1, state, work, every, every, points, samples, sums)
    return status, samples


def integrate(chain, scheme, d=None, v=None, a=None, steps=1, every=1, **inputs):
    """Samples (k, p, 4) of x, y, theta, V after every ``every`` steps, and the final state."""
    state = at_rest(chain.node_count)
    for target, start in zip((state.d, state.v, state.memory[:, :3]), (d, v, a), strict=True):
        if start is not None:
            target[:] = start
    status, samples = advance(chain, scheme, state, steps, every, **inputs)
    assert status == ticm.OK
    return samples, state


def tip_equation(chain, inputs, state):
    """P and q of (17) at the tip, for feed speed, its slope and air speed."""
    work = workspace(chain.node_count)
    ticm.node_equation(chain, newmark(1e-4), *inputs[:3], state, 0, work.P, work.q)
    return work.P[0], work.q[0]


def matrices(chain):
    """Dense mass and stiffness (3 n, 3 n) of the free nodes, tip first, from the element matrices."""
    n = chain.node_count - 1
    head, tail = element_blocks(chain)
    stiffness = element_stiffness(chain)
    both = np.hstack([head, tail])
    element = both.T @ stiffness @ both
    K = np.zeros((3 * n + 3, 3 * n + 3))
    for i in range(n):
        K[3 * i : 3 * i + 6, 3 * i : 3 * i + 6] += element
    K += np.diag(chain.support_stiffness.ravel())
    M = np.diag(np.tile([chain.mass, chain.mass, chain.inertia], n))
    return M, K[: 3 * n, : 3 * n]


def row_of_pieces(modes, matrices):
    """Sum of the pieces' matrices in a row from the tip, the last end held.

    Unknowns: for every piece its tip-side end, then its modes.
    """
    width = 3 + modes
    whole = np.zeros((width * len(matrices) + 3,) * 2)
    for k, matrix in enumerate(matrices):
        first = k * width
        own = np.r_[first : first + 3, first + width : first + width + 3, first + 3 : first + width]
        whole[np.ix_(own, own)] += matrix
    return whole[:-3, :-3]


def energy(M, K, state):
    """Kinetic plus elastic energy [J]."""
    d, v = state.d[:-1].ravel(), state.v[:-1].ravel()
    return 0.5 * v @ M @ v + 0.5 * d @ K @ d
