"""Newmark-beta and Wilson-theta as coefficients, and the scratch of a step."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from probe_env.arrays import FloatArray


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


class Work(NamedTuple):
    """Scratch of one step: node equations P (n + 1, 6), q (n + 1, 3) and T (n + 1, 9), s (n + 1, 3)."""

    P: FloatArray
    q: FloatArray
    T: FloatArray
    s: FloatArray


def workspace(nodes: int) -> Work:
    """Scratch arrays for a chain of ``nodes`` nodes."""
    return Work(np.zeros((nodes, 6)), np.zeros((nodes, 3)), np.zeros((nodes, 9)), np.zeros((nodes, 3)))
