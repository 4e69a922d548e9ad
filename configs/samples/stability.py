"""Cells of every method on both sides of its limit, and the small scenes; for ``results stability --confirm``."""

import sys
from pathlib import Path

import pandas as pd

from agents.chart.stability import map as cells
from agents.chart.stability.one_mass import run_one_mass
from agents.chart.stability.passive import run_digits, run_energy

FOLDER = Path(sys.argv[1])
RATIOS = (1.0, 2.2, 4.4)


def main() -> None:
    """Write map.csv of the shortest chain with the most friction, and the tables of the small scenes as they are."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    chosen = [
        cell
        for cell in cells.cells()
        if cell[2] == min(cells.LENGTHS) and cell[3] == max(cells.FRICTIONS) and cell[4] in RATIOS
    ]
    tables = {"one_mass": run_one_mass(), "energy": run_energy(), "digits": run_digits()}
    tables["map"] = pd.DataFrame([cells.run_cell(*cell) for cell in chosen])
    for name, table in tables.items():
        table.to_csv(FOLDER / f"{name}.csv", index=False)


if __name__ == "__main__":
    main()
