"""The picture of the return beside the insertion: spectra of the sensor, fed in and drawn back."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import pandas as pd

from agents.records.drawing import GRID, MM, colours, save
from agents.study.back import PROBES, Trip, density
from agents.study.claims import Ensemble
from agents.study.spectra import SHOWN

LENGTHS = (10, 30, 50, 55)
SILENT = 1e-9  # [mm/sqrt(Hz)]; below it a spectrum shows rounding


def ways_spectra(table: pd.DataFrame, path: Path) -> Path:
    """Radial spectra of both probes at 0.2 m/s, means over the members: fed in on the left, drawn back on the right."""
    e = Ensemble(table)
    figure, axes = plt.subplots(2, 2, figsize=(9, 6), sharex=True, sharey=True, layout="constrained")
    for line, probe in zip(axes, PROBES, strict=True):
        for axis, way, label in zip(line, ("in", "back"), ("fed in", "drawn back"), strict=True):
            for length, colour in zip(LENGTHS, colours(), strict=False):
                name = Trip(probe, "in", length).name if way == "in" else Trip(probe, "back", length).name
                if e.has(name):
                    values = [e.mean(name, density("radial", hertz)) * MM for hertz in SHOWN]
                    axis.semilogy(SHOWN, values, color=colour, linewidth=0.9, label=f"{length} m")
            axis.set_title(f"{probe} probe, {label}")
            axis.grid(**GRID)
        line[0].set_ylabel("radial [mm/√Hz]")
    axes[0, 0].set_ylim(bottom=SILENT)
    axes[0, 0].legend(frameon=False, ncols=2)
    for axis in axes[1]:
        axis.set_xlabel("frequency [Hz]")
    return save(figure, path)
