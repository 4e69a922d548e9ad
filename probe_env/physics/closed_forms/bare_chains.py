"""Chains with closed-form solutions and their simulation by any method; no scene describes these chains."""

import math
import time
from typing import Any, NamedTuple

import numpy as np

from probe_env.arrays import FloatArray
from probe_env.physics.methods import method_named
from probe_env.physics.methods.factors import node_matrices
from probe_env.physics.methods.method import KernelArguments
from probe_env.physics.model.chain import Chain, build_chain
from probe_env.physics.model.drive import Drive
from probe_env.physics.model.state import State, check_state
from probe_env.scene import Scene

AXIAL, RADIAL = 0, 1


class DrivenChain(NamedTuple):
    """A chain, the node of its sensor, constant feed speed and air speed [m/s], and nodes per pitch."""

    chain: Chain
    sensor: int = 0
    feed_speed: float = 0.0
    air_speed: float = 0.0
    nodes_per_pitch: int = 4


class ChainRun(NamedTuple):
    """Whether a run was stable; samples (k, 4) of x, y, theta and V of a node; sweeps; processor time [s]."""

    stable: bool
    samples: FloatArray
    sweeps: int
    cpu: float


def uniform_chain(elements: int, **changes: Any) -> Chain:
    """Straight cable of table 2 with elasticity and damping only."""
    nodes = elements + 1
    scene = Scene.model_validate({"tube": {"helix_diameter": 1e4, "helix_length": 1000.0}, "carrier_length": 0.1})
    none = np.zeros(nodes)
    uniform = build_chain(scene)._replace(
        cos_phi=1.0, sin_phi=0.0, curvature=0.0, couple_length=0.0, frame_inertia=0.0, friction=0.0,
        contact_stiffness=none, outer_gap=np.full(nodes, np.inf), lever=none, drag=none,
        support_stiffness=np.zeros((nodes, 3)), load=np.zeros((nodes, 3)),
    )  # fmt: skip
    return uniform._replace(**changes)


def bent_chain(elements: int, helix_diameter: float = 1.2, **changes: Any) -> Chain:
    """``uniform_chain`` with the frame angle of a helix, but without its inertia terms."""
    sin_phi = uniform_chain(1).element_length / helix_diameter
    return uniform_chain(elements, sin_phi=sin_phi, cos_phi=float(np.sqrt(1.0 - sin_phi**2)), **changes)


def linear_matrix(chain: Chain) -> FloatArray:
    """(3 n, 3 n) M^-1 K of the free nodes, tip first."""
    n = chain.node_count - 1
    tip, inner, ahead, behind = node_matrices(chain)
    matrix = np.kron(np.eye(n), inner) + np.kron(np.eye(n, k=1), ahead) + np.kron(np.eye(n, k=-1), behind)
    matrix[:3, :3] = tip
    return np.asarray(matrix)


def masses(chain: Chain) -> FloatArray:
    """(3 n,) diagonal of M of the free nodes."""
    return np.tile([chain.mass, chain.mass, chain.inertia], chain.node_count - 1)


def run_chain(
    method: str, driven: DrivenChain, time_step: float, state: State, steps: int, every: int, node: int = 0
) -> ChainRun:
    """Advance a state in place by a method, sampling a node after every ``every`` steps."""
    chain, sensor, feed_speed, air_speed, per_pitch = driven
    kernel, root = method_named(method), chain.node_count - 1
    check_state(state, root, chain.node_count, kernel.memory)
    constants = kernel.constants(chain, sensor, per_pitch, time_step)
    inputs = Drive(feed_speed, air_speed).inputs_of_steps(steps, time_step, chain.element_length, 0)
    points, samples = np.array([node], dtype=np.int64), np.zeros((steps // every, 1, 4))
    lane = KernelArguments(constants, state, root, inputs, points, samples, np.zeros(0))
    begin = time.thread_time()
    kernel.run([lane], time_step, per_pitch, every, every)
    spent = time.thread_time() - begin
    stable = not lane.failed and bool(np.isfinite(state.d).all())
    return ChainRun(stable, samples[:, 0], max(lane.failed or steps, lane.iterations), spent)


def linear_chain(chain: Chain, times: FloatArray, before: FloatArray, load: FloatArray) -> FloatArray:
    """Displacements (k, n, 3) of a damped chain without contact after a step from one constant load to another.

    Every mode obeys q'' + delta lambda q' + lambda q = p. The solution is exact for the discrete chain, so the error of
    a method is its error in time. The chain must not have the inertia terms of the frame.

    Args:
        chain: n nodes and the held root.
        times: (k,) since the change [s]; at 0 the chain is at rest under the first load.
        before: (n, 3) load until then [N], [N m].
        load: (n, 3) load from then on.
    """
    root_mass = np.sqrt(masses(chain))
    symmetric = root_mass[:, None] * linear_matrix(chain) / root_mass
    squares, modes = np.linalg.eigh(0.5 * (symmetric + symmetric.T))
    start, at_rest = (modes.T @ (force.ravel() / root_mass) / squares for force in (before, load))
    discriminant = np.sqrt((chain.damping_time * squares).astype(complex) ** 2 - 4.0 * squares)
    slow, fast = (0.5 * (sign * discriminant - chain.damping_time * squares) for sign in (1.0, -1.0))
    amplitude = (start - at_rest) / (slow - fast)
    moving = amplitude * (slow * np.exp(np.outer(times, fast)) - fast * np.exp(np.outer(times, slow)))
    return np.asarray(((at_rest + moving.real) @ modes.T / root_mass).reshape(len(times), -1, 3))


def impact(mass: float, stiffness: float, height: float, speed: float, times: FloatArray) -> FloatArray:
    """Height (k,) of a free mass that hits a spring and rebounds; the contact lasts pi / omega."""
    omega = math.sqrt(stiffness / mass)
    arrival = height / speed
    departure = arrival + math.pi / omega
    inside = -speed / omega * np.sin(omega * (times - arrival))
    return np.where(
        times < arrival, height - speed * times, np.where(times < departure, inside, speed * (times - departure))
    )
