"""Newmark-beta and Wilson-theta, the study's methods: coefficients, scratch of a step, and steps by any solver."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from probe_env.arrays import FloatArray
from probe_env.physics.methods import ticm
from probe_env.physics.methods.method import Advance, Method, Prepare
from probe_env.physics.model.chain import Chain
from probe_env.physics.model.kernel_call import Sampling
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


def _by_ticm(
    scheme_of: Callable[[float], Scheme], chain: Chain, time_step: float, sensor: int, nodes_per_pitch: int
) -> Advance:
    scheme, work = scheme_of(time_step), workspace(chain.node_count)

    def advance(inputs: FloatArray, root: int, state: State, sampling: Sampling) -> tuple[int, int, int, int]:
        result: tuple[int, int, int, int] = ticm.advance(chain, scheme, inputs, root, state, work, *sampling[:5])
        return result

    return advance


def _solved_by(scheme_of: Callable[[float], Scheme], solver: Solver) -> Prepare:
    def prepare(chain: Chain, time_step: float, sensor: int, nodes_per_pitch: int) -> Advance:
        return partial(_step_by_step, chain, solver(chain, scheme_of(time_step)), workspace(chain.node_count))

    return prepare


def _step_by_step(
    chain: Chain, step: Step, work: Workspace, inputs: FloatArray, root: int, state: State, sampling: Sampling
) -> tuple[int, int, int, int]:
    """The loop of ``ticm.advance`` in Python, for solvers that are not fused with it."""
    row, due = 0, sampling.first
    for k, step_inputs in enumerate(inputs):
        node = step(step_inputs, root, state, work)
        if node >= 0:
            return ticm.DIVERGED, k + 1, node, root
        root = ticm.move_root(chain, step_inputs, root, state)
        due -= 1
        if due == 0:
            due = sampling.every
            ticm.record(state, root, sampling.points, sampling.samples, row, sampling.tension_sum)
            row += 1
    return ticm.OK, len(inputs), -1, root


NEWMARK = Method("newmark", partial(_by_ticm, newmark), 2, 1e-4, solved_by=partial(_solved_by, newmark))
WILSON = Method("wilson", partial(_by_ticm, wilson), 2, 1e-4, solved_by=partial(_solved_by, wilson))
