"""The helix from above with the probe in it, its distance from the inner wall exaggerated and in colours."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.colors import LogNorm

from probe_env.arrays import FloatArray
from probe_env.envs.pictures.plate import GREEN, label_of
from probe_env.physics.simulation.simulator import Simulator

EXAGGERATION: Final = 20.0  # of the radial displacement, against the gap between two turns
INWARD: Final = 0.55  # how far the drawing winds inwards over the whole helix, so that turns do not overlap
WIDEST: Final = 0.06  # gap between two turns, where there are few
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
        """Draw the probe as it is now."""
        tube, nodes = self._tube, np.arange(simulator.root + 1)
        y = simulator.state.d[nodes, 1]
        place = (simulator.root - nodes) * simulator.chain.element_length
        drawn = np.clip(y * EXAGGERATION, -0.3 * tube.inner_diameter, 1.5 * tube.inner_diameter)
        line = self._spiral(place, drawn / tube.inner_diameter)
        self._cable.set_segments(list(np.stack([line[:-1], line[1:]], axis=1)))
        self._cable.set_array(np.clip(np.abs(y[:-1]) * 1e3, LOWEST_MM, HIGHEST_MM))
        self._sensor.set_data(*line[simulator.sensor][:, None])
        inserted = simulator.length_in_helix
        self._title.set_text(f"{inserted:.1f} of {tube.helix_length:g} m in a helix of {tube.helix_diameter:g} m")

    def _spiral(self, s: FloatArray, off: FloatArray | float = 0.0) -> FloatArray:
        """(k, 2) drawn places at distances s [m] from the entrance, ``off`` the middle by so many bores."""
        angle = 2.0 * s / self._tube.helix_diameter
        radius = 1.0 - self._inward * s / self._tube.helix_length + np.asarray(off) * self._gap
        return np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
