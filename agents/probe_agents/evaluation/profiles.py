"""Per-metre profiles in a report: interactive traces, and schedules for download."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Any, Final, NamedTuple
from urllib.parse import quote

import numpy as np
import pandas as pd

from probe_agents.evaluation.statistics import ranking
from probe_agents.records.drawing import policy_colours
from probe_env.schedule import WITHDRAWAL, Schedule

Description = Mapping[str, Any]
"""JSON-ready description of a policy."""
MOST_METRES: Final = 60_000
"""Number of points in all traces beyond which metres are averaged, to bound the size of the page."""
MOST_POINTS: Final = 2000
"""Points of a schedule that is offered for download."""
MOST_ROWS: Final = 8
"""Rows of a schedule on the first page."""
FIELDS: Final = {"feed_speed": 1e4, "air_supply_rate": 3.6e4, "radial_rms_m": 1e7}
"""Column of a trace -> factor in the page: whole numbers of 0.1 mm/s, 0.1 m3/h and 0.1 um."""


def traces(
    table: pd.DataFrame, profile: pd.DataFrame, visible: Collection[str], limit_mm: float | None
) -> dict[str, Any]:
    """Feed, air and vibration of every policy in every tube over the inserted length, JSON-ready; the first seed.

    Args:
        table: episodes.
        profile: a row for each metre of these episodes.
        visible: policies whose traces are visible when the page opens.
        limit_mm: limit of the radial rms [mm]; None: the limit is of another measure.
    """
    colours = policy_colours(table["policy"])
    first = profile[["policy", "context", "seed", "training_seed"]].drop_duplicates()
    first = first.sort_values(["training_seed", "seed"], kind="stable").drop_duplicates(["policy", "context"])
    metres = profile.merge(first).dropna(subset=["inserted_length"])
    width = 1 + len(metres) // MOST_METRES
    binned = metres.assign(
        metre=(metres["inserted_length"] // width) * width + 0.5 * width, radial_rms_m=metres["radial_rms_m"] ** 2
    )
    means = binned.groupby(["policy", "context", "metre"], as_index=False)[list(FIELDS)].mean()
    means["radial_rms_m"] **= 0.5
    grid = sorted(map(float, binned["metre"].unique()))
    columns = {
        case: _scaled(rows.set_index("metre").reindex(grid)) for case, rows in means.groupby(["policy", "context"])
    }
    tubes: list[dict[Any, Any]] = table.drop_duplicates("context").sort_values("context").to_dict("records")
    worst = table.loc[table.groupby("policy")["reward"].idxmin()].set_index("policy")["context"].to_dict()
    label = "helix {helix_diameter:g} m, friction {friction:.3f}"
    return {
        "metres": grid,
        "limit": limit_mm,
        "tubes": [
            {"number": tube["context"], "text": label.format(**tube) if tube["helix_diameter"] > 0.0 else ""}
            for tube in tubes
        ],
        "policies": [
            {
                "name": policy,
                "colour": colours[policy],
                "shown": policy in visible,
                "worst": worst[policy],
                "tubes": [columns.get((policy, tube["context"]), []) for tube in tubes],
            }
            for policy in ranking(table)
        ],
    }


def _scaled(rows: pd.DataFrame) -> list[list[int | None]]:
    scaled = (rows[name].to_numpy(dtype=float) * factor for name, factor in FIELDS.items())
    return [[round(v) if np.isfinite(v) else None for v in values.tolist()] for values in scaled]


class Download(NamedTuple):
    """A file in the page: policy, note, file name, and its content as a data URL."""

    policy: str
    what: str
    file: str
    address: str


def downloads(
    policies: Mapping[str, Description], table: pd.DataFrame, profile: pd.DataFrame, returns: bool = False
) -> tuple[list[Download], list[str]]:
    """Schedule files that ``probe-env evaluate`` takes, by rank, and the policies that have none.

    A fixed schedule is offered unchanged; for other policies, the feed and air in the tube with the median reward. With
    both passes the file has columns for the withdrawal; policies that control the withdrawal have no schedule.

    Args:
        policies: their descriptions, see ``descriptions``.
        table: episodes.
        profile: a row for each metre of these episodes.
        returns: whether the task has both passes.
    """
    offered: list[Download] = []
    none: list[str] = []
    for policy in ranking(table):
        described = policies.get(policy, {})
        back = described.get("back")
        fixed = back is not None or not returns
        schedules = (_fixed_schedules(described) or _median_schedule(policy, table, profile)) if fixed else {}
        for what, schedule in schedules.items():
            file = f"{file_name(policy)}{'-' + file_name(what) if len(schedules) > 1 else ''}.csv"
            address = f"data:text/csv;charset=utf-8,{quote(_csv(schedule, back))}"
            offered.append(Download(policy, what, file, address))
        none += [] if schedules else [policy]
    return offered, none


def file_name(name: str) -> str:
    """A file name for the name of a policy."""
    return re.sub(r"[^\w.-]+", "-", name).strip(".-") or "schedule"


def _csv(schedule: Schedule, withdrawal: Description | None) -> str:
    """A schedule's file, with columns of the withdrawal unless the schedule is over time."""
    if withdrawal is None or schedule.over == "time":
        return schedule.to_csv()
    back = _schedule({"over": schedule.over, "interpolation": schedule.interpolation, **withdrawal})
    position = schedule.position
    if len(back.position) > 1:
        position = tuple(sorted({*position, *back.position}))
    feed, air = (tuple(values.tolist()) for values in schedule.at(position))
    forth = replace(schedule, position=position, feed_speed=feed, air_supply_rate=air)
    comment, header, *rows = forth.to_csv().splitlines()
    table = zip(rows, *back.at(position), strict=True)
    lines = (
        comment,
        ",".join((header, *WITHDRAWAL.values())),
        *(f"{row},{u:.6g},{q * 3600.0:.6g}" for row, u, q in table),
    )
    return "\n".join(lines) + "\n"


def _fixed_schedules(described: Description) -> dict[str, Schedule]:
    """Name -> schedule of a policy that follows schedules; empty for others."""
    permitted, described = described.get("permitted_feed", math.inf), inner_policy(described)  # of ``SpeedLimited``
    listed = {f"helix of {d} m": s for d, s in described.get("schedules", {}).items()}
    if "schedule" in described:
        listed = {"unchanged": described["schedule"]}
    schedules = {what: _schedule(points) for what, points in listed.items()}
    return {
        what: replace(schedule, feed_speed=tuple(min(feed, permitted) for feed in schedule.feed_speed))
        for what, schedule in schedules.items()
        if len(schedule.position) <= MOST_POINTS
    }


def short_schedule(described: Description, profile: pd.DataFrame) -> tuple[str, pd.DataFrame]:
    """At most ``MOST_ROWS`` rows of a policy's schedule [m, m/s, m3/s], and a note on them.

    Of a schedule over length its rows, if there are more those that describe it best; of other policies the mean over
    the insertions of what was driven.

    Args:
        described: description of the policy.
        profile: a row for each metre of its episodes.
    """
    columns = ["inserted_length", "feed_speed", "air_supply_rate"]
    schedules = list(_fixed_schedules(described).values())
    if len(schedules) == 1 and schedules[0].over == columns[0]:
        note = "linear between rows" if schedules[0].interpolation == "linear" else "each row applies until the next"
        rows = pd.DataFrame({name: getattr(schedules[0], name) for name in ("position", *columns[1:])})
        if len(rows) > MOST_ROWS:
            best = _best_rows(schedules[0], MOST_ROWS)
            note, rows = f"{len(best)} of {len(rows)} rows; {note}", rows.iloc[best]
        return note, rows.set_axis(columns, axis=1)
    means = profile[columns].dropna().astype(float).groupby(columns[0], as_index=False).mean()
    metres = np.unique(np.linspace(0, max(len(means) - 1, 0), MOST_ROWS).round().astype(int))
    return "as driven, mean over the insertions", means.iloc[metres[: len(means)]]


def _best_rows(schedule: Schedule, most: int) -> list[int]:
    """The first and the last row, and one after the other the row from which the schedule of these deviates most."""
    values = np.array([schedule.feed_speed, schedule.air_supply_rate])
    scale = np.maximum(np.ptp(values, axis=1, keepdims=True), 1e-9)
    rows = [0, len(schedule.position) - 1]
    for _ in range(most - len(rows)):
        position, feed, air = (
            tuple(column[k] for k in rows)
            for column in (schedule.position, schedule.feed_speed, schedule.air_supply_rate)
        )
        thinned = replace(schedule, position=position, feed_speed=feed, air_supply_rate=air)
        deviation = np.abs(np.array(thinned.at(schedule.position)) - values) / scale
        rows = sorted({*rows, int(deviation.max(axis=0).argmax())})
    return rows


def _schedule(points: Description) -> Schedule:
    position, feed, air = (tuple(points[name]) for name in ("position", "feed_speed", "air_supply_rate"))
    return Schedule(points["over"], points["interpolation"], position, feed, air, points.get("start_length"))


def _median_schedule(policy: str, table: pd.DataFrame, profile: pd.DataFrame) -> dict[str, Schedule]:
    part = table[table["policy"] == policy].sort_values("reward", kind="stable")
    episode = part.iloc[(len(part) - 1) // 2]
    case, names = ["policy", "context", "seed", "training_seed"], ["inserted_length", "feed_speed", "air_supply_rate"]
    metres = profile[(profile[case] == episode[case]).all(axis=1)].dropna(subset=names).iloc[:MOST_POINTS]
    if metres.empty:
        return {}
    length, feed, air = (tuple(metres[name].astype(float)) for name in names)
    schedule = Schedule("inserted_length", "linear", length, feed, air)
    return {f"as run in tube {episode['context']} (median reward)": schedule}


def inner_policy(description: Description) -> Description:
    """The description of the innermost policy, without its wrappers."""
    inner = next((description[key] for key in ("forth", "of") if isinstance(description.get(key), Mapping)), None)
    return description if inner is None else inner_policy(inner)
