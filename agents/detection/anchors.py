"""Which policy finds smaller flaws in less time, and whether that hangs on the two anchors that fix the scale.

Both anchors times a factor divide all depths by it where the signal goes with the depth, and no ranking can change. So
each is halved and doubled by itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import pandas as pd
from scipy.stats import kendalltau

from agents.detection.pairs import pairs_of, survival
from agents.policies.catalogue import named_policies
from agents.policies.places import Place
from agents.processes.workers import Workers
from agents.records.provenance import provenance, write_atomically, write_json
from agents.rollouts.bootstrap import short
from agents.rollouts.depths import a90_95
from agents.rollouts.plan import Plan, run_plan
from agents.rollouts.statistics import by_context
from agents.terminal.tables import print_table
from probe_env.fidelity import resolve_fidelity
from probe_env.inspection.sensor import Sensor

POLICIES: Final = (
    "constant", "slow", "pi", "best-constant", "best-schedule", "best-schedule-by-diameter", "tension-scheduled",
    "adaptive", "ppo",
)  # fmt: skip
ANCHORS: Final = {
    "as they are": (1.0, 1.0), "quiet halved": (0.5, 1.0), "quiet doubled": (2.0, 1.0), "shaken halved": (1.0, 0.5),
    "shaken doubled": (1.0, 2.0),
}  # fmt: skip
"""Signal-to-noise of the sensor without vibration and with it, times these."""
USUAL: Final = "as they are"
A90: Final = "a90_95_percent_wall"


def scaled(sensor: Sensor, quiet: float, shaken: float) -> Sensor:
    """The sensor with its anchors times factors.

    Raises:
        ValueError: vibration would add no noise.
    """
    update = {"quiet_snr": quiet * sensor.quiet_snr, "shaken_snr": shaken * sensor.shaken_snr}
    return Sensor.model_validate(sensor.model_dump() | update)


def run_anchors(names: Sequence[str], place: Place, fidelity: str, output: Path, workers: Workers) -> pd.DataFrame:
    """Play policies on the same tubes with the anchors as they are, and each halved and doubled; store, print.

    Episodes that are in ``output`` are not played again.

    Raises:
        ValueError: a policy or a fidelity is not known, or one policy alone; nothing was run.
    """
    config = place.config.all_shown
    policies = named_policies(names, config, place.vibration)
    if len(policies) < 2:
        raise ValueError(f"policies = {', '.join(policies)}: a ranking needs two")
    rows: dict[str, dict[str, float]] = {name: {} for name in policies}
    tables: dict[str, pd.DataFrame] = {}
    for what, factors in ANCHORS.items():
        task = config.model_copy(update={"sensor": scaled(config.sensor, *factors)})
        plan = Plan(named_policies(names, task, place.vibration), place.contexts, config=task,
                    fidelity=resolve_fidelity(fidelity, task.scene))  # fmt: skip
        tables[what] = table = run_plan(plan, output / what.replace(" ", "-"), workers=workers)
        for name, row in rows.items():
            row[f"{A90}, {what}"] = a90_95(table, name)
            if what == USUAL:
                for kpi in ("reward", "inspection_time_s", "share_within_limit", "length_with_snr_over_3_m"):
                    row[kpi] = float(by_context(table, name, kpi).mean())
    summary = pd.DataFrame(rows).T.rename_axis("policy").reset_index()
    record = {"fidelity": plan.fidelity.model_dump(), "tubes": len(place.contexts)}
    write_atomically(output / "anchors.csv", summary.to_csv(index=False, float_format="%.5g"))
    pairs = pairs_of(tables)
    write_atomically(output / "pairs.csv", pairs.to_csv(index=False, float_format="%.5g"))
    commits = [commit for table in tables.values() for commit in table["commit"]]
    write_json(output / "provenance.json", provenance(commits=commits) | record | {"agreement": agreement(summary)})
    print_table(f"What is found, {len(place.contexts)} tubes", HEADER, cells(summary), left=1)
    for line in sentences(summary, pairs):
        print(line)
    return summary


def agreement(summary: pd.DataFrame) -> dict[str, float]:
    """Kendall's tau of the ranking by a90/95 as the anchors are with the others, and with the one in millimetres."""
    usual = summary[f"{A90}, {USUAL}"]
    others = {what: summary[f"{A90}, {what}"] for what in ANCHORS if what != USUAL}
    others |= {"reward in millimetres": -summary["reward"]}
    return {what: float(kendalltau(usual, values).statistic) for what, values in others.items()}


HEADER: Final = (
    "policy", "reward", "time [s]", "within limit [%]", "S/N over 3 [m]", *(f"a90/95, {what} [%]" for what in ANCHORS)
)  # fmt: skip


def cells(summary: pd.DataFrame) -> list[tuple[str, ...]]:
    """A row a policy, the smallest depth first."""
    ordered = summary.sort_values([f"{A90}, {USUAL}", "inspection_time_s"])
    return [
        (
            str(row["policy"]),
            f"{row['reward']:.1f}",
            f"{row['inspection_time_s']:.0f}",
            f"{100.0 * row['share_within_limit']:.1f}",
            f"{row['length_with_snr_over_3_m']:.1f}",
            *(short(row[f"{A90}, {what}"]) for what in ANCHORS),
        )
        for row in ordered.to_dict("records")
    ]


def sentences(summary: pd.DataFrame, pairs: pd.DataFrame) -> list[str]:
    """Where the answer differs from the one in millimetres, and whether it hangs on the anchors."""
    by_reward = summary.sort_values("reward", ascending=False)["policy"].tolist()
    by_depth = summary.sort_values([f"{A90}, {USUAL}", "inspection_time_s"])["policy"].tolist()
    moved = [name for name in by_depth if abs(by_depth.index(name) - by_reward.index(name)) >= 2]
    tau = agreement(summary)
    moved_anchors = ", ".join(f"{what} {tau[what]:.2f}" for what in ANCHORS if what != USUAL)
    return [
        f"By the depth that is found with 90 % the first is {by_depth[0]}, by the reward in millimetres {by_reward[0]};"
        f" {', '.join(moved) or 'none'} stand two places or more apart.",
        f"Kendall's tau with the ranking by anchors as they are: {moved_anchors}; with that by the reward in"
        f" millimetres {tau['reward in millimetres']:.2f}.",
        survival(pairs, USUAL),
    ]
