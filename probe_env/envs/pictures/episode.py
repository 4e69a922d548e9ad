"""Pictures of an episode: top view of the helix with the probe, and plots of actions and signals."""

from typing import Any, Final

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from probe_env.arrays import FloatArray
from probe_env.envs.episodes import Episodes
from probe_env.envs.pictures.plate import BLUE, DPI, GREEN, QUIET_MM, RED, SIZE, Picture, Plate, label_of, limits_around
from probe_env.envs.task.config import TaskConfig
from probe_env.physics.simulation.simulator import Simulator
from probe_env.physics.simulation.window import Window

EXAGGERATION: Final = 20.0  # of the radial displacement, relative to the gap between two turns
INWARD: Final = 0.55  # inward shift over the whole helix, so that turns do not overlap
WIDEST: Final = 0.06  # greatest gap between two turns
LOWEST_MM, HIGHEST_MM = 1e-3, 3.0


class Helix:
    """Draws the tube of a simulator into a figure, as a spiral from the entrance inwards.

    Attributes:
        moving: the artists that ``update`` changes.
    """

    def __init__(self, figure: Any, simulator: Simulator) -> None:
        self._tube = tube = simulator.scene.tube
        turns = tube.helix_length / (np.pi * tube.helix_diameter)
        self._gap = min(INWARD / turns, WIDEST)
        self._inward = self._gap * turns
        axes = figure.subplots(gridspec_kw={"left": 0.01, "right": 0.92, "bottom": 0.02, "top": 0.94})
        axes.plot(*self._spiral(np.linspace(0.0, tube.helix_length, 2000)).T, color="0.85", linewidth=1.5)
        self._cable = LineCollection([], cmap="plasma", norm=LogNorm(LOWEST_MM, HIGHEST_MM), linewidth=2.0)
        axes.add_collection(self._cable)
        (self._sensor,) = axes.plot([], [], "o", color=GREEN, markersize=7, label="sensor")
        axes.set(xlim=(-1.15, 1.15), ylim=(-1.15, 1.15), aspect="equal")
        axes.axis("off")
        axes.legend(loc="lower left", frameon=False, fontsize=8)
        label = f"radial displacement [mm], drawn x {EXAGGERATION:g}"
        figure.colorbar(self._cable, ax=axes, shrink=0.6, pad=0.02, label=label)
        self._title = axes.text(0.5, 1.0, "", transform=axes.transAxes, ha="center", fontsize=10)
        subtitle = label_of(simulator.scene)
        axes.text(0.5, 0.96, subtitle, transform=axes.transAxes, ha="center", fontsize=8, color="0.35")
        self.moving: tuple[Any, ...] = (self._cable, self._sensor, self._title)

    def update(self, simulator: Simulator) -> None:
        """Draw the current state of the probe."""
        tube, nodes = self._tube, np.arange(simulator.root + 1)
        y = simulator.state.d[nodes, 1]
        position = (simulator.root - nodes) * simulator.chain.element_length
        offset = np.clip(y * EXAGGERATION, -0.3 * tube.inner_diameter, 1.5 * tube.inner_diameter)
        line = self._spiral(position, offset / tube.inner_diameter)
        self._cable.set_segments(list(np.stack([line[:-1], line[1:]], axis=1)))
        self._cable.set_array(np.clip(np.abs(y[:-1]) * 1e3, LOWEST_MM, HIGHEST_MM))
        self._sensor.set_data(*line[simulator.sensor][:, None])
        inserted = simulator.length_in_helix
        self._title.set_text(f"{inserted:.1f} of {tube.helix_length:g} m in a helix of {tube.helix_diameter:g} m")

    def _spiral(self, s: FloatArray, off: FloatArray | float = 0.0) -> FloatArray:
        """(k, 2) points in the drawing at distances s [m] from the entrance; ``off`` is the offset in bores."""
        angle = 2.0 * s / self._tube.helix_diameter
        radius = 1.0 - self._inward * s / self._tube.helix_length + np.asarray(off) * self._gap
        return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])


COLUMNS: Final = ("time", "inserted_length", "feed_speed", "air_supply_rate", "radial_rms_m")
"""Columns from the info of a period; its reward and the minimum and maximum radial displacement [m] follow."""


class Traces:
    """Plots into a figure: the sensor's radial displacement, feed, air, radial rms and reward.

    Args:
        figure: the figure.
        config: the task, for axis limits.
        period: control period in time of the dynamics [s].
        end: helix length [m].

    Attributes:
        moving: the artists that ``update`` changes.
    """

    def __init__(self, figure: Any, config: TaskConfig, period: float, end: float) -> None:
        self._growing = config.growing
        # fixed positions: a computed layout takes longer than the drawing and moves between frames
        positions = {"left": 0.15, "right": 0.97, "bottom": 0.08, "top": 0.97, "hspace": 0.6}
        self._axes = figure.subplots(5, 1, gridspec_kw=positions)
        names = ("sensor y\n[mm]", "feed\n[m/s]", "air\n[m3/h]", "radial rms\n[mm]", "reward")
        for axes, name in zip(self._axes, names, strict=True):
            axes.set_ylabel(name, fontsize=8)
            axes.yaxis.set_label_coords(-0.11, 0.5)  # else it moves with the width of the numbers
            axes.tick_params(labelsize=7)
            axes.grid(color="0.92")
            axes.set_xlim(0.0, end if self._growing else config.time_limit)
            axes.tick_params(labelbottom=axes in (self._axes[0], self._axes[-1]))  # the others share the last one's
        sensor, feed, air, rms, reward = self._axes
        sensor.set_xlim(0.0, period)
        sensor.set_xlabel("time in the period [s]", fontsize=7)
        feed.set_ylim(0.0, 1.05 * config.feed_speeds[1])
        air.set_ylim(0.0, 1.05 * config.air_supply_rates[1] * 3600.0)
        self._minimum = {sensor: (-QUIET_MM, QUIET_MM), rms: (0.0, QUIET_MM), reward: (-0.1, 0.1)}
        if config.vibration_measure == "displacement":
            rms.axhline(config.limit * 1e3, color=RED, linewidth=0.8)
            self._minimum[rms] = (0.0, 1.2 * config.limit * 1e3)
        reward.set_xlabel("inserted length [m]" if self._growing else "time [s]", fontsize=8)
        self._lines = [axes.plot([], [], color=BLUE, linewidth=1.0)[0] for axes in self._axes]
        self._lines[0].set_linewidth(0.6)
        self.moving: tuple[Any, ...] = tuple(self._lines)

    def update(self, window: Window | None, index: int, history: FloatArray) -> bool:
        """Draw the last window of a probe and its history, see ``COLUMNS``; returns whether limits of axes changed."""
        if window is not None and window.time is not None and window.radial is not None:
            self._lines[0].set_data(window.time, window.radial[:, index] * 1e3)
        time, length, feed, air, rms, reward, low, high = history.T
        for line, values in zip(self._lines[1:], (feed, air * 3600.0, rms * 1e3, reward), strict=True):
            line.set_data(length if self._growing else time, values)
        changed = False
        for axes, values in zip(self._minimum, (np.r_[low, high] * 1e3, rms * 1e3, reward), strict=True):
            limits = limits_around(values, self._minimum[axes])
            if limits != axes.get_ylim():
                axes.set_ylim(*limits)
                changed = True
        return changed


class Renderer:
    """Draws one probe of some episodes, with its history since the start of the episode.

    Args:
        episodes: the episodes.
        index: index of the probe.
    """

    def __init__(self, episodes: Episodes, index: int = 0) -> None:
        self.episodes, self.index = episodes, index
        self.history: list[tuple[float, ...]] = []
        self._last_window: Window | None = None
        self._artists: tuple[Plate, Helix, Traces] | None = None
        self._window: tuple[Any, Any] | None = None  # figure and image

    def begin(self, info: dict[str, Any]) -> None:
        """Start with the info of a reset; clears the last episode."""
        self.history, self._artists, self._last_window = [(*self._values(info), 0.0, 0.0, 0.0)], None, None

    def add(self, info: dict[str, Any], reward: float) -> None:
        """Add info and reward of a period."""
        self._last_window = self.episodes.window
        assert self._last_window is not None
        assert self._last_window.radial is not None
        radial = self._last_window.radial[:, self.index]
        self.history.append((*self._values(info), reward, float(radial.min()), float(radial.max())))

    @staticmethod
    def _values(info: dict[str, Any]) -> tuple[float, ...]:
        return tuple(float(info[name]) for name in COLUMNS)

    def picture(self) -> Picture:
        """(h, w, 3) RGB picture; needs no display."""
        simulator = self.episodes.simulated().simulators[self.index]
        plate, helix, traces = self._artists = self._artists or self._draw()
        helix.update(simulator)
        changed = traces.update(self._last_window, self.index, np.array(self.history))
        return plate.picture(changed)

    def show(self) -> None:
        """Show the picture in a window (needs a display and an interactive matplotlib backend)."""
        import matplotlib.pyplot as plt

        picture = self.picture()
        if self._window is None or not plt.fignum_exists(self._window[0].number):  # or the user closed it
            plt.ion()
            figure = plt.figure(figsize=SIZE, dpi=DPI)
            axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
            axes.axis("off")
            self._window = figure, axes.imshow(picture)
        else:
            self._window[1].set_data(picture)
        plt.pause(1e-3)

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._window is not None:
            import matplotlib.pyplot as plt

            plt.close(self._window[0])
            self._window = None

    def _draw(self) -> tuple[Plate, Helix, Traces]:
        """Create the figure of an episode."""
        simulator, config = self.episodes.simulated().simulators[self.index], self.episodes.config
        figure = Figure(figsize=SIZE, dpi=DPI)
        halves: Any = figure.subfigures(1, 2, width_ratios=(1.0, 1.05))
        helix = Helix(halves[0], simulator)
        fidelity = self.episodes.fidelity
        everywhere = fidelity.steady_feed is None and not config.returns
        period = config.period / (fidelity.time_lapse if everywhere else 1.0)  # the longest period
        traces = Traces(halves[1], config, period, simulator.scene.tube.helix_length)
        return Plate(figure, (*helix.moving, *traces.moving)), helix, traces

    def __getstate__(self) -> dict[str, Any]:
        """Copies and pickles have neither pixels nor windows."""
        return self.__dict__ | {"_artists": None, "_window": None}
