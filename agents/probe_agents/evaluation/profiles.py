"""Per-metre profiles in a report: interactive traces, and schedules for download."""

import re
from collections.abc import Collection, Mapping
from typing import Any, Final, NamedTuple
from urllib.parse import quote

import numpy as np
import pandas as pd

from probe_agents.evaluation.statistics import ranking
from probe_agents.records.drawing import policy_colours
from probe_env.schedule import Schedule

Description = Mapping[str, Any]
"""JSON-ready description of a policy."""
MAX_METRES: Final = 60_000
"""Number of points in all traces beyond which metres are averaged, to bound the size of the page."""
MAX_ROWS: Final = 8
"""Rows of a schedule on the first page."""
POINT: Final = ["inserted_length", "feed_speed", "air_supply_rate"]
"""Columns of a point of a schedule."""
FIELDS: Final = {"feed_speed": 1e4, "air_supply_rate": 3.6e4, "radial_rms_m": 1e7}
"""Column of a trace -> factor in the page: whole numbers of 0.1 mm/s, 0.1 m3/h and 0.1 um."""


def traces(
    table: pd.DataFrame, profile: pd.DataFrame, visible: Collection[str], limit_mm: float | None
) -> dict[str, Any]:
    """Feed, air and vibration of every policy in every tube over the inserted length, JSON-ready; the first seed.

    The ``visible`` policies are drawn when the page opens. The limit of the radial rms is None for another measure.
    """
    colours = policy_colours(table["policy"])
    first = profile[["policy", "context", "seed", "training_seed"]].drop_duplicates()
    first = first.sort_values(["training_seed", "seed"], kind="stable").drop_duplicates(["policy", "context"])
    metres = profile.merge(first).dropna(subset=["inserted_length"])
    width = 1 + len(metres) // MAX_METRES
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
    """A schedule file in the page: policy, tube in which it was driven, file name, and content as a data URL."""

    policy: str
    tube: int
    file: str
    address: str


def downloads(table: pd.DataFrame, profile: pd.DataFrame) -> list[Download]:
    """Feed and air of each policy, as driven in the tube with its median reward, as files for ``evaluate``."""
    case, offered = ["policy", "context", "seed", "training_seed"], []
    for policy in ranking(table):
        part = table[table["policy"] == policy].sort_values("reward", kind="stable")
        episode = part.iloc[(len(part) - 1) // 2]
        metres = profile[(profile[case] == episode[case]).all(axis=1)][POINT].dropna().astype(float)
        if len(metres):
            length, feed, air = map(tuple, metres.to_numpy().T)
            schedule = Schedule("inserted_length", "linear", length, feed, air)
            address = f"data:text/csv;charset=utf-8,{quote(schedule.to_csv())}"
            offered.append(Download(policy, int(episode["context"]), f"{file_name(policy)}.csv", address))
    return offered


def file_name(name: str) -> str:
    """A file name for the name of a policy."""
    return re.sub(r"[^\w.-]+", "-", name).strip(".-") or "schedule"


def short_schedule(described: Description, profile: pd.DataFrame) -> tuple[str, pd.DataFrame]:
    """At most ``MAX_ROWS`` rows of feed and air over length [m, m/s, m3/s], and a note on them.

    The first and the last row, then one by one the row that deviates most from linear interpolation; of a schedule over
    length its own rows, of other policies the mean over the insertions in each metre of ``profile``.
    """
    points = inner_policy(described).get("schedule", {})
    if points.get("over") == POINT[0]:
        columns = [points["position"], points["feed_speed"], points["air_supply_rate"]]
        table = pd.DataFrame(dict(zip(POINT, columns, strict=True)))
        table["feed_speed"] = table["feed_speed"].clip(upper=described.get("permitted_feed"))  # of ``SpeedLimited``
        note = "linear between rows" if points["interpolation"] == "linear" else "each row applies until the next"
    else:
        table = profile[POINT].dropna().astype(float).groupby(POINT[0], as_index=False).mean()
        note = "as driven, mean over the insertions"
    if len(table) <= MAX_ROWS:
        return note, table
    length, values = table[POINT[0]].to_numpy(), table[POINT[1:]].to_numpy().T
    scale = np.maximum(np.ptp(values, axis=1), 1e-9)
    rows = [0, len(table) - 1]
    while len(rows) < MAX_ROWS:
        parts = [np.interp(length, length[rows], v[rows]) - v for v in values]
        deviation = np.max(np.abs(parts) / scale[:, None], axis=0)
        if deviation.max() < 1e-9:
            break
        rows = sorted({*rows, int(deviation.argmax())})
    return f"{len(rows)} of {len(table)} rows; {note}", table.iloc[rows]


def inner_policy(description: Description) -> Description:
    """The description of the innermost policy, without its wrappers."""
    inner = next((description[key] for key in ("forth", "of") if isinstance(description.get(key), Mapping)), None)
    return description if inner is None else inner_policy(inner)
