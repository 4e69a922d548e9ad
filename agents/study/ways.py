"""The picture of the return beside the insertion: spectra of the sensor, fed in and drawn back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import pandas as pd
from matplotlib.axes import Axes

from agents.records.drawing import GRID, MM, colours, save
from agents.study.back import PROBES, SETTLING, Trip, density
from agents.study.claims import Ensemble
from agents.study.spectra import SHOWN

LENGTHS = (10, 30, 50, 55)
SILENT = 1e-8  # [mm/sqrt(Hz)]; below it a spectrum shows rounding


def ways_spectra(table: pd.DataFrame, path: Path) -> Path:
    """Radial spectra of both probes at 0.2 m/s, means over the members: fed in on the left, drawn back on the right."""
    e = Ensemble(table)
    figure, axes = plt.subplots(2, 2, figsize=(9, 6), sharex=True, sharey=True, layout="constrained")
    for line, probe in zip(axes, PROBES, strict=True):
        for axis, way, label in zip(line, ("in", "back"), ("fed in", "drawn back"), strict=True):
            for length, colour in zip(LENGTHS, colours(), strict=False):
                trip = Trip(probe, "back", length)
                trip = trip.beside() if way == "in" else trip
                _draw(axis, e, trip, colour, f"{length} m")
                _draw(axis, e, replace(trip, settling=SETTLING), colour, f"{length} m, {SETTLING:g} s later", "--")
            axis.set_title(f"{probe} probe, {label}")
            axis.grid(**GRID)
        line[0].set_ylabel("radial [mm/√Hz]")
    axes[0, 0].set_ylim(bottom=SILENT)
    for axis in axes[0]:
        axis.legend(frameon=False, ncols=2, fontsize=8)
    for axis in axes[1]:
        axis.set_xlabel("frequency [Hz]")
    return save(figure, path)


def _draw(axis: Axes, e: Ensemble, trip: Trip, colour: Any, label: str, style: str = "-") -> None:
    """The mean spectrum of a trip, if there is one."""
    if e.has(trip.name):
        values = [e.mean(trip.name, density("radial", hertz)) * MM for hertz in SHOWN]
        axis.semilogy(SHOWN, values, style, color=colour, linewidth=0.9, label=label)
