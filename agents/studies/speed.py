"""Speed: the methods as ratios within one run, and environment steps per second.

Machines are shared, so only ratios of one run carry over. Every kernel is compiled and warm before its clock starts;
jobs take turns and the best of several repeats counts.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Final

import gymnasium as gym
import numpy as np
import pandas as pd
from tqdm import tqdm

from agents.records.atomic import write_atomically
from agents.records.manifest import write_manifest
from agents.studies.tables import print_frame
from agents.vec_env import ProbeVecEnv
from probe_env import Scene, SimulatorBatch
from probe_env.physics.methods import METHODS

SIMULATED: Final = 0.4  # [s] of a method
SLOW_SIMULATED: Final = 0.04  # [s] of a method without lanes and with a shorter step than the study's
STUDY: Final = ("newmark", 1)
ENV_ID, LENGTH = "probe_env/Snapshot-v1", 27.5  # carrier length [m]: half of an insertion
ENVIRONMENTS: Final = (1, 16, 64)
STEPS: Final = 20


def run_speed(output: Path, repeats: int = 7, environments: tuple[int, ...] = ENVIRONMENTS) -> pd.DataFrame:
    """Time every method alone and with full lanes at l = 50 m, and environments in batches; store and print.

    Writes methods.csv (method, probes, time_step_s, ns_per_node_step, s_per_simulated_s, ratio: the study's scheme over
    this one for a simulated second of one probe) and environments.csv (environments, steps_per_s).

    Args:
        output: folder.
        repeats: of every timing, 1 to 1000.
        environments: sizes of the batches; 1 is the single environment.

    Returns:
        the table of methods.
    """
    if not 1 <= repeats <= 1000:
        raise ValueError(f"repeats = {repeats!r} is outside the accepted range 1 to 1000")
    methods = _methods(repeats)
    rates = pd.DataFrame(
        [(n, _steps_per_second(n, repeats)) for n in environments], columns=["environments", "steps_per_s"]
    )
    for name, table in (("methods", methods), ("environments", rates)):
        write_atomically(output / f"{name}.csv", table.to_csv(index=False, float_format="%.4g"))
        print_frame(name, table)
    write_manifest(output, ("methods.csv", "environments.csv"))
    print(f"written: {output}/ (methods.csv, environments.csv)")
    return methods


def _methods(repeats: int) -> pd.DataFrame:
    """One thread, table 2's probe at l = 50 m, each method with its usual step."""
    keys = dict.fromkeys((name, count) for name, method in METHODS.items() for count in (1, method.width))
    batches = {(name, n): SimulatorBatch([Scene()] * n, name, METHODS[name].usual_step, threads=1) for name, n in keys}
    spans = {key: SIMULATED if METHODS[key[0]].usual_step >= 1e-4 else SLOW_SIMULATED for key in keys}
    jobs = {key: partial(batch.advance, None, None, spans[key], spans[key]) for key, batch in batches.items()}
    seconds = _best_times(jobs, repeats)
    rows = []
    for (method, probes), batch in batches.items():
        step = METHODS[method].usual_step
        per_second = seconds[method, probes] / spans[method, probes] / probes
        node_step = per_second * step / batch.simulators[0].root * 1e9
        ratio = seconds[STUDY] / spans[STUDY] / per_second
        rows.append((method, probes, step, node_step, per_second, ratio))
    columns = ["method", "probes", "time_step_s", "ns_per_node_step", "s_per_simulated_s", "ratio"]
    return pd.DataFrame(rows, columns=columns)


def _best_times(jobs: Mapping[tuple[str, int], Callable[[], object]], repeats: int) -> dict[tuple[str, int], float]:
    """Best wall time [s] of each job, warmed up once, in turns."""
    for job in jobs.values():
        job()
    best = dict.fromkeys(jobs, np.inf)
    for _ in tqdm(range(repeats), desc="methods", unit="round"):
        for key, job in jobs.items():
            start = time.perf_counter()
            job()
            best[key] = min(best[key], time.perf_counter() - start)
    return best


def _steps_per_second(count: int, repeats: int) -> float:
    """Environment steps of 0.1 s per second of wall time, on all cores."""
    scene = Scene(carrier_length=LENGTH)
    env = gym.make(ENV_ID, scene=scene) if count == 1 else ProbeVecEnv(ENV_ID, count, scene=scene)
    action = np.zeros(2 if count == 1 else (count, 2), dtype=np.float32)
    best = np.inf
    for _ in range(min(repeats, 3)):  # an episode has 80 steps
        env.reset()
        env.step(action)
        start = time.perf_counter()
        for _ in range(STEPS):
            env.step(action)
        best = min(best, time.perf_counter() - start)
    env.close()
    return count * STEPS / best
