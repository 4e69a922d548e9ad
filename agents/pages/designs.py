"""Probe designs in words."""

from __future__ import annotations

from pathlib import Path

from agents.design import compare as design_compare
from agents.pages.sources import RESULTS, command, source
from agents.records.models import Record
from agents.records.reading import read_csv, read_json
from probe_env import Design

DESIGN_TABLES = {
    "countermeasures": "The study's countermeasures (its section 4.3) one by one, in sections of constant length at its"
    " 0.2 m/s and 63 m3/h, {tubes} held-out tubes:",
    "confirmed": "The design found against the study's two, in whole insertions at the study's feed, {tubes} held-out"
    " tubes; changes are against the improved probe, and vibration and time are over what the guide leaves to inspect:",
    "confirmed-finely": "The better two at the finest setting, `reference`, on the same {tubes} tubes:",
}
DRIVEN = (
    "The study's probes, the design found under the study's feed and the one found under the agent's, all driven by the"
    " agent, in whole insertions, {tubes} held-out tubes; changes are against the improved probe:"
)


def search() -> str:
    """What the search for designs found under the study's feed, and what vibration depends on."""
    return _search_summary(RESULTS / "design" / "search")


def codesign() -> str:
    """What the search found under an agent's feed, and how the designs compare when the agent drives them."""
    folder = RESULTS / "design"
    return f"{_search_summary(folder / 'codesign')}\n\n{_compared(folder / 'driven', DRIVEN)}"


def _search_summary(folder: Path) -> str:
    influence, record = read_csv(folder / "sensitivity.csv"), read_json(folder / "provenance.json", Record).model_dump()
    front = read_csv(folder / "front.csv")
    rows = influence[influence["objective"] == "mean_square_ratio"].to_dict("records")
    rows.sort(key=lambda row: -abs(row["coefficient"]))
    effects = ", ".join(
        f"{row['parameter'].replace('_', ' ')} {row['coefficient']:+.2f} [{row['low']:+.2f}, {row['high']:+.2f}]"
        for row in rows
    )
    design = Design.from_toml(folder / "found.toml").model_dump()
    fields = ", ".join(f"{name.replace('_', ' ')} {value:.4g}" for name, value in design.items())
    return (
        f"{record['trials']} designs on {record['contexts']} training tubes, {len(front)} on the front. What vibration"
        f" depends on (standardised rank regression over the trials): {effects}. The design with the best reward by the"
        f" task's weights (SI units): {fields}. {source(folder / 'provenance.json')}"
    )


def designs() -> str:
    """Designs compared: a table a comparison."""
    return "\n\n".join(_compared(RESULTS / "design" / name, title) for name, title in DESIGN_TABLES.items())


def _compared(folder: Path, title: str) -> str:
    summary = read_csv(folder / "summary.csv")
    names, table = design_compare.header(summary), design_compare.cells(summary)
    record = read_json(folder / "provenance.json", Record).model_dump()
    tubes = read_csv(folder / "designs.csv")["context"].nunique()
    lines = [title.format(tubes=tubes), "", f"| {' | '.join(names)} |"]
    lines += ["|---" * len(names) + "|", *(f"| {' | '.join(row)} |" for row in table)]
    return "\n".join(lines) + f"\n\nMade by `{command(record)}` at commit {record['commit']}."
