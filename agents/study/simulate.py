"""One scene from start to end: simulate, tabulate, draw, and store everything in a folder."""

from __future__ import annotations

import io
import math
import warnings
from pathlib import Path

import numpy as np
from tqdm import tqdm

from agents.records.provenance import provenance, write_atomically, write_json
from agents.study import figures
from agents.terminal.tables import print_table
from probe_env import Run, Simulator
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
)
SHAPE_COUNT, SHAPE_SPACING = 10, 0.01


def simulate_scene(
    simulator: Simulator,
    duration: float,
    statistics_from: float,
    output: Path,
    name: str,
    quiet: bool = False,
) -> dict[str, float]:
    """Run a scene with a progress bar and write scene.toml, results.json, signals.npz and figures.

    Returns:
        the sensor's statistics and the mean root tension, SI units.

    Raises:
        ValueError: an argument is not valid; nothing was written.
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
    with tqdm(total=duration, desc=name, disable=quiet, bar_format=layout) as bar:

        def show(time: float) -> None:
            bar.update(time - bar.n)

        run = simulator.run(duration, points=("sensor", "tip", "root"), snapshots=snapshots, progress=show)
    statistics = point_statistics(run, "sensor", statistics_from)
    root = point_statistics(run, "root", statistics_from)
    statistics["root_tension_mean_n"] = root["tension_mean_n"]
    statistics["root_tension_rms_n"] = root["tension_rms_n"]
    _store(simulator, run, statistics, statistics_from, output, name)
    return statistics


def _store(simulator: Simulator, run: Run, statistics: dict[str, float], start: float, output: Path, name: str) -> None:
    output.mkdir(parents=True, exist_ok=True)
    scene, stable = simulator.scene, simulator.stable_time_step
    write_atomically(output / "scene.toml", scene.to_toml())
    column = run.column("sensor")
    chosen = run.time >= start
    write_json(
        output / "results.json",
        {
            "scene": scene.model_dump(),
            "method": simulator.method,
            "solver": simulator.solver,
            "time_step_s": simulator.time_step,
            "stable_time_step_s": stable if math.isfinite(stable) else None,  # implicit holds with any step
            "nodes_per_pitch": simulator.nodes_per_pitch,
            "statistics_from_s": start,
            "statistics": statistics,
            "axial_frequencies_hz": dominant_frequencies(run.axial[chosen, column], run.sample_period),
            "radial_frequencies_hz": dominant_frequencies(run.radial[chosen, column], run.sample_period),
            **provenance(),
        },
    )
    arrays = {
        key: getattr(run, key)
        for key in (
            "time",
            "axial",
            "radial",
            "rotation",
            "tension",
            "distance_from_tip",
            "mean_tension",
            "position",
        )
    }
    arrays["points"] = np.array(run.points)
    if run.shapes is not None:
        arrays |= {f"shapes_{key}": getattr(run.shapes, key) for key in run.shapes.__dataclass_fields__}
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **arrays)
    write_atomically(output / "signals.npz", buffer.getvalue())
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # a probe at rest has flat axes
        figures.time_histories(run, "sensor", output / "time_histories.png", f"{name}: displacement of the sensor")
        figures.locus(run, "sensor", scene, output / "locus.png")
        figures.spectra(run, "sensor", output / "spectra.png", start)
        figures.tension_profile(run, output / "tension.png")
        if run.shapes is not None:
            figures.travelling_shapes(run, scene, output / "shapes.png")


def print_statistics(statistics: dict[str, float], title: str) -> None:
    """The sensor's statistics as a table."""
    rows = [(label, f"{statistics[key] * factor:.4g}", unit) for label, key, factor, unit in ROWS]
    rows.append(("root tension, mean", f"{statistics['root_tension_mean_n']:.4g}", "N"))
    rows.append(("root tension, rms", f"{statistics['root_tension_rms_n']:.4g}", "N"))
    print_table(title, ("at the sensor", "value", "unit"), rows)
