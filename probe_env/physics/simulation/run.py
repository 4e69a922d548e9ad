"""What a simulation returns: signals of named points, tension along the probe, snapshots of its shape."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from tqdm import tqdm

from probe_env.arrays import FloatArray

if TYPE_CHECKING:
    import pandas as pd

QUANTITIES: Final = {"axial": "m", "radial": "m", "rotation": "rad", "tension": "N"}
"""Signals of a run and their units."""


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

    def __repr__(self) -> str:
        return f"<Shapes of {len(self.position)} nodes at {', '.join(f'{time:g}' for time in self.time)} s>"


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

    def to_pandas(self) -> pd.DataFrame:
        """The signals over ``time_s``, a column a point and quantity: ("sensor", "radial_m") and so on."""
        import pandas as pd  # which takes half a second to load

        columns = {
            (point, f"{name}_{unit.lower()}"): getattr(self, name)[:, k]
            for k, point in enumerate(self.points)
            for name, unit in QUANTITIES.items()
        }
        return pd.DataFrame(columns, index=pd.Index(self.time, name="time_s"))

    def summary(self) -> pd.DataFrame:
        """Rms about the mean and largest magnitude of every signal, SI units; a row a point."""
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
        """Draw a quantity of all points over time; needs matplotlib.

        Args:
            quantity: one of ``QUANTITIES``.
            options: of ``pandas.DataFrame.plot``.

        Returns:
            matplotlib's axes.

        Raises:
            ValueError: no such quantity.
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
        """For notebooks."""
        return f"<p>{self.time[0]:g} to {self.time[-1]:g} s, {len(self.time)} samples</p>{self.summary().to_html()}"


def point_name(point: str | float) -> str:
    """Name of a point given by name or by distance from the tip in metres."""
    return point if isinstance(point, str) else f"{float(point):g} m"


@contextmanager
def shown(progress: Callable[[float], None] | bool, start: float, duration: float) -> Iterator[Callable[[float], None]]:
    """What to call with the simulated time [s]: nothing, a bar's update, or a given function."""
    if callable(progress):
        yield progress
        return
    with tqdm(total=round(duration, 6), unit="s", disable=not progress) as bar:

        def tell(time: float) -> None:
            bar.update(round(time - start, 6) - bar.n)

        yield tell
