"""Prints the results table of the README from results/evaluation/summary.csv; a test compares the two."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

SUMMARY = Path(__file__).parents[1] / "results" / "evaluation" / "summary.csv"
POLICIES = {
    "constant": "0.2 m/s and 63 m³/h, as in the study",
    "pi": "PI control of the measured vibration",
    "best-schedule": "best schedule over length for all training tubes",
    "plc-integral": "PLC law of twelve constants: length, root tension and noise in, feed and air out",
    "ppo": "PPO, five training seeds",
    "student": "networks that imitate `plc-integral`, five training seeds",
    "planner": "model-predictive control on a copy of the simulator: an upper bound for feedback",
}
OLD_NAMES = {"plc-law": "plc-proportional", "trimmed-law": "plc-integral"}
"""Names of policies in results that were stored before version 0.1.0."""
COLUMNS = {
    "reward": ("reward", 1.0, ".1f"),
    "time [s]": ("inspection_time_s", 1.0, ".0f"),
    "within the limit [%]": ("share_within_limit", 100.0, ".1f"),
    "radial rms [mm]": ("radial_rms_m", 1e3, ".3f"),
    "air [m³]": ("air_m3", 1.0, ".1f"),
}
"""Header -> KPI, factor, format."""


def table() -> str:
    """The table in Markdown; a method with several training seeds NAME@K has their mean."""
    summary = pd.read_csv(SUMMARY)
    summary = summary.assign(policy=summary["policy"].str.replace(r"@\d+$", "", regex=True).replace(OLD_NAMES))
    means = summary.groupby(["policy", "kpi"])["mean"].mean()
    lines = [f"| policy | description | {' | '.join(COLUMNS)} |", "|---|---|" + "---:|" * len(COLUMNS)]
    for name, description in POLICIES.items():
        cells = (f"{means[name, kpi] * factor:{style}}" for kpi, factor, style in COLUMNS.values())
        lines.append(f"| `{name}` | {description} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(table())
