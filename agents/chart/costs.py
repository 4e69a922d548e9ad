"""Processor time of a node-step, all methods within one run of one machine, with full lanes and one thread."""

from __future__ import annotations

import time
from pathlib import Path

import pandas as pd
from tqdm import tqdm

from agents.chart.ensembles import Setting
from agents.records.provenance import provenance, write_atomically, write_json
from probe_env.physics.methods import METHODS

NODES = {"imex": (1, 2, 4, 8, 16), "imex32": (4, 8, 16)}
LENGTHS = (10.0, 30.0, 40.0, 50.0)  # [m]
TIMED, TIMED_IN_LANES = 500, 4000
"""Steps of a method, and of one with lanes."""
LONGEST_STEP = 1e-4  # [s]
REPEATS = 5


def run_costs(output: Path) -> pd.DataFrame:
    """Rows of method, nodes_per_pitch, carrier_length_m, ns_per_node_step in costs.csv; the best of ``REPEATS`` counts.

    Always measured anew as a whole, since only ratios within one run mean something.
    """
    cells = [(m, nodes, length) for m in METHODS for nodes in NODES.get(m, (4,)) for length in LENGTHS]
    rows = []
    for method, nodes, length in tqdm(cells, desc="costs", unit="setting"):
        kind = METHODS[method]
        setting = Setting(method, min(kind.usual_step, LONGEST_STEP), nodes, length)
        probes = kind.width
        batch = setting.batch(probes, threads=1)
        steps = TIMED_IN_LANES if kind.lanes else TIMED
        batch.advance(None, None, steps * setting.time_step, steps * setting.time_step)  # warm, and in contact
        spent = []
        for _ in range(REPEATS):
            begin = time.process_time()
            batch.advance(None, None, steps * setting.time_step, steps * setting.time_step)
            spent.append(time.process_time() - begin)
        node_steps = probes * steps * (length + 2.5) / 0.1 * nodes
        rows.append((method, nodes, length, min(spent) / node_steps * 1e9))
    table = pd.DataFrame(rows, columns=["method", "nodes_per_pitch", "carrier_length_m", "ns_per_node_step"])
    write_atomically(output / "costs.csv", table.to_csv(index=False, float_format="%.5g"))
    write_json(output / "costs-provenance.json", provenance())
    return table


def cpu_seconds(costs: pd.DataFrame, settings: pd.DataFrame) -> pd.Series:
    """Processor time [s] of one probe for a simulated second, for rows with the columns of a ``Setting``."""
    keys = ["method", "nodes_per_pitch", "carrier_length_m"]
    node_step = settings[keys].merge(costs, how="left", on=keys)["ns_per_node_step"].to_numpy()
    nodes = (settings["carrier_length_m"] + 2.5) / 0.1 * settings["nodes_per_pitch"]
    seconds: pd.Series = nodes / settings["time_step_s"] * node_step * 1e-9
    return seconds
