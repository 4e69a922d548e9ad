"""What training brought: agents against the policies that set the bar, learning curves, throughput."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from agents.statistics import RESAMPLES, Interval, by_context, over_seeds, paired_difference

SHOWN = ("reward", "inspection_time_s", "share_within_limit")


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
        reward = paired_difference(table, agent, other, "reward")
        time = relative_change(table, agent, other, "inspection_time_s")
        out = relative_change(table.assign(out=1.0 - table["share_within_limit"]), agent, other, "out")
        lines.append(
            f"`{agent}` against `{other}`: reward {reward.mean:+.1f} [{reward.low:+.1f}, {reward.high:+.1f}],"
            f" inspection time {_percent(time)}, length out of the limit {_percent(out)}."
        )
    share = gain_fraction(table, agent, others[0], top)
    lines.append(f"`{agent}` reaches {share.text(100.0)} % of what `{top}` gains over `{others[0]}` in reward.")
    return lines


def relative_change(table: pd.DataFrame, first: str, second: str, kpi: str) -> Interval:
    """Change of a KPI's mean over the contexts from second to first, as a share of the second's; paired bootstrap."""
    pair = np.column_stack([by_context(table, name, kpi).to_numpy() for name in (first, second)])
    return _drawn(pair, lambda rows: float(rows[:, 0].mean() / rows[:, 1].mean() - 1.0))


def gain_fraction(table: pd.DataFrame, agent: str, reference: str, top: str) -> Interval:
    """(agent - reference) / (top - reference) of the mean rewards; paired bootstrap over the contexts."""
    trio = np.column_stack([by_context(table, name, "reward").to_numpy() for name in (agent, reference, top)])
    return _drawn(trio, lambda rows: float((rows[:, 0] - rows[:, 1]).mean() / (rows[:, 2] - rows[:, 1]).mean()))


def _drawn(columns: np.ndarray, statistic: Callable[[np.ndarray], float]) -> Interval:
    rng = np.random.default_rng(0)
    drawn = [statistic(columns[rng.integers(len(columns), size=len(columns))]) for _ in range(RESAMPLES)]
    low, high = np.percentile(drawn, [2.5, 97.5])
    return Interval(statistic(columns), float(low), float(high))


def _percent(change: Interval) -> str:
    return f"{100.0 * change.mean:+.0f} % [{100.0 * change.low:+.0f}, {100.0 * change.high:+.0f}]"


def markdown(table: pd.DataFrame, methods: Sequence[str]) -> str:
    """Interquartile means over training seeds of the means over tubes, with intervals over both."""
    lines = [
        "| method | training seeds | reward | inspection time [s] | length within the limit [%] |",
        "|---" * 5 + "|",
    ]
    for method in methods:
        seeds = table.loc[table["policy"] == method, "agent"].nunique()
        cells = [over_seeds(table, method, kpi).text(100.0 if kpi == "share_within_limit" else 1.0) for kpi in SHOWN]
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
    return pd.concat([pd.read_csv(path) for path in paths], ignore_index=True)


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
        "minutes_a_seed": float(whole.mean()) / 60.0,
    }
