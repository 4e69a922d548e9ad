"""What was done to a probe and what it felt: signals of the last period, and feed, air, vibration and reward so far."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from probe_env.arrays import FloatArray
from probe_env.envs.pictures.plate import BLUE, QUIET_MM, RED, limits_around
from probe_env.envs.task import TaskConfig
from probe_env.physics.simulation.window import Window

COLUMNS: Final = ("time", "inserted_length", "feed_speed", "air_supply_rate", "radial_rms_m")
"""Of a period's info. Its reward follows, and the sensor's least and greatest radial displacement in it [m]."""


class Traces:
    """Draws strips into a figure: the sensor's radial displacement, feed, air, radial rms and reward.

    Args:
        figure: where.
        config: the task, for limits.
        period: of control, on the dynamics clock [s].
        end: length of the helix [m].

    Attributes:
        moving: the artists that ``update`` changes.
    """

    def __init__(self, figure: Any, config: TaskConfig, period: float, end: float) -> None:
        self._growing = config.growing
        # fixed places: a layout that is computed anew costs more than the drawing, and moves from frame to frame
        places = {"left": 0.15, "right": 0.97, "bottom": 0.08, "top": 0.97, "hspace": 0.6}
        self._axes = figure.subplots(5, 1, gridspec_kw=places)
        names = ("sensor y\n[mm]", "feed\n[m/s]", "air\n[m3/h]", "radial rms\n[mm]", "reward")
        for axes, name in zip(self._axes, names, strict=True):
            axes.set_ylabel(name, fontsize=8)
            axes.yaxis.set_label_coords(-0.11, 0.5)  # or it would move with the width of the numbers
            axes.tick_params(labelsize=7)
            axes.grid(color="0.92")
            axes.set_xlim(0.0, end if self._growing else config.time_limit)
            axes.tick_params(labelbottom=axes in (self._axes[0], self._axes[-1]))  # those between share the last one's
        sensor, feed, air, rms, reward = self._axes
        sensor.set_xlim(0.0, period)
        sensor.set_xlabel("time in the period [s]", fontsize=7)
        feed.set_ylim(0.0, 1.05 * config.feed_speeds[1])
        air.set_ylim(0.0, 1.05 * config.air_supply_rates[1] * 3600.0)
        self._least = {sensor: (-QUIET_MM, QUIET_MM), rms: (0.0, QUIET_MM), reward: (-0.1, 0.1)}
        if config.vibration_measure == "displacement":
            rms.axhline(config.limit * 1e3, color=RED, linewidth=0.8)
            self._least[rms] = (0.0, 1.2 * config.limit * 1e3)
        reward.set_xlabel("inserted length [m]" if self._growing else "time [s]", fontsize=8)
        self._lines = [axes.plot([], [], color=BLUE, linewidth=1.0)[0] for axes in self._axes]
        self._lines[0].set_linewidth(0.6)
        self.moving: tuple[Any, ...] = tuple(self._lines)

    def update(self, window: Window | None, index: int, history: FloatArray) -> list[Any]:
        """Draw the last window of a probe, and what is known of its periods: a row each, see ``COLUMNS``.

        Returns:
            the axes whose limits changed: they hold all that was, so that they seldom do.
        """
        if window is not None and window.time is not None and window.radial is not None:
            self._lines[0].set_data(window.time, window.radial[:, index] * 1e3)
        time, length, feed, air, rms, reward, low, high = history.T
        for line, values in zip(self._lines[1:], (feed, air * 3600.0, rms * 1e3, reward), strict=True):
            line.set_data(length if self._growing else time, values)
        changed = []
        for axes, values in zip(self._least, (np.r_[low, high] * 1e3, rms * 1e3, reward), strict=True):
            limits = limits_around(values, self._least[axes])
            if limits != axes.get_ylim():
                axes.set_ylim(*limits)
                changed.append(axes)
        return changed
