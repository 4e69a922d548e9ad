"""Figures in the style of the study: time histories, locus, spectra, travelling shapes."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from scipy.signal import welch

from agents.atomic import write_atomically
from probe_env import Run, Scene

MM = 1e3
GRID: dict[str, Any] = {"color": "0.9", "linewidth": 0.8}
BLUE, RED, GREY = "#1f5fa8", "#c0392b", "0.45"


def save(figure: Figure, path: Path, dpi: int = 110) -> Path:
    """Write a figure as a whole, and close it."""
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=dpi, format=path.suffix.removeprefix("."))
    write_atomically(path, buffer.getvalue())
    plt.close(figure)
    return path


def _plain(name: str) -> str:
    """A name as it is: between dollar signs would be a formula."""
    return name.replace("$", r"\$")


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


def profiles(curves: dict[str, tuple[np.ndarray, np.ndarray]], path: Path) -> Path:
    """Radial rms [m] over inserted length [m], one curve a name."""
    figure, axis = plt.subplots(figsize=(7, 3.6), layout="constrained")
    for name, (length, rms) in curves.items():
        axis.plot(length, rms * MM, label=name, linewidth=1.2)
    axis.set(xlabel="inserted length [m]", ylabel="radial rms at the sensor [mm]")
    axis.grid(**GRID)
    axis.legend(frameon=False)
    return save(figure, path)


def trade_off(summary: pd.DataFrame, path: Path) -> Path:
    """Inspection time against the share of length out of the limit, a point a policy with both intervals."""
    figure, axis = plt.subplots(figsize=(9, 5), layout="constrained")
    rows = summary.set_index(["policy", "kpi"])
    for colour, policy in zip(_colours(), dict.fromkeys(summary["policy"]), strict=False):
        time, share = rows.loc[(policy, "inspection_time_s")], rows.loc[(policy, "share_within_limit")]
        x, y = time["mean"], 100.0 * (1.0 - share["mean"])
        across = [[x - time["low"]], [time["high"] - x]]
        along = [[100.0 * (share["high"] - share["mean"])], [100.0 * (share["mean"] - share["low"])]]
        axis.errorbar(x, y, xerr=across, yerr=along, fmt="o", capsize=3, color=colour, label=_plain(policy))
    return _save_time_against_vibration(figure, path)


def front(points: pd.DataFrame, path: Path) -> Path:
    """Fronts of policy families: inspection time against length out of the limit, a line a family."""
    figure, axis = plt.subplots(figsize=(9, 5), layout="constrained")
    for colour, (family, rows) in zip(_colours(), points.groupby("family", sort=False), strict=False):
        ordered = rows.sort_values("time_s")
        x, y = ordered["time_s"], 100.0 * ordered["out_share"]
        across = [x - ordered["time_low"], ordered["time_high"] - x]
        along = [y - 100.0 * ordered["out_low"], 100.0 * ordered["out_high"] - y]
        axis.errorbar(x, y, xerr=across, yerr=along, fmt="o-", capsize=3, color=colour, label=_plain(str(family)))
    return _save_time_against_vibration(figure, path)


def _save_time_against_vibration(figure: Figure, path: Path) -> Path:
    (axis,) = figure.axes
    axis.set_xlabel("inspection time [s]")
    axis.set_ylabel("length out of the limit [%]")
    axis.set_ylim(bottom=0.0)
    axis.grid(**GRID)
    axis.legend(frameon=False)
    return save(figure, path)


def policy_profiles(profile: pd.DataFrame, path: Path) -> Path:
    """Feed, air and vibration over the inserted length by policy, in bins of two metres."""
    figure, axes = plt.subplots(3, 1, figsize=(9, 8), sharex=True, layout="constrained")
    binned = profile.assign(bin=(profile["inserted_length"] // 2.0) * 2.0 + 1.0)
    fields = (
        ("feed_speed", 1.0, "feed [m/s]"),
        ("air_supply_rate", 3600.0, "air [m3/h]"),
        ("radial_rms_m", MM, "radial rms [mm]"),
    )
    for colour, policy in zip(_colours(), dict.fromkeys(profile["policy"]), strict=False):
        groups = binned[binned["policy"] == policy].groupby("bin")
        for axis, (name, factor, label) in zip(axes, fields, strict=True):
            mean = groups[name].mean() * factor
            axis.plot(mean.index, mean, color=colour, label=_plain(policy))
            axis.set_ylabel(label)
        loud = groups["radial_rms_m"].quantile(0.9) * MM
        axes[2].plot(loud.index, loud, color=colour, linewidth=0.7)
    for axis in axes:
        axis.grid(**GRID)
        axis.set_ylim(bottom=0.0)
    axes[0].legend(frameon=False, ncols=3)
    axes[2].axhline(0.1, color=GREY, linestyle=":")
    axes[2].set_xlabel("inserted length [m]")
    return save(figure, path)


def worst_episodes(table: pd.DataFrame, profile: pd.DataFrame, path: Path) -> Path:
    """Of each policy the episode with the lowest reward: feed and vibration over the inserted length."""
    policies = list(dict.fromkeys(table["policy"]))
    figure, axes = plt.subplots(
        len(policies), 1, figsize=(9, 2.0 * len(policies) + 0.6), sharex=True, squeeze=False, layout="constrained"
    )
    for axis, policy in zip(axes[:, 0], policies, strict=True):
        part = table[table["policy"] == policy]
        worst = part.loc[part["reward"].idxmin()]
        place = ["policy", "context", "seed"]
        rows = profile[(profile[place] == worst[place]).all(axis=1)]
        rows = rows[rows["agent"] == worst["agent"]] if "agent" in rows else rows
        axis.plot(rows["inserted_length"], rows["radial_rms_m"] * MM, color=BLUE, linewidth=0.8)
        axis.set_ylabel("radial rms [mm]", color=BLUE)
        feed = axis.twinx()
        feed.plot(rows["inserted_length"], rows["feed_speed"], color=RED, linewidth=0.8)
        feed.set_ylabel("feed [m/s]", color=RED)
        feed.set_ylim(0.0, 0.42)
        axis.set_title(
            f"{_plain(policy)}: reward {worst['reward']:.0f}, friction {worst['friction']:.2f},"
            f" helix {worst['helix_diameter']:g} m",
            fontsize=10,
        )
        axis.grid(**GRID)
    axes[-1, 0].set_xlabel("inserted length [m]")
    return save(figure, path)


def _colours() -> list[Any]:
    return list(plt.get_cmap("tab20").colors[::2] + plt.get_cmap("tab20").colors[1::2])  # type: ignore[attr-defined]


def design_front(table: pd.DataFrame, references: pd.DataFrame, path: Path) -> Path:
    """Designs of a search: vibration against time and against drive margin, with the probes that they are to beat."""
    figure, axes = plt.subplots(1, 2, figsize=(11, 4.5), sharey=True, layout="constrained")
    labels = {"inspection_time_s": "inspection time [s]", "drive_margin_n": "drive margin [N]"}
    if np.ptp(table["inspection_time_s"]) < 1.0:  # a given feed: all take the same time
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
    return save(figure, path)


def parallel_coordinates(table: pd.DataFrame, axes: dict[str, tuple[float, float, str]], path: Path) -> Path:
    """Every design of a search as a line through its parameters, each from its lowest to its highest value."""
    figure, axis = plt.subplots(figsize=(11, 5), layout="constrained")
    names = list(axes)
    for on_front, colour, width in ((False, "0.85", 0.6), (True, BLUE, 1.4)):
        for row in table[table["on_front"] == on_front].to_dict("records"):
            shares = [(row[name] - axes[name][0]) / (axes[name][1] - axes[name][0]) for name in names]
            axis.plot(range(len(names)), shares, color=colour, linewidth=width)
    labels = [f"{name.replace('_', ' ')}\n{axes[name][0]:.3g} to {axes[name][1]:.3g} {axes[name][2]}" for name in names]
    axis.set_xticks(range(len(names)), labels, fontsize=7)
    axis.set(ylabel="from lowest to highest", ylim=(-0.02, 1.02), title="Designs tried (grey) and on the front (blue)")
    axis.grid(**GRID)
    return save(figure, path)


def learning_curves(runs: dict[str, pd.DataFrame], path: Path) -> Path:
    """Validation reward over environment steps of training, a line a seed; step 0 is the warm start."""
    figure, axis = plt.subplots(figsize=(8, 4), layout="constrained")
    for colour, (name, curves) in zip(_colours(), runs.items(), strict=False):
        for number, (_, rows) in enumerate(curves.groupby("seed")):
            label = name if number == 0 else None
            axis.plot(rows["steps"], rows["reward"], "o-", color=colour, linewidth=1.0, markersize=3, label=label)
    axis.set(xlabel="environment steps after the warm start", ylabel="reward on the validation tubes")
    axis.grid(**GRID)
    axis.legend(frameon=False)
    return save(figure, path)
