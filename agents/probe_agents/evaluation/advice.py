"""Which schedule, and which pass: the policy that ends a plant's work first, and what the others do better."""

import math
from collections.abc import Collection

import numpy as np
import pandas as pd

from probe_agents.evaluation.kpis import displayed_kpis, goal_of, heading
from probe_agents.evaluation.statistics import (
    broken_limits,
    bundle_table,
    by_context,
    curves_by_tube,
    has_curves,
    mean_interval,
    paired_difference,
    ranking,
    short,
    signed,
)  # fmt: skip
from probe_agents.policies.on_map import FIRST
from probe_env.arrays import FloatArray
from probe_env.envs.plants import Bundle
from probe_env.envs.task.config import TaskConfig
from probe_env.inspection.detection import depths_found, pod_gaussian, snr_at, threshold
from probe_env.inspection.snr import FREQUENCY, snr_of_groove

Rows = tuple[tuple[str, ...], ...]
"""Header and rows of a table."""


def choose(table: pd.DataFrame, oracles: Collection[str]) -> tuple[str, str, Rows]:
    """The advised policy, a sentence on what others do better, and a table; of those within the limits, no oracles.

    A row for each policy that is best by goal (``with_goal``), a90 or reward: these criteria, the policy, and by each
    criterion the mean with its interval, or below the advised policy the paired difference to it. The sentence names
    policies whose difference by goal may be zero.
    """
    labels, goal = displayed_kpis(table.columns), goal_of(table.columns)
    order = [name for name in ranking(table) if name not in oracles] or ranking(table)
    within = [name for name in order if not broken_limits(table, name)]
    kpis = dict.fromkeys(name for name in (goal, "a90_percent_wall", "reward") if name in labels)
    best: dict[str, list[str]] = {}
    for kpi in kpis:
        sign = -1.0 if kpi == "reward" else 1.0
        winner = min(within or order, key=lambda policy: sign * by_context(table, policy, kpi).mean())
        best.setdefault(winner, []).append(labels[kpi][0])
    first, rows = (within or order)[0], [("best by", "policy", *(heading(labels[kpi]) for kpi in kpis))]
    for policy, names in best.items():
        cells = (
            mean_interval(by_context(table, policy, kpi).to_numpy()).text()
            if policy == first
            else signed(paired_difference(table, policy, first, kpi))
            for kpi in kpis
        )
        rows.append((", ".join(names), policy, *cells))
    others = (f", by {' and '.join(names)} {policy}" for policy, names in best.items() if policy != first)
    sentence = f"best by {' and '.join(best[first])} is {first}{''.join(others)}"
    differences = {name: paired_difference(table, name, first, goal) for name in (within or order) if name != first}
    if unclear := [name for name, found in differences.items() if found.low <= 0.0 <= found.high]:
        sentence += f"; by {labels[goal][0]} not clearly better than {', '.join(unclear)}"
    if not within:
        sentence = f"no schedule is within the limits ({broken_limits(table, first)}); of all, {sentence}"
    return first, sentence, tuple(rows)


def compare_passes(table: pd.DataFrame, policy: str, task: TaskConfig, bundle: Bundle | None) -> Rows:
    """Time and a90 of inspecting on the way in with a policy, on the way out, and on both ways.

    The way out is calculated: at the permitted speed, for a probe that does not vibrate and needs no second pass, after
    an insertion at the fastest feed. On both ways the insertion is that of the policy, once. The withdrawal takes the
    time of the bundle, or that of the inspection if it is longer. The row of the way out has the largest mu l / r of
    the tubes, with which friction amplifies a ripple of the feed. Empty if the table has both passes already, or if
    neither a bundle nor an instrument asks for it.
    """
    if task.returns or not task.growing or goal_of(table.columns) == "reward":
        return ()
    length, speed, fastest = task.scene.tube.helix_length, task.permitted_feed, task.feed_speeds[1]
    of_bundle = [f"hours for {bundle.tubes} tubes"] if bundle else []
    bundle = bundle or Bundle(tubes=1, withdrawal_time=length / fastest)
    back, driven = max(bundle.withdrawal_time or 0.0, length / speed), by_context(table, policy, "inspection_time_s")
    hours = [float(bundle_table(table[table["policy"] == policy], bundle)["total_hours"].iloc[0])]
    for insertion in ((length - FIRST) / fastest, float(driven.mean())):
        hours.append(bundle.tubes * (bundle.setup_time + insertion + back) / 3600.0)
    groove = snr_of_groove(task.sensor, np.array([speed]), np.zeros((1, len(FREQUENCY))))

    def found(curves: FloatArray, fraction: float) -> float:
        """Mean a90 [% of the wall] of insertions (n, d) and the way out, which has a fraction of the false calls."""
        calls = task.sensor.model_copy(update={"false_calls": fraction * task.sensor.false_calls})
        pod = pod_gaussian(snr_at(task.sensor, groove), threshold(calls, length))
        return 100.0 * float(depths_found(1.0 - (1.0 - curves) * (1.0 - pod), 0.9).mean())

    a90 = [math.nan, found(np.zeros((1, 1)), 1.0), math.nan]
    if has_curves(table):
        a90[0] = float(by_context(table, policy, "a90_percent_wall").mean())
        a90[2] = found(curves_by_tube(table, policy), 0.5)
    amplified = float((table["friction"] / table["helix_diameter"]).max()) * 2.0 * length
    names = f"on the way in, {policy}", f"on the way out, \u03bcl/r up to {amplified:.2g}", "on both ways"
    figures = zip(names, hours, a90, strict=True)
    rows = (
        (name, short(3600.0 * total / bundle.tubes), *[short(total)] * len(of_bundle), short(depth))
        for name, total, depth in figures
    )
    return ("inspected", "time per tube [s]", *of_bundle, "a90 [% wall]"), *rows
