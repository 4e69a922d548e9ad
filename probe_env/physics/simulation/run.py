"""What a simulation returns: signals of named points, tension along the probe, snapshots of its shape."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from probe_env.arrays import FloatArray
from probe_env.physics.methods import ticm
from probe_env.physics.model.chain import Chain
from probe_env.physics.model.state import State

if TYPE_CHECKING:
    import pandas as pd

ROOT: Final = -1
"""Sampled node at the held root, which moves as the probe grows."""
CHANNELS: Final = 4
"""Values of a sample: x, y, theta and V."""
QUANTITIES: Final = {"axial": "m", "radial": "m", "rotation": "rad", "tension": "N"}
"""Signals of a run and their units."""
Progress = Callable[[float], None]


@dataclass(frozen=True)
class Shapes:
    """Snapshots of the whole probe (figure 19 of the study); s snapshots of n + 1 nodes, entrance first.

    Attributes:
        time: (s,) [s].
        position: (n + 1,) distance from the entrance of the tube, unstretched probe [m].
        axial, radial: (s, n + 1) displacement [m].
        rotation: (s, n + 1) [rad].
        tension: (s, n) axial force of the elements [N].
    """

    time: FloatArray
    position: FloatArray
    axial: FloatArray
    radial: FloatArray
    rotation: FloatArray
    tension: FloatArray

    def __repr__(self) -> str:
        return f"<Shapes of {len(self.position)} nodes at {', '.join(f'{time:g}' for time in self.time)} s>"


@dataclass(frozen=True)
class Run:
    """Signals of p points at k sample times; the first sample is the initial state.

    Attributes:
        time: (k,) [s].
        axial, radial: (k, p) displacement from an unstretched probe moving at the feed speed [m].
        rotation: (k, p) [rad].
        tension: (k, p) axial force in the element on the point's root side [N]; for the root, ahead of it, less the
            force of the entrance with ``terms.entrance``.
        points: names of the points, in the order of the columns.
        distance_from_tip: (p,) of the node of each point [m].
        mean_tension: (n,) axial force of every element, mean of all samples after the first [N].
        position: (n,) distance of the middle of each element from the entrance of the tube [m], entrance first.
        shapes: requested snapshots, or None.
    """

    time: FloatArray
    axial: FloatArray
    radial: FloatArray
    rotation: FloatArray
    tension: FloatArray
    points: tuple[str, ...]
    distance_from_tip: FloatArray
    mean_tension: FloatArray
    position: FloatArray
    shapes: Shapes | None = None

    def column(self, point: str | float) -> int:
        """Index of a point's column."""
        name = point_name(point)
        if name not in self.points:
            raise ValueError(f"point {name!r} was not recorded; this run has {', '.join(self.points)}")
        return self.points.index(name)

    @property
    def sample_period(self) -> float:
        """Time between samples [s]."""
        return float(self.time[1] - self.time[0]) if len(self.time) > 1 else float("nan")

    def to_pandas(self) -> pd.DataFrame:
        """Signals over ``time_s``, a column for each point and quantity, such as ("sensor", "radial_m")."""
        import pandas as pd  # takes half a second

        columns = {
            (point, f"{name}_{unit.lower()}"): getattr(self, name)[:, k]
            for k, point in enumerate(self.points)
            for name, unit in QUANTITIES.items()
        }
        return pd.DataFrame(columns, index=pd.Index(self.time, name="time_s"))

    def summary(self) -> pd.DataFrame:
        """Rms about the mean and largest magnitude of every signal, SI units; a row for each point."""
        import pandas as pd

        frame = self.to_pandas()
        figures = {"rms": frame.std(ddof=0), "max": frame.abs().max()}
        rows = {
            point: {
                f"{quantity}_{name}": values[point, quantity]
                for quantity in frame[point]
                for name, values in figures.items()
            }
            for point in self.points
        }
        return pd.DataFrame.from_dict(rows, orient="index")

    def plot(self, quantity: str = "radial", **options: Any) -> Any:
        """Plot a quantity of all points over time; needs matplotlib.

        Args:
            quantity: one of ``QUANTITIES``.
            options: of ``pandas.DataFrame.plot``.

        Returns:
            the axes.
        """
        if quantity not in QUANTITIES:
            raise ValueError(f"quantity = {quantity!r} is not one of {', '.join(QUANTITIES)}")
        unit = QUANTITIES[quantity]
        frame = self.to_pandas().xs(f"{quantity}_{unit.lower()}", axis=1, level=1)
        return frame.plot(xlabel="time [s]", ylabel=f"{quantity} [{unit}]", **options)

    def __repr__(self) -> str:
        rms = ", ".join(
            f"{name} {1e3 * value:.3g}" for name, value in zip(self.points, self.radial.std(axis=0), strict=True)
        )
        span = f"{self.time[0]:g} to {self.time[-1]:g} s"
        return f"<Run of {span}, {len(self.time)} samples; radial rms [mm]: {rms}>"

    def _repr_html_(self) -> str:
        """Table of ``summary`` for notebooks."""
        return f"<p>{self.time[0]:g} to {self.time[-1]:g} s, {len(self.time)} samples</p>{self.summary().to_html()}"


def point_name(point: str | float) -> str:
    """Name of a point given by name or by distance from the tip in metres."""
    return point if isinstance(point, str) else f"{float(point):g} m"


@contextmanager
def progress_bar(progress: Progress | bool, start: float, duration: float) -> Iterator[Progress]:
    """A function of the simulated time [s] that updates a progress bar, or the function given as ``progress``."""
    if callable(progress):
        yield progress
        return
    with tqdm(total=round(duration, 6), unit="s", disable=not progress) as bar:

        def report(time: float) -> None:
            bar.update(round(time - start, 6) - bar.n)

        yield report


MAX_SAMPLES: Final = 2**31
"""Greatest size of the samples of one call [bytes]."""


class Samples(NamedTuple):
    """Arrays in which a kernel stores samples of p points.

    Attributes:
        every: steps between samples.
        points: (p,) nodes; -1 is the root, which moves as the probe grows.
        rows: (k, p, 4) x, y, theta and V.
        tension_sum: (n + 1,) sum of the axial forces of all samples; empty if not requested.
    """

    every: int
    points: npt.NDArray[np.int64]
    rows: FloatArray
    tension_sum: FloatArray


class Recorder:
    """Records signals of p points and snapshots of a run.

    Args:
        chain: the probe.
        state: initial state.
        root: node that is held initially.
        nodes: (p,) sampled nodes; -1 is the root, which moves as the probe grows.
        steps: number of steps of the run.
        every: steps between samples.
    """

    def __init__(
        self, chain: Chain, state: State, root: int, nodes: npt.NDArray[np.int64], steps: int, every: int
    ) -> None:
        check_size(steps // every + 1, len(nodes))
        self.element_length, self.root = chain.element_length, root
        self.signals = np.zeros((steps // every + 1, len(nodes), CHANNELS))
        self.samples = Samples(every, nodes, self.signals[1:], np.zeros(chain.node_count))
        self.shapes: list[tuple[float, FloatArray, FloatArray]] = []
        ticm.record(state, root, nodes, self.signals, 0, np.zeros(chain.node_count))

    def add_snapshot(self, time: float, state: State) -> None:
        """Add a snapshot at a time [s]."""
        self.shapes.append((time, state.d.copy(), state.tension))

    def to_run(self, first: int, time_step: float, points: Sequence[str | float]) -> Run:
        """The recorded run; it began after ``first`` steps of ``time_step`` [s]."""
        h, root, signals, (every, nodes, _, tension_sum) = self.element_length, self.root, self.signals, self.samples
        return Run(
            time=(first + every * np.arange(len(signals))) * time_step,
            axial=signals[:, :, 0],
            radial=signals[:, :, 1],
            rotation=signals[:, :, 2],
            tension=signals[:, :, 3],
            points=tuple(point_name(point) for point in points),
            distance_from_tip=np.where(nodes < 0, root, nodes) * h,
            mean_tension=tension_sum[root - 1 :: -1] / max(len(signals) - 1, 1),
            position=(np.arange(root) + 0.5) * h,
            shapes=self._shapes() if self.shapes else None,
        )

    def _shapes(self) -> Shapes:
        times, displacements, forces = zip(*self.shapes, strict=True)
        d = np.array(displacements)[:, ::-1]
        return Shapes(
            time=np.array(times),
            position=np.arange(d.shape[1]) * self.element_length,
            axial=d[:, :, 0].copy(),
            radial=d[:, :, 1].copy(),
            rotation=d[:, :, 2].copy(),
            tension=np.array(forces)[:, -2::-1].copy(),
        )


def node_of(point: str | float, sensor: int, length: float, element_length: float) -> int:
    """Node of a point; -1 for the root, which moves as the probe grows.

    Args:
        point: "sensor", "tip", "root" or a distance from the tip [m].
        sensor: node of the sensor.
        length: inserted length [m].
        element_length: [m].
    """
    if isinstance(point, str):
        named = {"sensor": sensor, "tip": 0, "root": ROOT}
        if point not in named:
            raise ValueError(
                f"points: {point!r} is not sensor, tip, root or a distance from the tip of 0 to {length:g} m"
            )
        return named[point]
    if not 0.0 <= point <= length + 1e-9:
        raise ValueError(f"points: {point!r} m from the tip is outside the inserted length 0 to {length:g} m")
    return round(point / element_length)


def check_size(rows: int, points: int) -> None:
    """Raise ValueError if the samples need more than ``MAX_SAMPLES`` bytes."""
    size = 8 * CHANNELS * rows * points
    if size > MAX_SAMPLES:
        raise ValueError(
            f"duration, sample_period, points: {rows} samples of {points} points take {size / 2**30:.3g} GiB, more than"
            f" {MAX_SAMPLES / 2**30:g}: increase sample_period, reduce points or advance in several calls"
        )


def snapshot_steps(snapshots: Sequence[float], time_step: float, first: int, steps: int) -> list[int]:
    """Steps after which snapshots are due, from their times [s], for a run that begins with step ``first``."""
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
