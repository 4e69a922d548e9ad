"""Pictures of an episode: the helix from above with the probe in it, and strips of what was done and felt."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from probe_env.arrays import FloatArray
from probe_env.envs.episodes import Episodes

SIZE, DPI = (10.0, 6.0), 100
EXAGGERATION: Final = 20.0  # of the radial displacement, against the gap between two turns
INWARD: Final = 0.55  # how far the drawing winds inwards over the whole helix, so that turns do not overlap
LOWEST_MM, HIGHEST_MM = 1e-3, 3.0


class Renderer:
    """Draws one probe of some episodes; keeps what was done since the episode began.

    Args:
        episodes: where the probe and its last window are.
        index: which probe.
    """

    def __init__(self, episodes: Episodes, index: int = 0) -> None:
        self.episodes, self.index = episodes, index
        self.history: list[tuple[float, ...]] = []
        self._figure: Any = None

    def add(self, info: dict[str, Any], reward: float) -> None:
        """Note a period's info and reward."""
        names = ("time", "inserted_length", "feed_speed", "air_supply_rate", "radial_rms_m")
        self.history.append((*(float(info[name]) for name in names), reward))

    def picture(self) -> npt.NDArray[np.uint8]:
        """(h, w, 3) RGB picture; needs no display."""
        figure = Figure(figsize=SIZE, dpi=DPI)
        canvas: Any = FigureCanvasAgg(figure)
        halves: Any = figure.subfigures(1, 2, width_ratios=(1.0, 1.05))
        self._draw_helix(halves[0])
        self._draw_strips(halves[1])
        canvas.draw()
        return np.asarray(canvas.buffer_rgba())[:, :, :3].copy()

    def show(self) -> None:
        """Show the picture in a window (needs a display and an interactive matplotlib backend)."""
        import matplotlib.pyplot as plt

        if self._figure is None:
            plt.ion()
            self._figure, axis = plt.subplots(figsize=SIZE, layout="constrained")
            axis.axis("off")
            self._image = axis.imshow(self.picture())
        else:
            self._image.set_data(self.picture())
        plt.pause(1e-3)

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._figure is not None:
            import matplotlib.pyplot as plt

            plt.close(self._figure)
            self._figure = None

    def _draw_helix(self, figure: Any) -> None:
        """Tube as a spiral from the entrance inwards, probe coloured by its distance from the inner wall."""
        simulator = self.episodes.batch.simulators[self.index]
        tube = simulator.scene.tube
        nodes = np.arange(simulator.root + 1)
        y = simulator.state.d[nodes, 1]
        place = np.maximum((simulator.root - nodes) * simulator.chain.element_length, 0.0)
        turns = tube.helix_length / (np.pi * tube.helix_diameter)
        gap = INWARD / turns / tube.inner_diameter  # drawn width of the tube's clearance, per metre

        def spiral(s: FloatArray, off: FloatArray | float = 0.0) -> FloatArray:
            angle = 2.0 * s / tube.helix_diameter
            radius = 1.0 - INWARD * s / tube.helix_length + np.asarray(off) * gap
            return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])

        axis = figure.subplots(gridspec_kw={"left": 0.01, "right": 0.92, "bottom": 0.02, "top": 0.94})
        axis.plot(*spiral(np.linspace(0.0, tube.helix_length, 2000)).T, color="0.85", linewidth=1.5)
        line = spiral(place, np.clip(y * EXAGGERATION, -0.3 * tube.inner_diameter, 1.5 * tube.inner_diameter))
        colour = np.clip(np.abs(y) * 1e3, LOWEST_MM, HIGHEST_MM)
        segments = np.stack([line[:-1], line[1:]], axis=1)
        cable = LineCollection(list(segments), cmap="plasma", norm=LogNorm(LOWEST_MM, HIGHEST_MM), linewidth=2.0)
        cable.set_array(colour[:-1])
        axis.add_collection(cable)
        axis.plot(*line[simulator.sensor], "o", color="#1a7f37", markersize=7, label="sensor")
        axis.set(xlim=(-1.15, 1.15), ylim=(-1.15, 1.15), aspect="equal")
        axis.axis("off")
        axis.legend(loc="lower left", frameon=False, fontsize=8)
        label = f"radial displacement [mm], drawn x {EXAGGERATION:g}"
        figure.colorbar(cable, ax=axis, shrink=0.6, pad=0.02, label=label)
        inserted = min(simulator.inserted_length, tube.helix_length)
        diameter = tube.helix_diameter
        axis.set_title(f"{inserted:.1f} of {tube.helix_length:g} m in a helix of {diameter:g} m", fontsize=10)

    def _draw_strips(self, figure: Any) -> None:
        # fixed places: a layout that is computed anew costs more than the drawing, and moves from frame to frame
        places = {"left": 0.15, "right": 0.97, "bottom": 0.08, "top": 0.97, "hspace": 0.6}
        axes = figure.subplots(5, 1, gridspec_kw=places)
        window = self.episodes.window
        if window is not None and window.time is not None and window.radial is not None:
            axes[0].plot(window.time, window.radial[:, self.index] * 1e3, color="#1f5fa8", linewidth=0.6)
        axes[0].set_ylabel("sensor y\n[mm]", fontsize=8)
        axes[0].set_xlabel("time in the period [s]", fontsize=7)
        time, length, feed, air, rms, reward = np.array(self.history).T
        growing = self.episodes.config.growing
        x = length if growing else time
        strips = (
            (feed, "feed\n[m/s]", self.episodes.config.feed_speeds),
            (air * 3600.0, "air\n[m3/h]", tuple(q * 3600.0 for q in self.episodes.config.air_supply_rates)),
            (rms * 1e3, "radial rms\n[mm]", None),
            (reward, "reward", None),
        )
        for axis, (values, label, limits) in zip(axes[1:], strips, strict=True):
            axis.plot(x, values, color="#1f5fa8", linewidth=1.0)
            axis.set_ylabel(label, fontsize=8)
            if limits:
                axis.set_ylim(0.0, 1.05 * limits[1])
        if self.episodes.config.vibration_measure == "displacement":
            axes[3].axhline(self.episodes.config.limit * 1e3, color="#c0392b", linewidth=0.8)
        end = self.episodes.batch.simulators[self.index].scene.tube.helix_length if growing else None
        for axis in axes[1:]:
            axis.set_xlim((0.0, end) if growing else (0.0, self.episodes.config.time_limit))
        for axis in axes:
            axis.tick_params(labelsize=7)
            axis.grid(color="0.92")
        axes[-1].set_xlabel("inserted length [m]" if growing else "time [s]", fontsize=8)
