"""Strip chart, Lissajous figures and curves of detection, as inspection software shows them."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle
from pathlib import Path
from typing import Final

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from agents.detection.passage import Insertion
from agents.records.drawing import BLUE, GREY, GRID, MM, RED, colours, plain, save
from probe_env.arrays import FloatArray
from probe_env.inspection.channels import Flaw, smoothed

AROUND: Final = 0.025
"""[m] on either side of a flaw that its figure shows."""


class Marks:
    """Supports, flaws and calls in a chart.

    Args:
        title: above it.
        flaws: that were put into the tube.
        supports: places [m].
        called: places [m].
        threshold: in deviations of the filtered noise.
    """

    def __init__(
        self, title: str, flaws: Sequence[Flaw], supports: FloatArray, called: FloatArray, threshold: float
    ) -> None:
        self.title, self.flaws, self.supports = title, flaws, supports
        self.called, self.threshold = called, threshold

    def draw(self, axis: Axes) -> None:
        """Supports as ticks at the top, flaws as lines."""
        for place in self.supports:
            axis.axvline(place, ymin=0.95, color=GREY, linewidth=0.8)
        for flaw in self.flaws:
            axis.axvline(flaw.place, color=RED, linewidth=0.6, linestyle=":")


def strip_chart(run: Insertion, voltages: FloatArray, behind: FloatArray, marks: Marks, path: Path) -> Path:
    """X and Y, what the filter makes of them, and the vibration, over the place of the sensor.

    Args:
        run: the insertion.
        voltages: (k, 2) channels [V].
        behind: (k,) the filtered signal, over its noise.
        marks: what stands in the tube and what was called.
        path: of the picture.
    """
    figure, axes = plt.subplots(4, 1, figsize=(12, 9), sharex=True, layout="constrained")
    passage, shown = run.passage, smoothed(run.passage, voltages)
    for axis, values, name in zip(axes, shown.T, "XY", strict=False):
        axis.plot(passage.place, values, color=BLUE, linewidth=0.4)
        axis.set_ylabel(f"{name} [V]")
    axes[2].plot(passage.place, behind, color="0.2", linewidth=0.4)
    axes[2].axhline(marks.threshold, color=RED, linewidth=0.8)
    axes[2].plot(marks.called, np.full(len(marks.called), marks.threshold), "v", color=RED, markersize=6)
    axes[2].set_ylabel("behind the filter\n[deviations of its noise]")
    places = passage.place[run.period - 1 :: run.period]
    axes[3].plot(places, [MM * period["radial_rms_m"] for period in run.periods], color=GREY, label="radial rms [mm]")
    axes[3].plot(places, [0.1 * period["snr"] for period in run.periods], color=BLUE, label="S/N of a 20 % groove / 10")
    axes[3].set(xlabel="sensor from the entrance of the helix [m]", ylim=(0.0, None))
    axes[3].legend(frameon=False, ncols=2, loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.1)
    for axis in axes:
        axis.grid(**GRID)
        marks.draw(axis)
    figure.suptitle(plain(marks.title))
    return save(figure, path)


def grooves(run: Insertion, voltages: FloatArray, flaws: Sequence[Flaw], path: Path) -> Path:
    """X and Y over time and as a Lissajous figure while the sensor passes each flaw."""
    figure, axes = plt.subplots(len(flaws), 2, figsize=(9, 3.2 * len(flaws)), layout="constrained", squeeze=False)
    passage, shown = run.passage, smoothed(run.passage, voltages)
    for (left, right), flaw in zip(axes, flaws, strict=True):
        near = np.abs(passage.place - flaw.place) < AROUND
        time = passage.time[near] - (passage.time[near].mean() if near.any() else 0.0)
        for values, name, colour in zip(shown[near].T, "XY", (BLUE, RED), strict=True):
            left.plot(time, values, color=colour, linewidth=1.0, label=name)
        right.plot(shown[near, 0], shown[near, 1], color="0.2", linewidth=1.0)
        left.set(xlabel="time [s]", ylabel="[V]", title=f"{100.0 * flaw.depth:g} % at {flaw.place:g} m")
        right.set(xlabel="X [V]", ylabel="Y [V]", aspect="equal", adjustable="datalim")
        left.legend(frameon=False, ncols=2)
        for axis in (left, right):
            axis.grid(**GRID)
    return save(figure, path)


def curves(bands: pd.DataFrame, path: Path) -> Path:
    """Probability of detection over the depth with 95 % bands over the tubes, a line a policy."""
    figure, axis = plt.subplots(figsize=(8, 5), layout="constrained")
    for (policy, part), colour in zip(bands.groupby("policy", sort=False), cycle(colours()), strict=False):
        axis.plot(part["depth_percent_wall"], part["pod"], color=colour, label=plain(str(policy)))
        axis.fill_between(part["depth_percent_wall"], part["low"], part["high"], color=colour, alpha=0.15, linewidth=0)
    axis.axhline(0.9, color=GREY, linewidth=0.8, linestyle=":")
    axis.set(xscale="log", ylim=(0.0, 1.0), xlabel="depth [% of the wall]", ylabel="probability of detection")
    axis.set_xticks([2, 5, 10, 20, 50, 100], ["2", "5", "10", "20", "50", "100"])
    axis.minorticks_off()
    axis.grid(**GRID)
    axis.legend(frameon=False, fontsize=8)
    return save(figure, path)
