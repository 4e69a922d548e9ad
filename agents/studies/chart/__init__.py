"""The chart of accuracy against cost: every method before chaos and in it, mesh and model choices, time-lapse."""

from __future__ import annotations

import warnings
from pathlib import Path

import pandas as pd

from agents.records.atomic import write_atomically
from agents.records.manifest import CHECKOUT, write_manifest
from agents.records.reading import read_csv
from agents.records.store import COLUMNS, as_csv, stored_rows
from agents.records.tables import COSTS
from agents.studies.chart import errors, figures
from agents.studies.chart.ensembles import run_ensembles, run_insertions
from agents.studies.chart.smooth import orders, run_smooth
from agents.studies.claims.cases import load_rows
from agents.studies.tables import print_frame

STUDY = CHECKOUT / "results" / "study"
"""Stored runs of the slow methods, made by ``run_claims``."""
TABLES = {"ensembles": COLUMNS, "insertions": COLUMNS, "smooth": COLUMNS, "costs": COSTS}


def run_chart(output: Path, target: Path | None = None, study: Path = STUDY) -> None:
    """Run everything that is not stored yet, timing last, then write the tables and figures.

    Args:
        output: folder of the stored runs, tables and figures.
        target: file of the errors that ``fidelity="auto"`` goes by; default: measured_errors.csv in the folder.
        study: folder with ensemble.csv, the slow methods' runs.

    Raises:
        FileError: something stored in the folder is damaged or of another commit; nothing was run.
    """
    for name, columns in TABLES.items():
        path = output / f"{name}.csv"
        if path.exists():
            read_csv(path, columns)
    run_ensembles(output)
    run_insertions(output)
    run_smooth(output)
    errors.run_costs(output)
    draw_chart(output, target, study)


def draw_chart(output: Path, target: Path | None = None, study: Path = STUDY) -> None:
    """Write and print the tables, and draw the figures, of stored runs."""
    smooth, ensembles, insertions = (
        stored_rows(output / f"{name}.csv") for name in ("smooth", "ensembles", "insertions")
    )
    costs, slow = read_csv(output / "costs.csv", COSTS), load_rows(study)
    if slow.empty:
        warnings.warn(f"{study} holds no runs of the slow methods: they are left out", stacklevel=2)
    else:
        ensembles = pd.concat([ensembles, errors.study_members(slow)], ignore_index=True)
    constant, inserted = errors.constant_length(ensembles, costs), errors.insertion(insertions, costs)
    tables = {
        "errors": constant,
        "insertion-errors": inserted,
        "time-lapse-errors": errors.time_lapse(insertions, costs),
        "orders": orders(smooth),
        "choices": errors.choices(ensembles, costs),
        "presets": errors.presets(constant, costs),
    }
    for name, table in tables.items():
        write_atomically(output / f"{name}.csv", as_csv(table, 4))
    measured = errors.measured_errors(constant, inserted)
    write_atomically(target or output / "measured_errors.csv", as_csv(measured, 4))
    commits = pd.concat([table["commit"].dropna() for table in (smooth, ensembles, insertions)])
    write_manifest(output, [f"{name}.csv" for name in (*TABLES, *tables)], commits=commits)
    figures.smooth(smooth, output / "smooth.png")
    figures.chaos(constant, inserted, output / "chaos.png")
    print_frame("Order and error before chaos", tables["orders"], texts=2)
    print_frame("Radial rms by choice", tables["choices"])
    print_frame("Radial rms by preset", tables["presets"], texts=2)
    print(f"written: {output}/ ({', '.join(tables)} as .csv, smooth.png, chaos.png)")
