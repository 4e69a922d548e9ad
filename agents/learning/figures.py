"""Pictures of training."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import pandas as pd

from agents.records.drawing import GRID, colours, save


def learning_curves(runs: dict[str, pd.DataFrame], path: Path) -> Path:
    """Validation reward over environment steps of training, a line a seed; step 0 is the warm start."""
    figure, axis = plt.subplots(figsize=(8, 4), layout="constrained")
    for colour, (name, curves) in zip(colours(), runs.items(), strict=False):
        for number, (_, rows) in enumerate(curves.groupby("seed")):
            label = name if number == 0 else None
            axis.plot(rows["steps"], rows["reward"], "o-", color=colour, linewidth=1.0, markersize=3, label=label)
    axis.set(xlabel="environment steps after the warm start", ylabel="reward on the validation tubes")
    axis.grid(**GRID)
    axis.legend(frameon=False)
    return save(figure, path)
