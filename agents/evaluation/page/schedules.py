"""Schedules that a page offers for download, as CSV files that ``probe-env evaluate`` takes."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final
from urllib.parse import quote

import pandas as pd

from agents.evaluation.page.described import Description, within
from agents.evaluation.page.verdict import ranking
from probe_env.schedule import BACK, Schedule

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
    policies: Mapping[str, Description], table: pd.DataFrame, profile: pd.DataFrame, returns: bool = False
) -> tuple[list[Download], list[str]]:
    """Schedules by rank, and policies of which there is none.

    A fixed schedule is offered as it was given; of a policy that decides by itself, what it fed in the tube in which
    its reward was the median. Where the probe is drawn back, too, the way back is beside it; none is offered of a
    policy that decides on the way back as well, of which no metre is kept.

    Args:
        policies: their descriptions, see ``descriptions``; may be empty.
        table: episodes.
        profile: of them.
        returns: whether the probe is drawn back.
    """
    by_schedule, none = [], []
    for policy in ranking(table):
        described = policies.get(policy, {})
        back = described.get("back")
        known = back is not None or not returns
        schedules = (_given(within(described)) or _fed(policy, table, profile)) if known else {}
        for what, schedule in schedules.items():
            file = f"{_file_name(policy)}{'-' + _file_name(what) if len(schedules) > 1 else ''}.csv"
            address = f"data:text/csv;charset=utf-8,{quote(_csv(schedule, back))}"
            by_schedule.append(Download(policy, what, file, address))
        none += [] if schedules else [policy]
    return by_schedule, none


def _file_name(name: str) -> str:
    return re.sub(r"[^\w.-]+", "-", name).strip(".-") or "schedule"


def _csv(schedule: Schedule, way_back: Description | None) -> str:
    """A schedule's file, with the columns of the way back; one over time has none and comes back as fast as it goes."""
    if way_back is None or schedule.over == "time":
        return schedule.to_csv()
    back = _schedule({"over": schedule.over, "interpolation": schedule.interpolation, **way_back})  # of one file
    position = schedule.position
    if len(back.position) > 1:
        position = tuple(sorted({*position, *back.position}))
    feed, air = (tuple(values.tolist()) for values in schedule.at(position))
    forth = replace(schedule, position=position, feed_speed=feed, air_supply_rate=air)
    comment, header, *rows = forth.to_csv().splitlines()
    drawn = zip(rows, *back.at(position), strict=True)
    lines = (comment, ",".join((header, *BACK.values())), *(f"{row},{u:.6g},{q * 3600.0:.6g}" for row, u, q in drawn))
    return "\n".join(lines) + "\n"


def _given(described: Description) -> dict[str, Schedule]:
    """The fixed schedules in a policy's description; what is too long for a page is left out."""
    listed = {f"helix of {d} m": s for d, s in described.get("schedules", {}).items()}
    if "schedule" in described:
        listed = {"as it was given": described["schedule"]}
    schedules = {what: _schedule(given) for what, given in listed.items()}
    return {what: schedule for what, schedule in schedules.items() if len(schedule.position) <= MOST_POINTS}


def _schedule(given: Description) -> Schedule:
    position, feed, air = (tuple(given[name]) for name in ("position", "feed_speed", "air_supply_rate"))
    return Schedule(given["over"], given["interpolation"], position, feed, air, given.get("start_length"))


def _fed(policy: str, table: pd.DataFrame, profile: pd.DataFrame) -> dict[str, Schedule]:
    """What a policy fed a metre of the way in, in the episode of its median reward."""
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
