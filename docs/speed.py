"""Measures environment steps per second into results/bench/speed.json and prints the row of the README."""

from __future__ import annotations

import json
import time
from pathlib import Path

import gymnasium as gym
import numpy as np

import probe_env
from probe_agents.records.manifest import write_json, write_manifest

FOLDER = Path(__file__).parents[1] / "results" / "bench"
CASES = (("fast", 1, 60), ("fast", 16, 60), ("fast", 64, 40), ("surrogate", 64, 300))
"""Fidelity, number of environments, steps of a run."""
RUNS = 5


def steps_per_second(fidelity: str, count: int, steps: int) -> float:
    """Steps of all environments per second from the start of an insertion, after one step that compiles."""
    env = gym.make_vec("probe_env/Insertion-v1", num_envs=count, fidelity=fidelity, contexts="train")
    env.reset(seed=0)
    actions = np.zeros((count, 2), dtype=np.float32)
    env.step(actions)
    begin = time.perf_counter()
    for _ in range(steps):
        env.step(actions)
    return count * steps / (time.perf_counter() - begin)


def row() -> str:
    """The README's row, from the stored medians to two digits."""
    stored = json.loads((FOLDER / "speed.json").read_text())
    one, sixteen, many, surrogate = (f"{float(f'{np.median(runs):.2g}'):,.0f}" for runs in stored.values())
    return (
        "| speed | environment steps per second on two cores in the first minute of an insertion:"
        f" {one} at `fast` with one probe, {sixteen} with 16,"
        f" {many} with 64; {surrogate} in the `surrogate` with 64 |"
    )


if __name__ == "__main__":
    assert probe_env.__all__  # the import registers the ids
    runs = [[steps_per_second(*case) for case in CASES] for _ in range(RUNS)]
    names = [f"{fidelity}, {count}" for fidelity, count, _ in CASES]
    write_json(FOLDER / "speed.json", {name: [run[k] for run in runs] for k, name in enumerate(names)})
    write_manifest(FOLDER, ("speed.json",), command="python docs/speed.py", seeds=(0,))
    print(row())
