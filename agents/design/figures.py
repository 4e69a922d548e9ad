"""Pictures of a search: the designs on the front and their parameters."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from agents.records.drawing import BLUE, GRID, RED, save


def design_front(table: pd.DataFrame, references: pd.DataFrame, path: Path, tube: str = "") -> Path:
    """Designs of a search: vibration against time and drive margin, with the probes to beat; ``tube`` is named."""
    figure, axes = plt.subplots(1, 2, figsize=(11, 4.5), sharey=True, layout="constrained")
    labels = {"inspection_time_s": "inspection time [s]", "drive_margin_n": "drive margin [N]"}
    if np.ptp(table["inspection_time_s"].quantile([0.1, 0.9])) < 1.0:  # a given feed: all take the same time
        labels = {"guide_length": "guide length [m]", "drive_margin_n": "drive margin [N]"}
    for axis, (column, label) in zip(axes, labels.items(), strict=True):
        for on_front, colour, size, name in ((False, "0.8", 10, "tried"), (True, BLUE, 28, "on the front")):
            part = table[table["on_front"] == on_front]
            axis.scatter(part[column], part["mean_square_ratio"], color=colour, s=size, label=name)
        for colour, marker, (probe, rows) in zip((RED, "#d98c00"), "sD", references.groupby("design", sort=False)):  # noqa: B905
            axis.scatter(rows[column], rows["mean_square_ratio"], color=colour, marker=marker, s=40, label=probe)
        axis.set(xlabel=label, yscale="log")
        axis.grid(**GRID)
    axes[0].set_ylabel("mean of (radial rms / limit)$^2$")
    handles, names = axes[1].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=4, frameon=False, fontsize=9)
    if tube:
        figure.suptitle(f"Designs tried in {tube}", fontsize=10)
    return save(figure, path)


def parallel_coordinates(
    table: pd.DataFrame, axes: dict[str, tuple[float, float, str]], path: Path, tube: str = ""
) -> Path:
    """Every design of a search as a line through its parameters, each from its lowest to its highest value."""
    figure, axis = plt.subplots(figsize=(11, 5), layout="constrained")
    names = list(axes)
    for on_front, colour, width in ((False, "0.85", 0.6), (True, BLUE, 1.4)):
        for row in table[table["on_front"] == on_front].to_dict("records"):
            shares = [(row[name] - axes[name][0]) / (axes[name][1] - axes[name][0]) for name in names]
            axis.plot(range(len(names)), shares, color=colour, linewidth=width)
    labels = [f"{name.replace('_', ' ')}\n{axes[name][0]:.3g} to {axes[name][1]:.3g} {axes[name][2]}" for name in names]
    axis.set_xticks(range(len(names)), labels, fontsize=7)
    title = f"Designs tried (grey) and on the front (blue){tube and f', in {tube}'}"
    axis.set(ylabel="from lowest to highest", ylim=(-0.02, 1.02), title=title)
    axis.grid(**GRID)
    return save(figure, path)
