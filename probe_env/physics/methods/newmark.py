"""Newmark-beta and Wilson-theta, the study's methods: coefficients, scratch of a step, and steps by any solver."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from probe_env.arrays import FloatArray
from probe_env.physics.methods import ticm
from probe_env.physics.methods.method import Lane, Method
from probe_env.physics.model.chain import Chain
from probe_env.physics.model.state import State


class Scheme(NamedTuple):
    """Coefficients of (16) and table 1, with h_a and h_v as combinations of the last d, v and a."""

    time_step: float
    theta: float
    wilson: bool
    B_a: float
    B_v: float
    a_d: float
    a_v: float
    a_a: float
    v_d: float
    v_v: float
    v_a: float


def newmark(time_step: float, beta: float = 0.25, gamma: float = 0.5) -> Scheme:
    """Newmark-beta of table 1."""
    dt = time_step
    a_d, a_v, a_a = -1.0 / (beta * dt**2), -1.0 / (beta * dt), -(0.5 - beta) / beta
    return Scheme(
        dt, 1.0, False, -a_d, gamma / (beta * dt),
        a_d, a_v, a_a,
        dt * gamma * a_d, 1.0 + dt * gamma * a_v, dt * (1.0 - gamma + gamma * a_a),
    )  # fmt: skip


def wilson(time_step: float, theta: float = 1.4) -> Scheme:
    """Wilson-theta of table 1: the system is solved at t + theta dt."""
    dt = theta * time_step
    return Scheme(
        time_step, theta, True, 6.0 / dt**2, 3.0 / dt,
        -6.0 / dt**2, -6.0 / dt, -2.0,
        -3.0 / dt, -2.0, -dt / 2.0,
    )  # fmt: skip


class Workspace(NamedTuple):
    """Scratch of one step: node equations P (n + 1, 6), q (n + 1, 3) and T (n + 1, 9), s (n + 1, 3)."""

    P: FloatArray
    q: FloatArray
    T: FloatArray
    s: FloatArray


def workspace(nodes: int) -> Workspace:
    """Scratch arrays for a chain of ``nodes`` nodes."""
    return Workspace(np.zeros((nodes, 6)), np.zeros((nodes, 3)), np.zeros((nodes, 9)), np.zeros((nodes, 3)))


Step = Callable[[FloatArray, int, State, Workspace], int]
"""(inputs of a step, root, state, work) -> first diverged node or -1."""
Solver = Callable[[Chain, Scheme], Step]
"""A solver of the linear system (17)-(18), constant matrices prepared."""


class Newmark(Method):
    """Newmark's method, beta 1/4 and gamma 1/2.

    Args:
        solver: of the linear system of a step; default: the TICM, in one compiled loop.
    """

    name = "newmark"
    order = 2
    usual_step = 1e-4
    scheme: Callable[[float], Scheme] = staticmethod(newmark)

    def __init__(self, solver: Solver | None = None) -> None:
        self.solver = solver

    def constants(
        self, chain: Chain, sensor: int, nodes_per_pitch: int, time_step: float
    ) -> tuple[Chain, Scheme, Step | None]:
        """Chain, coefficients and, with a solver, its step."""
        scheme = self.scheme(time_step)
        return chain, scheme, self.solver(chain, scheme) if self.solver else None

    def run(
        self, lanes: Sequence[Lane], time_step: float, nodes_per_pitch: int, first_sample: int, sample_every: int
    ) -> float:
        """See ``Method.run``; the group is one probe."""
        (lane,) = lanes
        chain, scheme, step = lane.constants
        tension_sum = lane.tension_sum if len(lane.tension_sum) else np.zeros(chain.node_count)
        work, sampling = workspace(chain.node_count), (lane.points, lane.samples, tension_sum)
        begin = time.perf_counter()
        if step is None:
            status, done, _, lane.root = ticm.advance(
                chain, scheme, lane.inputs, lane.root, lane.state, work, first_sample, sample_every, *sampling
            )
            lane.failed = done if status == ticm.DIVERGED else 0
        else:  # the same loop in Python, for solvers that are not fused with it
            for k, step_inputs in enumerate(lane.inputs):
                if step(step_inputs, lane.root, lane.state, work) >= 0:
                    lane.failed = k + 1
                    break
                lane.root = ticm.move_root(chain, step_inputs, lane.root, lane.state)
                row, left = divmod(k + 1 - first_sample, sample_every)
                if row >= 0 and left == 0:
                    points, samples, tensions = sampling
                    ticm.record(lane.state, lane.root, points, samples, row, tensions)
        return time.perf_counter() - begin


class Wilson(Newmark):
    """Wilson's method, theta 1.4."""

    name = "wilson"
    scheme = staticmethod(wilson)
