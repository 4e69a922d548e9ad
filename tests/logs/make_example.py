"""Makes ``configs/logs/example-rig.csv``: an insertion as a German rig would have logged it.

Run it as ``python tests/logs/make_example.py`` (half a minute). The environment feeds at ``fidelity="fast"`` and stands
still once; what its sensors show twice a second is written with noise, semicolons and decimal commas.
"""

from __future__ import annotations

from datetime import datetime, timedelta
from pathlib import Path

import gymnasium as gym
import numpy as np

import probe_env
from probe_env import TaskConfig

FILE = Path(__file__).parents[2] / "configs" / "logs" / "example-rig.csv"
HEAD = "Zeitstempel;Weg [m];Vorschub [mm/s];Luft [m³/h];Zugkraft [N];Rauschen [µm];Bemerkung"
PERIOD = 0.5
STANDSTILL = 30.0, 20.0
"""Inserted length at which the operator stops [m], and for how long [s]."""
ENCODER_NOISE = 2e-4
"""Standard deviation [m]."""


def feed_and_air(length: float, since_stop: float | None) -> tuple[float, float]:
    """What the operator sets: slower with length, and once nothing at all."""
    standing = since_stop is not None and since_stop < STANDSTILL[1]
    feed = 0.0 if standing else float(np.interp(length, [5.0, 15.0, 25.0, 40.0], [0.35, 0.3, 0.16, 0.1]))
    return feed, float(np.interp(length, [5.0, 25.0, 40.0], [63.0, 90.0, 110.0])) / 3600.0


def main() -> None:
    """Simulate and write."""
    config = TaskConfig(feed_speeds=(1e-6, 0.4), period=PERIOD)  # the usual task's feed does not stop
    env = gym.make("probe_env/Insertion-v1", config=config, fidelity="fast", contexts=[probe_env.Context(friction=0.2)])
    _, info = env.reset(seed=1)
    rng, start = np.random.default_rng(1), datetime(2024, 5, 14, 9, 31, 5, 200_000)
    rows, time, stopped, done = ["# Prüfstand 2, Sonde 7, Einschub von Hand gesteuert", HEAD], 0.0, None, False
    while not done:
        length = float(info["inserted_length"])
        if stopped is None and length >= STANDSTILL[0]:
            stopped = time
        feed, air = feed_and_air(length, None if stopped is None else time - stopped)
        _, _, terminated, truncated, info = env.step(config.actions(feed, air)[0].astype(np.float32))
        done = terminated or truncated
        time += PERIOD
        shown = (
            f"{info['inserted_length'] + ENCODER_NOISE * rng.normal():.4f}",
            f"{1e3 * info['feed_speed']:.1f}",
            f"{3600.0 * info['air_supply_rate'] + 0.3 * rng.normal():.1f}",
            f"{info['tension_mean_n'] * (1.0 + 0.02 * rng.normal()):.2f}",
            f"{1e6 * np.hypot(info['radial_rms_m'], 1e-6) * np.exp(0.05 * rng.normal()):.1f}",
        )
        stamp = (start + timedelta(seconds=time)).isoformat(timespec="milliseconds")
        note = "Halt" if stopped is not None and time - stopped <= PERIOD else ""
        rows.append(";".join((stamp, *(cell.replace(".", ",") for cell in shown), note)))
    FILE.parent.mkdir(exist_ok=True)
    FILE.write_bytes(("\r\n".join(rows) + "\r\n").encode("cp1252"))
    print(f"written: {FILE}, {len(rows) - 2} rows")


if __name__ == "__main__":
    main()
