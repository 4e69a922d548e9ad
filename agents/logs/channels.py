"""Columns of a table as the quantities that they are, in SI units: chosen by heads, converted, checked for range."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from agents.logs.decimals import decimal_sign, numbers, trimmed
from agents.logs.quantities import DATE, QUANTITIES, Given, Quantity, known_as, plain, split_head
from agents.logs.tables.heads import HEADS_SHOWN
from agents.logs.tables.table import Table
from agents.logs.times import dated, is_written_out, seconds_of
from agents.logs.units import factor
from probe_env.arrays import FloatArray
from probe_env.files import FileError

NOISE: Final[Mapping[str, float]] = {"air_supply": 1.0 / 3600.0, "inserted_length": 0.02}
"""What a meter may show below zero, by its own noise [SI]; it is taken for zero."""


@dataclass(frozen=True)
class Channels:
    """A log as it was recorded, in SI units.

    Attributes:
        table: where it was read.
        time: (rows,) seconds of any origin; NaN where there is none.
        values: quantity -> (rows,), NaN where there is none.
        places: quantity -> number of its column.
    """

    table: Table
    time: FloatArray
    values: Mapping[str, FloatArray]
    places: Mapping[str, int]


def channels_of(table: Table, given: Sequence[Given], decimal: str, air: float | None) -> Channels:
    """The quantities of a table.

    Args:
        table: texts.
        given: what ``--columns`` says.
        decimal: decimal sign; empty: as the file tells.
        air: air supply [m3/s] of a log that does not have it.

    Raises:
        FileError: a column is missing, is there twice or has no unit; a cell is not what it should be.
    """
    places, units = _chosen(table, given)
    date = places.pop(DATE, None)
    for name in ("time", "feed_speed", "air_supply"):
        alternatives = ("feed_speed", "inserted_length") if name == "feed_speed" else (name,)
        if not any(other in places for other in alternatives) and not (name == "air_supply" and air is not None):
            raise _lacks(table, " or ".join(alternatives))
    cells = {k: trimmed(table.columns[k]) for k in places.values()}
    if date is not None:
        k = places["time"]
        cells[k] = dated(table, date, trimmed(table.columns[date]), cells[k])
    written = is_written_out(cells[places["time"]])
    counted = [name for name in places if not (written and name == "time")]
    factors = {name: _factor(table, QUANTITIES[name], places[name], units) for name in counted}
    sign = decimal or decimal_sign(table, {places[name]: cells[places[name]] for name in counted})

    def values(name: str) -> FloatArray:
        k = places[name]
        if name not in factors:
            return seconds_of(table, k, cells[k])
        return np.asarray(numbers(table, k, cells[k], sign) * factors[name])

    quantities = {name: _in_range(table, k, QUANTITIES[name], values(name)) for name, k in places.items()}
    if "air_supply" not in quantities and air is not None:
        quantities["air_supply"] = np.full(len(table.lines), air)
    return Channels(table, quantities.pop("time"), quantities, places)


def _chosen(table: Table, given: Sequence[Given]) -> tuple[dict[str, int], dict[str, str]]:
    """Number of the column of every quantity, and the units that ``--columns`` gives."""
    places: dict[str, int] = {}
    for other in given:
        matches = [k for k, head in enumerate(table.heads) if head.strip() == other.head]
        matches = matches or [k for k, head in enumerate(table.heads) if head and other.means(head)]
        if len(matches) != 1:
            often = "is not there" if not matches else f"is there {len(matches)} times: rename one in the file"
            raise FileError(table.path, f"column {other.head[:60]!r} of --columns {often}; found: {_heads(table)}")
        if matches[0] in places.values():
            raise FileError(table.path, f"column {other.head[:60]!r} is named twice in --columns: it is one quantity")
        places[other.quantity] = matches[0]
    named = set(places.values())
    for k, head in enumerate(table.heads):
        name = known_as(head)
        if k in named or name is None or name in {other.quantity for other in given}:
            continue
        if name in places:
            raise FileError(
                table.path,
                f"columns {table.heads[places[name]]!r} and {head!r} are both {name}: say which it is,"
                f" --columns 'HEAD={name}'",
            )
        places[name] = k
    return places, {other.quantity: other.unit for other in given if other.unit}


def _factor(table: Table, quantity: Quantity, k: int, units: Mapping[str, str]) -> float:
    head = table.heads[k]
    unit = units.get(quantity.name) or split_head(head)[1] or table.units[k]
    if not unit and quantity.name == "time":
        unit = quantity.unit
    if not unit:
        raise FileError(
            table.path, f"column {head!r} has no unit: give it, --columns '{plain(head)}={quantity.name}[UNIT]'"
        )
    try:
        return factor(unit, quantity)
    except ValueError as error:
        raise FileError(table.path, f"column {head!r}: {error}") from error


def _in_range(table: Table, k: int, quantity: Quantity, values: FloatArray) -> FloatArray:
    low = quantity.low - NOISE.get(quantity.name, 0.0)
    wrong = (values < low) | (values > quantity.high)
    if wrong.any():
        row = int(wrong.argmax())
        raise table.error(
            row,
            f"{quantity.name} = {values[row] / quantity.scale:.6g} {quantity.unit} is outside the accepted range"
            f" {quantity.low / quantity.scale:g} to {quantity.high / quantity.scale:g} {quantity.unit} - is the unit"
            " right?",
            k,
        )
    return np.asarray(np.where(values < quantity.low, quantity.low, values))


def _lacks(table: Table, names: str) -> FileError:
    hint = "; or give a constant, --air-supply M3_PER_H" if names == "air_supply" else ""
    return FileError(
        table.path,
        f"no column is known as {names}; found: {_heads(table)} - name it: --columns 'HEAD={names.split()[0]}'{hint}",
    )


def _heads(table: Table) -> str:
    shown = ", ".join(repr(head[:60]) for head in table.heads[:HEADS_SHOWN])
    return shown + (" ..." if len(table.heads) > HEADS_SHOWN else "")
