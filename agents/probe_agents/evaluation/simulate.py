"""Simulates one scene: statistics, figures and files in a folder."""

import io
import math
import warnings
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from scipy.signal import welch
from tqdm import tqdm

from probe_agents.records.atomic import write_atomically
from probe_agents.records.drawing import BLUE, GREY, MM, RED, save
from probe_agents.records.manifest import write_json, write_manifest
from probe_agents.terminal.tables import print_table
from probe_env import Run, Scene, Simulator
from probe_env.physics.simulation.signals import dominant_frequencies, point_statistics

ROWS = (
    ("axial mean", "axial_mean_m", 1e3, "mm"),
    ("axial rms", "axial_rms_m", 1e3, "mm"),
    ("radial mean", "radial_mean_m", 1e3, "mm"),
    ("radial rms", "radial_rms_m", 1e3, "mm"),
    ("radial p99", "radial_p99_m", 1e3, "mm"),
    ("radial max", "radial_max_m", 1e3, "mm"),
    ("radial acceleration mean", "radial_acceleration_mean_m_per_s2", 1.0, "m/s2"),
    ("radial acceleration rms", "radial_acceleration_rms_m_per_s2", 1.0, "m/s2"),
    ("radial acceleration p99 (magnitude)", "radial_acceleration_p99_m_per_s2", 1.0, "m/s2"),
    ("radial acceleration max (magnitude)", "radial_acceleration_max_m_per_s2", 1.0, "m/s2"),
    ("share of time lifted off", "lift_off_share", 100.0, "%"),
    ("axial dominant frequency", "axial_peak_hz", 1.0, "Hz"),
    ("radial dominant frequency", "radial_peak_hz", 1.0, "Hz"),
    ("root tension, mean", "root_tension_mean_n", 1.0, "N"),
    ("root tension, rms", "root_tension_rms_n", 1.0, "N"),
)
SHAPE_COUNT, SHAPE_SPACING = 10, 0.01  # snapshots, and the time between them [s]
ARRAYS = ("time", "axial", "radial", "rotation", "tension", "distance_from_tip", "mean_tension", "position")
LOCUS_WINDOW = 0.4  # [s]
HIGHEST_FREQUENCY = 100.0  # [Hz]


def simulate_scene(
    simulator: Simulator, duration: float, statistics_from: float, output: Path, name: str
) -> dict[str, float]:
    """Run a scene with a progress bar and write scene.toml, results.json, signals.npz, manifest.json and figures.

    Returns statistics of the sensor and the mean root tension, SI units.

    Raises:
        SimulationError: the state diverged; nothing was written.
    """
    if not 0.0 <= statistics_from < duration:
        raise ValueError(
            f"statistics_from = {statistics_from!r} s is outside the run: accepted is 0 to less than {duration:g} s"
        )
    dt = simulator.time_step
    last = round(duration / dt) * dt
    spacing = round(SHAPE_SPACING / dt) * dt
    snapshots = [last - k * spacing for k in range(SHAPE_COUNT)][::-1] if spacing > 0.0 and last > 0.2 else ()
    layout = "{l_bar}{bar}| {n:.2f}/{total:g} s [{elapsed}<{remaining}]"
    with tqdm(total=duration, desc=name, bar_format=layout) as bar:

        def show(time: float) -> None:
            bar.update(time - bar.n)

        run = simulator.run(duration, points=("sensor", "tip", "root"), snapshots=snapshots, progress=show)
    statistics = point_statistics(run, "sensor", statistics_from)
    root = point_statistics(run, "root", statistics_from)
    statistics |= {f"root_{key}": root[key] for key in ("tension_mean_n", "tension_rms_n")}
    _store(simulator, run, statistics, statistics_from, output)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # flat axes of a probe at rest
        _draw(run, simulator.scene, statistics_from, output, name)
    return statistics


def _store(simulator: Simulator, run: Run, statistics: dict[str, float], start: float, output: Path) -> None:
    output.mkdir(parents=True, exist_ok=True)
    scene, stable = simulator.scene, simulator.stable_time_step
    write_atomically(output / "scene.toml", scene.to_toml())
    column = run.column("sensor")
    chosen = run.time >= start
    results = {
        "scene": scene.model_dump(),
        "method": simulator.method.name,
        "time_step_s": simulator.time_step,
        "stable_time_step_s": stable if math.isfinite(stable) else None,  # implicit is stable with any step
        "nodes_per_pitch": simulator.nodes_per_pitch,
        "statistics_from_s": start,
        "statistics": statistics,
        "axial_frequencies_hz": dominant_frequencies(run.axial[chosen, column], run.sample_period),
        "radial_frequencies_hz": dominant_frequencies(run.radial[chosen, column], run.sample_period),
    }
    write_json(output / "results.json", results)
    arrays = {key: getattr(run, key) for key in ARRAYS} | {"points": np.array(run.points)}
    if run.shapes is not None:
        arrays |= {f"shapes_{key}": getattr(run.shapes, key) for key in run.shapes.__dataclass_fields__}
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **arrays)
    write_atomically(output / "signals.npz", buffer.getvalue())
    write_manifest(output, ("scene.toml", "results.json", "signals.npz"))


def _draw(run: Run, scene: Scene, start: float, output: Path, name: str) -> None:
    """The study's figures of the sensor: 11-18, 20 (histories), 13 (locus), 14 (spectra), 19 (shapes); and tension."""
    column = run.column("sensor")
    axial, radial = run.axial[:, column], run.radial[:, column]

    figure, axes = plt.subplots(2, 1, figsize=(9, 5), sharex=True, layout="constrained")
    for axis, signal, label in zip(axes, (axial, radial), ("axial x", "radial y"), strict=True):
        axis.plot(run.time, signal * MM, color=BLUE, linewidth=0.6)
        axis.set_ylabel(f"{label} [mm]")
    axes[1].axhline(0.0, color=GREY, linewidth=0.8)
    axes[1].set_xlabel("time [s]")
    figure.suptitle(f"{name}: displacement of the sensor")
    save(figure, output / "time_histories.png")

    last = run.time >= run.time[-1] - LOCUS_WINDOW
    travelled = scene.feed_speed * (run.time[last] - run.time[last][0]) + axial[last]
    figure, axis = plt.subplots(figsize=(9, 3), layout="constrained")
    axis.plot(travelled * MM, radial[last] * MM, color=BLUE, linewidth=0.9)
    axis.axhline(0.0, color=GREY, linewidth=0.8)
    axis.set(xlabel="position along the tube [mm]", ylabel="radial y [mm]")
    axis.set_title(f"Locus of the sensor, last {LOCUS_WINDOW:g} s")
    save(figure, output / "locus.png")

    figure, axes = plt.subplots(2, 1, figsize=(9, 5), sharex=True, layout="constrained")
    for axis, signal, label in zip(axes, (axial, radial), ("axial", "radial"), strict=True):
        values = signal[run.time >= start]
        segment = min(len(values), round(2.0 / run.sample_period))
        frequency, power = welch(values, 1.0 / run.sample_period, nperseg=segment)
        axis.plot(frequency, np.sqrt(power) * MM, color=BLUE, linewidth=0.9)
        axis.set_ylabel(f"{label} [mm/√Hz]")
        axis.set_xlim(0.0, HIGHEST_FREQUENCY)
        axis.set_ylim(bottom=0.0)
    axes[1].set_xlabel("frequency [Hz]")
    figure.suptitle("Spectra of the sensor")
    save(figure, output / "spectra.png")

    figure, axis = plt.subplots(figsize=(9, 3), layout="constrained")
    axis.plot(run.position, run.mean_tension, color=BLUE)
    axis.set(xlabel="distance from the entrance [m]", ylabel="mean tension [N]")
    save(figure, output / "tension.png")

    if run.shapes is not None:
        save(_shapes(run, scene), output / "shapes.png", grid=False)


def _shapes(run: Run, scene: Scene) -> Figure:
    """Snapshots of the whole probe, in time from top to bottom; the sensor as a dashed line."""
    shapes = run.shapes
    assert shapes is not None
    figure, axes = plt.subplots(1, 2, figsize=(12, 6), layout="constrained", sharey=True)
    for axis, signal, label in zip(axes, (shapes.axial, shapes.radial), ("axial", "radial"), strict=True):
        spacing = max(float(np.ptp(signal)) * 0.55, 1e-9)
        for row, (time, values) in enumerate(zip(shapes.time, signal, strict=True)):
            axis.axhline(-row, color="0.9", linewidth=0.6)
            axis.plot(shapes.position, values / spacing - row, color=BLUE, linewidth=0.8)
            if axis is axes[0]:
                axis.text(0.5, 0.12 - row, f"{time:.2f} s", fontsize=7, color=GREY)
        axis.axvline(scene.carrier_length, color=RED, linestyle="--", linewidth=0.8)
        axis.set_xlabel("distance from the entrance [m]")
        axis.set_title(f"{label} displacement, {spacing * MM:.2g} mm a row")
        axis.set_yticks([])
    return figure


def print_statistics(statistics: dict[str, float], title: str) -> None:
    """Print the statistics of the sensor."""
    rows = [(label, f"{statistics[key] * factor:.4g}", unit) for label, key, factor, unit in ROWS]
    print_table(title, ("at the sensor", "value", "unit"), rows)
