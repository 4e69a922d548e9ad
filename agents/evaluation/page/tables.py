"""The tables of a page: all KPIs ranked, time and length within the limit by helix diameter and tube by tube."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import pandas as pd

from agents.evaluation.page.verdict import ranking
from agents.records.columns import KPIS, OVER_TUBES, label_of, shown_of
from agents.rollouts.bootstrap import short
from agents.rollouts.statistics import by_context, endings, paired_difference
from probe_env.envs.task import FAILURES

MOST_DIAMETERS = 12
"""Helix diameters beyond which a table by diameter says no more than one tube by tube."""


@dataclass(frozen=True)
class Cell:
    """A figure, what stands below it in small print, and whether it is the best of its kind."""

    text: str
    below: str = ""
    best: bool = False


@dataclass(frozen=True)
class Row:
    """A line of a table: its head, what stands below that, and cells."""

    head: str
    below: str
    cells: tuple[Cell, ...]


def header(kpi: str) -> str:
    """Name and unit of a KPI."""
    name, _, unit = (KPIS | OVER_TUBES)[kpi]
    return f"{name} [{unit}]" if unit else name


def ranked(
    table: pd.DataFrame, summary: pd.DataFrame, own: Collection[str], informed: Collection[str]
) -> tuple[list[str], list[Row]]:
    """Header and a row a policy, best first: every KPI with its interval, the reward against the best, how it ended."""
    figures: dict[tuple[str, str], dict[Any, Any]] = {(r["policy"], r["kpi"]): r for r in summary.to_dict("records")}
    rows, ends = [], _endings(table)
    order = ranking(table)
    best = next((name for name in order if name not in informed), order[0])
    for policy in order:
        cells = [_against(table, policy, best)]
        for kpi, (_, factor, _) in shown_of(table.columns).items():
            row = figures[policy, kpi]
            cells.append(_with_ends(row["mean"] * factor, row["low"] * factor, row["high"] * factor))
        cells.insert(0, cells.pop(1))  # the reward first
        what = ("yours" if policy in own else "") or ("is told the tube" if policy in informed else "")
        rows.append(Row(policy, what, (*cells, _ended(ends[policy]))))
    names = [header(kpi) for kpi in shown_of(table.columns)]
    return ["policy", names[0], f"reward against {best}", *names[1:], "how it ended"], rows


def _with_ends(mean: float, low: float, high: float, sign: str = "") -> Cell:
    return Cell(short(mean, sign), f"{short(low, sign)} to {short(high, sign)}" if low < high else "")


def _against(table: pd.DataFrame, policy: str, best: str) -> Cell:
    if policy == best:
        return Cell("best")
    difference = paired_difference(table, policy, best, "reward")
    cell = _with_ends(difference.mean, difference.low, difference.high, "+")
    unclear = difference.low < 0.0 < difference.high
    return Cell(f"{cell.text} (unclear)" if unclear else cell.text, cell.below)


def _endings(table: pd.DataFrame) -> dict[str, dict[str, int]]:
    return {
        str(policy): {str(name): int(count) for name, count in row.items()} for policy, row in endings(table).iterrows()
    }


def _ended(row: Mapping[str, int]) -> Cell:
    """Insertions that came to their end, and why others did not."""
    complete, _, shortfall = ended(row).partition(", ")
    return Cell(complete, shortfall)


def ended(row: Mapping[str, int]) -> str:
    """How many insertions came to their end, and why others did not, in words."""
    reasons = {label_of(name): row[name] for name in FAILURES}
    reasons["out of time"] = row["episodes"] - row["complete"] - sum(reasons.values())
    parts = [f"{count} {reason}" for reason, count in reasons.items() if count]
    return ", ".join([f"{row['complete']} of {row['episodes']} complete", *parts])


def by_diameter(table: pd.DataFrame, informed: Collection[str]) -> tuple[list[str], list[Row]]:
    """Header and a row a policy: mean time and length within the limit, a column a helix diameter; none if unknown."""
    diameters = sorted(table["helix_diameter"].unique())
    if len(diameters) > MOST_DIAMETERS or diameters[0] <= 0.0:
        return [], []
    columns = [_judged(table[table["helix_diameter"] == diameter], informed) for diameter in diameters]
    counts = [table.loc[table["helix_diameter"] == diameter, "context"].nunique() for diameter in diameters]
    names = [
        f"{diameter:g} m ({count} tube{'s' if count > 1 else ''})"
        for diameter, count in zip(diameters, counts, strict=True)
    ]
    rows = [Row(policy, "", tuple(column[policy] for column in columns)) for policy in ranking(table)]
    return ["policy", *names], rows


def by_tube(table: pd.DataFrame, informed: Collection[str]) -> tuple[list[str], list[Row]]:
    """Header and a row a tube: what it is, then time and length within the limit of every policy."""
    order, rows = ranking(table), []
    tubes = table.drop_duplicates("context").set_index("context").sort_index()
    known = bool((tubes["helix_diameter"] > 0.0).all())
    for number, tube in tubes.iterrows():
        cells = [Cell(f"{tube[name] * factor:.{digits}f}") for name, factor, digits in TUBE.values()] if known else []
        judged = _judged(table[table["context"] == number], informed)
        rows.append(Row(f"{number}", "", (*cells, *(judged[policy] for policy in order))))
    return ["tube", *(TUBE if known else ()), *order], rows


TUBE = {
    "helix diameter [m]": ("helix_diameter", 1.0, 2),
    "friction": ("friction", 1.0, 3),
    "contact stiffness [kN/m]": ("contact_stiffness", 1e-3, 0),
    "drag factor": ("drag_factor", 1.0, 2),
}
"""Header -> what a tube is told by, factor and digits."""


def _judged(part: pd.DataFrame, informed: Collection[str]) -> dict[str, Cell]:
    """Of every policy the mean time and length within the limit on some tubes; the best is marked."""
    best, ends = next((name for name in ranking(part) if name not in informed), ""), _endings(part)
    cells = {}
    for policy in ranking(part):
        time, share = (by_context(part, policy, kpi).mean() for kpi in ("inspection_time_s", "share_within_limit"))
        row = ends[policy]
        failed = row["episodes"] - row["complete"]
        stopped = f", {failed} not complete" if failed and row["episodes"] > 1 else ", not complete" if failed else ""
        cells[policy] = Cell(f"{short(time)} s", f"{short(100.0 * share)} %{stopped}", policy == best)
    return cells
