"""What feedback can still win, in words: planners beside the policies of every table; the world to train in."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

import pandas as pd

from agents.evaluation import headroom as study
from agents.pages.sources import RESULTS, command, markdown, source, stored_table, ways_to_fail
from agents.policies.catalogue import LAWS
from agents.policies.planning.planner import PLANNERS
from agents.records.models import Figures
from agents.records.reading import read_json
from agents.records.tables import read_episodes
from agents.rollouts.statistics import BEST, failures, grouped, paired_difference, share_of_lead
from agents.worlds import measure as worlds
from agents.worlds.noise import STORED as NOISE

FOLDER = RESULTS / "headroom"
GAIN = ("gain", "gain_low", "gain_high")
STUDENT: Final = "student"
"""The agents that learnt from a law, and the stage that plays them."""
BAR, BLURRED = "tension-scheduled", "planner-blurred"
"""What the gap that a student is to close half of lies between."""
FINELY: Final = RESULTS / "headroom-finely"
GAP = ("policy", "reward", "at `fast`", f"less `{BAR}`", "of the gap [%]", "of that at `fast` [%]")
SHARE = "of the planner's lead [%]"
"""Heading of the column that other tables have of it."""


def headroom() -> str:
    """Planners and policies on the same tubes."""
    summary = stored_table(FOLDER / "headroom.csv", "policy", "tubes", "reward", *GAIN)
    rows = summary.set_index("policy")
    exact, blurred, estimated = (rows.loc[name] for name in PLANNERS)
    lost = int(failures(summary).sum())
    return (
        f"**The planner earns {exact['reward']:.1f}, {exact['gain']:.1f} [{exact['gain_low']:.1f},"
        f" {exact['gain_high']:.1f}] more than `best-schedule`; with states blurred by 10 µm {blurred['reward']:.1f},"
        f" in a tube that it only estimates {estimated['reward']:.1f}.**\n\n"
        f"{markdown(study.HEADER, study.cells(summary))}\n\n"
        f"Means over {exact['tubes']:.0f} held-out tubes, differences paired, 95 % intervals; `ppo` is its training"
        f" seed 0; {lost} insertions {ways_to_fail()}. {source(FOLDER / 'provenance.json')}"
    )


def headroom_finely() -> str:
    """The gap between what a rig can run and a planner, without time-lapse, and in the same tubes with it."""
    table, rows = grouped(read_episodes(FINELY / "episodes.csv")), []
    lapsed = grouped(read_episodes(RESULTS / "control" / "episodes.csv"))
    lapsed = with_student(with_planner(lapsed[lapsed["context"].isin(set(table["context"]))], BLURRED))
    for policy in dict.fromkeys(table["policy"]):
        rewards = (f"{part.loc[part['policy'] == policy, 'reward'].mean():.1f}" for part in (table, lapsed))
        shares = (share_of_lead(part, policy, BLURRED, BAR).text(100.0) for part in (table, lapsed))
        gain = paired_difference(table, policy, BAR, "reward").text()
        rows.append((f"`{policy}`", *rewards, gain, *shares))
    return (
        f"{markdown(GAP, rows)}\n\nMeans over {table['context'].nunique()} held-out tubes, which are balanced over the"
        f" diameters; the gap is from `{BAR}` to `{BLURRED}`; differences paired, 95 % intervals;"
        f" {int(failures(table).sum())} of {len(table)} insertions at `standard` {ways_to_fail()}. What is of `fast` is"
        f" of `probe-env results control student headroom`. {source(FINELY / 'provenance.json')}"
    )


def planner_settings() -> str:
    """What horizon, candidates and terminal value are worth."""
    summary = stored_table(
        FOLDER / "settings.csv", "periods", "candidates", "every", "rest", "copies", "tubes", "reward", *GAIN
    )
    return (
        f"{markdown(study.SETTINGS_HEADER, study.setting_cells(summary))}\n\n"
        f"Means over {int(summary['tubes'].iloc[0])} training tubes, one of each helix diameter, differences paired;"
        " copies are simulated seconds for each second of the insertion."
        f" {source(FOLDER / 'settings-provenance.json')}"
    )


def with_planner(table: pd.DataFrame, planner_name: str = BEST) -> pd.DataFrame:
    """An evaluation's table with a planner's episodes on the same tubes."""
    return _with(table, FOLDER.name, (planner_name,))


def with_law(table: pd.DataFrame) -> pd.DataFrame:
    """An evaluation's table with the episodes of the PLC's laws on the same tubes."""
    return _with(table, "control", LAWS)


def with_student(table: pd.DataFrame) -> pd.DataFrame:
    """An evaluation's table with the episodes of the student's seeds on the same tubes."""
    return _with(table, STUDENT, (STUDENT,))


def _with(table: pd.DataFrame, stage: str, policies: Iterable[str]) -> pd.DataFrame:
    played = grouped(read_episodes(RESULTS / stage / "episodes.csv"))
    chosen = played[played["policy"].isin(list(policies)) & played["context"].isin(set(table["context"]))]
    return pd.concat([table, chosen[[name for name in table.columns if name in chosen]]], ignore_index=True)


def lead_of(table: pd.DataFrame, policy: str) -> str:
    """The share of the planner's lead over ``best-schedule`` that a policy has, in % with its interval.

    Args:
        table: see ``with_planner``.
        policy: in it.
    """
    share = share_of_lead(table, policy)
    return f"{100.0 * share.mean:.0f} [{100.0 * share.low:.0f}, {100.0 * share.high:.0f}]"


def world() -> str:
    """Rewards in the world of the map beside simulated ones."""
    summary = stored_table(
        RESULTS / "world" / "map-world.csv", "policy", "map", "simulated", "error", "error_low", "error_high"
    )
    stored = read_json(NOISE, Figures)
    record, measured = stored.provenance.model_dump(), stored.model_extra or {}
    agreement = measured["agreement"]
    return (
        f"{markdown(worlds.HEADER, worlds.cells(summary))}\n\n"
        f"Mean rewards on {agreement['tubes']:.0f} held-out tubes, differences paired, 95 % intervals; the order of the"
        f" policies agrees with a Kendall's tau of {agreement['tau']:.2f}. The noise was measured on"
        f" {measured['periods']} seconds of {measured['tubes']} training tubes."
        f" Made by `{command(record)}` at commit {record['commit']}."
    )
