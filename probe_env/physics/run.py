"""What a simulation returns: signals of named points, tension along the probe, snapshots of its shape."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probe_env.arrays import FloatArray


@dataclass(frozen=True)
class Shapes:
    """Whole-probe snapshots (the study's figure 19); s snapshots of n + 1 nodes, entrance first.

    Attributes:
        time: (s,) [s].
        position: (n + 1,) distance from the tube's entrance of the unstretched probe [m].
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


@dataclass(frozen=True)
class Run:
    """Signals of p points at k sample times; the first sample is the start of the run.

    Attributes:
        time: (k,) [s].
        axial, radial: (k, p) displacement from the unstretched probe that moves at the feed speed [m].
        rotation: (k, p) [rad].
        tension: (k, p) axial force in the element on the point's root side [N]; for the root, ahead of it.
        points: names of the points, in the order of the columns.
        distance_from_tip: (p,) of the node taken for each point [m].
        mean_tension: (n,) axial force of every element, mean of all samples after the first [N].
        position: (n,) distance of the elements' middle from the tube's entrance [m], entrance first.
        shapes: snapshots, if any were asked for.
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
        """Index of a point's column.

        Raises:
            ValueError: the run has no such point.
        """
        name = point_name(point)
        if name not in self.points:
            raise ValueError(f"point {name!r} was not recorded; this run has {', '.join(self.points)}")
        return self.points.index(name)

    @property
    def sample_period(self) -> float:
        """Time between samples [s]."""
        return float(self.time[1] - self.time[0]) if len(self.time) > 1 else float("nan")


def point_name(point: str | float) -> str:
    """Name of a point given by name or by distance from the tip in metres."""
    return point if isinstance(point, str) else f"{float(point):g} m"


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
