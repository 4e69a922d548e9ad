"""The chart as a whole: runs what is missing, then draws and prints."""

from __future__ import annotations

import warnings
from pathlib import Path

import pandas as pd

from agents.chart import errors, figures, tables
from agents.chart.costs import run_costs
from agents.chart.ensembles import run_ensembles
from agents.chart.insertions import CONVERGED, REFERENCE, run_insertions
from agents.chart.smooth import run_smooth
from agents.records.provenance import CHECKOUT, write_atomically
from agents.records.reading import read_csv
from agents.records.store import COLUMNS, as_csv, stored_rows
from agents.records.tables import COSTS
from agents.study.cases import load_rows

STUDY = CHECKOUT / "results" / "study"
"""The slow methods' runs: `probe-env study` made them."""


def run_chart(output: Path, target: Path) -> None:
    """Everything that is missing; what is timed comes last, when the machine has nothing else to do.

    Raises:
        FileError: something stored in the folder is damaged; nothing was run.
    """
    for name in ("ensembles", "insertions", "smooth", "costs"):
        path = output / f"{name}.csv"
        if path.exists():
            read_csv(path, COSTS if name == "costs" else COLUMNS)
    run_ensembles(output)
    run_insertions(output)
    run_smooth(output)
    run_costs(output)
    draw_chart(output, target)


def draw_chart(output: Path, target: Path) -> None:
    """Tables of errors, figures, and ``target``, a table of what ``fidelity="auto"`` goes by, from stored runs."""
    fine, whole = error_tables(output), error_tables(output, converged=True)
    costs = read_csv(output / "costs.csv", COSTS)
    for errors_of, suffix in ((fine, ""), (whole, "-converged")):
        write_atomically(output / f"errors{suffix}.csv", as_csv(errors_of[0], 4))
        write_atomically(output / f"insertion-errors{suffix}.csv", as_csv(errors_of[1], 4))
    measured = tables.measured_errors(*whole)
    write_atomically(target, as_csv(measured, 4))
    smooth = stored_rows(output / "smooth.csv")
    chosen = tables.choices(*fine)
    figures.smooth(smooth, output / "smooth.png")
    figures.chaos(*whole, output / "chaos.png")
    figures.model(chosen, output / "model.png")
    presets = tables.presets(*whole, costs)
    for part in (tables.smooth(smooth), tables.choices_markdown(chosen), presets):
        print(part + "\n")
    print(f"written: {output}/ (errors*.csv, insertion-errors*.csv, smooth.png, chaos.png, model.png)")


def error_tables(output: Path, converged: bool = False) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Errors at constant length and over insertions, see ``errors``, from stored runs.

    Args:
        output: folder of the runs.
        converged: against the converged mesh with a fine step, not against table 2's.
    """
    costs = read_csv(output / "costs.csv", COSTS)
    members = [stored_rows(output / "ensembles.csv")]
    study = load_rows(STUDY)
    if study.empty:
        warnings.warn(f"{STUDY} holds no runs of the slow methods (`make study`): they are left out", stacklevel=2)
    else:
        members.append(errors.study_members(study))
    against = errors.converged_mesh if converged else errors.fine_step
    constant = errors.constant_length(pd.concat(members, ignore_index=True), costs, against)
    inserted = stored_rows(output / "insertions.csv")
    return constant, errors.insertion(inserted, costs, CONVERGED if converged else REFERENCE)
