"""Feed schedules: feed speed and air supply over time or inserted length, read from CSV or TOML."""

from __future__ import annotations

import csv
import math
import re
import reprlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt

from probe_env.arrays import FloatArray
from probe_env.files import MEBI, FileError, read_text, read_toml

Row = tuple[str, Mapping[str, Any]]
"""Location in a file, and values by column."""
Over = Literal["time", "inserted_length"]
Interpolation = Literal["linear", "steps"]
POSITIONS: Final[dict[str, tuple[Over, float, str]]] = {
    "time_s": ("time", 1e5, "s"),
    "inserted_length_m": ("inserted_length", 1e3, "m"),
}
FEED, AIR = "feed_speed_m_per_s", "air_supply_m3_per_h"
RANGES: Final = {FEED: (0.0, 2.0, "m/s"), AIR: (0.0, 720.0, "m3/h")}
INSERTION: Final = {FEED: FEED, AIR: AIR}
"""Columns of insertion."""
WITHDRAWAL: Final = {FEED: "return_feed_speed_m_per_s", AIR: "return_air_supply_m3_per_h"}
"""Columns of withdrawal, in addition to those of insertion."""
COLUMNS: Final = (*POSITIONS, *RANGES, *WITHDRAWAL.values())
CSV_COMMENT = "# interpolation:"
SEPARATORS: Final = (
    " - semicolons or decimal commas? Commas between columns need decimal points; where semicolons are between columns,"
    " probe-env reads decimal commas, too"
)
WRONG_UNIT, ENOUGH = 0.1, 5.0
"""Ratio of length and fed length of a log below which a unit is wrong, if one of them is more than this [m]."""
STEP: Final = 1e-6
"""Distance of two points at the same place, a step in a linear schedule [m or s]."""
MAX_BYTES, MAX_POINTS, MAX_COLUMNS = 64 * MEBI, 1_000_000, 1000
"""Limits of a file; enough for three hours of a log at 100 Hz."""


@dataclass(frozen=True)
class Schedule:
    """Feed speed [m/s] and air supply [m3/s] over time [s] or inserted length [m]; constant beyond its ends.

    The interpolation between points is "linear", or "steps": constant up to the next point.
    """

    over: Over
    interpolation: Interpolation
    position: tuple[float, ...]
    feed_speed: tuple[float, ...]
    air_supply_rate: tuple[float, ...]
    start_length: float | None = None
    """Inserted length at the first point of a schedule over time [m]; None: any."""

    def at(self, position: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Feed speed and air supply at times or lengths ``position`` of any shape, SI units."""
        points = np.asarray(position, dtype=float)
        if self.interpolation == "linear":
            feed, air = (np.interp(points, self.position, values) for values in (self.feed_speed, self.air_supply_rate))
            return np.asarray(feed), np.asarray(air)
        # tolerance for lengths in single precision
        k = np.clip(np.searchsorted(self.position, points + 1e-5, side="right") - 1, 0, None)
        return np.asarray(self.feed_speed)[k], np.asarray(self.air_supply_rate)[k]

    def fed_length(self, time: npt.ArrayLike) -> FloatArray:
        """Length [m] fed from the first point of a schedule over time to times of any shape [s]; < 0 before it."""
        times, (position, feed, lengths) = np.asarray(time, dtype=float), self._integral
        k = np.clip(np.searchsorted(position, times, side="right") - 1, 0, None)
        mean = feed[k] if self.interpolation == "steps" else 0.5 * (feed[k] + np.interp(times, position, feed))
        return np.asarray(lengths[k] + mean * (times - position[k]))

    def time_at(self, inserted: FloatArray) -> FloatArray:
        """Times (N,) [s] at which a schedule over time reaches lengths (N,) [m]; 0 without ``start_length``."""
        if self.start_length is None:
            return np.zeros(len(inserted))
        position, _, fed = self._integral
        lengths = self.start_length + fed
        k = np.searchsorted(lengths, inserted - 1e-5)  # float32 lengths
        before, after = np.clip(k - 1, 0, None), np.clip(k, None, len(position) - 1)
        fraction = (inserted - lengths[before]) / np.maximum(lengths[after] - lengths[before], 1e-9)
        return np.asarray(position[before] + np.clip(fraction, 0.0, 1.0) * (position[after] - position[before]))

    @cached_property
    def _integral(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Times, feed speeds and lengths fed up to these times, (n,) each."""
        position, feed = np.array(self.position), np.array(self.feed_speed)
        means = feed[:-1] if self.interpolation == "steps" else 0.5 * (feed[:-1] + feed[1:])
        return position, feed, np.concatenate([[0.0], np.cumsum(means * np.diff(position))])

    @classmethod
    def read(cls, path: str | Path) -> Schedule:
        """Read a schedule or a measured log.

        A CSV file has the columns ``time_s`` or ``inserted_length_m``, ``feed_speed_m_per_s`` and
        ``air_supply_m3_per_h``; other columns are ignored, so that logs can be replayed. A file with both time and
        length is a schedule over time that starts at the first length. A schedule over length may have
        ``return_feed_speed_m_per_s`` and ``return_air_supply_m3_per_h`` for withdrawal. The first line may be
        ``# interpolation: steps``; else it is linear, and two rows at the same place are a step. A TOML file has
        ``interpolation`` and ``points``, a list of tables with these keys.

        Raises:
            FileNotFoundError: no such file.
            FileError: not a valid schedule; names file, line, column, value and accepted range.
        """
        return schedule_of_rows(Path(path), *schedule_rows(Path(path)))

    @classmethod
    def read_withdrawal(cls, path: str | Path) -> Schedule | None:
        """Read the withdrawal of a schedule over inserted length; None if the file has no column of ``WITHDRAWAL``."""
        return withdrawal_of_rows(Path(path), *schedule_rows(Path(path)))

    def to_csv(self) -> str:
        """The schedule as CSV text for ``read``."""
        columns = {next(name for name, (over, _, _) in POSITIONS.items() if over == self.over): self.position}
        if self.start_length is not None:
            columns["inserted_length_m"] = tuple((self.start_length + self.fed_length(self.position)).tolist())
        lines = [f"{CSV_COMMENT} {self.interpolation}", ",".join((*columns, FEED, AIR))]
        for *points, feed, air in zip(*columns.values(), self.feed_speed, self.air_supply_rate, strict=True):
            lines.append(",".join((*(f"{point:g}" for point in points), f"{feed:.6g}", f"{air * 3600.0:.6g}")))
        return "\n".join(lines) + "\n"


def schedule_rows(path: Path) -> tuple[str, list[Row]]:
    """Interpolation and rows of a file, unchecked but for the columns."""
    if path.suffix not in (".csv", ".toml"):
        raise FileError(path, "a schedule must be a .csv or a .toml file")
    return _from_csv(path) if path.suffix == ".csv" else _from_toml(path)


def schedule_of_rows(path: Path, interpolation: str, rows: Sequence[Row]) -> Schedule:
    """Schedule of the rows of a file (location and values by column); raises FileError as ``Schedule.read``."""
    if interpolation not in ("linear", "steps"):
        raise FileError(path, f"interpolation = {interpolation[:80]!r} is not one of linear, steps")
    return _validated(path, interpolation, rows)  # type: ignore[arg-type]


def withdrawal_of_rows(path: Path, interpolation: str, rows: Sequence[Row]) -> Schedule | None:
    """Schedule of withdrawal of the rows of a file, or None; raises FileError as ``Schedule.read_withdrawal``."""
    insertion = schedule_of_rows(path, interpolation, rows)
    found = [name for name in WITHDRAWAL.values() if any(name in row for _, row in rows)]
    if not found:
        return None
    if len(found) < len(WITHDRAWAL) or insertion.over == "time":
        raise FileError(path, f"{' and '.join(WITHDRAWAL.values())} go together, and need inserted_length_m")
    return _validated(path, insertion.interpolation, rows, WITHDRAWAL)


def _from_csv(path: Path) -> tuple[str, list[Row]]:
    lines = re.split("\r\n|\r|\n", read_text(path, MAX_BYTES))
    interpolation, first = "linear", 0
    if lines[0].startswith("#"):
        if not lines[0].startswith(CSV_COMMENT):
            raise FileError(path, f"line 1: a comment must be {CSV_COMMENT!r} and linear or steps")
        interpolation, first = lines[0][len(CSV_COMMENT) :].strip(), 1
    table = csv.reader(lines[first:], strict=True)
    named: list[Row] = []
    header: list[str] = []
    try:
        for row in table:
            line = first + table.line_num
            if not any(map(str.strip, row)):
                continue
            if header and not any(map(str.strip, row[len(header) :])):  # commas behind the last value
                del row[len(header) :]
            if not header:
                header = [name.strip() for name in row]
                _check_header(path, line, header)
            elif len(row) != len(header):
                hint = SEPARATORS if len(row) > len(header) or any(";" in cell for cell in row) else ""
                raise FileError(path, f"line {line} has {len(row)} values for {len(header)} columns{hint}")
            else:
                used = ((name, value) for name, value in zip(header, row, strict=True) if name in COLUMNS)
                named.append((f"line {line}", dict(used)))
            if len(named) > MAX_POINTS:
                raise FileError(path, f"line {line}: more than the {MAX_POINTS} points that a schedule may have")
    except csv.Error as error:
        raise FileError(path, f"line {first + table.line_num}: not CSV: {error}") from error
    if not header:
        raise FileError(path, "empty: a header and at least one row are needed")
    return interpolation, named or [("header", dict.fromkeys(header))]


def _check_header(path: Path, line: int, header: list[str]) -> None:
    if len(header) > MAX_COLUMNS:
        raise FileError(path, f"line {line}: {len(header)} columns are more than {MAX_COLUMNS}")
    for name in header:
        if name and header.count(name) > 1:
            raise FileError(path, f"column {name!r} appears {header.count(name)} times in the header")
    _check_columns(path, header)


def _from_toml(path: Path) -> tuple[str, list[Row]]:
    data = read_toml(path)
    unknown = sorted(set(data) - {"interpolation", "points"})
    if unknown:
        raise FileError(path, f"unknown key {unknown[0]!r}; accepted are interpolation, points")
    points = data.get("points")
    if not isinstance(points, list) or not points or not all(isinstance(point, dict) for point in points):
        raise FileError(path, "points must be a list of tables, at least one")
    _check_columns(path, points[0])
    return str(data.get("interpolation", "linear")), [(f"point {k}", point) for k, point in enumerate(points, start=1)]


def _check_columns(path: Path, columns: Iterable[str]) -> None:
    found = set(columns)
    listed = ", ".join(sorted(found)) or "none"
    if not found & set(POSITIONS):
        raise FileError(
            path,
            f"one of the columns {', '.join(POSITIONS)} is needed; found: {listed}"
            + (SEPARATORS if ";" in listed else ""),
        )
    for name in (FEED, AIR):
        if name not in found:
            raise FileError(path, f"the column {name} is missing; found: {listed}")


def _validated(
    path: Path,
    interpolation: Interpolation,
    rows: Sequence[Row],
    columns: Mapping[str, str] = INSERTION,
) -> Schedule:
    if rows[0][0] == "header":
        raise FileError(path, "no rows: at least one is needed")
    column = next(name for name in POSITIONS if name in rows[0][1])
    (over, maximum, unit), length = POSITIONS[column], "inserted_length_m"
    ranges = {column: (0.0, maximum, unit)} | {columns[name]: range_ for name, range_ in RANGES.items()}
    position, feed, air = (
        tuple(_number(path, location, name, row.get(name), range_) for location, row in rows)
        for name, range_ in ranges.items()
    )
    for k, ((location, _), before, now) in enumerate(zip(rows[1:], position[:-1], position[1:], strict=True), start=1):
        if now == before and interpolation == "linear" and position[max(k - 2, 0)] < before:
            position = (*position[:k], now + STEP, *position[k + 1 :])
        elif now <= before:
            hint = "; two rows at the same place are a step" * (now == before and interpolation == "linear")
            raise FileError(path, f"{location}, {column} = {now!r} must be greater than {before!r} before it{hint}")
    schedule = Schedule(over, interpolation, position, feed, tuple(value / 3600.0 for value in air))
    if over == "inserted_length" or length not in rows[0][1]:
        return schedule
    first, accepted = rows[0][1][length], (0.0, *POSITIONS[length][1:])  # a log; its last length may be missing
    ends = ((place, row.get(length) or first) for place, row in (rows[0], rows[-1]))
    start, end = (_number(path, place, length, value, accepted) for place, value in ends)
    fed, moved = float(schedule.fed_length(position[-1])), end - start
    if 0.0 < min(fed, moved) < WRONG_UNIT * max(fed, moved) and max(fed, moved) > ENOUGH:
        problem = f"{length} rises by {moved:.4g} m, and speed times time is {fed:.4g} m"
        raise FileError(path, f"{problem}: is the unit of time, length or speed right?")
    return replace(schedule, start_length=start)


def _number(path: Path, location: str, name: str, value: Any, accepted: tuple[float, float, str]) -> float:
    try:
        if value is None or isinstance(value, bool):
            raise ValueError
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        raise FileError(path, f"{location}, {name} = {reprlib.repr(value)} is not a number") from None
    if not math.isfinite(number):
        raise FileError(path, f"{location}, {name} = {value!r} is not finite")
    low, high, unit = accepted
    if not low <= number <= high:
        raise FileError(
            path, f"{location}, {name} = {number!r} is outside the accepted range {low:g} to {high:g} {unit}"
        )
    return number
