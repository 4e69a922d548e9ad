"""Every policy along every axis: what it loses against the task that it was made for, and how often it is unsafe."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import pandas as pd

from agents.evaluation.kpis import CORE_FAILURES, COST_KPIS
from agents.evaluation.plan import Plan, run_plan
from agents.evaluation.statistics import Interval, mean_interval, paired_difference
from agents.policies.catalogue import named_policies
from agents.policies.places import Place
from agents.processes.workers import Workers
from agents.records.provenance import provenance, write_atomically, write_json
from agents.records.tables import Columns
from agents.robustness.axes import AXES, NOMINAL, Disturbed, disturbed
from agents.robustness.figures import draw_profiles
from agents.terminal.tables import print_table
from probe_env.envs.task import FAILURES
from probe_env.fidelity import resolve_fidelity

COLUMNS: Final[Columns] = {
    "policy": "name", "axis": "text", "value": "text", "tubes": "count",
    **dict.fromkeys(("reward", "change", "low", "high", *COST_KPIS, *CORE_FAILURES), "number"),
}  # fmt: skip
"""``robustness.csv``: mean reward, its change against the nominal task with a paired 95 % interval, mean costs an
insertion in periods, and the shares of insertions that lost their drive or diverged."""


def run_study(
    specs: Sequence[str], place: Place, fidelity: str, output: Path, workers: Workers, axes: Sequence[str] = tuple(AXES)
) -> pd.DataFrame:
    """Play what is missing in ``output``, a folder a value of an axis; store the table and its picture, and print.

    Policies are made for the place's task: what is disturbed they see, if at all, by what they measure. The starts are
    the same everywhere, so that changes are paired tube by tube.

    Raises:
        ValueError: no such policy or axis, or a value of an axis cannot be in this place; nothing was played then.
    """
    config = place.config.all_shown
    policies, settings = named_policies(specs, config, place.vibration), disturbed(config, tuple(axes))
    accuracy = resolve_fidelity(fidelity, place.config.scene)
    plans = [Plan(policies, place.contexts, config=setting.config, fidelity=accuracy) for setting in settings]
    count = len(policies) * len(place.contexts)
    print(f"{len(plans)} tasks, {count} insertions each: {len(plans) * count} insertions in {output}")
    tables = []
    for k, (setting, plan) in enumerate(zip(settings, plans, strict=True)):
        print(f"{k + 1} of {len(plans)}: {setting.name}", flush=True)
        table = run_plan(plan, output / folder_of(setting), workers=workers)
        tables.append(table.assign(axis=setting.axis, value=setting.value))
    episodes = pd.concat(tables, ignore_index=True)
    summary = summary_of(episodes)
    write_atomically(output / "episodes.csv", episodes.to_csv(index=False, float_format="%.6g"))
    write_atomically(output / "robustness.csv", summary.to_csv(index=False, float_format="%.5g"))
    about = {"limit": len(place.contexts), "fidelity": fidelity, "tube": place.tube.title}
    write_json(output / "provenance.json", provenance(commits=episodes["commit"]) | about)
    draw_profiles(summary, output / "robustness.png")
    names = tuple(dict.fromkeys(summary["policy"]))
    print_table(f"Reward, and its change along the axes, {len(place.contexts)} tubes", header(names), cells(summary))
    print_table("Unsafe periods an insertion", header(names), cost_cells(summary))
    return summary


def folder_of(setting: Disturbed) -> str:
    """A folder's name: letters and figures of the setting's, which tell settings apart."""
    signs = setting.name.replace("+", "plus ").replace("-", "minus ").replace(".", "_")
    return re.sub(r"[^A-Za-z0-9_]+", "-", signs).strip("-")


def summary_of(episodes: pd.DataFrame) -> pd.DataFrame:
    """A row a policy and setting, ``COLUMNS``, of the episodes of all of them (``axis`` and ``value`` in columns)."""
    settings = episodes["axis"].str.cat(episodes["value"], sep=" ")
    # the same tubes and starts whatever is disturbed: paired as policies are
    paired = episodes.assign(policy=episodes["policy"] + "/" + settings)
    rows = []
    for (policy, axis, value), part in episodes.groupby(["policy", "axis", "value"], sort=False):
        change = paired_difference(paired, f"{policy}/{axis} {value}", f"{policy}/{NOMINAL} ", "reward")
        row: dict[str, Any] = {"policy": policy, "axis": axis, "value": value or "-", "tubes": len(part)}
        row |= {"reward": mean_interval(part["reward"].to_numpy()).mean}
        row |= {"change": change.mean, "low": change.low, "high": change.high}
        rows.append(row | {name: float(part[name].mean()) for name in (*COST_KPIS, *FAILURES)})
    order = {policy: k for k, policy in enumerate(dict.fromkeys(episodes["policy"]))}
    return pd.DataFrame(rows).sort_values("policy", key=lambda names: names.map(order), kind="stable")


def header(policies: Sequence[str]) -> tuple[str, ...]:
    """Of ``cells`` and ``cost_cells``."""
    return ("disturbed", *policies)


def cells(summary: pd.DataFrame) -> list[tuple[str, ...]]:
    """A row a setting: the nominal reward of every policy, then how each changes, with intervals."""
    return _by_setting(
        summary,
        lambda row: (
            f"{row.reward:.1f}"
            if row.axis == NOMINAL
            else f"{row.change:+.1f} [{row.low:.1f}, {row.high:.1f}]" + (" !" if row.diverged else "")
        ),
    )


def cost_cells(summary: pd.DataFrame) -> list[tuple[str, ...]]:
    """A row a setting: mean cost of every policy, and which share of its insertions lost the drive."""
    return _by_setting(
        summary, lambda row: f"{row.cost:.3g}" + (f" ({100.0 * row.lost_drive:.0f} % lost)" if row.lost_drive else "")
    )


def worst_of(summary: pd.DataFrame) -> dict[str, tuple[str, Interval]]:
    """By policy the setting in which it loses most, and how much."""
    worst = {}
    for policy, part in summary[summary["axis"] != NOMINAL].groupby("policy", sort=False):
        row = part.sort_values("change").iloc[0]
        worst[str(policy)] = (f"{row['axis']} {row['value']}", Interval(row["change"], row["low"], row["high"]))
    return worst


def _by_setting(summary: pd.DataFrame, cell: Callable[[Any], str]) -> list[tuple[str, ...]]:
    rows: dict[str, list[str]] = {}
    for row in summary.itertuples():
        name = str(row.axis) if row.axis == NOMINAL else f"{row.axis}, {row.value}"
        rows.setdefault(name, []).append(cell(row))
    return [(name, *texts) for name, texts in rows.items()]
