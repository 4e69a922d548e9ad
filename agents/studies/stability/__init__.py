"""The stability map: which time steps are stable and which are accurate, run and in theory."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from agents.records.atomic import write_atomically
from agents.records.manifest import write_manifest
from agents.studies.stability.one_mass import run_one_mass
from agents.studies.stability.passive import run_energy
from agents.studies.stability.stability_map import Cell, by_step, cells, draw_map, run_map, verdicts
from agents.studies.tables import print_frame


def run_stability(output: Path, runs: list[Cell] | None = None, jobs: int = 2) -> pd.DataFrame:
    """Run the map, one mass and passive chains; writes map.csv, steps.csv, one_mass.csv, energy.csv and map.png.

    Args:
        output: folder.
        runs: cells of the map; default: all.
        jobs: runs at the same time.

    Returns:
        the map.
    """
    table = run_map(cells() if runs is None else runs, jobs)
    steps = by_step(table)
    tables = {"map": table, "steps": steps, "one_mass": run_one_mass(), "energy": run_energy()}
    for name, part in tables.items():
        write_atomically(output / f"{name}.csv", part.to_csv(index=False, float_format="%.5g"))
    write_manifest(output, [f"{name}.csv" for name in tables])
    draw_map(verdicts(table), output / "map.png")
    print_frame("Shares of the cells of a step (ratio to the named limit)", steps)
    print(f"written: {output}/ ({', '.join(tables)} as .csv, map.png)")
    return table
