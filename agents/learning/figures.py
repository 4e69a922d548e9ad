"""Pictures of training."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import pandas as pd

from agents.records.drawing import BLUE, GREY, GRID, RED, colours, plain, save


def learning_curves(runs: dict[str, pd.DataFrame], path: Path, steps: str) -> Path:
    """Validation reward over environment steps of training, a line a seed; ``steps`` says what they are."""
    figure, axis = plt.subplots(figsize=(8, 4), layout="constrained")
    for colour, (name, curves) in zip(colours(), runs.items(), strict=False):
        for number, (_, rows) in enumerate(curves.groupby("seed")):
            label = name if number == 0 else None
            axis.plot(rows["steps"], rows["reward"], "o-", color=colour, linewidth=1.0, markersize=3, label=label)
    axis.set(xlabel=steps, ylabel="reward on the validation tubes")
    axis.grid(**GRID)
    axis.legend(frameon=False)
    return save(figure, path)


def performance_profiles(table: pd.DataFrame, path: Path) -> Path:
    """Share of runs that reach a reward, a line a method with its band; see ``comparison.profiles``."""
    figure, axis = plt.subplots(figsize=(8, 4.5), layout="constrained")
    for colour, (name, rows) in zip(colours(), table.groupby("policy", sort=False), strict=False):
        axis.plot(rows["threshold"], 100.0 * rows["share"], color=colour, label=plain(str(name)))
        axis.fill_between(rows["threshold"], 100.0 * rows["low"], 100.0 * rows["high"], color=colour, alpha=0.15, lw=0)
    axis.set(xlabel="reward of at least", ylabel="share of tubes and seeds [%]", ylim=(0.0, 100.0))
    axis.grid(**GRID)
    axis.legend(frameon=False)
    return save(figure, path)


def search_history(table: pd.DataFrame, importances: dict[str, float], path: Path) -> Path:
    """A search for hyperparameters: the reward of every trial, the best so far, and what mattered."""
    figure, (axis, shares) = plt.subplots(1, 2, figsize=(11, 4), layout="constrained", width_ratios=(3, 2))
    for state, colour, label in (
        ("complete", BLUE, "all phases"),
        ("pruned", "0.7", "ended early"),
        ("failed", RED, "broke down"),
    ):
        part = table[table["state"] == state]
        axis.scatter(part["trial"], part["reward"], color=colour, s=16, label=label if len(part) else None)
    best = table["reward"].where(table["state"] == "complete").cummax()
    axis.step(table["trial"], best, where="post", color=BLUE, linewidth=1.0, label="best so far")
    axis.set(xlabel="trial", ylabel="reward on the validation tubes", title="Trials")
    axis.grid(**GRID)
    axis.legend(frameon=False, fontsize=8)
    names = sorted(importances, key=lambda name: importances[name])
    shares.barh(names, [importances[name] for name in names], color=BLUE)
    shares.set(xlabel="share", title="What mattered", axisbelow=True)
    if not importances:
        shares.text(0.5, 0.5, "too few complete trials to tell", ha="center", color=GREY, transform=shares.transAxes)
    shares.grid(**GRID)
    return save(figure, path)
