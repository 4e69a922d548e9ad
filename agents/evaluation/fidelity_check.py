"""Honesty of the solver: do an evaluation's figures and ranking stay at half the step and with a finer fidelity?

With the finer one twice: what was fed and blown is replayed, so that nothing but the physics differs; and the policies
act themselves, so that feedback answers to what it meets, as it would on a rig.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, Literal

import pandas as pd
from scipy.stats import kendalltau

from agents.policies.fixed import Scheduled
from agents.processes.workers import HERE, Workers
from agents.records.columns import KPIS, kpis_of
from agents.records.provenance import write_atomically
from agents.records.reading import read_parquet
from agents.records.tables import PROFILE
from agents.rollouts.bootstrap import Interval
from agents.rollouts.plan import Plan, run_plan
from agents.rollouts.statistics import by_context, mean_interval
from probe_env.fidelity import Fidelity, resolve_fidelity
from probe_env.machine import available_cores
from probe_env.physics.methods import METHODS
from probe_env.schedule import Schedule

Level = Literal["no", "half-step", "replayed", "acting", "all"]
FINER: Final = "reference"
COLUMNS: Final = ["check", "policy", "kpi", "before", "mean", "low", "high", "rank", "rank_before"]
WORTH_A_WORD: Final = 1e-3  # of the figure before


@dataclass(frozen=True)
class Checks:
    """Which checks; ``finer`` is the fidelity, see ``resolve_fidelity``, that "replayed" and "acting" take."""

    level: Level = "no"
    finer: str | Fidelity = FINER


def run_checks(checks: Checks, plan: Plan, table: pd.DataFrame, output: Path, workers: Workers = HERE) -> None:
    """Run what was asked for, store fidelity.csv and print it in words.

    Args:
        checks: half the step always, unless the level is "no"; "all": with both of the others.
        plan: of the evaluation.
        table: its episodes.
        output: its folder, with profile.parquet.
        workers: who runs the episodes.

    Raises:
        ValueError: the finer fidelity is not known.
    """
    if checks.level == "no":
        return
    finer = resolve_fidelity(checks.finer, plan.config.scene)
    parts = [check_half_step(plan, table, output, workers)]
    if checks.level in ("replayed", "all"):
        profile = read_parquet(output / "profile.parquet", PROFILE)
        parts.append(check_replayed(replace(plan, fidelity=finer), table, profile, output, workers))
    if checks.level in ("acting", "all"):
        parts.append(check_acting(replace(plan, fidelity=finer), table, output, workers))
    report_checks(parts, output)


def check_half_step(plan: Plan, table: pd.DataFrame, output: Path, workers: Workers = HERE) -> pd.DataFrame:
    """All episodes again at half the time step; differences to ``table``, see ``differences``."""
    half = plan.fidelity.model_copy(update={"time_step": plan.fidelity.time_step / 2.0})
    repeated = run_plan(replace(plan, fidelity=half), output / "half-step", workers=workers)
    return differences("half step", repeated, table)


def check_replayed(
    plan: Plan, table: pd.DataFrame, profile: pd.DataFrame, output: Path, workers: Workers = HERE
) -> pd.DataFrame:
    """The first seed's episodes replayed: what each fed and blew over length, as a schedule."""
    parts = []
    for k, context in enumerate(plan.contexts):
        policies = {name: Scheduled(plan.config, replayed(profile, name, k, plan.seeds[0])) for name in plan.policies}
        repeated = run_plan(
            replace(plan, policies=policies, contexts=[context], seeds=plan.seeds[:1]),
            output / "finer-replayed" / f"context-{k}",
            **_side_by_side(plan.fidelity, workers),
        )
        parts.append(repeated.assign(context=k))
    return differences("replayed with a finer fidelity", pd.concat(parts, ignore_index=True), _first_seed(plan, table))


def check_acting(plan: Plan, table: pd.DataFrame, output: Path, workers: Workers = HERE) -> pd.DataFrame:
    """The same episodes, but the policies act by what they observe."""
    once = replace(plan, seeds=plan.seeds[:1])
    repeated = run_plan(once, output / "finer-acting", **_side_by_side(plan.fidelity, workers))
    return differences("acting with a finer fidelity", repeated, _first_seed(plan, table))


def _side_by_side(fidelity: Fidelity, workers: Workers) -> dict[str, Any]:
    """As many episodes at a time as cores where there are no lanes to fill, so that each is stored as it ends.

    Side by side they would all end after an hour, and an interruption before that would lose them.
    """
    if METHODS[fidelity.method].lanes:
        return {"workers": workers}
    return {"batch": available_cores() if workers.here else 1, "workers": workers}


def _first_seed(plan: Plan, table: pd.DataFrame) -> pd.DataFrame:
    return table[table["seed"] == plan.seeds[0]]


def replayed(profile: pd.DataFrame, policy: str, context: int, seed: int) -> Schedule:
    """What an episode fed and blew over the inserted length."""
    rows = profile[(profile["policy"] == policy) & (profile["context"] == context) & (profile["seed"] == seed)]
    if rows.empty:
        raise ValueError(f"no profile of {policy} on context {context} with seed {seed} is stored")
    columns = (rows[name].astype(float) for name in ("inserted_length", "feed_speed", "air_supply_rate"))
    position, feed, air = (tuple(column) for column in columns)
    return Schedule("inserted_length", "linear", position, feed, air)


def differences(check: str, repeated: pd.DataFrame, before: pd.DataFrame) -> pd.DataFrame:
    """For every policy and KPI: mean before, its change on the same contexts with interval, the rank by reward."""
    ranks = [_ranks(frame) for frame in (repeated, before)]
    rows = []
    for policy in dict.fromkeys(repeated["policy"]):
        for kpi in kpis_of(set(repeated.columns) & set(before.columns)):
            reference = by_context(before, policy, kpi)
            change = mean_interval((by_context(repeated, policy, kpi) - reference).to_numpy())
            interval = (float(reference.mean()), change.mean, change.low, change.high)
            rows.append((check, policy, kpi, *interval, ranks[0][policy], ranks[1][policy]))
    return pd.DataFrame(rows, columns=COLUMNS)


def _ranks(table: pd.DataFrame) -> dict[str, int]:
    means = table.groupby("policy")["reward"].mean().sort_values(ascending=False)
    return {str(policy): place for place, policy in enumerate(means.index, start=1)}


def report_checks(parts: Sequence[pd.DataFrame], output: Path) -> pd.DataFrame:
    """Store fidelity.csv and say in words what moved."""
    checks = pd.concat(parts, ignore_index=True)
    write_atomically(output / "fidelity.csv", checks.to_csv(index=False, float_format="%.6g"))
    print("\n".join(words(checks)))
    return checks


def words(checks: pd.DataFrame) -> list[str]:
    """Whether the ranking stays, and the figures that move by more than rounding, with intervals without zero."""
    lines = []
    for check, rows in checks.groupby("check", sort=False):
        places = rows.drop_duplicates("policy")
        agreement = kendalltau(places["rank"], places["rank_before"]).statistic if len(places) > 1 else 1.0
        same = "stays" if (places["rank"] == places["rank_before"]).all() else "changes"
        rewards = rows[rows["kpi"] == "reward"].sort_values("rank")
        order = ", ".join(f"{row['policy']} {row['before'] + row['mean']:.1f}" for row in rewards.to_dict("records"))
        lines.append(
            f"{check}: the ranking of {len(places)} policies by reward {same} (Kendall's tau {agreement:.2f}): {order}"
        )
        for row in rows.to_dict("records"):
            clear = row["low"] > 0.0 or row["high"] < 0.0
            if clear and abs(row["mean"]) > WORTH_A_WORD * abs(row["before"]):
                name, factor, unit = KPIS[row["kpi"]]
                change = Interval(row["mean"], row["low"], row["high"]).text(factor)
                lines.append(f"{row['policy']}: {name} changes by {change} {unit}".rstrip())
    return lines
