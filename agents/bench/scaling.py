"""What a thousand insertions cost on more cores: measured on this machine, projected for others."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import Final

import pandas as pd
from tqdm import tqdm

from agents.policies.fixed import Constant
from agents.processes.pool import stop_pool
from agents.processes.workers import Workers
from agents.records.provenance import provenance, write_atomically, write_json
from agents.rollouts.plan import BATCH, Plan, portion_size, run_plan
from probe_env import TaskConfig
from probe_env.envs.contexts import spread_contexts
from probe_env.fidelity import PRESETS
from probe_env.machine import available_cores

EPISODES: Final = 1000
CORES: Final = (2, 16, 64, 256, 1024)
SIZES: Final = (1, 2, 4, 8, 16)
MEASURED: Final = 16
"""Insertions of the measured evaluation."""


def run_scaling(output: Path) -> pd.DataFrame:
    """Seconds of an insertion in portions of several sizes, of an evaluation with one and all cores, and a projection.

    Stores portions.csv, jobs.csv, projection.csv and provenance.json.
    """
    _seconds(1, Workers())  # compiled before the clock starts
    portions = pd.DataFrame(
        [(size, _seconds(size, Workers()) / size) for size in tqdm(SIZES, desc="portions", unit="size")],
        columns=["size", "seconds_an_insertion"],
    )
    cores = available_cores()
    jobs = pd.DataFrame(
        [(n, _seconds(MEASURED, Workers(jobs=n), fresh=n > 1)) for n in (1, cores)], columns=["jobs", "seconds"]
    )
    idle = _seconds(cores, Workers(jobs=cores), fresh=True) - float(portions["seconds_an_insertion"].iloc[0])
    projection = project(portions, max(idle, 0.0))
    for name, table in (("portions", portions), ("jobs", jobs), ("projection", projection)):
        write_atomically(output / f"{name}.csv", table.to_csv(index=False, float_format="%.4g"))
    write_json(output / "provenance.json", provenance())
    print(markdown(projection))
    print(f"written: {output}/ (portions.csv, jobs.csv, projection.csv)")
    return projection


def _seconds(episodes: int, workers: Workers, fresh: bool = False) -> float:
    """Wall time of so many insertions at 0.2 m/s, one thread a worker; ``fresh``: workers must start first."""
    config = TaskConfig()
    contexts = spread_contexts("test", 1) * episodes
    plan = Plan({"constant": Constant(config)}, contexts, (0,), config, PRESETS["fast"])
    if fresh:
        stop_pool()
    begin = time.perf_counter()
    run_plan(plan, None, threads=1, workers=workers)
    return time.perf_counter() - begin


def project(portions: pd.DataFrame, start: float) -> pd.DataFrame:
    """Wall time of ``EPISODES`` insertions over cores: portions are worked off in rounds, after the workers' start.

    Args:
        portions: size and seconds_an_insertion.
        start: of a worker until its first step [s].
    """
    sizes, seconds = portions["size"].to_numpy(), portions["seconds_an_insertion"].to_numpy(dtype=float)
    best = EPISODES * float(seconds[sizes == BATCH][0])
    rows = []
    for cores in CORES:
        size = portion_size(EPISODES, cores)
        rounds = math.ceil(math.ceil(EPISODES / size) / cores)
        wall = start + rounds * size * float(seconds[sizes <= size][-1])
        rows.append((cores, size, rounds, wall, best / cores / wall))
    return pd.DataFrame(rows, columns=["cores", "portion", "rounds", "wall_s", "efficiency"])


def markdown(projection: pd.DataFrame) -> str:
    """The projection as a table."""
    lines = ["| cores | insertions a portion | rounds | wall time | efficiency |", "|---|---|---|---|---|"]
    for row in projection.to_dict("records"):
        cells = f"{row['cores']:.0f} | {row['portion']:.0f} | {row['rounds']:.0f} | {row['wall_s']:.0f} s"
        lines.append(f"| {cells} | {100.0 * row['efficiency']:.0f} % |")
    return "\n".join(lines)
