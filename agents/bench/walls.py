"""What the cable's contact with the walls costs where it does not act."""

from __future__ import annotations

import time
from typing import Any, Final

import numpy as np
from tqdm import tqdm

from probe_env import Scene, SimulatorBatch
from probe_env.physics.methods import METHODS

METHODS_TIMED: Final = ("imex", "imex32")
STEPS: Final = {4: 2e-4, 8: 1.25e-4}
"""Nodes a pitch, and the longest step [s] that presets take with them."""
LENGTHS: Final = (30.0, 50.0)
ROUNDS: Final = 25
SIMULATED: Final = 0.1
"""Seconds a round."""
TITLE: Final = "A step with the cable's contact, where it does not act, over one without"
HEADER: Final = ("method", "nodes a pitch", "length [m]", "median ratio", f"quartiles of {ROUNDS}")


def idle_cable() -> list[dict[str, Any]]:
    """Time of a step with ``contact.cable`` over that without, of table 2's probe, whose cable touches no wall.

    Returns:
        a row for each method, mesh and length [m]: median and quartiles of the ratio of processor times in rounds that
        take turns, on one thread.
    """
    rows = []
    cases = [(method, nodes, length) for method in METHODS_TIMED for nodes in STEPS for length in LENGTHS]
    for method, nodes, length in tqdm(cases, desc="cable's contact", unit="case"):
        batches = [_batch(method, nodes, length, cable) for cable in (False, True)]
        ratios = [_seconds(batches[1]) / free for free in (_seconds(batches[0]) for _ in range(ROUNDS))]
        low, median, high = np.percentile(ratios, (25, 50, 75))
        rows.append({
            "method": method, "nodes_per_pitch": nodes, "length_m": length,
            "ratio": float(median), "low": float(low), "high": float(high),
        })  # fmt: skip
    return rows


def cells(rows: list[dict[str, Any]]) -> list[tuple[str, ...]]:
    """What ``idle_cable`` found, for a table under ``HEADER``."""
    return [
        (
            row["method"], str(row["nodes_per_pitch"]), f"{row['length_m']:g}",
            f"{row['ratio']:.2f}", f"{row['low']:.2f} to {row['high']:.2f}",
        )
        for row in rows
    ]  # fmt: skip


def _batch(method: str, nodes: int, length: float, cable: bool) -> SimulatorBatch:
    scene = Scene.model_validate({"carrier_length": length, "contact": {"cable": cable}})
    batch = SimulatorBatch([scene] * METHODS[method].width, method, STEPS[nodes], nodes, perturbation=1e-7, threads=1)
    batch.advance(None, None, SIMULATED)  # compiled and warm
    return batch


def _seconds(batch: SimulatorBatch) -> float:
    start = time.process_time()
    batch.advance(None, None, SIMULATED)
    return time.process_time() - start
