"""The chart as a whole: runs what is missing, then draws and prints."""

from __future__ import annotations

import warnings
from pathlib import Path

import pandas as pd

from agents.chart import errors, figures, tables
from agents.chart.costs import run_costs
from agents.chart.ensembles import run_ensembles
from agents.chart.insertions import run_insertions
from agents.chart.smooth import run_smooth
from agents.records.provenance import CHECKOUT, write_atomically
from agents.records.reading import read_csv
from agents.records.store import as_csv, stored_rows
from agents.records.tables import COSTS
from agents.study.cases import load_rows

STUDY = CHECKOUT / "results" / "study"
"""The slow methods' runs: `probe-env study` made them."""


def run_chart(output: Path, target: Path) -> None:
    """Everything that is missing; what is timed comes last, when the machine has nothing else to do."""
    run_ensembles(output)
    run_insertions(output)
    run_smooth(output)
    run_costs(output)
    draw_chart(output, target)


def draw_chart(output: Path, target: Path) -> None:
    """Tables of errors, figures, and ``target``, a table of what ``fidelity="auto"`` goes by, from stored runs."""
    constant, inserted = error_tables(output)
    costs = read_csv(output / "costs.csv", COSTS)
    write_atomically(output / "errors.csv", as_csv(constant, 4))
    write_atomically(output / "insertion-errors.csv", as_csv(inserted, 4))
    measured = tables.measured_errors(constant, inserted)
    write_atomically(target, as_csv(measured, 4))
    smooth = stored_rows(output / "smooth.csv")
    chosen = tables.choices(constant, inserted)
    figures.smooth(smooth, output / "smooth.png")
    figures.chaos(constant, inserted, output / "chaos.png")
    figures.model(chosen, output / "model.png")
    presets = tables.presets(constant, inserted, costs)
    for part in (tables.smooth(smooth), tables.choices_markdown(chosen), presets):
        print(part + "\n")
    print(f"written: {output}/ (errors.csv, insertion-errors.csv, smooth.png, chaos.png, model.png)")


def error_tables(output: Path) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Errors at constant length and over insertions, see ``errors``, from stored runs."""
    costs = read_csv(output / "costs.csv", COSTS)
    members = [stored_rows(output / "ensembles.csv")]
    study = load_rows(STUDY)
    if study.empty:
        warnings.warn(f"{STUDY} holds no runs of the slow methods (`make study`): they are left out", stacklevel=2)
    else:
        members.append(errors.study_members(study))
    constant = errors.constant_length(pd.concat(members, ignore_index=True), costs)
    return constant, errors.insertion(stored_rows(output / "insertions.csv"), costs)
