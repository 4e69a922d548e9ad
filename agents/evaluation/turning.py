"""How gently feed has to turn round, and what time-lapse on the way in makes of it: schedules that look back."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import pandas as pd

from agents.policies.catalogue import named_policies
from agents.policies.places import both_ways, place_of
from agents.processes.workers import Workers
from agents.records.provenance import provenance, write_atomically, write_json
from agents.rollouts.depths import a90_95
from agents.rollouts.plan import Plan, run_plan
from agents.rollouts.statistics import paired_difference
from agents.terminal.tables import print_table
from probe_env.fidelity import BOTH_WAYS

POLICIES: Final = ("fast-in", "steady-back")
RAMPS: Final = (0.5, 0.2, 0.1)
"""Greatest change of the feed speed [m/s2]; the first is the task's own."""
FIDELITIES: Final = ("fast", "unlapsed")
"""With time-lapse on the way in and without."""
KEYS: Final = ("policy", "ramp", "fidelity")
KPIS: Final = ("reward", "inspection_time_s", "share_within_limit", "a90_percent_wall")
DEPTH: Final = "a90_95_percent_wall"
SHOWN: Final = {"inspection_time_s": 1.0, DEPTH: 1.0, "share_within_limit": 100.0, "reward": 1.0}
"""Column of the summary -> factor of the unit for people."""
CHANGES: Final = {"ramp": "by_ramp", "fidelity": "by_time_lapse"}
"""What a90 is paired over, and how the columns of its change begin."""
HEADER: Final = (
    "policy", "ramp [m/s2]",
    *(f"{what}, `{fidelity}`" for fidelity in FIDELITIES
      for what in ("time [s]", "a90/95 [% wall]", "within the limit [%]", "reward")),
)  # fmt: skip


def run_study(limit: int, output: Path, workers: Workers) -> pd.DataFrame:
    """Play every schedule with every ramp, with time-lapse and without, where the way back counts; store and print.

    Episodes that are in ``output`` are not played again.

    Raises:
        ValueError: the limit is out of range.
    """
    place, episodes = both_ways(place_of(None, "test", limit), "back"), []
    for fidelity in FIDELITIES:
        for ramp in RAMPS:
            config = place.config.all_shown.model_copy(update={"ramp": ramp})
            policies = named_policies(POLICIES, config)
            plan = Plan(policies, place.contexts, config=config, fidelity=BOTH_WAYS[fidelity])
            table = run_plan(plan, output / f"{fidelity}-ramp-{ramp:g}", workers=workers)
            episodes.append(table.assign(ramp=ramp, fidelity=fidelity))
    table = pd.concat(episodes, ignore_index=True)
    summary = summarise(table)
    write_atomically(output / "episodes.csv", table.to_csv(index=False, float_format="%.6g"))
    write_atomically(output / "turning.csv", summary.to_csv(index=False, float_format="%.5g"))
    record = {"limit": int(table["context"].nunique()), "fidelity": list(FIDELITIES)}
    write_json(output / "provenance.json", provenance(commits=table["commit"]) | record)
    print_table(f"Looking on the way back, {record['limit']} tubes", HEADER, cells(summary), left=1)
    return summary


def summarise(table: pd.DataFrame) -> pd.DataFrame:
    """A row a policy, ramp and fidelity: means, depth, and by how much a90 differs [% of the wall], tube by tube.

    ``by_ramp`` is less that of the first ramp at the same fidelity, ``by_time_lapse`` less that without time-lapse.
    """
    names = [_name(*key) for key in table[list(KEYS)].itertuples(index=False)]
    named, rows = table.assign(policy=names), []
    for (policy, ramp, fidelity), part in table.groupby(list(KEYS), sort=False):
        row: dict[str, Any] = dict(zip(KEYS, (policy, ramp, fidelity), strict=True)) | {"tubes": len(part)}
        row |= {kpi: part[kpi].mean() for kpi in KPIS} | {DEPTH: a90_95(part, str(policy))}
        others = {"ramp": _name(policy, RAMPS[0], fidelity), "fidelity": _name(policy, ramp, FIDELITIES[-1])}
        for what, column in CHANGES.items():
            change = paired_difference(named, _name(policy, ramp, fidelity), others[what], "a90_percent_wall")
            row |= {column: change.mean, f"{column}_low": change.low, f"{column}_high": change.high}
        rows.append(row)
    return pd.DataFrame(rows)


def _name(policy: Any, ramp: Any, fidelity: Any) -> str:
    """Of a policy with a ramp at a fidelity, for pairs."""
    return f"{policy}/{ramp:g}/{fidelity}"


def cells(summary: pd.DataFrame) -> list[tuple[str, ...]]:
    """A row a policy and ramp, with time-lapse beside without."""
    by_key = {tuple(row[key] for key in KEYS): row for row in summary.to_dict("records")}
    rows = []
    for policy in summary["policy"].unique():
        for ramp in summary["ramp"].unique():
            played = [by_key[policy, ramp, fidelity] for fidelity in FIDELITIES]
            figures = [f"{factor * row[name]:.3g}" for row in played for name, factor in SHOWN.items()]
            rows.append((policy, f"{ramp:g}", *figures))
    return rows
