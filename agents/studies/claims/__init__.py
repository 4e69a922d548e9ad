"""The claims of the published study, tested on ensembles of its cases."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import pandas as pd

from agents.records.atomic import write_atomically
from agents.records.drawing import BLUE, GRID, MM, save
from agents.records.manifest import write_manifest
from agents.records.shipped import shipped_folder
from agents.studies.claims.cases import DURATION, SUBSET, run_cases
from agents.studies.claims.claims import GROWTH, RADIAL, Ensemble, claims_of
from agents.studies.tables import print_frame


def run_claims(
    output: Path, members: int = 1, duration: float = DURATION, subset: bool = False, jobs: int = 2
) -> pd.DataFrame:
    """Run what is not stored yet of the study's cases; writes ensemble.csv, claims.csv (``claims_of``) and growth.png.

    Args:
        output: folder; stored runs are not repeated.
        members: perturbed runs a case.
        duration: simulated time of a run [s].
        subset: a few cases instead of all.
        jobs: runs at the same time.

    Returns:
        the table of claims.
    """
    table = run_cases(shipped_folder("scenes"), output, members, duration, SUBSET if subset else (), jobs)
    claims = claims_of(table)
    write_atomically(output / "claims.csv", claims.to_csv(index=False, float_format="%.4g"))
    files = ("ensemble.csv", "claims.csv")
    write_manifest(output, files, commits=table["commit"], members=members, duration_s=duration)
    columns = ("claim", "figure", "case", "statistic", "mean", "least", "greatest", "reference_mean", "holds")
    print_frame(f"Claims: {members} run(s) a case, {duration:g} s each", claims, columns, texts=4)
    complete = Ensemble(table).has(*(f"l{length}" for length in GROWTH))
    if complete:
        draw_growth(table, output / "growth.png")
    print(f"written: {output}/ (ensemble.csv, claims.csv{', growth.png' if complete else ''})")
    return claims


def draw_growth(table: pd.DataFrame, path: Path) -> None:
    """Radial rms at the sensor against the carrier length: range and mean of the ensemble."""
    members = [Ensemble(table).values(f"l{length}", RADIAL) * MM for length in GROWTH]
    figure, axis = plt.subplots(figsize=(7, 3.6), layout="constrained")
    low, high = ([f(values) for values in members] for f in (min, max))
    axis.fill_between(GROWTH, low, high, color=BLUE, alpha=0.2, label="range of the perturbed runs")
    axis.plot(GROWTH, [values.mean() for values in members], "o-", color=BLUE, label="mean")
    axis.set(xlabel="carrier length [m]", ylabel="radial rms at the sensor [mm]", yscale="log")
    axis.grid(**GRID)
    axis.legend(frameon=False)
    save(figure, path)
