"""Pictures of the headroom: rewards tube by tube, and what horizon and candidates are worth."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from agents.records.drawing import GREY, GRID, colours, plain, save
from agents.rollouts.statistics import by_context, mean_interval


def by_tube(table: pd.DataFrame, bar: str, path: Path) -> Path:
    """Reward less that of ``bar``: a point a tube, a row a policy, with the mean and its interval."""
    names = [name for name in dict.fromkeys(table["policy"]) if name != bar]
    figure, axis = plt.subplots(figsize=(9, 1.2 + 0.45 * len(names)), layout="constrained")
    least = by_context(table, bar, "reward")
    for row, (colour, name) in enumerate(zip(colours(), names, strict=False)):
        gain = (by_context(table, name, "reward") - least).to_numpy()
        mean = mean_interval(gain)
        height = np.linspace(-0.25, 0.25, len(gain)) if len(gain) > 1 else np.zeros(1)
        axis.plot(gain, row + height, ".", color=colour, alpha=0.6)
        axis.errorbar(
            mean.mean, row, xerr=[[mean.mean - mean.low], [mean.high - mean.mean]], fmt="D", color="black", capsize=3
        )
    axis.set_yticks(range(len(names)), [plain(name) for name in names])
    axis.invert_yaxis()
    axis.axvline(0.0, color=GREY, linewidth=1.0)
    axis.set_xlabel(f"reward less that of {plain(bar)}, a point a tube; mean with 95 % interval")
    axis.grid(axis="x", **GRID)
    return save(figure, path)


def settings(summary: pd.DataFrame, path: Path) -> Path:
    """Reward less the shipped planner's over what a setting costs, a line for each thing that is changed."""
    figure, axis = plt.subplots(figsize=(9, 5), layout="constrained")
    shipped = summary[summary["gain"] == 0.0].iloc[0]
    mapped = summary[summary["rest"] == "map"]
    for colour, changed in zip(colours(), ("periods", "candidates", "every"), strict=False):
        others = [name for name in ("periods", "candidates", "every") if name != changed]
        same = mapped[(mapped[others] == shipped[others]).all(axis=1)].sort_values("copies")
        _line(axis, same, colour, f"{changed}: {', '.join(map(str, same[changed]))}", "o-")
    _line(axis, summary[summary["rest"] != "map"], GREY, "nothing after the periods", "s")
    axis.set_xscale("log", base=2)
    axis.set_xlabel("simulated seconds of copies for each second of the insertion")
    axis.set_ylabel("reward less the shipped planner's")
    axis.grid(**GRID)
    axis.legend(frameon=False)
    return save(figure, path)


def _line(axis: Axes, rows: pd.DataFrame, colour: str, label: str, form: str) -> None:
    along = [rows["gain"] - rows["gain_low"], rows["gain_high"] - rows["gain"]]
    axis.errorbar(rows["copies"], rows["gain"], yerr=along, fmt=form, color=colour, capsize=3, label=label)
