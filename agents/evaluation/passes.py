"""Whether to look on the way in, on the way back or both ways: schedules in Inspection-v0, for two probes."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final, get_args

import pandas as pd

from agents.policies.catalogue import named_policies
from agents.policies.places import both_ways, place_of, with_probe
from agents.processes.workers import Workers
from agents.records.provenance import provenance, write_atomically, write_json
from agents.rollouts.depths import a90_95
from agents.rollouts.plan import Plan, run_plan
from agents.rollouts.statistics import mean_interval, paired_difference
from agents.terminal.tables import print_table
from probe_env.envs.task import Inspects
from probe_env.fidelity import resolve_fidelity

POLICIES: Final = ("fast-in", "steady-back", "slow-back", "best-schedule", "tension-scheduled")
BESIDE: Final = "best-schedule"
"""Looking on the way in by this is what rewards are paired with."""
PROBES: Final = ("original", "improved")
LOOKS: Final[dict[str, str]] = {"in": "the way in", "back": "the way back", "best": "the better of both"}
KPIS: Final = {"reward": 1.0, "inspection_time_s": 1.0, "share_within_limit": 100.0}
"""KPI -> factor of the unit for people: s, %."""
DEPTH: Final = "a90_95_percent_wall"


def run_study(limit: int, fidelity: str, output: Path, workers: Workers) -> pd.DataFrame:
    """Play every policy both ways with every probe, for each thing that a metre may count for; store and print.

    Episodes that are in ``output`` are not played again. The rewards are paired with those of the way in with
    ``best-schedule``, tube by tube.

    Raises:
        ValueError: the limit is out of range.
    """
    rows, episodes = [], []
    for probe in PROBES:
        for inspects in get_args(Inspects):
            place = both_ways(place_of(None, "test", limit), inspects)
            config = with_probe(place.config.all_shown, probe)
            policies = named_policies(POLICIES, config)
            plan = Plan(policies, place.contexts, config=config, fidelity=resolve_fidelity(fidelity, both_ways=True))
            table = run_plan(plan, output / f"{probe}-{inspects}", workers=workers)
            episodes.append(table.assign(probe=probe, inspects=inspects))
    table = pd.concat(episodes, ignore_index=True)
    for probe in PROBES:
        of_probe = table[table["probe"] == probe]
        # the same tubes and starts, whatever counts: paired as policies are
        paired = of_probe.assign(policy=of_probe["policy"] + "/" + of_probe["inspects"])
        for (policy, inspects), part in of_probe.groupby(["policy", "inspects"], sort=False):
            row: dict[str, Any] = {"probe": probe, "policy": policy, "inspects": inspects, "tubes": len(part)}
            for kpi in KPIS:
                interval = mean_interval(part[kpi].to_numpy())
                row |= {kpi: interval.mean, f"{kpi}_low": interval.low, f"{kpi}_high": interval.high}
            row[DEPTH] = a90_95(part, str(policy))
            gain = paired_difference(paired, f"{policy}/{inspects}", f"{BESIDE}/in", "reward")
            rows.append(row | {"gain": gain.mean, "gain_low": gain.low, "gain_high": gain.high})
    summary = pd.DataFrame(rows)
    write_atomically(output / "episodes.csv", table.to_csv(index=False, float_format="%.6g"))
    write_atomically(output / "passes.csv", summary.to_csv(index=False, float_format="%.5g"))
    tubes = int(table["context"].nunique())
    write_json(output / "provenance.json", provenance(commits=table["commit"]) | {"limit": tubes, "fidelity": fidelity})
    print_table(f"Both passes, {tubes} tubes", HEADER, cells(summary), left=3)
    return summary


HEADER: Final = (
    "probe",
    "way in",
    "what counts",
    "reward",
    "time [s]",
    "within the limit [%]",
    "a90/95 [% wall]",
    "reward, paired",
)


def cells(summary: pd.DataFrame) -> list[tuple[str, ...]]:
    """A row a probe, policy and what counts."""
    rows = []
    for row in summary.to_dict("records"):
        figures = [f"{factor * row[kpi]:.3g}" for kpi, factor in KPIS.items()]
        depth = "" if pd.isna(row[DEPTH]) else f"{row[DEPTH]:.3g}"
        gain = f"{row['gain']:+.1f} [{row['gain_low']:.1f}, {row['gain_high']:.1f}]"
        rows.append((str(row["probe"]), str(row["policy"]), LOOKS[row["inspects"]], *figures, depth, gain))
    return rows
