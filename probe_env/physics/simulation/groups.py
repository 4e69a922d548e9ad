"""Probes of a batch that advance together, in the lanes of one kernel call, or one by itself."""

from __future__ import annotations

import contextlib
import itertools
import time
from collections.abc import Hashable, Sequence

import numpy as np

from probe_env.arrays import FloatArray
from probe_env.errors import SimulationError
from probe_env.physics.methods import method_named
from probe_env.physics.methods.lane_group import Lane
from probe_env.physics.model.kernel_call import Sampling
from probe_env.physics.simulation.simulator import STEPS_PER_CALL, Simulator


def groups_of(simulators: Sequence[Simulator], running: Sequence[int]) -> list[list[int]]:
    """Which of the ``running`` probes advance together: of a kind, about equally long, as many as there are lanes.

    So few that each by itself takes less time do that. All are of one method.
    """
    if not running:
        return []
    method = method_named(simulators[running[0]].method)
    kernel = method.lanes
    kinds: dict[Hashable, list[int]] = {}
    for k in sorted(running, key=lambda k: simulators[k].root):
        kind = kernel.kind(simulators[k].lane_constants()[1]) if kernel else None
        kinds.setdefault(kind, []).append(k)
    groups: list[list[int]] = []
    for same in kinds.values():
        for start in range(0, len(same), method.width):
            group = same[start : start + method.width]
            groups += [[k] for k in group] if len(group) * method.alone_share < 1.0 else [group]
    return groups


def advance_group(
    simulators: Sequence[Simulator], group: Sequence[int], steps: int, every: int, signals: FloatArray
) -> float:
    """Advance the probes of a group; returns the seconds that the kernels took.

    Args:
        simulators: of the batch.
        group: places of those that advance.
        steps: to do.
        every: so many steps a sample is taken.
        signals: (N, 2 + samples, 3) sensor x and y [m] and root tension [N] go here, after two samples of before.
    """
    members = [simulators[k] for k in group]
    kernel = method_named(members[0].method).lanes
    if kernel is None:
        return _advance_one(members[0], steps, every, signals[group[0]])
    none = np.zeros((0, 2, 4))
    lanes = [
        Lane(*s.lane_constants(), s.state, s.root, np.array([s.sensor, -1], dtype=np.int64), none[:, 0], none)
        for s in members
    ]
    done, seconds = 0, 0.0
    while done < steps and group:
        stretch = min(steps - done, STEPS_PER_CALL)
        first = every - done % every
        rows = max(0, (stretch - first) // every + 1)
        for lane, simulator in zip(lanes, members, strict=True):
            lane.inputs, lane.samples = simulator.inputs_of_steps(stretch), np.zeros((rows, 2, 4))
        failed, spent = kernel.run(lanes, members[0].time_step, members[0].nodes_per_pitch, first, every)
        seconds += spent
        start = 2 + done // every
        for k, lane, simulator, step in zip(group, lanes, members, failed, strict=True):
            signals[k, start : start + rows, 0:2] = lane.samples[:, 0, 0:2]
            signals[k, start : start + rows, 2] = lane.samples[:, 1, 3]
            simulator.note_steps(step or stretch, lane.root, diverged=step > 0)
        held = [not step for step in failed]
        lanes, members = list(itertools.compress(lanes, held)), list(itertools.compress(members, held))
        group = list(itertools.compress(group, held))
        done += stretch
    return seconds


def _advance_one(simulator: Simulator, steps: int, every: int, signals: FloatArray) -> float:
    """``advance_group`` for a method that does not run in lanes; ``signals`` are this probe's."""
    points, samples = np.array([simulator.sensor, -1], dtype=np.int64), np.zeros((steps // every, 2, 4))
    tension_sum, counts = np.zeros(simulator.chain.node_count), np.zeros(2, dtype=np.int64)
    begin = time.perf_counter()
    with contextlib.suppress(SimulationError):  # kept by the simulator, reported in the window
        simulator.advance_steps(steps, Sampling(every, every, points, samples, tension_sum, counts))
    seconds = time.perf_counter() - begin
    signals[2:, 0:2] = samples[:, 0, 0:2]
    signals[2:, 2] = samples[:, 1, 3]
    return seconds
