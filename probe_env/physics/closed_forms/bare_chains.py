"""Chains with a closed form, run on the kernels of the methods themselves: what no scene has is set in the arrays."""

from __future__ import annotations

import math
import time
from typing import Any, NamedTuple

import numpy as np

from probe_env.arrays import FloatArray
from probe_env.physics.methods import method_named
from probe_env.physics.methods.factors import node_matrices
from probe_env.physics.methods.method import Lane
from probe_env.physics.model.chain import Chain, build_chain
from probe_env.physics.model.drive import Drive
from probe_env.physics.model.state import State, check_state
from probe_env.scene import Scene

LAPACK = "newmark (LAPACK)"
"""Newmark with the banded solver of LAPACK in place of the TICM."""
AXIAL, RADIAL = 0, 1


class Driven(NamedTuple):
    """A chain, its sensor's node, the constant feed speed and air speed [m/s] that it is driven with, nodes a pitch."""

    chain: Chain
    sensor: int = 0
    feed_speed: float = 0.0
    air_speed: float = 0.0
    nodes_per_pitch: int = 4


class ChainRun(NamedTuple):
    """Whether a run held; samples (k, 4) of x, y, theta and V of a node; sweeps; processor time of its thread [s]."""

    held: bool
    samples: FloatArray
    sweeps: int
    cpu: float


def plain_chain(elements: int, **changes: Any) -> Chain:
    """Table 2's cable, straight, with nothing but elasticity and damping."""
    nodes = elements + 1
    scene = Scene.model_validate({"tube": {"helix_diameter": 1e4, "helix_length": 1000.0}, "carrier_length": 0.1})
    none = np.zeros(nodes)
    plain = build_chain(scene)._replace(
        cos_phi=1.0, sin_phi=0.0, curvature=0.0, couple_length=0.0, frame_inertia=0.0, friction=0.0,
        contact_stiffness=none, outer_gap=np.full(nodes, np.inf), lever=none, drag=none,
        support_stiffness=np.zeros((nodes, 3)), load=np.zeros((nodes, 3)),
    )  # fmt: skip
    return plain._replace(**changes)


def bent_chain(elements: int, helix_diameter: float = 1.2, **changes: Any) -> Chain:
    """The same with the frame angle of a helix, but without its inertia terms."""
    sin_phi = plain_chain(1).element_length / helix_diameter
    return plain_chain(elements, sin_phi=sin_phi, cos_phi=float(np.sqrt(1.0 - sin_phi**2)), **changes)


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
    method: str, driven: Driven, time_step: float, state: State, steps: int, every: int, node: int = 0
) -> ChainRun:
    """Advance a state in place by a method (or ``LAPACK``), a node sampled every so many steps."""
    chain, sensor, feed_speed, air_speed, per_pitch = driven
    scheme, solver = ("newmark", "banded") if method == LAPACK else (method, "ticm")
    kernel, root = method_named(scheme, solver), chain.node_count - 1
    check_state(state, root, chain.node_count, kernel.memory)
    constants = kernel.constants(chain, sensor, per_pitch, time_step)
    inputs = Drive(feed_speed, air_speed).inputs_of_steps(steps, time_step, chain.element_length, 0)
    points, samples = np.array([node], dtype=np.int64), np.zeros((steps // every, 1, 4))
    lane = Lane(constants, state, root, inputs, points, samples, np.zeros(0))
    begin = time.thread_time()
    kernel.run([lane], time_step, per_pitch, every, every)
    spent = time.thread_time() - begin
    held = not lane.failed and bool(np.isfinite(state.d).all())
    return ChainRun(held, samples[:, 0], max(lane.failed or steps, lane.iterations), spent)


def linear_chain(chain: Chain, times: FloatArray, before: FloatArray, load: FloatArray) -> FloatArray:
    """Displacements (k, n, 3) of a damped chain without contact that rested under one load when another one set in.

    Every mode obeys q'' + delta lambda q' + lambda q = p; exact for the discrete chain, so what a method is off by is
    its error in time alone. The chain must be without the frame's inertia terms.

    Args:
        chain: n nodes and the held root.
        times: (k,) since the change [s]; 0 gives the rest under the load before.
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
    """Height (k,) of a free mass above a spring that it flies at and leaves again; the contact lasts pi / omega."""
    omega = math.sqrt(stiffness / mass)
    arrival = height / speed
    departure = arrival + math.pi / omega
    inside = -speed / omega * np.sin(omega * (times - arrival))
    return np.where(
        times < arrival, height - speed * times, np.where(times < departure, inside, speed * (times - departure))
    )
