"""Statistics of an evaluation: means with intervals, interquartile means, paired differences, plain sentences."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

import numpy as np
import pandas as pd
from scipy.stats import t as student
from scipy.stats import trim_mean

from agents.records.columns import HIGH, OVER_TUBES, kpis_of, label_of
from agents.rollouts.bootstrap import CONFIDENCE, PERCENTILES, Interval, bootstrap_ends, redrawn, short
from agents.rollouts.depths import a90_95, tells
from probe_env.envs.task import ENDINGS, FAILURES

BEST: Final = "planner"
BAR: Final = "best-schedule"
"""Policies whose difference in reward is the planner's lead, the measure of headroom."""


def ratio_interval(values: np.ndarray, reference: np.ndarray) -> Interval:
    """Ratio of the means of two independent samples; NaN without two values of each."""
    values, reference = values[np.isfinite(values)], reference[np.isfinite(reference)]
    if min(len(values), len(reference)) < 2 or reference.mean() == 0.0:
        return Interval(*(float("nan"),) * 3)
    ratio = float(values.mean() / reference.mean())
    if np.ptp(values) == 0.0 and np.ptp(reference) == 0.0:
        return Interval(ratio, ratio, ratio)

    def of_means(a: np.ndarray, b: np.ndarray, axis: int = -1) -> np.ndarray:
        return np.asarray(a.mean(axis=axis) / b.mean(axis=axis))

    return Interval(ratio, *map(float, bootstrap_ends(of_means, values, reference)))


def nested_interval(statistic: Callable[..., np.ndarray], *arrays: np.ndarray) -> Interval:
    """A statistic of the interquartile means over training seeds of several methods' means over contexts.

    Args:
        statistic: of one mean a method.
        arrays: (seeds, contexts) of each method; contexts are drawn anew, the same for all, and each one's seeds.
    """
    drawn = [
        [part[rows][:, contexts].mean(axis=1) for part, rows in zip(arrays, seeds, strict=True)]
        for contexts, *seeds in redrawn(arrays[0].shape[1], *map(len, arrays))
    ]
    means = [interquartile_means(np.array(part)) for part in zip(*drawn, strict=True)]
    low, high = np.percentile(statistic(*means), PERCENTILES)
    measured = statistic(*(interquartile_means(part.mean(axis=1)) for part in arrays))
    return Interval(float(measured), float(low), float(high))


def mean_interval(values: np.ndarray) -> Interval:
    """Mean of independent values with a bootstrap interval (BCa); the mean alone where all are equal or one.

    Raises:
        ValueError: no values, or some that are not finite.
    """
    values = np.asarray(values, dtype=float)
    if len(values) == 0 or not np.isfinite(values).all():
        raise ValueError(f"values = {values!r} must be finite and at least one")
    mean = float(values.mean())
    if len(values) == 1 or np.ptp(values) == 0.0:
        return Interval(mean, mean, mean)
    return Interval(mean, *map(float, bootstrap_ends(np.mean, values)))


def student_factor(count: int) -> float:
    """Half of the 95 % interval of a mean of ``count`` normal values, by Student, over its standard error."""
    return float(student.ppf(0.5 + 0.5 * CONFIDENCE, count - 1))


def student_interval(values: pd.Series) -> Interval:
    """Mean of normal values with Student's interval; NaN without two of them."""
    mean, half = float(values.mean()), float(student_factor(len(values)) * values.std() / np.sqrt(len(values)))
    return Interval(mean, mean - half, mean + half)


def interquartile_mean(values: np.ndarray) -> float:
    """Mean of the middle half."""
    return float(interquartile_means(values))


def interquartile_means(values: np.ndarray) -> np.ndarray:
    """Mean of the middle half of each row."""
    return np.asarray(trim_mean(np.asarray(values, dtype=float), 0.25, axis=-1))


def grouped(table: pd.DataFrame) -> pd.DataFrame:
    """The table with training seeds of one method gathered: policy NAME@K becomes NAME with K in column ``agent``."""
    parts = {name: method_and_seed(name) for name in table["policy"].unique()}
    return table.assign(
        agent=table["policy"].map(lambda name: parts[name][1]), policy=table["policy"].map(lambda name: parts[name][0])
    )


def method_and_seed(policy: str) -> tuple[str, int]:
    """NAME@K as (NAME, K), anything else as (NAME, 0)."""
    name, mark, seed = policy.rpartition("@")
    return (name, int(seed)) if mark and seed.isdecimal() else (policy, 0)


def seeds_by_contexts(table: pd.DataFrame, policy: str, kpi: str) -> pd.DataFrame:
    """A KPI of a method: training seeds in rows, contexts in columns, averaged over the seeds of the episodes."""
    return table[table["policy"] == policy].pivot_table(index="agent", columns="context", values=kpi)


def by_context(table: pd.DataFrame, policy: str, kpi: str) -> pd.Series:
    """A KPI of a policy by context, averaged over the seeds: the independent values."""
    return table[table["policy"] == policy].groupby("context")[kpi].mean()


def paired_difference(table: pd.DataFrame, first: str, second: str, kpi: str) -> Interval:
    """Mean of first minus second on the same contexts, with its interval.

    Raises:
        ValueError: the policies were not run on the same contexts and seeds.
    """
    places = [set(map(tuple, table.loc[table["policy"] == p, ["context", "seed"]].to_numpy())) for p in (first, second)]
    if places[0] != places[1] or not places[0]:
        raise ValueError(f"{first} and {second} were not run on the same contexts and seeds: nothing to pair")
    return mean_interval((by_context(table, first, kpi) - by_context(table, second, kpi)).to_numpy())


def share_of_lead(table: pd.DataFrame, policy: str, best: str = BEST, bar: str = BAR) -> Interval:
    """How much of the lead of one policy over another a third one has, in reward, with its interval over contexts.

    Args:
        table: episodes, all policies on the same contexts.
        policy: whose share it is.
        best: 1 by definition.
        bar: 0 by definition.

    Raises:
        ValueError: the policies were not run on the same contexts.
    """
    columns = [by_context(table, name, "reward") for name in (policy, best, bar)]
    if not len(columns[0]) or any(not column.index.equals(columns[0].index) for column in columns):
        raise ValueError(f"{policy}, {best} and {bar} were not run on the same contexts: nothing to pair")
    values, most, least = (column.to_numpy() for column in columns)

    def share(a: np.ndarray, b: np.ndarray, axis: int = -1) -> np.ndarray:
        return np.asarray(a.mean(axis=axis) / b.mean(axis=axis))

    estimate = float(share(values - least, most - least))
    if len(values) < 2 or np.ptp(values - most) == 0.0 or np.ptp(values - least) == 0.0:
        return Interval(estimate, estimate, estimate)
    return Interval(estimate, *map(float, bootstrap_ends(share, values - least, most - least, paired=True)))


def summarise(table: pd.DataFrame) -> pd.DataFrame:
    """For every policy and KPI: mean, interval, interquartile mean, worst; and how episodes ended."""
    rows = []
    for policy in dict.fromkeys(table["policy"]):
        part = table[table["policy"] == policy]
        for kpi in kpis_of(table.columns):
            values = by_context(table, policy, kpi).to_numpy()
            interval = mean_interval(values)
            good_high = kpi in HIGH
            worst = part[kpi].min() if good_high else part[kpi].max()
            rows.append((policy, kpi, interval.mean, interval.low, interval.high, interquartile_mean(values), worst))
        if tells(table):
            rows.append((policy, *OVER_TUBES, *[a90_95(table, policy)] * 4, part["a90_percent_wall"].max()))
    return pd.DataFrame(rows, columns=["policy", "kpi", "mean", "low", "high", "iqm", "worst"])


def endings(table: pd.DataFrame) -> pd.DataFrame:
    """How many episodes of each policy were complete, and how many failed by each of ``FAILURES``."""
    ended = table.reindex(columns=["policy", *ENDINGS], fill_value=0.0)  # a newer ending ended none of them
    counts = ended.groupby("policy", sort=False).sum().astype(int)
    return counts.assign(episodes=table.groupby("policy").size())


def failures(table: pd.DataFrame) -> pd.Series:
    """How many of some episodes failed by each of ``FAILURES``; by one that is newer than the table none."""
    return table.reindex(columns=list(FAILURES), fill_value=0.0).sum().astype(int)


def in_words(counts: Mapping[str, int] | pd.Series) -> list[str]:
    """Counts of ``FAILURES`` with what tables call them."""
    return [f"{counts[name]} {label_of(name)}" for name in FAILURES]


def sentences(table: pd.DataFrame, reference: str) -> list[str]:
    """One plain sentence for every other policy: time and length within the limit against the reference."""
    lines = []
    for policy in dict.fromkeys(table["policy"]):
        if policy == reference:
            continue
        time = paired_difference(table, policy, reference, "inspection_time_s")
        share = paired_difference(table, policy, reference, "share_within_limit")
        longer = "as long as" if time.low == time.high == 0.0 else f"{_in_words(time, 1.0, ' s')} than"
        lines.append(
            f"{policy} takes {longer} {reference} and keeps"
            f" {_in_words(share, 100.0, ' % of the length')} within the limit." + led(table, policy)
        )
    return lines


def led(table: pd.DataFrame, policy: str) -> str:
    """How much of the planner's lead a policy has, where the planner was played, too."""
    if policy in (BEST, BAR) or not {BEST, BAR} <= set(table["policy"]):
        return ""
    return f" It has {share_of_lead(table, policy).text(100.0)} % of the lead of {BEST} over {BAR}."


def _in_words(difference: Interval, factor: float, unit: str) -> str:
    """A difference such as "41 s less [38, 44]", or that its interval includes none."""
    low, high = difference.low * factor, difference.high * factor
    if low <= 0.0 <= high and low < high:
        return f"no clearly different amount (by {short(difference.mean * factor)}{unit} [{short(low)}, {short(high)}])"
    near, far = sorted((abs(low), abs(high)))
    word = "less" if difference.mean < 0.0 else "more"
    ends = f" [{short(near)}, {short(far)}]" if near < far else ""
    return f"{short(abs(difference.mean * factor))}{unit} {word}{ends}"
