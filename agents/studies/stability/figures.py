"""Figures of stability: the map, one mass, the transfer matrix."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.colors import ListedColormap
from matplotlib.patches import Patch

from agents.records.drawing import GREY, GRID, save
from agents.studies.chart.figures import COLOURS

VERDICTS = {"stable": "#1f5fa8", "wrong": "#f5b041", "unstable": "#c0392b"}


def stability_map(table: pd.DataFrame, path: Path) -> None:
    """Verdicts over step, a panel a method, a row a stiffness, length and friction."""
    methods = list(dict.fromkeys(table["method"]))
    rows = ["stiffness_n_per_m", "length_m", "friction"]
    figure, axes = plt.subplots(1, len(methods), figsize=(14, 6), sharey=True, layout="constrained", squeeze=False)
    codes = table.assign(code=table["verdict"].map(list(VERDICTS).index))
    for axis, method in zip(axes[0], methods, strict=True):
        grid = codes[codes["method"] == method].pivot_table("code", rows, "ratio")
        axis.imshow(
            grid.to_numpy(), aspect="auto", cmap=ListedColormap(list(VERDICTS.values())), vmin=0, vmax=2, origin="lower"
        )
        axis.set_xticks(range(grid.shape[1]), [f"{ratio:g}" for ratio in grid.columns], fontsize=8, rotation=90)
        labels = [f"{k:.0e} N/m, {length:.0f} m, friction {mu:g}" for k, length, mu in grid.index]
        axis.set_yticks(range(grid.shape[0]), labels, fontsize=8)
        axis.set_xlabel("step / named limit")
        axis.set_title(method)
    marks = [Patch(color=colour) for colour in VERDICTS.values()]
    labels = ["stable", "stable, but bounces are off by 5 % of critical damping or more", "diverged"]
    if len(table) < len(methods) * len(table.drop_duplicates([*rows, "ratio"])):
        marks.append(Patch(facecolor="white", edgecolor=GREY))
        labels.append("refused: its rounding would show")
    figure.legend(marks, labels, loc="outside lower center", ncols=len(marks), frameon=False)
    save(figure, path, dpi=90)


def one_mass(table: pd.DataFrame, path: Path) -> None:
    """Spectral radius in both springs with theory's limit, numerical damping, restitution of bounces, over omega dt."""
    figure, axes = plt.subplots(2, 2, figsize=(11, 7), sharex=True, layout="constrained")
    panels = (
        (axes[0, 0], "elastic", "spectral_radius", "spectral radius, elastic spring"),
        (axes[0, 1], "contact", "spectral_radius", "spectral radius, inside the contact spring"),
        (axes[1, 0], "elastic", "damping", "numerical damping ratio, elastic spring"),
        (axes[1, 1], "contact", "restitution", "restitution of bounces (contact switches on and off)"),
    )
    for axis, spring, column, title in panels:
        for method, part in table[table["spring"] == spring].groupby("method"):
            axis.plot(
                part["omega_dt"], part[column], "o-", ms=3.5, linewidth=1.1, color=COLOURS[str(method)], label=method
            )
        axis.axvline(2.0, color=GREY, linestyle=":", linewidth=1.0)
        axis.set_title(title, fontsize=10)
        axis.grid(**GRID)
        axis.set_xscale("log")
    for axis in axes[0]:
        axis.axhline(1.0, color=GREY, linewidth=0.8)
        axis.set_ylim(0.2, 1.8)
    axes[1, 1].axhline(1.0, color=GREY, linewidth=0.8)
    axes[1, 0].set_ylim(-0.02, 0.42)
    ticks = [0.1, 0.2, 0.5, 1.0, 2.0, 5.0]
    for axis in axes[1]:
        axis.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        axis.minorticks_off()
        axis.set_xlabel("omega dt (dotted: 2, the limit of what is explicit)")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=5, frameon=False)
    save(figure, path, dpi=90)


def digits(table: pd.DataFrame, path: Path) -> None:
    """Difference to LAPACK's solution over the number of elements."""
    figure, axis = plt.subplots(figsize=(7, 3.6), layout="constrained")
    for solver, part in table.groupby("solver"):
        axis.plot(part["elements"], np.clip(part["error"], 1e-17, 1e3), "o-", ms=4, label=solver)
    axis.axhline(1.0, color=GREY, linewidth=0.8)
    axis.set(
        xscale="log",
        yscale="log",
        xlabel="elements of 25 mm",
        ylabel="error of one solution",
        ylim=(1e-17, 1e4),
        title="Digits of a step's solution (clipped at 1,000)",
    )
    axis.grid(**GRID)
    axis.legend(frameon=False)
    save(figure, path, dpi=90)
