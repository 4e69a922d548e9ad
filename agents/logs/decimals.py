"""Numbers as people write them: which sign is the decimal one is decided by the whole file, and never guessed."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from agents.logs.tables.table import Table
from probe_env.arrays import FloatArray

MISSING: Final = r"(?i)^(?:|-+|n/?a|#n/?a|nan|null|none|nil|\?|#nv|#value!|#wert!|#div/0!)$"
PROOF_WITHIN: Final = 1000
"""Rows that are looked at before all are."""
_SPACES: Final = "[ '’\u00a0\u2009\u202f]"
_POWER: Final = r"(?:[eE][+-]?\d+)"


def trimmed(cells: Any) -> Any:
    """Texts without white space around them, a no-break one included."""
    return pc.utf8_trim(cells, " \t\u00a0\u2009\u202f\ufeff")


def is_missing(cells: Any) -> Any:
    """Which of the trimmed texts say that there is no value."""
    return pc.match_substring_regex(cells, MISSING)


def decimal_sign(table: Table, columns: Mapping[int, Any]) -> str:
    """The decimal sign of a file by all its numbers.

    Args:
        table: where they are.
        columns: number of the column -> its trimmed texts.

    Raises:
        FileError: some numbers have a point and others a comma, or each might be one or the other.
    """
    used = {sign: any(_any(cells, sign) for cells in columns.values()) for sign in ".,"}
    proofs = {sign: _first(columns, _proof(sign)) if used[sign] else None for sign in ".,"}
    if proofs["."] and proofs[","]:
        row, k = max(proofs["."], proofs[","])
        cell = columns[k][row].as_py()
        raise table.error(row, f"{cell[:40]!r} has another decimal sign than the numbers before it: use one", k)
    for sign, proof in proofs.items():
        if proof:
            return sign
    if not used[","] and (table.decimal or table.separator == ","):  # commas separate: a point is no thousands' then
        return "."
    unclear = _first(columns, r"[.,]")
    if unclear:
        row, k = unclear
        cell = columns[k][row].as_py()
        raise table.error(
            row,
            f"{cell[:40]!r} may have a decimal sign or thousands, and no other number tells: --decimal point or comma",
            k,
        )
    return "."


def numbers(table: Table, column: int, cells: Any, sign: str) -> FloatArray:
    """Numbers (rows,) of trimmed texts, NaN where there is none.

    Raises:
        FileError: something else than a finite number.
    """
    grouped = "," if sign == "." else "."
    if sign == "." or not _any(cells, "."):
        plainly = _written_plainly(cells, sign)
        if plainly is not None:
            return plainly
    missing = is_missing(cells)
    d, g = re.escape(sign), re.escape(grouped)
    shape = rf"^[+-]?(?:\d+|\d{{1,3}}(?:{g}\d{{3}})+|\d{{1,3}}(?:{_SPACES}\d{{3}})+)?(?:{d}\d*)?{_POWER}?$"
    good = pc.and_(pc.match_substring_regex(cells, shape), pc.match_substring_regex(cells, r"\d"))
    _refuse(table, column, cells, ~np.asarray(pc.or_(missing, good)), sign)
    plain = pc.replace_substring_regex(cells, rf"^\+|{g}|{_SPACES}", "")
    plain = pc.replace_substring(plain, sign, ".")
    values = pc.if_else(missing, pa.scalar("nan", pa.large_string()), plain).cast(pa.float64())
    parsed = np.asarray(values, dtype=float)
    _refuse(table, column, cells, np.isinf(parsed), sign)
    return parsed


def _refuse(table: Table, column: int, cells: Any, wrong: Any, sign: str) -> None:
    if wrong.any():
        row = int(wrong.argmax())
        cell, other = cells[row].as_py(), "," if sign == "." else "."
        hint = f" with the decimal sign {sign!r}, which the other numbers have" if other in cell else ""
        raise table.error(row, f"{cell[:40]!r} is not a finite number{hint} - correct it, or leave it empty", column)


def _any(cells: Any, text: str) -> bool:
    return bool(pc.any(pc.match_substring(cells, text)).as_py())


def _proof(d: str) -> str:
    """What only a number with the decimal sign ``d`` looks like."""
    g = re.escape("," if d == "." else ".")
    d = re.escape(d)
    return (
        rf"^[+-]?(?:\d{{1,3}}(?:{g}\d{{3}})+{d}\d*"  # thousands and a decimal sign
        rf"|\d{{1,3}}(?:{g}\d{{3}}){{2,}}"  # groups of thousands
        rf"|\d*{d}(?:\d{{0,2}}|\d{{4,}}){_POWER}?"  # not three digits behind it
        rf"|(?:0\d*|\d{{4,}}|){d}\d*{_POWER}?"  # nor one to three before it, as a group has
        rf"|\d+{d}\d*{_POWER})$"
    )


def _first(columns: Mapping[int, Any], shape: str) -> tuple[int, int] | None:
    """Row and column of the first text of a shape, row by row."""
    for begin, count in ((0, PROOF_WITHIN), (PROOF_WITHIN, None)):  # most files show it at once
        matches = []
        for k, cells in columns.items():
            match = np.asarray(pc.match_substring_regex(cells.slice(begin, count), shape))
            if match.any():
                matches.append((begin + int(match.argmax()), k))
        if matches:
            return min(matches)
    return None


def _written_plainly(cells: Any, sign: str) -> FloatArray | None:
    """Numbers of texts that are all as Python writes them but for the sign; None: some are not."""
    try:
        values = (cells if sign == "." else pc.replace_substring(cells, sign, ".")).cast(pa.float64())
    except pa.ArrowInvalid:
        return None
    parsed = np.asarray(values, dtype=float)
    return parsed if np.isfinite(parsed).all() else None
