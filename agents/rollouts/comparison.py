"""Comparing methods over tubes and training seeds as rliable does: who is better how often, and where the rewards lie.

Agarwal et al., Deep reinforcement learning at the edge of the statistical precipice, 2021. Tubes are drawn anew as well
as seeds, since they are a sample, too.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from agents.records.columns import HIGH
from agents.rollouts.bootstrap import PERCENTILES, Interval, redrawn
from agents.rollouts.statistics import seeds_by_contexts
from probe_env.arrays import FloatArray


def probability_of_improvement(table: pd.DataFrame, first: str, second: str, kpi: str = "reward") -> Interval:
    """How often a run of one method is better than one of another in the same tube, ties as half.

    Args:
        table: episodes, grouped (``statistics.grouped``).
        first: the method.
        second: what it is compared with.
        kpi: more is better for those of ``HIGH``, else less.

    Raises:
        ValueError: the methods were not run on the same contexts.
    """
    values = [seeds_by_contexts(table, name, kpi) for name in (first, second)]
    if not values[0].columns.equals(values[1].columns):
        raise ValueError(f"{first} and {second} were not run on the same contexts: nothing to pair")
    one, other = (part.to_numpy() for part in values)
    sign = 1.0 if kpi in HIGH else -1.0
    better = 0.5 * (1.0 + np.sign(sign * (one[:, None] - other[None])))  # (seeds, seeds, tubes)
    drawn = [better[np.ix_(*places)].mean() for places in redrawn(*better.shape)]
    return Interval(float(better.mean()), *map(float, np.percentile(drawn, PERCENTILES)))


def profiles(table: pd.DataFrame, policies: list[str], thresholds: FloatArray, kpi: str = "reward") -> pd.DataFrame:
    """Performance profiles: the share of runs, over tubes and seeds, with at least so much, with 95 % bands.

    Args:
        table: episodes, grouped.
        policies: of it.
        thresholds: (t,) of the KPI.
        kpi: in its own units.
    """
    parts = []
    for policy in policies:
        values = seeds_by_contexts(table, policy, kpi).to_numpy()
        reached = values[:, :, None] >= thresholds
        drawn = [reached[rows][:, tubes].mean(axis=(0, 1)) for rows, tubes in redrawn(*values.shape)]
        low, high = np.percentile(drawn, PERCENTILES, axis=0)
        columns = {"threshold": thresholds, "share": reached.mean(axis=(0, 1)), "low": low, "high": high}
        parts.append(pd.DataFrame({"policy": policy, **columns}))
    return pd.concat(parts, ignore_index=True)
