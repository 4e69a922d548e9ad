"""What training brought: agents against the policies that set the bar, learning curves, throughput."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from agents.records.columns import KPIS
from agents.records.reading import read_csv
from agents.records.tables import CURVE
from agents.rollouts.bootstrap import Interval
from agents.rollouts.statistics import nested_interval, seeds_by_contexts

SHOWN = ("reward", "inspection_time_s", "share_within_limit", "a90_percent_wall")
"""KPIs of the table, as far as the evaluation has them."""


def verdicts(table: pd.DataFrame, agent: str, others: Sequence[str], top: str) -> list[str]:
    """How a method compares with others in plain figures.

    Args:
        table: of an evaluation, grouped (``statistics.grouped``).
        agent: the method, all of its training seeds.
        others: policies that it should beat; the first is the best open-loop schedule.
        top: the policy that knows the tube.
    """
    lines = []
    for other in others:
        reward = difference(table, agent, other, "reward")
        time = relative_change(table, agent, other, "inspection_time_s")
        out = relative_change(table.assign(out=1.0 - table["share_within_limit"]), agent, other, "out")
        lines.append(
            f"`{agent}` against `{other}`: reward {reward.mean:+.1f} [{reward.low:+.1f}, {reward.high:+.1f}],"
            f" inspection time {_percent(time)}, length out of the limit {_percent(out)}."
        )
    share = gain_fraction(table, agent, others[0], top)
    lines.append(f"`{agent}` reaches {share.text(100.0)} % of what `{top}` gains over `{others[0]}` in reward.")
    return lines


def over_seeds(table: pd.DataFrame, policy: str, kpi: str) -> Interval:
    """Interquartile mean over training seeds of the mean over contexts."""
    return _drawn(table, (policy,), kpi, lambda a: a)


def difference(table: pd.DataFrame, first: str, second: str, kpi: str) -> Interval:
    """First minus second: interquartile mean over training seeds of the mean over contexts, as in the table."""
    return _drawn(table, (first, second), kpi, lambda a, b: a - b)


def relative_change(table: pd.DataFrame, first: str, second: str, kpi: str) -> Interval:
    """Change from second to first, as a share of the second's."""
    return _drawn(table, (first, second), kpi, lambda a, b: a / b - 1.0)


def gain_fraction(table: pd.DataFrame, agent: str, reference: str, top: str) -> Interval:
    """(agent - reference) / (top - reference) of the rewards."""
    return _drawn(table, (agent, reference, top), "reward", lambda a, b, c: (a - b) / (c - b))


def _drawn(table: pd.DataFrame, names: Sequence[str], kpi: str, statistic: Callable[..., np.ndarray]) -> Interval:
    """A statistic of several methods; interval by drawing contexts (the same for all) and each one's seeds anew."""
    values = [seeds_by_contexts(table, name, kpi) for name in names]
    if len({tuple(part.columns) for part in values}) != 1:
        raise ValueError(f"{', '.join(names)} were not run on the same contexts")
    return nested_interval(statistic, *(part.to_numpy() for part in values))


def _percent(change: Interval) -> str:
    return f"{100.0 * change.mean:+.0f} % [{100.0 * change.low:+.0f}, {100.0 * change.high:+.0f}]"


def markdown(table: pd.DataFrame, methods: Sequence[str]) -> str:
    """Interquartile means over training seeds of the means over tubes, with intervals over both."""
    shown = {kpi: KPIS[kpi] for kpi in SHOWN if kpi in table}
    heads = [f"{name} [{unit}]" if unit else name for name, _, unit in shown.values()]
    lines = ["| method | training seeds | " + " | ".join(heads) + " |", "|---" * (2 + len(heads)) + "|"]
    for method in methods:
        seeds = table.loc[table["policy"] == method, "agent"].nunique()
        cells = [over_seeds(table, method, kpi).text(factor) for kpi, (_, factor, _) in shown.items()]
        lines.append(f"| `{method}` | {seeds} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def load_curves(folder: Path) -> pd.DataFrame:
    """Learning curves of all seeds of a run.

    Raises:
        FileNotFoundError: no seed has one.
    """
    paths = sorted(folder.glob("seed-*/learning.csv"))
    if not paths:
        raise FileNotFoundError(2, "no learning curve is stored there", str(folder / "seed-*/learning.csv"))
    return pd.concat([read_csv(path, CURVE) for path in paths], ignore_index=True)


def throughput(curves: pd.DataFrame, imitation_steps: int) -> dict[str, float]:
    """Environment steps per second of training and the kernel's share of its time, validation left out.

    Args:
        curves: learning curves of seeds that had one thread each.
        imitation_steps: environment steps of phase 0.
    """
    steps = imitation_steps * curves["seed"].nunique() + float(curves.groupby("seed")["steps"].max().sum())
    wall = float(curves["wall_s"].sum())
    whole = curves.groupby("seed")[["wall_s", "validation_s"]].sum().sum(axis=1)
    return {
        "steps_per_second": steps / wall,
        "kernel_share": float(curves["kernel_s"].sum()) / wall,
        "minutes_a_seed": float(whole.median()) / 60.0,
    }
