"""How gently feed has to turn round, and what time-lapse makes of it: schedules in Inspection-v0, looking back."""

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
from agents.rollouts.statistics import mean_interval, paired_difference
from agents.terminal.tables import print_table
from probe_env.fidelity import BOTH_WAYS

POLICIES: Final = ("fast-in", "steady-back")
RAMPS: Final = (0.5, 0.2, 0.1)
"""Greatest change of the feed speed [m/s2]; the first is the task's own."""
LAPSES: Final = (4.0, 1.0)
"""Time-lapse: that of ``fast``, and none."""
KPIS: Final = ("reward", "inspection_time_s", "share_within_limit", "a90_percent_wall")
DEPTH: Final = "a90_95_percent_wall"
SHOWN: Final = {"inspection_time_s": 1.0, DEPTH: 1.0, "share_within_limit": 100.0}
"""Column of the summary -> factor of the unit for people."""
KEYS: Final = ("policy", "ramp", "time_lapse")
HEADER: Final = (
    "policy", "ramp [m/s2]",
    *(f"{what}, {how}" for how in ("fast", "no time-lapse")
      for what in ("time [s]", "a90/95, back [% wall]", "within the limit [%]")),
)  # fmt: skip


def run_study(limit: int, output: Path, workers: Workers) -> pd.DataFrame:
    """Play every schedule with every ramp, with time-lapse and without, where the way back counts; store and print.

    Nodes are those of ``fast``. Episodes that are in ``output`` are not played again. Depths are paired with those of
    the first ramp, tube by tube.

    Raises:
        ValueError: the limit is out of range.
    """
    place, episodes = both_ways(place_of(None, "test", limit), "back"), []
    for lapse in LAPSES:
        fidelity = BOTH_WAYS["fast"].model_copy(update={"time_lapse": lapse})
        for ramp in RAMPS:
            config = place.config.all_shown.model_copy(update={"ramp": ramp})
            plan = Plan(named_policies(POLICIES, config), place.contexts, config=config, fidelity=fidelity)
            table = run_plan(plan, output / f"ramp-{ramp:g}-lapse-{lapse:g}", workers=workers)
            episodes.append(table.assign(ramp=ramp, time_lapse=lapse))
    table = pd.concat(episodes, ignore_index=True)
    summary = summarise(table)
    write_atomically(output / "episodes.csv", table.to_csv(index=False, float_format="%.6g"))
    write_atomically(output / "turning.csv", summary.to_csv(index=False, float_format="%.5g"))
    record = {"limit": int(table["context"].nunique()), "fidelity": BOTH_WAYS["fast"].model_dump()}
    write_json(output / "provenance.json", provenance(commits=table["commit"]) | record)
    print_table(f"Looking on the way back, {record['limit']} tubes", HEADER, cells(summary), left=1)
    return summary


def summarise(table: pd.DataFrame) -> pd.DataFrame:
    """A row a policy, ramp and time-lapse: means, depth, and what a90 changes by against the first ramp."""
    rows = []
    named = table.assign(policy=[_name(*key) for key in zip(*(table[c] for c in KEYS), strict=True)])
    for (policy, ramp, lapse), part in table.groupby(list(KEYS), sort=False):
        row: dict[str, Any] = {"policy": policy, "ramp": ramp, "time_lapse": lapse, "tubes": part["context"].nunique()}
        row |= {kpi: mean_interval(part[kpi].to_numpy()).mean for kpi in KPIS}
        row[DEPTH] = a90_95(part, str(policy))
        here, usual = _name(policy, ramp, lapse), _name(policy, RAMPS[0], lapse)
        change = paired_difference(named, here, usual, "a90_percent_wall")
        lapsed = paired_difference(named, _name(policy, ramp, LAPSES[0]), _name(policy, ramp, LAPSES[1]),
                                   "a90_percent_wall")  # fmt: skip
        row |= {"change": change.mean, "change_low": change.low, "change_high": change.high}
        rows.append(row | {"lapsed": lapsed.mean, "lapsed_low": lapsed.low, "lapsed_high": lapsed.high})
    return pd.DataFrame(rows)


def _name(policy: Any, ramp: Any, lapse: Any) -> str:
    """Of a policy with a ramp and a time-lapse, for pairs."""
    return f"{policy}/{ramp:g}/{lapse:g}"


def cells(summary: pd.DataFrame) -> list[tuple[str, ...]]:
    """A row a policy and ramp, with time-lapse beside without."""
    by_key = {tuple(row[key] for key in KEYS): row for row in summary.to_dict("records")}
    rows = []
    for policy in summary["policy"].unique():
        for ramp in summary["ramp"].unique():
            played = [by_key[policy, ramp, lapse] for lapse in LAPSES]
            figures = [f"{factor * row[name]:.3g}" for row in played for name, factor in SHOWN.items()]
            rows.append((policy, f"{ramp:g}", *figures))
    return rows
