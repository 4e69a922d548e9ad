"""What policies find over tubes: curves of detection with bands, and the depths found with 50 and 90 %."""

from __future__ import annotations

from typing import Final

import numpy as np
import pandas as pd

from agents.rollouts.bootstrap import PERCENTILES, Interval, redrawn_means
from probe_env.arrays import FloatArray
from probe_env.inspection.detection import DEPTHS, depths_found
from probe_env.inspection.tally import POD_NAMES

BOUND: Final = 95.0
"""Percentile of the depth found with 90 %, when tubes are drawn anew: a90/95."""
COLUMNS: Final = ("policy", "a50_percent_wall", "a90_percent_wall", "a90_95_percent_wall")


def tells(table: pd.DataFrame) -> bool:
    """Whether a table of episodes has curves; those that are older have none."""
    return set(POD_NAMES) <= set(table.columns)


def curves_by_tube(table: pd.DataFrame, policy: str) -> FloatArray:
    """(tubes, d) probability of detection at ``DEPTHS`` in each tube, mean over seeds: the independent values."""
    part = table[table["policy"] == policy]
    return part.groupby("context")[list(POD_NAMES)].mean().to_numpy()


def a90_95(table: pd.DataFrame, policy: str) -> float:
    """Depth [% of the wall] that is found with 90 % over the tubes, with 95 % confidence (bootstrap over tubes)."""
    return float(100.0 * np.percentile(depths_found(redrawn_means(curves_by_tube(table, policy)), 0.9), BOUND))


def depths_of(table: pd.DataFrame) -> pd.DataFrame:
    """A row a policy: a50, a90 and a90/95 over the tubes [% of the wall], by the mean of their curves."""
    rows = []
    for policy in dict.fromkeys(table["policy"]):
        mean = _mean(curves_by_tube(table, policy))
        half, most = (100.0 * float(depths_found(mean, level)[0]) for level in (0.5, 0.9))
        rows.append((policy, half, most, a90_95(table, policy)))
    return pd.DataFrame(rows, columns=list(COLUMNS))


def difference_of_a90(first: FloatArray, second: FloatArray) -> Interval:
    """Depth found with 90 % by one policy less that by another [% of the wall], with its 95 % interval.

    One tube says nothing of the scatter between tubes: the interval's ends are nan.

    Args:
        first: (tubes, d) its curves at ``DEPTHS``, see ``curves_by_tube``.
        second: (tubes, d) those of the other in the same tubes: both are drawn anew together.
    """
    mean, drawn = (
        100.0 * (depths_found(of(first), 0.9) - depths_found(of(second), 0.9)) for of in (_mean, redrawn_means)
    )
    low, high = np.percentile(drawn, PERCENTILES) if len(first) > 1 else (np.nan, np.nan)
    return Interval(float(mean[0]), float(low), float(high))


def _mean(curves: FloatArray) -> FloatArray:
    return np.asarray(curves.mean(axis=0, keepdims=True))


def bands(table: pd.DataFrame) -> pd.DataFrame:
    """A row a policy and depth: probability of detection over the tubes with its 95 % band."""
    parts = []
    for policy in dict.fromkeys(table["policy"]):
        curves = curves_by_tube(table, policy)
        low, high = np.percentile(redrawn_means(curves), PERCENTILES, axis=0)
        columns = {"depth_percent_wall": 100.0 * DEPTHS, "pod": curves.mean(axis=0), "low": low, "high": high}
        parts.append(pd.DataFrame({"policy": policy, **columns}))
    return pd.concat(parts, ignore_index=True)
