"""The picture of robustness: a panel a policy, a line a disturbance."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Final

import matplotlib.pyplot as plt
import pandas as pd
from matplotlib.ticker import FixedLocator, NullLocator

from agents.records.drawing import BLUE, GREY, GRID, RED, plain, save
from agents.robustness.axes import NOMINAL

ACROSS: Final = (4, 3)
"""Panels side by side: as leave the fewest places empty."""
LINEAR: Final = 5.0
"""Change of the reward up to which the axis is linear; it is logarithmic beyond."""
TICKS: Final = (-1000.0, -100.0, -10.0, 0.0, 10.0, 100.0)


def draw_profiles(summary: pd.DataFrame, path: Path) -> Path:
    """What every policy loses along every axis, with 95 % intervals; red where insertions lost their drive."""
    parts = [(str(policy), part) for policy, part in summary.groupby("policy", sort=False)]
    disturbed = [part[part["axis"] != NOMINAL] for _, part in parts]
    across, lines = min(len(parts), min(ACROSS, key=lambda count: -len(parts) % count)), len(disturbed[0])
    down = math.ceil(len(parts) / across)
    size = (2.2 + 2.7 * across, 1.0 + down * (0.9 + 0.27 * lines))
    figure, axes = plt.subplots(
        down, across, figsize=size, sharex=True, sharey=True, squeeze=False, layout="constrained"
    )
    for axis in axes.ravel()[len(parts) :]:
        axis.set_visible(False)
    for axis, (policy, nominal), part in zip(axes.ravel(), parts, disturbed, strict=False):
        reward = float(nominal.loc[nominal["axis"] == NOMINAL, "reward"].iloc[0])
        for y, row in enumerate(part.itertuples()):
            colour = RED if row.lost_drive else BLUE
            axis.plot([row.low, row.high], [y, y], color=colour, linewidth=1.5)
            axis.plot([row.change], [y], "o", color=colour, markersize=4)
        axis.axvline(0.0, color=GREY, linewidth=0.8)
        axis.set_xscale("symlog", linthresh=LINEAR)
        axis.xaxis.set_major_locator(FixedLocator(TICKS))
        axis.xaxis.set_minor_locator(NullLocator())
        axis.xaxis.set_major_formatter("{x:g}")
        axis.set_title(f"{plain(policy)}\n{reward:.1f} undisturbed", fontsize="medium")
        axis.set_yticks(range(lines), [f"{row.axis}, {row.value}" for row in part.itertuples()], fontsize="small")
        axis.grid(**GRID)
    for k, axis in enumerate(axes.ravel()):
        axis.tick_params(labelbottom=k + across >= len(parts))  # nothing is below
    axes[0, 0].set_ylim(lines - 0.5, -0.5)
    figure.supxlabel("change of the reward; red: some insertions lose their drive", fontsize="medium")
    return save(figure, path)
