"""Inspection time against vibration: the front of every policy family as one of its parameters is swept."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import moocore
import numpy as np
import pandas as pd

from agents.evaluation import figures
from agents.policies.catalogue import named_policies
from agents.policies.fixed import PI, Constant, FixedPolicy, OnOff, SlowDown
from agents.policies.on_map import MapPolicy, Privileged, TensionScheduled
from agents.policies.places import Place
from agents.records.provenance import write_atomically
from agents.rollouts.bootstrap import Interval, bootstrap_ends
from agents.rollouts.depths import a90_95, tells
from agents.rollouts.plan import Plan, Policy, run_plan
from agents.rollouts.statistics import by_context, grouped, mean_interval, method_and_seed
from agents.terminal.tables import print_table
from probe_env.fidelity import resolve_fidelity
from probe_env.inspection.detection import WORST

DEPTH: Final = "a90_95_percent_wall"
REFERENCE: Final = (900.0, 1.0)
"""Time limit [s] and all of the length out of the limit: the corner that the hypervolume is measured from."""


@dataclass(frozen=True)
class Family:
    """Policies that differ in one parameter."""

    kind: type[FixedPolicy]
    parameter: str
    values: tuple[float, ...]
    fixed: dict[str, Any]

    def member(self, value: float, place: Place) -> FixedPolicy:
        """The policy of a value of the parameter."""
        looked_up = {"vibration": place.vibration} if issubclass(self.kind, MapPolicy) else {}
        return self.kind(place.config.all_shown, **{self.parameter: value}, **self.fixed, **looked_up)


STRONG_AIR: Final = {"air_supply_rate": 100.0 / 3600.0}
FAMILIES: Final[dict[str, Family]] = {
    "constant": Family(Constant, "feed_speed", (0.07, 0.1, 0.14, 0.2, 0.3), STRONG_AIR),
    "slow-down": Family(SlowDown, "slow", (0.05, 0.08, 0.12, 0.16, 0.22), {}),
    "on-off": Family(OnOff, "level", (2e-5, 4e-5, 8e-5, 1.6e-4, 3.2e-4), {}),
    "pi": Family(PI, "level", (1.5e-5, 3e-5, 6e-5, 1.2e-4, 2.4e-4), {}),
    "tension-scheduled": Family(TensionScheduled, "vibration_weight", (0.2, 0.5, 1.0, 2.0, 5.0), {}),
    "privileged": Family(Privileged, "vibration_weight", (0.2, 0.5, 1.0, 2.0, 5.0), {}),
}


def run_tradeoff(
    names: Sequence[str], output: Path, place: Place, fidelity: str, beside: Sequence[str] = ()
) -> pd.DataFrame:
    """Sweep families; stores front.csv, hypervolume.csv and front.png beside the evaluation's tables.

    ``beside`` are single policies by their specs, drawn as points: agents, schedules.

    Raises:
        ValueError: an argument is not valid; nothing was run.
    """
    for name in names:
        if name not in FAMILIES:
            raise ValueError(f"family = {name!r} is not one of {', '.join(FAMILIES)}")
    config = place.config.all_shown
    singles = named_policies(beside, config, place.vibration) if beside else {}
    policies: dict[str, Policy] = {
        f"{name} {value:g}": FAMILIES[name].member(value, place) for name in names for value in FAMILIES[name].values
    }
    table = run_plan(
        Plan(policies | singles, place.contexts, (0,), config, resolve_fidelity(fidelity, config.scene)), output
    )
    front, volumes = front_of(grouped(table), names, singles), hypervolumes(table, names)
    write_atomically(output / "front.csv", front.to_csv(index=False, float_format="%.6g"))
    write_atomically(output / "hypervolume.csv", volumes.to_csv(index=False, float_format="%.6g"))
    figures.front(front, output / "front.png")
    _print(front, volumes)
    print(f"written: {output}/ (front.csv, hypervolume.csv, front.png)")
    return front


def front_of(table: pd.DataFrame, names: Sequence[str], singles: Iterable[str] = ()) -> pd.DataFrame:
    """Mean time [s] and share of length out of the limit of every member, with 95 % intervals over the contexts.

    Of episodes that have curves of detection also a90/95 over the contexts [% of the wall]. A single policy is a family
    of its own, of value NaN; NAME@K of all K are one.
    """
    members = [(name, value, f"{name} {value:g}") for name in names for value in FAMILIES[name].values]
    members += [(name, float("nan"), name) for name in dict.fromkeys(method_and_seed(single)[0] for single in singles)]
    rows = []
    for name, value, policy in members:
        time = mean_interval(by_context(table, policy, "inspection_time_s").to_numpy())
        out = mean_interval(1.0 - by_context(table, policy, "share_within_limit").to_numpy())
        rows.append((name, value, time.mean, time.low, time.high, out.mean, out.low, out.high))
    columns = ["family", "value", "time_s", "time_low", "time_high", "out_share", "out_low", "out_high"]
    front = pd.DataFrame(rows, columns=columns)
    return front.assign(**{DEPTH: [a90_95(table, policy) for *_, policy in members]}) if tells(table) else front


def unbeaten(front: pd.DataFrame, by: str = DEPTH) -> pd.DataFrame:
    """The members that no other one beats both in time and by another column, the fastest first.

    Those with which not even a hole is found are left out.
    """
    ordered = front[front[DEPTH] < 100.0 * WORST].sort_values(["time_s", by])
    best: np.ndarray = moocore.is_nondominated(ordered[["time_s", by]].to_numpy(), keep_weakly=False)
    return ordered[best]


def member_of(row: Mapping[Hashable, Any]) -> str:
    """What a row of a front is called: family and value, or a single policy."""
    return str(row["family"]) if pd.isna(row["value"]) else f"{row['family']} {row['value']:g}"


def hypervolumes(table: pd.DataFrame, names: Sequence[str]) -> pd.DataFrame:
    """Share of the box from nothing to ``REFERENCE`` that each family's front dominates; intervals over contexts."""
    rows = []
    for name in names:
        policies = [f"{name} {value:g}" for value in FAMILIES[name].values]
        time = np.array([by_context(table, policy, "inspection_time_s") for policy in policies]) / REFERENCE[0]
        out = (1.0 - np.array([by_context(table, policy, "share_within_limit") for policy in policies])) / REFERENCE[1]
        interval = _interval(time, out)
        rows.append((name, interval.mean, interval.low, interval.high))
    return pd.DataFrame(rows, columns=["family", "hypervolume", "low", "high"])


def _interval(time: np.ndarray, out: np.ndarray) -> Interval:
    """Hypervolume of the means (p, contexts) and its bootstrap interval when contexts are drawn anew."""

    def volume(which: np.ndarray) -> float:
        points = np.column_stack([time[:, which].mean(axis=1), out[:, which].mean(axis=1)])
        return float(moocore.hypervolume(points, ref=[1.0, 1.0]))

    every = np.arange(time.shape[1])
    if len(every) < 2:
        return Interval(volume(every), volume(every), volume(every))
    ends = bootstrap_ends(volume, every, method="percentile", vectorized=False, n_resamples=2000)
    return Interval(volume(every), *map(float, ends))


def _print(front: pd.DataFrame, volumes: pd.DataFrame) -> None:
    rows = []
    for row in front.to_dict("records"):
        time = Interval(row["time_s"], row["time_low"], row["time_high"])
        out = Interval(row["out_share"], row["out_low"], row["out_high"])
        depth = (f"{row[DEPTH]:.1f}",) if DEPTH in row else ()
        rows.append((row["family"], f"{row['value']:g}", time.text(), out.text(100.0), *depth))
    header = ("family", "value", "time [s]", "out of limit [%]", *(("a90/95 [% wall]",) if DEPTH in front else ()))
    print_table("Time against length out of the limit, 95 % intervals", header, rows, left=0)
    for row in volumes.to_dict("records"):
        print(f"{row['family']}: hypervolume {Interval(row['hypervolume'], row['low'], row['high']).text()}")
    if DEPTH in front:
        best = ", ".join(member_of(row) for row in unbeaten(front).to_dict("records"))
        print(f"no other is both faster and finds smaller flaws: {best}")
