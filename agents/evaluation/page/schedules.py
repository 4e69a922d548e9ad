"""Schedules that a page offers for download, as CSV files that ``probe-env evaluate`` takes."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final
from urllib.parse import quote

import pandas as pd

from agents.evaluation.page.verdict import ranking
from agents.rollouts.statistics import method_and_seed
from probe_env.schedule import Schedule

MOST_POINTS: Final = 2000
"""Of a schedule on a page: a longer one is a log, whose file its owner has."""


@dataclass(frozen=True)
class Download:
    """A file within the page: what it is, its name, and its content as an address."""

    policy: str
    what: str
    file: str
    address: str


def downloads(
    policies: Mapping[str, dict[str, Any]], table: pd.DataFrame, profile: pd.DataFrame
) -> tuple[list[Download], list[str]]:
    """Schedules by rank, and policies of which there is none.

    A fixed schedule is offered as it was given; of a policy that decides by itself, what it fed in the tube in which
    its reward was the median.

    Args:
        policies: their descriptions, by the names before training seeds were gathered; may be empty.
        table: episodes.
        profile: of them.
    """
    by_schedule, none = [], []
    for policy in ranking(table):
        described = next((d for name, d in policies.items() if method_and_seed(name)[0] == policy), {})
        schedules = _given(described) or _fed(policy, table, profile)
        for what, schedule in schedules.items():
            file = f"{_file_name(policy)}{'-' + _file_name(what) if len(schedules) > 1 else ''}.csv"
            address = f"data:text/csv;charset=utf-8,{quote(schedule.to_csv())}"
            by_schedule.append(Download(policy, what, file, address))
        none += [] if schedules else [policy]
    return by_schedule, none


def _file_name(name: str) -> str:
    return re.sub(r"[^\w.-]+", "-", name).strip(".-") or "schedule"


def _given(described: Mapping[str, Any]) -> dict[str, Schedule]:
    """The fixed schedules in a policy's description; what is too long for a page is left out."""
    listed = {f"helix of {d} m": s for d, s in described.get("schedules", {}).items()}
    if "schedule" in described:
        listed = {"as it was given": described["schedule"]}
    schedules = {what: _schedule(given) for what, given in listed.items()}
    return {what: schedule for what, schedule in schedules.items() if len(schedule.position) <= MOST_POINTS}


def _schedule(given: Mapping[str, Any]) -> Schedule:
    position, feed, air = (tuple(given[name]) for name in ("position", "feed_speed", "air_supply_rate"))
    return Schedule(given["over"], given["interpolation"], position, feed, air, given.get("start_length"))


def _fed(policy: str, table: pd.DataFrame, profile: pd.DataFrame) -> dict[str, Schedule]:
    """What a policy fed a metre, in the episode of its median reward."""
    part = table[table["policy"] == policy].sort_values("reward", kind="stable")
    episode = part.iloc[(len(part) - 1) // 2]
    place = ["policy", "context", "seed", "agent"]
    metres = profile[(profile[place] == episode[place]).all(axis=1)]
    metres = metres.dropna(subset=["inserted_length", "feed_speed", "air_supply_rate"]).iloc[:MOST_POINTS]
    if metres.empty:
        return {}
    names = ("inserted_length", "feed_speed", "air_supply_rate")
    length, feed, air = (tuple(metres[name].astype(float)) for name in names)
    return {
        f"as fed in tube {episode['context']}, its median": Schedule("inserted_length", "linear", length, feed, air)
    }
