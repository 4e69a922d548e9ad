"""Robustness in words."""

from __future__ import annotations

from agents.pages.sources import RESULTS, markdown, source
from agents.records.models import Record
from agents.records.reading import read_csv, read_json
from agents.robustness import study


def robustness() -> str:
    """What policies lose along the axes."""
    folder = RESULTS / "robustness"
    if not folder.exists():
        return "Nothing is stored yet: `probe-env results robustness` makes it."
    summary = read_csv(folder / "robustness.csv", study.COLUMNS)
    header = study.header(tuple(dict.fromkeys(summary["policy"])))
    worst = "; ".join(
        f"`{policy}` {loss.mean:+.1f} [{loss.low:.1f}, {loss.high:.1f}] with {name}"
        for policy, (name, loss) in study.worst_of(summary).items()
    )
    record = read_json(folder / "provenance.json", Record).model_dump()
    return (
        f"What each loses at worst: {worst}.\n\n"
        f"{markdown(header, study.cells(summary))}\n\n"
        f"Mean reward over {record['limit']} tubes in the task itself, and how it changes, paired tube by tube, with"
        " 95 % intervals; ! where insertions diverged.\n\n"
        "![What every policy loses along every axis](../../results/robustness/robustness.png)\n\n"
        "Control periods of an insertion that were unsafe, and how many of the insertions lost their drive:\n\n"
        f"{markdown(header, study.cost_cells(summary))}\n\n"
        f"Simulated with `{record['fidelity']}`. {source(folder / 'provenance.json')}"
    )
