"""Which row is the head, and which the units below it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from agents.logs.quantities import NAMED, Given, known_as
from agents.logs.units import looks_like_unit
from probe_env.files import FileError

HEAD_WITHIN: Final = 200
"""Lines, empty ones apart, within which the head must stand."""
HEADS_SHOWN: Final = 12
_NUMBER_OR_TIME: Final = re.compile(r"[+-]?[\d.,'  ]*\d[\d.,'  ]*(?:[eE][+-]?\d+)?|\d[\d:.,TZ +-]*:[\d:.,TZ +-]*")


def head_score(cells: Sequence[str], given: Sequence[Given]) -> int:
    """How many quantities the cells of a line name."""
    named = {other.quantity for cell in cells for other in given if cell and other.means(cell)}
    return len(named | {name for cell in cells if cell and (name := known_as(cell))})


def is_units_row(cells: Sequence[str]) -> bool:
    """Whether the row below a head has units, and no number or time."""
    filled = [cell.strip() for cell in cells if cell.strip()]
    return bool(filled) and not any(map(_NUMBER_OR_TIME.fullmatch, filled)) and all(map(looks_like_unit, filled))


def no_head(path: Path, cells: Sequence[str], line: str) -> FileError:
    """Nobody knows the heads."""
    shown = ", ".join(repr(cell[:60]) for cell in cells[:HEADS_SHOWN]) + (" ..." if len(cells) > HEADS_SHOWN else "")
    return FileError(
        path,
        f"{line}: no head that names two quantities; found: {shown or 'none'} - say what they are:"
        f" --columns 'HEAD=QUANTITY', with QUANTITY one of {', '.join(NAMED)}",
    )
