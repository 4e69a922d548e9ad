"""Speeds as ratios within one run: the machines are shared, so only ratios carry over.

Every kernel is compiled and warmed up before its clock starts; the best of several repeats counts, taken in
turns so that a slow moment of the machine hits all alike; the ratios of single rounds are their scatter.
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import solve_banded
from tqdm import tqdm

from agents.bench import walls
from agents.bench.environments import bench_environments
from agents.records.provenance import provenance, write_json
from agents.terminal.tables import print_table
from probe_env import Scene, Simulator, SimulatorBatch
from probe_env.physics.methods import METHODS, ticm
from probe_env.physics.methods.newmark import newmark, workspace
from probe_env.physics.model.chain import build_chain
from probe_env.physics.model.drive import Drive
from probe_env.physics.model.state import at_rest

NEWMARK_STEP, FAST_STEP = 1e-4, 2e-4
IN_LANES = tuple(name for name, method in METHODS.items() if method.lanes and method.usual_step >= FAST_STEP)
ALONE = ("imex", "superelement", "superelement32")
SCALING_NODES = (500, 1000, 2000, 5000, 10000, 20000)


def run_bench(output: Path, repeats: int) -> dict[str, Any]:
    """Time the solvers, the scaling with length and the first result; store bench.json and print it."""
    results: dict[str, Any] = {
        "solvers": _solvers(repeats),
        "scaling": _scaling(repeats),
        "fast": _fast(repeats),
        "idle_cable": walls.idle_cable(),
        "insertion": _insertion(),
        "environments": bench_environments(),
        "first_result_s": _first_result(),
        "repeats": repeats,
        **provenance(),
    }
    write_json(output / "bench.json", results)
    _print(results)
    print(f"written: {output}/bench.json")
    return results


def best_times(jobs: dict[str, Callable[[], object]], repeats: int) -> dict[str, float]:
    """Best wall time [s] of each job, warmed up once, in turns."""
    return {name: min(times) for name, times in times_of(jobs, repeats).items()}


def times_of(jobs: dict[str, Callable[[], object]], repeats: int) -> dict[str, list[float]]:
    """Wall times [s] of each job, one a round of all, warmed up once."""
    for job in jobs.values():
        job()
    times: dict[str, list[float]] = {name: [] for name in jobs}
    for _ in tqdm(range(repeats), desc=", ".join(jobs)[:40], unit="round"):
        for name, job in jobs.items():
            start = time.perf_counter()
            job()
            times[name].append(time.perf_counter() - start)
    return times


def _solvers(repeats: int) -> dict[str, dict[str, float]]:
    """Cost of a node-step at l = 50 m: the study's scheme by each linear solver, and LAPACK's solve alone."""
    steps = {"ticm": 1000, "banded": 40, "transfer-matrix": 40}
    simulators = {name: Simulator(Scene(), solver=name) for name in steps}
    nodes = simulators["ticm"].chain.node_count
    band = np.random.default_rng(0).normal(size=(11, 3 * (nodes - 1)))
    band[5] += 20.0
    right = np.ones(3 * (nodes - 1))
    jobs: dict[str, Callable[[], object]] = {
        name: lambda s=simulator, n=steps[name]: s.run(n * 1e-4, sample_period=n * 1e-4)  # type: ignore[misc]
        for name, simulator in simulators.items()
        if name != "transfer-matrix"  # its solution is lost within a few steps at this length: no speed to quote
    }
    jobs["solve_banded alone"] = lambda: [solve_banded((5, 5), band, right) for _ in range(40)]
    best = best_times(jobs, repeats)
    count = {**steps, "solve_banded alone": 40}
    per_node = {name: best[name] / count[name] / nodes for name in jobs}
    return {
        name: {"ns_per_node_step": seconds * 1e9, "times_ticm": seconds / per_node["ticm"]}
        for name, seconds in per_node.items()
    }


def _fast(repeats: int) -> dict[str, dict[str, float]]:
    """Cost of the fast methods at l = 50 m, one thread, against the study's scheme at its step of 1e-4 s.

    A node-step of the superelements is a quarter of a pitch's.
    """
    simulated = 0.4
    kinds = {"newmark": 4, "newmark, 8 nodes a pitch": 8}
    simulators = {
        name: Simulator(Scene(), time_step=NEWMARK_STEP, nodes_per_pitch=nodes) for name, nodes in kinds.items()
    }
    for method in ALONE:
        simulators[f"{method}, one probe"] = Simulator(Scene(), method, FAST_STEP)
    lanes = {f"{method}, {METHODS[method].width} lanes": method for method in IN_LANES}
    batches = {
        name: SimulatorBatch([Scene()] * METHODS[method].width, method, FAST_STEP, threads=1)
        for name, method in lanes.items()
    }
    jobs: dict[str, Callable[[], object]] = {
        name: lambda s=simulator: s.advance(duration=simulated, sample_period=simulated)  # type: ignore[misc]
        for name, simulator in simulators.items()
    }
    jobs |= {
        name: lambda b=batch: b.advance(None, None, simulated, simulated)  # type: ignore[misc]
        for name, batch in batches.items()
    }
    times = times_of(jobs, repeats)
    best = {name: min(rounds) for name, rounds in times.items()}
    rows = {}
    for name, rounds in times.items():
        simulator = simulators[name] if name in simulators else batches[name].simulators[0]
        probes = len(batches[name]) if name in batches else 1
        per_second = best[name] / simulated / probes
        ratios = [study / own * probes for study, own in zip(times["newmark"], rounds, strict=True)]
        rows[name] = {
            "time_step_s": simulator.time_step,
            "ns_per_node_step": per_second * simulator.time_step / simulator.root * 1e9,
            "s_per_simulated_s": per_second,
            "simulated_second_ratio": best["newmark"] / simulated / per_second,
            "simulated_second_ratio_low": min(ratios),
            "simulated_second_ratio_high": max(ratios),
            "of_eight_nodes_ratio": best["newmark, 8 nodes a pitch"] / simulated / per_second,
        }
    for row in rows.values():
        row["node_step_ratio"] = rows["newmark"]["ns_per_node_step"] / row["ns_per_node_step"]
    return rows


def _insertion() -> dict[str, float]:
    """Wall time [s] of full insertions, 5 to 60 m at 0.2 m/s, per probe: 16 probes, all cores."""
    times = {}
    for lapse in (1.0, 4.0):
        batch = SimulatorBatch(
            [Scene(carrier_length=2.5)] * 16, "superelement32", FAST_STEP,
            growing=True, time_lapse=lapse, perturbation=1e-7,
        )  # fmt: skip
        periods = round(275.0 / lapse)
        start = time.perf_counter()
        for _ in tqdm(range(periods), desc=f"insertion, time-lapse {lapse:g}", unit="s"):
            window = batch.advance(None, None, 1.0)
        times[f"time_lapse_{lapse:g}"] = (time.perf_counter() - start) / len(batch)
        if window.diverged.any() or window.inserted_length.min() < 59.7:
            raise RuntimeError(f"the insertion did not end at 60 m: {window.inserted_length}, {window.diverged}")
    return times


def _scaling(repeats: int) -> dict[str, Any]:
    """Exponent of the cost of a step against the number of nodes."""
    jobs = {str(nodes): _steps_of(nodes, 2_000_000 // nodes) for nodes in SCALING_NODES}
    best = best_times(jobs, repeats)
    per_step = [best[str(nodes)] / (2_000_000 // nodes) for nodes in SCALING_NODES]
    exponent = float(np.polyfit(np.log(SCALING_NODES), np.log(per_step), 1)[0])
    return {
        "nodes": list(SCALING_NODES),
        "ns_per_node_step": [t / n * 1e9 for t, n in zip(per_step, SCALING_NODES, strict=True)],
        "exponent": exponent,
    }


def _steps_of(nodes: int, steps: int) -> Callable[[], object]:
    length = (nodes - 1) * 0.025
    scene = Scene.model_validate({"tube": {"helix_length": 1000.0}, "carrier_length": round(length - 2.5, 1)})
    chain = build_chain(scene)
    state, work, scheme = at_rest(chain.node_count), workspace(chain.node_count), newmark(1e-4)
    inputs = Drive(0.2, 60.0).inputs_of_steps(steps, 1e-4, chain.element_length, 0)
    points, samples = np.zeros(1, dtype=np.int64), np.zeros((1, 1, 4))
    tension, root = np.zeros(chain.node_count), chain.node_count - 1
    return lambda: ticm.advance(chain, scheme, inputs, root, state, work, steps, steps, points, samples, tension)


def _first_result() -> float:
    """Wall time [s] of a new Python process from start to a first result, kernels cached."""
    code = "from probe_env import Scene, Simulator; Simulator(Scene(carrier_length=10.0)).run(0.01)"
    start = 0.0
    for _ in range(2):  # the first fills the cache
        start = time.perf_counter()
        subprocess.run([sys.executable, "-c", code], check=True)
    return time.perf_counter() - start


def _print(results: dict[str, Any]) -> None:
    header: tuple[str, ...] = ("solver", "ns a node-step", "times the TICM's")
    rows = [(n, f"{row['ns_per_node_step']:.0f}", f"{row['times_ticm']:.1f}") for n, row in results["solvers"].items()]
    print_table("Cost of a step of the study's scheme, l = 50 m", header, rows)
    header = ("method", "step [s]", "ns a node-step", "node-step ratio", "ratio for a simulated second", "to 8 nodes")
    figures = ("ns_per_node_step", "node_step_ratio", "simulated_second_ratio", "of_eight_nodes_ratio")
    fast = [(n, f"{row['time_step_s']:g}", *(f"{row[f]:.1f}" for f in figures)) for n, row in results["fast"].items()]
    print_table("The fast scheme against the study's, l = 50 m, one thread", header, fast)
    print_table(walls.TITLE, walls.HEADER, walls.cells(results["idle_cable"]))
    for name, seconds in results["insertion"].items():
        print(f"full insertion at 0.2 m/s, 16 probes, all cores, {name}: {seconds:.2f} s a probe")
    environments = results["environments"]
    title = f"Environment steps of 0.1 s, {environments['carrier_length_m']:g} m of carrier cable"
    rates = environments["steps_per_second"]
    rows = [(name, f"{rate:.0f}", f"{rate / rates['single']:.1f}") for name, rate in rates.items()]
    print_table(title, ("kind, environments", "steps/s", "times the single one"), rows)
    print(f"share of a step outside the kernel, batch of 16: {100.0 * environments['share_outside_kernel']:.1f} %")
    for name, seconds in environments["episode_s_per_probe"].items():
        alone = environments["episode_s_alone"][name]
        heard = ", ".join(
            f"{100.0 * environments[key][name]:.1f} %" for key in ("share_listening", "share_listening_alone")
        )
        print(
            f"an episode of fidelity {name}: batch of 16, all cores {seconds:.2f} s a probe; alone {alone:.2f} s; of it"
            f" signal-to-noise {heard}"
        )
    scaling = results["scaling"]
    costs = ", ".join(f"{cost:.0f}" for cost in scaling["ns_per_node_step"])
    span = f"{SCALING_NODES[0]} to {SCALING_NODES[-1]} nodes"
    print(f"cost of a step against nodes, {span}: exponent {scaling['exponent']:.3f} ({costs} ns a node)")
    print(f"new process to first result, kernels cached: {results['first_result_s']:.1f} s")
