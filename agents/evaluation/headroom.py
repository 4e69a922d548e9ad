"""How much feedback can still win: planners on the simulator itself beside what a rig could run, tube by tube."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final, NamedTuple

import pandas as pd

from agents.evaluation import headroom_figures
from agents.policies.catalogue import named_policies
from agents.policies.places import Place
from agents.policies.planning.planner import PLANNERS, Planner
from agents.processes.workers import Workers
from agents.records.provenance import provenance, write_atomically, write_json
from agents.rollouts.plan import Plan, Policy, run_plan
from agents.rollouts.statistics import (
    BAR,
    by_context,
    failures,
    grouped,
    mean_interval,
    paired_difference,
    share_of_lead,
)
from agents.terminal.tables import print_table
from probe_env.envs.task import FAILURES
from probe_env.fidelity import resolve_fidelity

ALWAYS: Final = (*PLANNERS, BAR)
"""What shares are counted by is always played."""


class Lookahead(NamedTuple):
    """How far, how often and how broadly a planner looks."""

    periods: int
    candidates: int
    every: int
    rest: str = "map"

    @property
    def copies(self) -> float:
        """Simulated seconds of copies for each second of the insertion: what it costs."""
        return self.periods * self.candidates / self.every

    @property
    def name(self) -> str:
        """For tables: periods, candidates, periods to the next plan."""
        short = f"{self.periods}x{self.candidates}/{self.every}"
        return short if self.rest == "map" else f"{short}-{self.rest}"


SETTINGS: Final = (
    Lookahead(1, 16, 2), Lookahead(2, 16, 2), Lookahead(4, 16, 2), Lookahead(8, 16, 2),
    Lookahead(4, 4, 2), Lookahead(4, 8, 2), Lookahead(4, 32, 2),
    Lookahead(4, 16, 1), Lookahead(4, 16, 4), Lookahead(4, 16, 2, "nothing"),
)  # fmt: skip
"""Around the one that ships: one thing at a time."""


def run_headroom(names: Sequence[str], place: Place, fidelity: str, output: Path, workers: Workers) -> pd.DataFrame:
    """Play planners and other policies on the same tubes; store and print rewards and shares of the planner's lead.

    Episodes that are in ``output`` are not played again.

    Raises:
        ValueError: a policy or a fidelity is not known; nothing was run.
    """
    config = place.config.all_shown
    policies = named_policies(list(dict.fromkeys((*ALWAYS, *names))), config, place.vibration)
    plan = Plan(policies, place.contexts, config=config, fidelity=resolve_fidelity(fidelity, config.scene))
    table = grouped(run_plan(plan, output, workers=workers))
    rows = []
    for policy in dict.fromkeys(table["policy"]):
        reward = mean_interval(by_context(table, policy, "reward").to_numpy())
        gain = paired_difference(table, policy, BAR, "reward") if policy != BAR else None
        share = share_of_lead(table, policy)
        failed = failures(table[table["policy"] == policy])
        rows.append(
            {
                "policy": policy, "tubes": len(place.contexts),
                "reward": reward.mean, "reward_low": reward.low, "reward_high": reward.high,
                "gain": gain.mean if gain else 0.0, "gain_low": gain.low if gain else 0.0,
                "gain_high": gain.high if gain else 0.0,
                "share": share.mean, "share_low": share.low, "share_high": share.high,
                "inspection_time_s": by_context(table, policy, "inspection_time_s").mean(),
                "share_within_limit": by_context(table, policy, "share_within_limit").mean(),
                **{name: int(failed[name]) for name in FAILURES},
            }
        )  # fmt: skip
    summary = pd.DataFrame(rows)
    write_atomically(output / "headroom.csv", summary.to_csv(index=False, float_format="%.5g"))
    write_json(
        output / "provenance.json", provenance(commits=table["commit"]) | {"fidelity": plan.fidelity.model_dump()}
    )
    headroom_figures.by_tube(table, BAR, output / "headroom.png")
    print_table(f"Headroom, {len(place.contexts)} tubes", HEADER, cells(summary), left=1)
    return summary


def run_settings(place: Place, fidelity: str, output: Path, workers: Workers) -> pd.DataFrame:
    """Play a planner with other horizons, candidates and terminal values on the same tubes; store, draw and print.

    The differences are to the planner as it ships, paired. Episodes that are in ``output`` are not played again.
    """
    config = place.config.all_shown
    policies: dict[str, Policy] = {
        setting.name: Planner(config, vibration=place.vibration, **setting._asdict()) for setting in SETTINGS
    }
    plan = Plan(policies, place.contexts, config=config, fidelity=resolve_fidelity(fidelity, config.scene))
    table = run_plan(plan, output, workers=workers)
    shipped = shipped_setting().name
    rows = []
    for setting in SETTINGS:
        reward = mean_interval(by_context(table, setting.name, "reward").to_numpy())
        gain = paired_difference(table, setting.name, shipped, "reward")
        rows.append(
            {
                **setting._asdict(), "copies": setting.copies, "tubes": len(place.contexts), "reward": reward.mean,
                "gain": gain.mean, "gain_low": gain.low, "gain_high": gain.high,
            }
        )  # fmt: skip
    summary = pd.DataFrame(rows)
    write_atomically(output / "settings.csv", summary.to_csv(index=False, float_format="%.5g"))
    write_json(
        output / "settings-provenance.json",
        provenance(commits=table["commit"]) | {"fidelity": plan.fidelity.model_dump()},
    )
    headroom_figures.settings(summary, output / "settings.png")
    print_table(f"Planners, {len(place.contexts)} tubes", SETTINGS_HEADER, setting_cells(summary), left=1)
    return summary


def shipped_setting() -> Lookahead:
    """Of the planner that goes by name."""
    return Lookahead(Planner.periods, Planner.candidates, Planner.every, Planner.rest)


HEADER: Final = ("policy", "reward", f"less {BAR}", "share of the planner's lead [%]", "time [s]", "within limit [%]")
SETTINGS_HEADER: Final = ("periods x candidates / every", "then", "copies", "reward", "less the shipped one's")


def cells(summary: pd.DataFrame) -> list[tuple[str, ...]]:
    """A row a policy."""
    return [
        (
            str(row["policy"]),
            f"{row['reward']:.1f} [{row['reward_low']:.1f}, {row['reward_high']:.1f}]",
            f"{row['gain']:+.1f} [{row['gain_low']:.1f}, {row['gain_high']:.1f}]",
            f"{100 * row['share']:.0f} [{100 * row['share_low']:.0f}, {100 * row['share_high']:.0f}]",
            f"{row['inspection_time_s']:.0f}",
            f"{100 * row['share_within_limit']:.1f}",
        )
        for row in summary.to_dict("records")
    ]


def setting_cells(summary: pd.DataFrame) -> list[tuple[str, ...]]:
    """A row a setting."""
    return [
        (
            f"{row['periods']} x {row['candidates']} / {row['every']}",
            str(row["rest"]),
            f"{row['copies']:g}",
            f"{row['reward']:.1f}",
            f"{row['gain']:+.1f} [{row['gain_low']:.1f}, {row['gain_high']:.1f}]",
        )
        for row in summary.to_dict("records")
    ]
