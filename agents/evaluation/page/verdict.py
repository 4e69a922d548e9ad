"""The verdict: how a policy does against the best of an evaluation, in one sentence that is honest about scatter."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Final

import pandas as pd

from agents.rollouts.bootstrap import Interval, short
from agents.rollouts.statistics import by_context, endings, paired_difference
from probe_env.envs.task import Measure, TaskConfig

MEASURES: Final[dict[Measure, tuple[str, float, str]]] = {
    "displacement": ("radial rms", 1e3, "mm"),
    "velocity": ("radial velocity rms", 1e3, "mm/s"),
    "acceleration": ("radial acceleration rms", 1.0, "m/s²"),
    "snr": ("noise in the band of a flaw", 1.0, "of a 20 % groove's signal"),
}
"""Vibration measure -> name, factor and unit for people."""
FEW: Final = 10
"""Tubes below which a bootstrap interval is rough."""


@dataclass(frozen=True)
class Verdict:
    """What to know first of a policy, and the figures behind it."""

    policy: str
    headline: str
    detail: str


def limit_of(task: TaskConfig) -> str:
    """The vibration limit with its unit."""
    _, factor, unit = MEASURES[task.vibration_measure]
    return f"{task.limit * factor:.4g} {unit}"


def ranking(table: pd.DataFrame) -> list[str]:
    """Policies from the highest mean reward to the lowest."""
    means = table.groupby(["policy", "context"], sort=False)["reward"].mean().groupby("policy", sort=False).mean()
    return [str(name) for name in means.sort_values(ascending=False, kind="stable").index]


def verdict(table: pd.DataFrame, policy: str, informed: Collection[str], limit: str) -> Verdict:
    """A policy against the best of the others; those that are told the tube are none to be held to.

    Args:
        table: of the episodes, on the same tubes for all.
        policy: that is judged.
        informed: policies that know what no rig does.
        limit: in words.
    """
    rivals = [name for name in ranking(table) if name == policy or name not in informed]
    tubes = table["context"].nunique()
    time, share = (by_context(table, policy, kpi).mean() for kpi in ("inspection_time_s", "share_within_limit"))
    if len(rivals) == 1:
        alone = f"{short(time)} s, {short(100.0 * share)} % of the length within {limit}{_failures(table, policy)}."
        return Verdict(policy, alone, f"Means over {_tubes(tubes)}; nothing to compare it with.")
    other = next(name for name in rivals if name != policy)
    best = rivals[0] == policy
    rival = f"the next best here, {other}" if best else f"the best here, {other}"
    differences = {kpi: paired_difference(table, policy, other, kpi) for kpi in
                   ("inspection_time_s", "share_within_limit", "reward")}  # fmt: skip
    words = f"{_time(differences['inspection_time_s'], rival)}, {_share(differences['share_within_limit'], limit)}"
    first = f"the best here{', within scatter' if _unclear(differences['reward']) else ''}: " if best else ""
    headline = f"{first}{words}{_failures(table, policy)}{_failures(table, other, other)}."
    other_time, other_share = (
        by_context(table, other, kpi).mean() for kpi in ("inspection_time_s", "share_within_limit")
    )
    reward = differences["reward"]
    judged = "no clear difference" if _unclear(reward) else "better" if reward.mean > 0.0 else "worse"
    detail = (
        f"{short(time)} s against {short(other_time)} s; {short(100.0 * share)} % of the length within {limit} against"
        f" {short(100.0 * other_share)} %. By the reward, which weighs length, vibration, time and air: {judged},"
        f" {_signed(reward, 1.0, '')}. {_basis(tubes)}"
    )
    return Verdict(policy, headline, detail)


def _figure(value: float, sign: str = "") -> str:
    """As many digits as a sentence bears."""
    sign = sign if value else ""
    return f"{value:{sign}.0f}" if abs(value) >= 10.0 else f"{value:{sign}.2g}"


def _tubes(count: int) -> str:
    return f"{count} tube{'s' if count != 1 else ''}"


def _basis(tubes: int) -> str:
    if tubes == 1:
        return "One tube says nothing about scatter: take more."
    few = " So few tubes make rough intervals." if tubes < FEW else ""
    return f"Paired differences with 95 % bootstrap intervals over {tubes} tubes, the same for both.{few}"


def _unclear(difference: Interval) -> bool:
    return difference.low <= 0.0 <= difference.high


def _signed(difference: Interval, factor: float, unit: str) -> str:
    """Mean and interval with signs; the mean alone where there is no scatter."""
    mean, low, high = (value * factor for value in (difference.mean, difference.low, difference.high))
    ends = f" [{_figure(low, '+')}, {_figure(high, '+')}]" if low < high else ""
    return f"{_figure(mean, '+')}{unit}{ends}"


def _plain(difference: Interval, factor: float, unit: str) -> str:
    """Mean and interval without signs, of a difference that has a clear one."""
    near, far = sorted(abs(value * factor) for value in (difference.low, difference.high))
    ends = f" [{_figure(near)}, {_figure(far)}]" if near < far else ""
    return f"{_figure(abs(difference.mean * factor))}{unit}{ends}"


def _time(difference: Interval, rival: str) -> str:
    if difference.low == difference.high == 0.0:
        return f"as long as {rival}"
    if _unclear(difference):
        return f"as long as {rival}, within scatter ({_signed(difference, 1.0, ' s')})"
    return f"{_plain(difference, 1.0, ' s')} {'longer' if difference.mean > 0.0 else 'shorter'} than {rival}"


def _share(difference: Interval, limit: str) -> str:
    if difference.low == difference.high == 0.0:
        return f"at the same length within {limit}"
    if _unclear(difference):
        return f"at the same length within {limit}, within scatter ({_signed(difference, 100.0, ' % of the length')})"
    word = "more" if difference.mean > 0.0 else "less"
    return f"with {_plain(difference, 100.0, ' %')} {word} of the length within {limit}"


def _failures(table: pd.DataFrame, policy: str, named: str = "") -> str:
    """What insertions of a policy came to no end, as a clause; empty if none."""
    row = endings(table).loc[policy]
    if row["complete"] == row["episodes"]:
        return ""
    return f"; {named or 'it'} did not complete {row['episodes'] - row['complete']} of {row['episodes']} insertions"
