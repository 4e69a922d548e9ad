"""What a run keeps as it goes on: samples of points, the mean tension along the probe, snapshots of its shape."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from probe_env.arrays import FloatArray
from probe_env.physics.methods import ticm
from probe_env.physics.model.chain import Chain
from probe_env.physics.model.kernel_call import CHANNELS, Sampling
from probe_env.physics.model.state import State
from probe_env.physics.simulation.run import Run, Shapes, point_name

MOST_SAMPLES: Final = 2**31
"""Bytes that the samples of one call may take."""


class Recording:
    """Signals of p points every so many steps of a run, from its start on, and snapshots when told to.

    Args:
        chain: of the probe.
        state: at the start.
        root: node that is held at the start.
        nodes: (p,) that are sampled, -1: the root, which moves as the probe grows.
        steps: of the run.
        every: so many steps a sample.

    Raises:
        ValueError: the samples would not fit in memory.
    """

    def __init__(
        self, chain: Chain, state: State, root: int, nodes: npt.NDArray[np.int64], steps: int, every: int
    ) -> None:
        check_size(steps // every + 1, len(nodes))
        self.element_length, self.root, self.nodes, self.every = chain.element_length, root, nodes, every
        self.samples = np.zeros((steps // every + 1, len(nodes), CHANNELS))
        self.tension_sum = np.zeros(chain.node_count)
        self.shapes: list[tuple[float, FloatArray, FloatArray]] = []
        ticm.record(state, root, nodes, self.samples, 0, np.zeros(chain.node_count))

    def keep_shape(self, time: float, state: State) -> None:
        """Take a snapshot, at a time [s]."""
        self.shapes.append((time, state.d.copy(), state.axial_force.copy()))

    def sampling(self, done: int) -> Sampling:
        """What a kernel samples that goes on after so many steps of the run."""
        rows = self.samples[done // self.every + 1 :]
        counts = np.zeros(2, dtype=np.int64)
        return Sampling(self.every - done % self.every, self.every, self.nodes, rows, self.tension_sum, counts)

    def as_run(self, first: int, time_step: float, points: Sequence[str | float]) -> Run:
        """All that was kept, of a run that began after ``first`` steps of ``time_step`` [s]."""
        h, root, samples = self.element_length, self.root, self.samples
        return Run(
            time=(first + self.every * np.arange(len(samples))) * time_step,
            axial=samples[:, :, 0],
            radial=samples[:, :, 1],
            rotation=samples[:, :, 2],
            tension=samples[:, :, 3],
            points=tuple(point_name(point) for point in points),
            distance_from_tip=np.where(self.nodes < 0, root, self.nodes) * h,
            mean_tension=self.tension_sum[root - 1 :: -1] / max(len(samples) - 1, 1),
            position=(np.arange(root) + 0.5) * h,
            shapes=shapes_of(self.shapes, h) if self.shapes else None,
        )


def node_of(point: str | float, sensor: int, length: float, element_length: float) -> int:
    """Node of a point; -1 for the root, which moves as the probe grows.

    Args:
        point: "sensor", "tip", "root" or a distance from the tip [m].
        sensor: its node.
        length: that is inserted [m].
        element_length: [m].

    Raises:
        ValueError: there is no such point.
    """
    if isinstance(point, str):
        named = {"sensor": sensor, "tip": 0, "root": -1}
        if point not in named:
            raise ValueError(
                f"points: {point!r} is not sensor, tip, root or a distance from the tip of 0 to {length:g} m"
            )
        return named[point]
    if not 0.0 <= point <= length + 1e-9:
        raise ValueError(f"points: {point!r} m from the tip is outside the inserted length 0 to {length:g} m")
    return round(point / element_length)


def shapes_of(stored: list[tuple[float, FloatArray, FloatArray]], h: float) -> Shapes:
    """Snapshots from stored (time, d, axial force) of a probe with elements of length ``h`` [m]."""
    d = np.array([entry[1] for entry in stored])[:, ::-1]
    return Shapes(
        time=np.array([entry[0] for entry in stored]),
        position=np.arange(d.shape[1]) * h,
        axial=d[:, :, 0].copy(),
        radial=d[:, :, 1].copy(),
        rotation=d[:, :, 2].copy(),
        tension=np.array([entry[2][-2::-1] for entry in stored]),
    )


def check_size(rows: int, points: int) -> None:
    """Raise ValueError where the samples would take more than ``MOST_SAMPLES`` bytes."""
    size = 8 * CHANNELS * rows * points
    if size > MOST_SAMPLES:
        raise ValueError(
            f"duration, sample_period, points: {rows} samples of {points} points take {size / 2**30:.3g} GiB, more than"
            f" {MOST_SAMPLES / 2**30:g}: sample less often or fewer points, or advance in pieces"
        )


def snapshot_steps(snapshots: Sequence[float], time_step: float, first: int, steps: int) -> list[int]:
    """Steps of a run that begins with step ``first`` after which its snapshots are due, from their times [s].

    Raises:
        ValueError: not on a time step of the run, or not ascending.
    """
    ratios = [time / time_step - first for time in snapshots]
    for time, ratio in zip(snapshots, ratios, strict=True):
        if not (-1e-6 <= ratio <= steps + 1e-6 and abs(ratio - round(ratio)) <= 1e-6):
            raise ValueError(
                f"snapshots: {time!r} s is not on a time step of {time_step:g} s within this run,"
                f" {first * time_step:g} to {(first + steps) * time_step:g} s"
            )
    whole = [round(ratio) for ratio in ratios]
    if any(later <= earlier for earlier, later in itertools.pairwise(whole)):
        raise ValueError(f"snapshots = {list(snapshots)!r} s must ascend")
    return whole
