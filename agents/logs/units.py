"""Units as rigs write them, by the library pint: a factor to SI units, or what is wrong in words."""

from __future__ import annotations

import re
from functools import lru_cache
from typing import TYPE_CHECKING, Any, Final

from agents.logs.quantities import Quantity

if TYPE_CHECKING:
    import pint

LONGEST: Final = 40
"""Characters of a unit."""
_SUPERSCRIPTS: Final = str.maketrans({"²": "2", "³": "3", "¹": "1", "⁻": "-", "·": "*", "⋅": "*", "μ": "µ"})
_POWER: Final = re.compile(r"(?<=[A-Za-zµ])(?:\^|\*\*)?(-?[1-3])(?![\w^*])")
_SHAPE: Final = re.compile(r"[A-Za-zµ_]+(?:\*\*-?[1-3])?(?:[*/ ][A-Za-zµ_]+(?:\*\*-?[1-3])?)*")
"""All that is given to pint: it computes powers, and those of large numbers without end."""
_WORDS: Final = {"sek": "s", "sec": "s", "sekunden": "s", "minuten": "min", "std": "h", "stunden": "h"}
_NORMAL: Final = re.compile(r"^[Nn](?=(?:m\*\*3|[lL])(?:/|$))")
"""Normal cubic metres and litres: the air at normal conditions."""
_GRAVITY: Final = {"g": "standard_gravity", "G": "standard_gravity", "gn": "standard_gravity",
                   "g_n": "standard_gravity", "mg": "millistandard_gravity"}  # fmt: skip
_SI: Final = {"s": "s", "m": "m", "m/s": "m/s", "m3/h": "m**3/s", "N": "N", "m/s2": "m/s**2"}
"""Unit of a clean file -> the SI unit of its quantity."""


def factor(unit: str, quantity: Quantity) -> float:
    """What a value in ``unit`` is multiplied with to be in SI units.

    Raises:
        ValueError: no unit that is known, or not one of this quantity.
        ModuleNotFoundError: pint is not installed; units of clean files do without.
    """
    if unit == quantity.unit:
        return quantity.scale
    text = _as_pint_has_it(unit, quantity)
    like = f"give one like {quantity.unit}: --columns 'HEAD={quantity.name}[{quantity.unit}]'"
    if len(text) > LONGEST or not _SHAPE.fullmatch(text):
        raise ValueError(f"{unit[:LONGEST]!r} is not a unit - {like}")
    import pint

    registry = _registry()
    try:
        value = float(registry.Quantity(1.0, registry.parse_units(text)).to(_SI[quantity.unit]).magnitude)
    except pint.UndefinedUnitError:
        raise ValueError(f"the unit {unit!r} is not known - {like}") from None
    except pint.DimensionalityError:
        raise ValueError(f"{unit!r} is not a unit of {quantity.name} - {like}") from None
    except (pint.PintError, ValueError, TypeError, ArithmeticError, AttributeError) as error:
        raise ValueError(f"the unit {unit!r} cannot be read: {error} - {like}") from error
    return value


def looks_like_unit(cell: str) -> bool:
    """Whether a cell below a head may be its unit."""
    text = cell.strip().strip("[]()").strip().translate(_SUPERSCRIPTS)
    return not text or bool(len(text) <= LONGEST and re.fullmatch(r"[A-Za-zµ°%/*^ \d-]+", text) and not text.isdigit())


def _as_pint_has_it(unit: str, quantity: Quantity) -> str:
    text = re.sub(r"\s+(?:rms|eff\.?)$", "", unit.strip(), flags=re.IGNORECASE).translate(_SUPERSCRIPTS)
    text = _POWER.sub(r"**\1", re.sub(r"\s*([/*])\s*", r"\1", text))
    text = _WORDS.get(text.rstrip(".").lower(), text)
    if _SI[quantity.unit] == "m**3/s":
        return _NORMAL.sub("", text)
    return _GRAVITY.get(text, text) if _SI[quantity.unit] == "m/s**2" else text


@lru_cache(maxsize=1)
def _registry() -> pint.UnitRegistry[Any]:
    import pint

    return pint.UnitRegistry(cache_folder=None)
