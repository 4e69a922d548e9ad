"""The methods by name, each as one function that advances a probe by the rows of an input table."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Final

from probe_env.arrays import FloatArray
from probe_env.physics.chain import Chain
from probe_env.physics.kernel_call import Sampling, check_call, check_chain, check_lane_chain
from probe_env.physics.methods import banded, implicit, ticm, transfer_matrix
from probe_env.physics.methods.factors import implicit_weights
from probe_env.physics.methods.lane_group import KERNELS, Lane, advance_group, lane_constants
from probe_env.physics.methods.newmark import Scheme, Work, newmark, wilson, workspace
from probe_env.physics.state import State

SOLVERS: Final = ("ticm", "banded", "transfer-matrix")
SCHEMES: Final[dict[str, Callable[[float], Scheme]]] = {"newmark": newmark, "wilson": wilson}
METHODS: Final = (*SCHEMES, "implicit", *KERNELS)


Advance = Callable[[FloatArray, int, State, Sampling], tuple[int, int, int, int]]
"""(inputs, root, state, sampling) -> (status, steps done, diverged node or -1, root)."""


def build_method(
    method: str, solver: str, chain: Chain, time_step: float, sensor: int, nodes_per_pitch: int
) -> Advance:
    """The advance function of a method, with its constant matrices and scratch prepared.

    ``sensor`` is the sensor's node; guide floats reach from the tip up to it. What the function is called with is
    checked once a call: an array that does not fit the chain is a ``ValueError`` that names it.

    Raises:
        ValueError: no such method or solver, arrays of the chain that do not fit each other, or a chain with what the
            method does not simulate.
    """
    if method not in METHODS:
        raise ValueError(f"method = {method!r} is not one of {', '.join(METHODS)}")
    if solver not in SOLVERS:
        raise ValueError(f"solver = {solver!r} is not one of {', '.join(SOLVERS)}")
    check_chain(chain, sensor, nodes_per_pitch)
    return partial(_checked, _unchecked(method, solver, chain, time_step, sensor, nodes_per_pitch), chain.node_count)


def _checked(
    advance: Advance, nodes: int, inputs: FloatArray, root: int, state: State, sampling: Sampling
) -> tuple[int, int, int, int]:
    check_call(nodes, inputs, root, state, sampling)
    return advance(inputs, root, state, sampling)


def _unchecked(method: str, solver: str, chain: Chain, time_step: float, sensor: int, nodes_per_pitch: int) -> Advance:
    if method in KERNELS:
        if solver != "ticm":
            raise ValueError(f"solver = {solver!r} is for newmark and wilson; {method} has its own")
        check_lane_chain(method, chain, sensor, nodes_per_pitch)
        return partial(
            _single_lane, method, time_step, nodes_per_pitch,
            *lane_constants(method, chain, sensor, nodes_per_pitch, time_step),
        )  # fmt: skip
    if method == "implicit":
        if solver != "ticm":
            raise ValueError(f"solver = {solver!r} is for newmark and wilson; implicit is solved by the TICM alone")
        return _implicit(chain, time_step, nodes_per_pitch)
    scheme = SCHEMES[method](time_step)
    work = workspace(chain.node_count)
    if solver == "banded":
        return partial(_step_by_step, banded.stepper(chain, scheme), work)
    if solver == "transfer-matrix":
        return partial(_step_by_step, partial(transfer_matrix.step, chain, scheme), work)

    def advance(inputs: FloatArray, root: int, state: State, sampling: Sampling) -> tuple[int, int, int, int]:
        result: tuple[int, int, int, int] = ticm.advance(chain, scheme, inputs, root, state, work, *sampling[:5])
        return result

    return advance


def _implicit(chain: Chain, time_step: float, nodes_per_pitch: int) -> Advance:
    weights = (time_step, *implicit_weights(chain.damping_time, time_step))
    limits, places = implicit.couple_limits(chain, nodes_per_pitch), implicit.contact_places(chain)
    work = implicit.workspace(chain.node_count)

    def advance(inputs: FloatArray, root: int, state: State, sampling: Sampling) -> tuple[int, int, int, int]:
        result: tuple[int, int, int, int] = implicit.advance(
            chain, weights, limits, places, inputs, root, state, work, *sampling
        )
        return result

    return advance


def _step_by_step(
    step: banded.Step,
    work: Work,
    inputs: FloatArray,
    root: int,
    state: State,
    sampling: Sampling,
) -> tuple[int, int, int, int]:
    """The loop of ``ticm.advance`` in Python, for solvers that are not fused with it."""
    row, due = 0, sampling.first
    for k, step_inputs in enumerate(inputs):
        node = step(step_inputs, root, state, work)
        if node >= 0:
            return ticm.DIVERGED, k + 1, node, root
        root += int(step_inputs[3])
        due -= 1
        if due == 0:
            due = sampling.every
            ticm.record(state, root, sampling.points, sampling.samples, row, sampling.tension_sum)
            row += 1
    return ticm.OK, len(inputs), -1, root


def _single_lane(
    method: str,
    time_step: float,
    nodes_per_pitch: int,
    parameters: FloatArray,
    factors: FloatArray,
    inputs: FloatArray,
    root: int,
    state: State,
    sampling: Sampling,
) -> tuple[int, int, int, int]:
    """One probe by the kernels of the batch: a batch of one."""
    lane = Lane(parameters, factors, state, root)
    first, every, points, samples, tension_sum, _ = sampling
    rows = samples[: max(0, (len(inputs) - first) // every + 1)]
    (failed,) = advance_group(
        method, [lane], [inputs], time_step, nodes_per_pitch, first, every, [points], [rows], tension_sum
    )
    status = ticm.DIVERGED if failed else ticm.OK
    return status, failed or len(inputs), -1, lane.root
