"""Pictures in the style of the study: time histories, locus, spectra, travelling shapes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from scipy.signal import welch

from agents.records.drawing import BLUE, GREY, GRID, MM, RED, save
from probe_env import Run, Scene


def time_histories(run: Run, point: str, path: Path, title: str = "") -> Path:
    """Axial and radial displacement of one point over time (the study's figures 11-12, 15-18, 20)."""
    column = run.column(point)
    figure, axes = plt.subplots(2, 1, figsize=(9, 5), sharex=True, layout="constrained")
    for axis, signal, label in zip(axes, (run.axial, run.radial), ("axial x", "radial y"), strict=True):
        axis.plot(run.time, signal[:, column] * MM, color=BLUE, linewidth=0.6)
        axis.set_ylabel(f"{label} [mm]")
        axis.grid(**GRID)
    axes[1].axhline(0.0, color=GREY, linewidth=0.8)
    axes[1].set_xlabel("time [s]")
    figure.suptitle(title)
    return save(figure, path)


def locus(run: Run, point: str, scene: Scene, path: Path, window: float = 0.4) -> Path:
    """Path of a point along the tube in the last ``window`` seconds (the study's figure 13)."""
    column = run.column(point)
    chosen = run.time >= run.time[-1] - window
    travelled = scene.feed_speed * (run.time[chosen] - run.time[chosen][0]) + run.axial[chosen, column]
    figure, axis = plt.subplots(figsize=(9, 3), layout="constrained")
    axis.plot(travelled * MM, run.radial[chosen, column] * MM, color=BLUE, linewidth=0.9)
    axis.axhline(0.0, color=GREY, linewidth=0.8)
    axis.set(
        xlabel="position along the tube [mm]",
        ylabel="radial y [mm]",
        title=f"Locus of the {point}, last {window:g} s",
    )
    axis.grid(**GRID)
    return save(figure, path)


def spectra(run: Run, point: str, path: Path, start: float, highest: float = 100.0) -> Path:
    """Amplitude spectral densities of a point's displacements after ``start`` (the study's figure 14)."""
    column = run.column(point)
    chosen = run.time >= start
    figure, axes = plt.subplots(2, 1, figsize=(9, 5), sharex=True, layout="constrained")
    for axis, signal, label in zip(axes, (run.axial, run.radial), ("axial", "radial"), strict=True):
        values = signal[chosen, column]
        segment = min(len(values), round(2.0 / run.sample_period))
        frequency, power = welch(values, 1.0 / run.sample_period, nperseg=segment)
        axis.plot(frequency, np.sqrt(power) * MM, color=BLUE, linewidth=0.9)
        axis.set_ylabel(f"{label} [mm/√Hz]")
        axis.set_xlim(0.0, highest)
        axis.set_ylim(bottom=0.0)
        axis.grid(**GRID)
    axes[1].set_xlabel("frequency [Hz]")
    figure.suptitle(f"Spectra of the {point}")
    return save(figure, path)


def travelling_shapes(run: Run, scene: Scene, path: Path) -> Path:
    """Whole-probe snapshots, time going down (the study's figure 19); the sensor as a dashed line."""
    shapes = run.shapes
    if shapes is None:
        raise ValueError("the run has no snapshots: ask for them with snapshots=...")
    figure, axes = plt.subplots(1, 2, figsize=(12, 6), layout="constrained", sharey=True)
    for axis, signal, label in zip(axes, (shapes.axial, shapes.radial), ("axial", "radial"), strict=True):
        spacing = max(float(np.ptp(signal)) * 0.55, 1e-9)
        for row, (time, values) in enumerate(zip(shapes.time, signal, strict=True)):
            offset = -row
            axis.axhline(offset, color="0.9", linewidth=0.6)
            axis.plot(shapes.position, offset + values / spacing, color=BLUE, linewidth=0.8)
            if axis is axes[0]:
                axis.text(0.5, offset + 0.12, f"{time:.2f} s", fontsize=7, color=GREY)
        axis.axvline(scene.carrier_length, color=RED, linestyle="--", linewidth=0.8)
        axis.set(
            xlabel="distance from the entrance [m]",
            title=f"{label} displacement, {spacing * MM:.2g} mm a row",
        )
        axis.set_yticks([])
    return save(figure, path)


def tension_profile(run: Run, path: Path) -> Path:
    """Mean axial force along the probe."""
    figure, axis = plt.subplots(figsize=(9, 3), layout="constrained")
    axis.plot(run.position, run.mean_tension, color=BLUE)
    axis.set(xlabel="distance from the entrance [m]", ylabel="mean tension [N]")
    axis.grid(**GRID)
    return save(figure, path)


def length_against_vibration(
    lengths: Sequence[float], low: Sequence[float], middle: Sequence[float], high: Sequence[float], path: Path
) -> Path:
    """Radial rms at the sensor against the carrier length: range and mean of an ensemble (metres in)."""
    figure, axis = plt.subplots(figsize=(7, 3.6), layout="constrained")
    low_mm, middle_mm, high_mm = (np.asarray(values) * MM for values in (low, middle, high))
    axis.fill_between(lengths, low_mm, high_mm, color=BLUE, alpha=0.2, label="range of the perturbed runs")
    axis.plot(lengths, middle_mm, "o-", color=BLUE, label="mean")
    axis.set(xlabel="carrier length [m]", ylabel="radial rms at the sensor [mm]", yscale="log")
    axis.grid(**GRID)
    axis.legend(frameon=False)
    return save(figure, path)
