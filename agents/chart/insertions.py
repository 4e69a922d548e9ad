"""The whole insertion, 5 to 60 m at 0.2 m/s: statistics over length for time-lapse, step and method."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from tqdm import tqdm

from agents.chart.ensembles import COLUMNS, member_statistics
from agents.records.code_hash import code_hash
from agents.records.store import Store
from agents.study.cases import PERTURBATION
from agents.terminal.work import Work, announce
from probe_env import Scene, SimulatorBatch
from probe_env.physics.simulation.signals import SAMPLE_PERIOD

FEED_SPEED, START, END = 0.2, 5.0, 60.0  # [m/s], [m], [m]
STRETCH = 5.0  # [m] a row
CODE = ("agents.chart.insertions:_insert",)


@dataclass(frozen=True)
class Insertion:
    """One way to simulate it."""

    method: str = "imex"
    time_step: float = 2e-4
    time_lapse: float = 1.0
    nodes_per_pitch: int = 4
    members: int = 8

    @property
    def key(self) -> dict[str, Any]:
        """Everything but the number of members, as columns."""
        return {COLUMNS.get(name, name): value for name, value in asdict(self).items() if name != "members"}


REFERENCE = Insertion(time_step=5e-5)
"""Which of them the others on table 2's mesh are compared with."""
CONVERGED = Insertion("imex32", 5e-5, nodes_per_pitch=16)
"""Which of them all are compared with for mesh and step together."""
INSERTIONS = (
    *(Insertion("imex32", time_lapse=factor) for factor in (20.0, 10.0, 4.0, 2.0, 1.0)),
    *(Insertion("imex32", 1e-4, factor) for factor in (4.0, 1.0)),
    *(Insertion(time_lapse=factor) for factor in (4.0, 1.0)),
    REFERENCE,
    *(Insertion("superelement32", time_lapse=factor, members=16) for factor in (20.0, 10.0, 4.0, 2.0, 1.0)),
    Insertion("superelement32", 1e-4),
    Insertion("superelement", 5e-5),
    Insertion("newmark", 1e-4, 4.0, members=4),
    CONVERGED,
)


def run_insertions(output: Path) -> pd.DataFrame:
    """A row a stretch of length and member in insertions.csv; insertions that are stored are not run again.

    Raises:
        RuntimeError: a probe diverged.
    """
    columns = (*REFERENCE.key, "member", "from_m")
    store = Store(output / "insertions.csv", columns, lambda row: code_hash(CODE, row["method"]))

    def stored(insertion: Insertion) -> bool:
        return store.has(*insertion.key.values(), insertion.members - 1, END - STRETCH)

    announce(Work("setting", len(INSERTIONS), lambda: sum(map(stored, INSERTIONS)), store.path))
    for insertion in INSERTIONS:
        if not stored(insertion):
            store.add(*_insert(insertion))
    return store.table


def _insert(insertion: Insertion) -> list[dict[str, Any]]:
    scene = Scene(carrier_length=START - 2.5, feed_speed=FEED_SPEED)
    batch = SimulatorBatch(
        [scene] * insertion.members, insertion.method, insertion.time_step, insertion.nodes_per_pitch,
        growing=True, time_lapse=insertion.time_lapse, perturbation=PERTURBATION,
    )  # fmt: skip
    rows: list[dict[str, Any]] = []
    name = f"{insertion.method} {insertion.time_step:g} s, time-lapse {insertion.time_lapse:g}"
    for stretch in tqdm(np.arange(START, END, STRETCH), desc=name, unit="stretch"):
        window = batch.advance(
            None, None, STRETCH / FEED_SPEED / insertion.time_lapse, SAMPLE_PERIOD, keep_samples=True
        )
        if window.diverged.any():
            raise RuntimeError(f"{name}: {window.diverged.sum()} probes diverged beyond {stretch:g} m")
        for member in range(insertion.members):
            place = {"member": member, "from_m": float(stretch)}
            rows.append(insertion.key | place | member_statistics(window, member))
    return rows
