"""Newmark-beta and Wilson-theta, the methods of the study: coefficients and scratch arrays."""

import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from probe_env.arrays import FloatArray
from probe_env.physics.methods import ticm
from probe_env.physics.methods.method import KernelArguments, Method
from probe_env.physics.model.chain import Chain


class Scheme(NamedTuple):
    """Coefficients of (16) and table 1; h_a and h_v are combinations of the last d, v and a."""

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
    """Scratch of one step: node equations P (n + 1, 7), q (n + 1, 3) and T (n + 1, 9), s (n + 1, 3)."""

    P: FloatArray
    q: FloatArray
    T: FloatArray
    s: FloatArray


def workspace(nodes: int) -> Workspace:
    """Scratch arrays for a chain of ``nodes`` nodes."""
    return Workspace(np.zeros((nodes, 7)), np.zeros((nodes, 3)), np.zeros((nodes, 9)), np.zeros((nodes, 3)))


class Newmark(Method):
    """Newmark's method, beta 1/4 and gamma 1/2; the linear system of a step is solved by the TICM."""

    name = "newmark"
    order = 2
    usual_step = 1e-4
    scheme: Callable[[float], Scheme] = staticmethod(newmark)

    def constants(self, chain: Chain, sensor: int, nodes_per_pitch: int, time_step: float) -> tuple[Chain, Scheme]:
        """Chain and coefficients."""
        return chain, self.scheme(time_step)

    def run(
        self, lanes: Sequence[KernelArguments], time_step: float, per_pitch: int, first_sample: int, sample_every: int
    ) -> float:
        """See ``Method.run``; the group is one probe."""
        (lane,) = lanes
        nodes = len(lane.state.d)
        tension_sum = lane.tension_sum if len(lane.tension_sum) else np.zeros(nodes)
        begin = time.perf_counter()
        arguments: Any = (
            *lane.constants, lane.inputs, lane.root, lane.state, workspace(nodes), first_sample, sample_every,
            lane.points, lane.samples, tension_sum,
        )  # fmt: skip
        status, done, _, lane.root = ticm.advance(*arguments)
        lane.failed = done if status == ticm.DIVERGED else 0
        return time.perf_counter() - begin


class Wilson(Newmark):
    """Wilson's method, theta 1.4."""

    name = "wilson"
    scheme = staticmethod(wilson)
