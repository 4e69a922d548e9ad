"""Quantities of a log: their columns in a clean file, the heads and units that rigs write, and ``--columns``."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from math import inf
from typing import Final, NamedTuple

from probe_env.schedule import AIR, FEED, POSITIONS, RANGES

HOUR: Final = 3600.0


class Quantity(NamedTuple):
    """A quantity of a log: as ``--columns`` takes it and as a clean file has it."""

    name: str
    column: str
    unit: str
    scale: float  # of that unit [SI]
    si: str  # as pint writes it
    low: float  # accepted [SI]
    high: float
    rms: bool = False  # whether it is averaged as a root mean square


_RADIAL, _AXIAL = "radial_acceleration_rms", "axial_acceleration_rms"
_MOST_LENGTH, _MOST_FEED, _MOST_AIR = POSITIONS["inserted_length_m"][1], RANGES[FEED][1], RANGES[AIR][1] / HOUR
_ALL: Final = (
    Quantity("time", "time_s", "s", 1.0, "s", -inf, inf),
    Quantity("inserted_length", "inserted_length_m", "m", 1.0, "m", 0.0, _MOST_LENGTH),
    Quantity("feed_speed", FEED, "m/s", 1.0, "m/s", -_MOST_FEED, _MOST_FEED),
    Quantity("air_supply", AIR, "m3/h", 1.0 / HOUR, "m**3/s", 0.0, _MOST_AIR),
    Quantity("root_tension", "root_tension_n", "N", 1.0, "N", -1e5, 1e5),
    Quantity(_RADIAL, f"{_RADIAL}_m_per_s2", "m/s2", 1.0, "m/s**2", 0.0, 1e6, rms=True),
    Quantity(_AXIAL, f"{_AXIAL}_m_per_s2", "m/s2", 1.0, "m/s**2", 0.0, 1e6, rms=True),
    Quantity("rf_noise_rms", "rf_noise_rms_m", "m", 1.0, "m", 0.0, 1.0, rms=True),
)
QUANTITIES: Final[Mapping[str, Quantity]] = {quantity.name: quantity for quantity in _ALL}
DATE: Final = "date"
"""The day of a clock that stands in another column."""
NAMES: Final = (*QUANTITIES, DATE)
"""What ``--columns`` may name."""
HEADS: Final = {
    "time": "time, t, timestamp, time stamp, datetime, date time, elapsed time, zeit, zeitstempel, uhrzeit, zeitpunkt,"
    " datum uhrzeit, messzeit",
    "inserted_length": "inserted length, insertion length, length, position, encoder, encoder position, länge, laenge,"
    " weg, weggeber, drehgeber, eingeschobene länge, einschublänge, einschublaenge, einfahrlänge",
    "feed_speed": "feed speed, feed, feed rate, speed, velocity, vorschub, vorschubgeschwindigkeit, geschwindigkeit,"
    " einschubgeschwindigkeit",
    "air_supply": "air supply, air supply rate, air, air flow, airflow, flow, flow rate, luft, luftmenge, luftstrom,"
    " luftzufuhr, volumenstrom, luftvolumenstrom",
    "root_tension": "root tension, tension, cable tension, zugkraft, kabelzug, kabelzugkraft, wurzelzugkraft",
    _RADIAL: "radial acceleration rms, radial acceleration, acceleration radial, radialbeschleunigung,"
    " beschleunigung radial",
    _AXIAL: "axial acceleration rms, axial acceleration, acceleration axial, axialbeschleunigung, beschleunigung axial",
    "rf_noise_rms": "rf noise rms, rf noise, noise, eddy current noise, rauschen, hf rauschen, signalrauschen,"
    " wirbelstromrauschen",
    DATE: "date, day, datum, tag, messdatum",
}
"""Quantity -> heads that mean it, in small letters, without unit."""
_BY_HEAD: Final = {head: name for name, heads in HEADS.items() for head in heads.split(", ")}
MEASURED: Final = ("root_tension", _RADIAL, _AXIAL, "rf_noise_rms")
"""Quantities that a log may lack."""

_UNIT: Final = re.compile(r"\s*(?:\[([^\[\]]*)\]|\(([^()]*)\)|\bin\s+([^\s\[\]()]+))\s*$")
"""At the end of a head: [mm/s], (m3/h), in mm/s."""
_TOKEN: Final = "(?:ms|min|mm|cm|um|µm|m3|ft|kn|[smhnlg])"
_SUFFIX: Final = re.compile(rf"(.+?)_({_TOKEN}(?:_per_{_TOKEN}2?)?)$")
_CAPITALS: Final = {"n": "N", "kn": "kN"}

LONGEST_UNIT: Final = 40
"""Characters."""
_SUPERSCRIPTS: Final = str.maketrans({"²": "2", "³": "3", "¹": "1", "⁻": "-", "·": "*", "⋅": "*", "μ": "µ"})
_POWER: Final = re.compile(r"(?<=[A-Za-zµ])(?:\^|\*\*)?(-?[1-3])(?![\w^*])")
_SHAPE: Final = re.compile(r"[A-Za-zµ_]+(?:\*\*-?[1-3])?(?:[*/ ][A-Za-zµ_]+(?:\*\*-?[1-3])?)*")
"""The units that pint is given: it would also compute powers of large numbers, without end."""
_WORDS: Final = {"sek": "s", "sec": "s", "sekunden": "s", "minuten": "min", "std": "h", "stunden": "h"}
_GRAVITY: Final = dict.fromkeys(("g", "G", "gn", "g_n"), "standard_gravity") | {"mg": "millistandard_gravity"}
_NORMAL: Final = re.compile(r"^[Nn](?=(?:m\*\*3|[lL])(?:/|$))")
"""Normal cubic metres and litres: the air at normal conditions."""


def split_head(head: str) -> tuple[str, str]:
    """Words and unit of a head: "Vorschub [mm/s]", "flow (m3/h)", "Weg in mm", "feed_speed_mm_per_s"."""
    match = _UNIT.search(head)
    if match and match.start():
        return head[: match.start()].strip(), next(group for group in match.groups() if group is not None).strip()
    if suffix := _SUFFIX.fullmatch(head.strip().lower()):
        unit = suffix[2].replace("_per_", "/")
        return head.strip()[: suffix.end(1)], _CAPITALS.get(unit, unit)
    return head.strip(), ""


def plain(words: str) -> str:
    """Words of a head as they are compared: small letters, single spaces."""
    return re.sub(r"[\s_.\-:]+", " ", words).strip().casefold()


def known_as(head: str) -> str | None:
    """The quantity (or ``DATE``) that a head means; None if no known one."""
    words = plain(split_head(head)[0])
    return _BY_HEAD.get(words) or _BY_HEAD.get(re.sub(r" (?:rms|eff|effektiv)$", "", words))


class ColumnOption(NamedTuple):
    """One value of ``--columns``: "HEAD=QUANTITY" or "HEAD=QUANTITY[UNIT]"."""

    head: str
    quantity: str
    unit: str

    def means(self, head: str) -> bool:
        """Whether a head of the file, with or without its unit, is this one."""
        return plain(self.head) in (plain(head), plain(split_head(head)[0]))


def parse_columns(texts: Sequence[str]) -> tuple[ColumnOption, ...]:
    """Parse the values of ``--columns``.

    Raises:
        ValueError: not HEAD=QUANTITY, an unknown quantity, or one quantity from two columns.
    """
    options: list[ColumnOption] = []
    for text in texts:
        head, _, right = text.rpartition("=")
        name, unit = split_head(right) if right.rstrip().endswith(("]", ")")) else (right.strip(), "")
        if not head.strip() or name not in NAMES:
            problem = f"columns = {text[:100]!r} is not HEAD=QUANTITY or HEAD=QUANTITY[UNIT]"
            raise ValueError(f"{problem}, with one of {', '.join(NAMES)}")
        if name in (other.quantity for other in options):
            raise ValueError(f"columns = {text[:100]!r}: {name} is named twice, and comes from one column")
        options.append(ColumnOption(head.strip(), name, unit))
    return tuple(options)


def si_factor(unit: str, quantity: Quantity) -> float:
    """Factor from ``unit`` to the SI unit of a quantity, by pint.

    Raises:
        ValueError: an unknown unit, or a unit of another dimension.
        ModuleNotFoundError: pint is not installed; the units of clean files do not need it.
    """
    if unit == quantity.unit:
        return quantity.scale
    text = re.sub(r"\s+(?:rms|eff\.?)$", "", unit.strip(), flags=re.IGNORECASE).translate(_SUPERSCRIPTS)
    text = _POWER.sub(r"**\1", re.sub(r"\s*([/*])\s*", r"\1", text))
    text = _WORDS.get(text.rstrip(".").lower(), text)
    if quantity.si == "m**3/s":
        text = _NORMAL.sub("", text)
    elif quantity.si == "m/s**2":
        text = _GRAVITY.get(text, text)
    example = f"give one like {quantity.unit}: --columns 'HEAD={quantity.name}[{quantity.unit}]'"
    if len(text) > LONGEST_UNIT or not _SHAPE.fullmatch(text):
        raise ValueError(f"{unit[:LONGEST_UNIT]!r} is not a unit - {example}")
    import pint

    try:
        return float(pint.Quantity(1.0, pint.Unit(text)).to(quantity.si).magnitude)
    except pint.UndefinedUnitError:
        raise ValueError(f"the unit {unit!r} is not known - {example}") from None
    except pint.DimensionalityError:
        raise ValueError(f"{unit!r} is not a unit of {quantity.name} - {example}") from None
    except (pint.PintError, ValueError, TypeError, ArithmeticError, AttributeError) as error:
        raise ValueError(f"the unit {unit!r} cannot be read: {error} - {example}") from error


def looks_like_unit(cell: str) -> bool:
    """Whether a cell below a head may be its unit."""
    text = cell.strip().strip("[]()").strip().translate(_SUPERSCRIPTS)
    shape = rf"[A-Za-zµ°%/*^ \d-]{{0,{LONGEST_UNIT}}}"
    return not text.isdigit() and re.fullmatch(shape, text) is not None
