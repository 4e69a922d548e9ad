"""A schedule as points that are dragged and typed, over the inserted length."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from probe_env.envs.task import TaskConfig
from probe_env.files import FileError
from probe_env.schedule import AIR, CSV_COMMENT, FEED, Interpolation, Schedule

HOUR: Final = 3600.0
LENGTH: Final = "inserted_length_m"
NAMES: Final = (LENGTH, FEED, AIR)
"""Columns of points, in the units of schedule files."""
MISSING: Final = -1.0
"""What a point that was tapped has where nobody has said anything: between its neighbours."""
LEAST_GAP: Final = 0.01
"""Between two points [m]."""
Points = dict[str, list[float]]


def points_of(schedule: Schedule) -> Points:
    """The points of a schedule over inserted length.

    Raises:
        ValueError: it goes by time.
    """
    if schedule.over != "inserted_length":
        raise ValueError("a schedule over time cannot be dragged: lay it over, or run it as it is")
    air = [value * HOUR for value in schedule.air_supply_rate]
    return {
        LENGTH: list(schedule.position),
        FEED: list(schedule.feed_speed),
        AIR: [float(f"{value:.6g}") for value in air],
    }


def tidied(points: Mapping[str, Sequence[float]], config: TaskConfig) -> Points:
    """Points after a drag: in order, within what the feed device and the air supply give; beyond the helix they may be.

    What is ``MISSING`` is filled in straight between the neighbours.
    """
    columns = np.array([[_finite(value) for value in points[name]] for name in NAMES], dtype=float)
    columns = columns[:, np.argsort(columns[0], kind="stable")]
    length = np.maximum(columns[0], 0.0)
    for k in range(1, len(length)):
        length[k] = max(length[k], length[k - 1] + LEAST_GAP)
    ranges = (config.feed_speeds, tuple(HOUR * value for value in config.air_supply_rates))
    tidy = [[round(float(value), 3) for value in length]]
    for values, (low, high), digits in zip(columns[1:], ranges, (4, 2), strict=True):
        known = values != MISSING
        filled = np.interp(length, length[known], values[known]) if known.any() else np.full(len(length), low)
        tidy.append([round(float(value), digits) for value in np.clip(np.where(known, values, filled), low, high)])
    return dict(zip(NAMES, tidy, strict=True))


def schedule_of(points: Mapping[str, Sequence[object]], interpolation: Interpolation = "linear") -> Schedule:
    """The schedule of points, read as its file would be.

    Raises:
        FileError: what the file would be refused for, in one line.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "schedule.csv"
        path.write_text(csv_of(points, interpolation), encoding="utf-8")
        try:
            return Schedule.read(path)
        except FileError as error:
            raise FileError("schedule", error.problem) from None


def csv_of(points: Mapping[str, Sequence[object]], interpolation: Interpolation = "linear") -> str:
    """The text of a schedule file."""
    rows = zip(*(points[name] for name in NAMES), strict=True)
    lines = [f"{CSV_COMMENT} {interpolation}", ",".join(NAMES), *(",".join(map(str, row)) for row in rows)]
    return "\n".join(lines) + "\n"


def with_point(points: Mapping[str, Sequence[float]], config: TaskConfig) -> Points:
    """Points with one more, in the middle of the widest gap."""
    places = [0.0, *points[LENGTH], config.scene.tube.helix_length]
    widest = int(np.diff(places).argmax())
    middle = 0.5 * (places[widest] + places[widest + 1])
    return tidied({LENGTH: [*points[LENGTH], middle], **{n: [*points[n], MISSING] for n in NAMES[1:]}}, config)


def _finite(value: object) -> float:
    """A number of a browser's point, where nothing is one too."""
    number = float(value) if isinstance(value, int | float) else MISSING
    return number if np.isfinite(number) else MISSING
