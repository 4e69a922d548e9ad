"""Whether to look on the way in, on the way back or both ways: schedules in Inspection-v0, for two probes."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from agents.policies.both_ways import fidelity_of
from agents.policies.catalogue import named_policies
from agents.policies.places import both_ways, place_of, with_probe
from agents.processes.workers import Workers
from agents.records.provenance import provenance, write_atomically, write_json
from agents.rollouts.depths import a90_95
from agents.rollouts.plan import Plan, run_plan
from agents.rollouts.statistics import mean_interval, paired_difference
from agents.terminal.tables import print_table
from probe_env.envs.task import Outcome, TaskConfig, reward_terms

POLICIES: Final = (
    "fast-in", "best-both-ways", "steady-back", "slow-back", "best-schedule", "tension-scheduled", "trimmed-law",
)  # fmt: skip
BESIDE: Final = "best-schedule"
"""Looking on the way in by this is what rewards are paired with."""
PROBES: Final = ("original", "improved")
LOOKS: Final[dict[str, str]] = {"in": "the way in", "back": "the way back", "best": "the better of both"}
PLAYED: Final = "best"
"""What counts in the episodes that are played; their KPIs have the others' beside."""
KPIS: Final = {"reward": 1.0, "inspection_time_s": 1.0, "share_within_limit": 100.0}
"""KPI -> factor of the unit for people: s, %."""
DEPTH: Final = "a90_95_percent_wall"


def run_study(limit: int, fidelity: str, output: Path, workers: Workers) -> pd.DataFrame:
    """Play every policy both ways with every probe, judged by each thing that a metre may count for; store and print.

    Episodes that are in ``output`` are not played again. The rewards are paired with those of the way in with
    ``best-schedule``, tube by tube.

    Raises:
        ValueError: the limit is out of range, or the fidelity is none of both ways.
    """
    rows, episodes = [], []
    for probe in PROBES:
        place = both_ways(place_of(None, "test", limit), PLAYED)
        config = with_probe(place.config.all_shown, probe)
        policies = named_policies(POLICIES, config)
        plan = Plan(policies, place.contexts, config=config, fidelity=fidelity_of(fidelity))
        played = run_plan(plan, output / probe, workers=workers)
        episodes += [judged_by(played, look).assign(probe=probe, inspects=look) for look in LOOKS]
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
    title = f"Both passes, {tubes} tubes"
    print_table(f"{title}: found with 90 % [% wall], and within the limit [%]", FOUND, found_cells(summary), left=2)
    print_table(f"{title}: reward", REWARDS, reward_cells(summary), left=2)
    return summary


def most_reward(config: TaskConfig, metres: float) -> float:
    """What no policy earns more than, nor one that leaves its probe in the tube: it owes more than it saves.

    Args:
        config: the task of both passes.
        metres: that are inspected [m], both ways at the greatest feed with the least air, and nothing is shaken.
    """
    seconds = 2.0 * metres / config.feed_speeds[1]
    silent = (metres, 0.0, seconds, seconds * config.air_supply_rates[0], 0.0, False)
    terms = reward_terms(config, Outcome(*(np.array([value]) for value in silent)))
    return float(np.concatenate(list(terms.values())).sum())


def judged_by(table: pd.DataFrame, look: str) -> pd.DataFrame:
    """Episodes of both passes, which were played for ``PLAYED``, with the KPIs of what else a metre may count for."""
    beside = {
        other: [name for name in table.columns if name.startswith(f"{other}_")] for other in LOOKS if other != PLAYED
    }
    own = table.drop(columns=[name for names in beside.values() for name in names])
    return own.assign(**{name.removeprefix(f"{look}_"): table[name] for name in beside.get(look, ())})


FOUND: Final = (
    "probe", "policy", "time [s]", *(f"a90/95, {way} [% wall]" for way in ("in", "back", "either")),
    *(f"within the limit, {way} [%]" for way in ("in", "back", "better")),
)  # fmt: skip
REWARDS: Final = ("probe", "policy", *LOOKS.values())


def found_cells(summary: pd.DataFrame) -> list[tuple[str, ...]]:
    """A row a probe and policy: how long both ways take, what each way finds, and how much is within the limit."""
    rows = []
    for (probe, policy), ways in _by_policy(summary):
        columns = ((DEPTH, 1.0), ("share_within_limit", KPIS["share_within_limit"]))
        figures = [f"{factor * ways[way][kpi]:.3g}" for kpi, factor in columns for way in LOOKS]
        rows.append((probe, policy, f"{ways['in']['inspection_time_s']:.3g}", *figures))
    return rows


def reward_cells(summary: pd.DataFrame) -> list[tuple[str, ...]]:
    """A row a probe and policy: reward by what counts, and what it is more than that of the way in by ``BESIDE``."""
    rows = []
    for (probe, policy), ways in _by_policy(summary):
        gains = [
            f"{row['reward']:.1f} ({row['gain']:+.1f} [{row['gain_low']:.1f}, {row['gain_high']:.1f}])"
            for row in (ways[way] for way in LOOKS)
        ]
        rows.append((probe, policy, *gains))
    return rows


def _by_policy(summary: pd.DataFrame) -> list[tuple[tuple[str, str], dict[str, dict[str, Any]]]]:
    """Rows of the table by what counts, for each probe and policy."""
    parts = summary.groupby(["probe", "policy"], sort=False)
    return [
        ((str(probe), str(policy)), {str(row["inspects"]): row for row in part.to_dict("records")})  # type: ignore[misc]
        for (probe, policy), part in parts
    ]
