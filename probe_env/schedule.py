"""Feed schedules: feed speed and air supply over time or over inserted length, read from CSV or TOML."""

from __future__ import annotations

import csv
import math
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt

from probe_env.chain import FloatArray

Over = Literal["time", "inserted_length"]
Interpolation = Literal["linear", "steps"]
POSITIONS: Final[dict[str, tuple[Over, float, str]]] = {
    "time_s": ("time", 1e5, "s"),
    "inserted_length_m": ("inserted_length", 1e3, "m"),
}
FEED, AIR = "feed_speed_m_per_s", "air_supply_m3_per_h"
RANGES: Final = {FEED: (0.0, 2.0, "m/s"), AIR: (0.0, 720.0, "m3/h")}
CSV_COMMENT = "# interpolation:"


@dataclass(frozen=True)
class Schedule:
    """Feed speed [m/s] and air supply [m3/s] over time [s] or inserted length [m]; constant beyond its ends.

    With "linear" values go straight from point to point, with "steps" each holds until the next point.
    """

    over: Over
    interpolation: Interpolation
    position: tuple[float, ...]
    feed_speed: tuple[float, ...]
    air_supply_rate: tuple[float, ...]

    def at(self, position: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Feed speed and air supply at positions of any shape, SI units."""
        where = np.asarray(position, dtype=float)
        if self.interpolation == "linear":
            feed, air = (np.interp(where, self.position, values) for values in (self.feed_speed, self.air_supply_rate))
            return np.asarray(feed), np.asarray(air)
        # a float32 length just short of a point counts as on it
        k = np.clip(np.searchsorted(self.position, where + 1e-5, side="right") - 1, 0, None)
        return np.asarray(self.feed_speed)[k], np.asarray(self.air_supply_rate)[k]

    @classmethod
    def read(cls, path: str | Path) -> Schedule:
        """Read a schedule or a measured log.

        A CSV file has the columns ``time_s`` or ``inserted_length_m``, ``feed_speed_m_per_s`` and
        ``air_supply_m3_per_h`` (others are ignored, so a log can be replayed) and may begin with the line
        ``# interpolation: steps``. A TOML file has ``interpolation`` and ``points``, a list of tables with these keys.

        Raises:
            FileNotFoundError: no such file.
            ValueError: not a valid schedule; names file, row, column, value and accepted range.
        """
        path = Path(path)
        if path.suffix not in (".csv", ".toml"):
            raise ValueError(f"{path}: a schedule must be a .csv or a .toml file")
        try:
            text = path.read_bytes().decode("utf-8-sig")
        except UnicodeDecodeError as error:
            raise ValueError(f"{path}: not a text file in UTF-8: {error}") from error
        interpolation, rows = _from_csv(path, text) if path.suffix == ".csv" else _from_toml(path, text)
        if interpolation not in ("linear", "steps"):
            raise ValueError(f"{path}: interpolation = {interpolation!r} is not one of linear, steps")
        return _validated(path, interpolation, rows)  # type: ignore[arg-type]

    def to_csv(self) -> str:
        """The schedule as CSV text that ``read`` takes."""
        column = next(name for name, (over, _, _) in POSITIONS.items() if over == self.over)
        lines = [f"{CSV_COMMENT} {self.interpolation}", f"{column},{FEED},{AIR}"]
        rows = zip(self.position, self.feed_speed, self.air_supply_rate, strict=True)
        lines += [f"{position:g},{feed:.6g},{air * 3600.0:.6g}" for position, feed, air in rows]
        return "\n".join(lines) + "\n"


def _from_csv(path: Path, text: str) -> tuple[str, list[tuple[str, Mapping[str, Any]]]]:
    lines = text.splitlines()
    interpolation, first = "linear", 0
    if lines and lines[0].startswith("#"):
        if not lines[0].startswith(CSV_COMMENT):
            raise ValueError(f"{path}: line 1: a comment must be {CSV_COMMENT!r} and linear or steps")
        interpolation, first = lines[0][len(CSV_COMMENT) :].strip(), 1
    table = csv.reader(lines[first:], strict=True)
    try:
        rows = list(table)
    except csv.Error as error:
        raise ValueError(f"{path}: line {first + table.line_num}: not CSV: {error}") from error
    if not rows:
        raise ValueError(f"{path}: empty: a header and at least one row are needed")
    header = [name.strip() for name in rows[0]]
    for name in header:
        if header.count(name) > 1:
            raise ValueError(f"{path}: column {name!r} appears {header.count(name)} times in the header")
    named: list[tuple[str, Mapping[str, Any]]] = []
    for line, row in enumerate(rows[1:], start=first + 2):
        if not row:
            continue
        if len(row) != len(header):
            raise ValueError(f"{path}: line {line} has {len(row)} values for {len(header)} columns")
        named.append((f"line {line}", dict(zip(header, row, strict=True))))
    return interpolation, named or [("header", dict.fromkeys(header))]


def _from_toml(path: Path, text: str) -> tuple[str, list[tuple[str, Mapping[str, Any]]]]:
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"{path}: not a TOML file: {error}") from error
    unknown = set(data) - {"interpolation", "points"}
    if unknown:
        raise ValueError(f"{path}: unknown key {sorted(unknown)[0]!r}; accepted are interpolation, points")
    points = data.get("points")
    if not isinstance(points, list) or not points or not all(isinstance(point, dict) for point in points):
        raise ValueError(f"{path}: points must be a list of tables, at least one")
    return str(data.get("interpolation", "linear")), [(f"point {k}", point) for k, point in enumerate(points, start=1)]


def _validated(path: Path, interpolation: Interpolation, rows: Iterable[tuple[str, Mapping[str, Any]]]) -> Schedule:
    rows = list(rows)
    columns = set(rows[0][1])
    positions = [name for name in POSITIONS if name in columns]
    if len(positions) != 1:
        found = ", ".join(sorted(columns)) or "none"
        raise ValueError(f"{path}: exactly one of the columns {', '.join(POSITIONS)} is needed; found: {found}")
    for name in (FEED, AIR):
        if name not in columns:
            raise ValueError(f"{path}: the column {name} is missing; found: {', '.join(sorted(columns))}")
    if rows[0][0] == "header":
        raise ValueError(f"{path}: no rows: at least one is needed")
    column = positions[0]
    over, most, unit = POSITIONS[column]
    values: dict[str, list[float]] = {column: [], FEED: [], AIR: []}
    for place, row in rows:
        for name in values:
            low, high, its_unit = RANGES.get(name, (0.0, most, unit))
            value = _number(path, place, name, row.get(name))
            if not low <= value <= high:
                raise ValueError(
                    f"{path}: {place}, {name} = {value!r} is outside the accepted range {low:g} to {high:g} {its_unit}"
                )
            values[name].append(value)
        if len(values[column]) > 1 and values[column][-1] <= values[column][-2]:
            before, now = values[column][-2:]
            raise ValueError(f"{path}: {place}, {column} = {now!r} must be greater than {before!r} before it")
    air = tuple(value / 3600.0 for value in values[AIR])
    return Schedule(over, interpolation, tuple(values[column]), tuple(values[FEED]), air)


def _number(path: Path, place: str, name: str, given: Any) -> float:
    try:
        if given is None or isinstance(given, bool):
            raise ValueError
        value = float(given)
    except (TypeError, ValueError):
        raise ValueError(f"{path}: {place}, {name} = {given!r} is not a number") from None
    if not math.isfinite(value):
        raise ValueError(f"{path}: {place}, {name} = {given!r} is not finite")
    return value
