"""The claims of the published study, tested on ensembles of its cases."""

from __future__ import annotations

from pathlib import Path

import matplotlib.pyplot as plt
import pandas as pd

from agents.records.drawing import BLUE, GRID, MM, save
from agents.records.provenance import write_atomically
from agents.records.shipped import shipped_folder
from agents.studies.claims.cases import DURATION, SUBSET, run_cases
from agents.studies.claims.claims import GROWTH, RADIAL, Ensemble, claims_of
from agents.studies.tables import print_frame
from probe_env.settings import within


def run_claims(
    output: Path,
    members: int = 1,
    duration: float = DURATION,
    subset: bool = False,
    jobs: int = 2,
    scenes: Path | None = None,
) -> pd.DataFrame:
    """Run what is not stored yet of the study's cases, and compare its claims with it.

    Writes ensemble.csv, claims.csv (see ``claims_of``) and growth.png.

    Args:
        output: folder; stored runs are not repeated.
        members: perturbed runs a case, 1 to 1000.
        duration: simulated time of a run [s], 0.5 to 1e4.
        subset: a few cases instead of all.
        jobs: runs at the same time, 1 to 256.
        scenes: folder of the scene files; default: those that ship.

    Returns:
        the table of claims.
    """
    for name, value, most in (("members", members, 1000), ("jobs", jobs, 256)):
        if not 1 <= value <= most:
            raise ValueError(f"{name} = {value!r} is outside the accepted range 1 to {most}")
    within("duration", duration, 0.5, 1e4, "s")
    folder = scenes or shipped_folder("scenes")
    table = run_cases(folder, output, members, duration, SUBSET if subset else (), jobs)
    claims = claims_of(table)
    write_atomically(output / "claims.csv", claims.to_csv(index=False, float_format="%.4g"))
    columns = ("claim", "figure", "case", "statistic", "mean", "least", "greatest", "reference_mean", "holds")
    print_frame(f"Claims: {members} run(s) a case, {duration:g} s each", claims, columns, texts=4)
    written = "ensemble.csv, claims.csv"
    if Ensemble(table).has(*(f"l{length}" for length in GROWTH)):
        draw_growth(table, output / "growth.png")
        written += ", growth.png"
    print(f"written: {output}/ ({written})")
    return claims


def draw_growth(table: pd.DataFrame, path: Path) -> Path:
    """Radial rms at the sensor against the carrier length: range and mean of the ensemble."""
    members = [Ensemble(table).values(f"l{length}", RADIAL) * MM for length in GROWTH]
    figure, axis = plt.subplots(figsize=(7, 3.6), layout="constrained")
    low, high = ([f(values) for values in members] for f in (min, max))
    axis.fill_between(GROWTH, low, high, color=BLUE, alpha=0.2, label="range of the perturbed runs")
    axis.plot(GROWTH, [values.mean() for values in members], "o-", color=BLUE, label="mean")
    axis.set(xlabel="carrier length [m]", ylabel="radial rms at the sensor [mm]", yscale="log")
    axis.grid(**GRID)
    axis.legend(frameon=False)
    return save(figure, path)
