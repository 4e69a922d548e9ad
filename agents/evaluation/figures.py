"""Figures of evaluations and recordings."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle
from pathlib import Path
from typing import Final

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from agents.evaluation.recording import Chart, Insertion
from agents.records.drawing import BLUE, GREY, GRID, MM, RED, colours, plain, save
from probe_env.arrays import FloatArray
from probe_env.inspection.channels import Flaw, smoothed

AROUND: Final = 0.025
"""Half the width of a flaw's figure [m]."""


def trade_off(summary: pd.DataFrame, path: Path) -> Path:
    """Inspection time against the share of length out of the limit of every policy, with both intervals."""
    figure, axis = plt.subplots(figsize=(9, 5), layout="constrained")
    rows = summary.set_index(["policy", "kpi"])
    for colour, policy in zip(cycle(colours()), dict.fromkeys(summary["policy"]), strict=False):
        time, share = rows.loc[(policy, "inspection_time_s")], rows.loc[(policy, "share_within_limit")]
        x, y = time["mean"], 100.0 * (1.0 - share["mean"])
        across = [[x - time["low"]], [time["high"] - x]]
        along = [[100.0 * (share["high"] - share["mean"])], [100.0 * (share["mean"] - share["low"])]]
        axis.errorbar(x, y, xerr=across, yerr=along, fmt="o", capsize=3, color=colour, label=plain(policy))
    axis.set(xlabel="inspection time [s]", ylabel="length out of the limit [%]", ylim=(0.0, None))
    axis.grid(**GRID)
    axis.legend(frameon=False)
    return save(figure, path)


def policy_profiles(profile: pd.DataFrame, path: Path, limit_mm: float | None) -> Path:
    """Feed, air and vibration over the inserted length by policy, in bins of two metres; a line at the limit."""
    figure, axes = plt.subplots(3, 1, figsize=(9, 8), sharex=True, layout="constrained")
    binned = profile.assign(bin=(profile["inserted_length"] // 2.0) * 2.0 + 1.0)
    fields = (
        ("feed_speed", 1.0, "feed [m/s]"),
        ("air_supply_rate", 3600.0, "air [m3/h]"),
        ("radial_rms_m", MM, "radial rms [mm]"),
    )
    for colour, policy in zip(cycle(colours()), dict.fromkeys(profile["policy"]), strict=False):
        groups = binned[binned["policy"] == policy].groupby("bin")
        for axis, (name, factor, label) in zip(axes, fields, strict=True):
            mean = groups[name].mean() * factor
            axis.plot(mean.index, mean, color=colour, label=plain(policy))
            axis.set_ylabel(label)
        loud = groups["radial_rms_m"].quantile(0.9) * MM
        axes[2].plot(loud.index, loud, color=colour, linewidth=0.7)
    for axis in axes:
        axis.grid(**GRID)
        axis.set_ylim(bottom=0.0)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", frameon=False, ncols=3)
    if limit_mm is not None:
        axes[2].axhline(limit_mm, color=GREY, linestyle=":")
    axes[2].set_xlabel("inserted length [m]")
    return save(figure, path)


def strip_chart(run: Insertion, chart: Chart, title: str, path: Path) -> Path:
    """X and Y, the filtered signal with calls, and the vibration over the position of the sensor.

    Supports are ticks at the top, flaws lines.
    """
    figure, axes = plt.subplots(4, 1, figsize=(12, 9), sharex=True, layout="constrained")
    passage, shown = run.passage, smoothed(run.passage, chart.voltages)
    for axis, values, name in zip(axes, shown.T, "XY", strict=False):
        axis.plot(passage.place, values, color=BLUE, linewidth=0.4)
        axis.set_ylabel(f"{name} [V]")
    axes[2].plot(passage.place, chart.values, color="0.2", linewidth=0.4)
    axes[2].axhline(chart.threshold, color=RED, linewidth=0.8)
    axes[2].plot(chart.called, np.full(len(chart.called), chart.threshold), "v", color=RED, markersize=6)
    axes[2].set_ylabel("behind the filter\n[deviations of its noise]")
    places = passage.place[run.period - 1 :: run.period]
    axes[3].plot(places, [MM * period["radial_rms_m"] for period in run.periods], color=GREY, label="radial rms [mm]")
    axes[3].plot(places, [0.1 * period["snr"] for period in run.periods], color=BLUE, label="S/N of a 20 % groove / 10")
    axes[3].set(xlabel="sensor from the entrance of the helix [m]", ylim=(0.0, None))
    axes[3].legend(frameon=False, ncols=2, loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.1)
    for axis in axes:
        axis.grid(**GRID)
        for place in chart.supports:
            axis.axvline(place, ymin=0.95, color=GREY, linewidth=0.8)
        for flaw in chart.flaws:
            axis.axvline(flaw.place, color=RED, linewidth=0.6, linestyle=":")
    figure.suptitle(plain(title))
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
    """Probability of detection over the depth of every policy, with 95 % bands over the tubes."""
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
