"""What time-lapse changes: radial rms over the length of a full insertion, growing 1 to 10 times too fast.

A window is one metre of insertion at every factor, so the dynamics in it last the factor-th part of five
seconds; that is what a controller with a fixed period of insertion would see.
"""

from __future__ import annotations

import io
from itertools import pairwise
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from tqdm import tqdm

from agents.records.drawing import GRID, MM, save
from agents.records.provenance import provenance, write_atomically, write_json
from agents.rollouts.statistics import ratio_interval
from agents.terminal.tables import print_table
from probe_env import Scene, SimulatorBatch
from probe_env.fidelity import PRESETS

FAST = PRESETS["fast"]
FACTORS = (1, 2, 4, 10)
PROBES, FEED_SPEED, START = 8, 0.2, 5.0  # [m/s], inserted length at the start [m]
WINDOW = 1.0  # [m] of insertion
BINS = (20.0, 30.0, 40.0, 50.0, 60.0)  # [m] inserted length


def run_timelapse(output: Path) -> pd.DataFrame:
    """Full insertions at every factor; stores profile.csv, summary.csv, provenance.json and profile.png."""
    rows = []
    for factor in FACTORS:
        scene = Scene(carrier_length=START - 2.5, feed_speed=FEED_SPEED)
        batch = SimulatorBatch(
            [scene] * PROBES, FAST.method, FAST.time_step, growing=True, time_lapse=float(factor), perturbation=1e-7
        )
        for _ in tqdm(range(round((60.0 - START) / WINDOW)), desc=f"time-lapse {factor}", unit="m"):
            before = batch.simulators[0].inserted_length
            window = batch.advance(None, None, WINDOW / FEED_SPEED / factor)
            if window.diverged.any():
                raise RuntimeError(f"time-lapse {factor}: {window.diverged.sum()} probes diverged at {before:.1f} m")
            middle = 0.5 * (before + window.inserted_length[0])
            for probe, rms in enumerate(window.statistics["radial_rms_m"]):
                rows.append((factor, probe, middle, rms))
    profile = pd.DataFrame(rows, columns=["factor", "probe", "inserted_length_m", "radial_rms_m"])
    summary = summarise(profile)
    for name, table in (("profile", profile), ("summary", summary)):
        buffer = io.StringIO()
        table.to_csv(buffer, index=False, float_format="%.5g")
        write_atomically(output / f"{name}.csv", buffer.getvalue())
    write_json(output / "provenance.json", provenance())
    draw(profile, output / "profile.png")
    print_summary(summary)
    print(f"written: {output}/ (profile.csv, summary.csv, profile.png)")
    return summary


def summarise(profile: pd.DataFrame) -> pd.DataFrame:
    """Ratio of the rms of each factor to that of factor 1, by stretch of length, with 95 % bootstrap intervals.

    A probe's value in a stretch is the root mean square over its windows; probes are resampled.
    """
    rows = []
    for low, high in pairwise(BINS):
        part = profile[profile["inserted_length_m"].between(low, high, inclusive="left")]
        squares = part.assign(square=part["radial_rms_m"] ** 2).pivot_table("square", "probe", "factor")
        rms = {factor: np.sqrt(squares[factor].to_numpy()) for factor in FACTORS}
        for factor in FACTORS[1:]:
            ratio = ratio_interval(rms[factor], rms[1])
            rows.append((factor, low, high, ratio.mean, ratio.low, ratio.high))
    rows.sort()
    return pd.DataFrame(rows, columns=["factor", "from_m", "to_m", "ratio", "low", "high"])


def draw(profile: pd.DataFrame, path: Path) -> None:
    """Profiles of all factors, mean over the probes."""
    curves = {
        f"time-lapse {factor}": part.groupby("inserted_length_m")["radial_rms_m"].mean()
        for factor, part in profile.groupby("factor")
    }
    _draw({name: (c.index.to_numpy(), c.to_numpy()) for name, c in curves.items()}, path)


def markdown(summary: pd.DataFrame) -> str:
    """The ratios as a Markdown table."""
    stretches = [f"{low:.0f}-{high:.0f} m" for low, high in pairwise(BINS)]
    lines = ["| time-lapse | " + " | ".join(stretches) + " |", "|---" * (len(stretches) + 1) + "|"]
    for factor, part in summary.groupby("factor"):
        cells = [f"{row.ratio:.2f} [{row.low:.2f}, {row.high:.2f}]" for row in part.itertuples()]
        lines.append(f"| {factor} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def print_summary(summary: pd.DataFrame) -> None:
    """The ratios on the terminal."""
    rows = (
        (str(row.factor), f"{row.from_m:.0f}-{row.to_m:.0f} m", f"{row.ratio:.2f}", f"[{row.low:.2f}, {row.high:.2f}]")
        for row in summary.itertuples()
    )
    header = ("factor", "inserted length", "ratio", "interval")
    print_table("Radial rms with time-lapse over that without, 95 % intervals", header, rows, left=0)


def _draw(curves: dict[str, tuple[np.ndarray, np.ndarray]], path: Path) -> Path:
    """Radial rms [m] over inserted length [m], one curve a name."""
    figure, axis = plt.subplots(figsize=(7, 3.6), layout="constrained")
    for name, (length, rms) in curves.items():
        axis.plot(length, rms * MM, label=name, linewidth=1.2)
    axis.set(xlabel="inserted length [m]", ylabel="radial rms at the sensor [mm]")
    axis.grid(**GRID)
    axis.legend(frameon=False)
    return save(figure, path)
