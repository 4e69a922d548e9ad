"""What a log may hold: the quantities, their columns in a clean file, and the words that rigs have for them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

from probe_env.schedule import AIR, FEED, POSITIONS, RANGES

HOUR: Final = 3600.0


class Quantity(NamedTuple):
    """A quantity of a log.

    Attributes:
        name: of it, as ``--columns`` takes it.
        column: of a clean file.
        unit: of that column.
        scale: that unit in SI units.
        low: least value that is possible [SI].
        high: greatest value that is possible [SI].
        words: heads that mean it, in small letters, without unit.
        rms: whether its mean over an interval is that of the squares.
    """

    name: str
    column: str
    unit: str
    scale: float
    low: float
    high: float
    words: tuple[str, ...]
    rms: bool = False


DATE: Final = "date"
"""The day of a clock in another column: no quantity, but a column that ``--columns`` may name."""
DATE_WORDS: Final = ("date", "day", "datum", "tag", "messdatum")
_ALL: Final = (
    Quantity(
        "time", "time_s", "s", 1.0, float("-inf"), float("inf"),
        ("time", "t", "timestamp", "time stamp", "datetime", "date time", "elapsed time", "zeit", "zeitstempel",
         "uhrzeit", "zeitpunkt", "datum uhrzeit", "messzeit"),
    ),
    Quantity(
        "inserted_length", "inserted_length_m", "m", 1.0, 0.0, POSITIONS["inserted_length_m"][1],
        ("inserted length", "insertion length", "length", "position", "encoder", "encoder position", "länge", "laenge",
         "weg", "weggeber", "drehgeber", "eingeschobene länge", "einschublänge", "einschublaenge", "einfahrlänge"),
    ),
    Quantity(
        "feed_speed", FEED, "m/s", 1.0, -RANGES[FEED][1], RANGES[FEED][1],
        ("feed speed", "feed", "feed rate", "speed", "velocity", "vorschub", "vorschubgeschwindigkeit",
         "geschwindigkeit", "einschubgeschwindigkeit"),
    ),
    Quantity(
        "air_supply", AIR, "m3/h", 1.0 / HOUR, 0.0, RANGES[AIR][1] / HOUR,
        ("air supply", "air supply rate", "air", "air flow", "airflow", "flow", "flow rate", "luft", "luftmenge",
         "luftstrom", "luftzufuhr", "volumenstrom", "luftvolumenstrom"),
    ),
    Quantity(
        "root_tension", "root_tension_n", "N", 1.0, -1e5, 1e5,
        ("root tension", "tension", "cable tension", "zugkraft", "kabelzug", "kabelzugkraft", "wurzelzugkraft"),
    ),
    Quantity(
        "radial_acceleration_rms", "radial_acceleration_rms_m_per_s2", "m/s2", 1.0, 0.0, 1e6,
        ("radial acceleration rms", "radial acceleration", "acceleration radial", "radialbeschleunigung",
         "beschleunigung radial"), rms=True,
    ),
    Quantity(
        "axial_acceleration_rms", "axial_acceleration_rms_m_per_s2", "m/s2", 1.0, 0.0, 1e6,
        ("axial acceleration rms", "axial acceleration", "acceleration axial", "axialbeschleunigung",
         "beschleunigung axial"), rms=True,
    ),
    Quantity(
        "rf_noise_rms", "rf_noise_rms_m", "m", 1.0, 0.0, 1.0,
        ("rf noise rms", "rf noise", "noise", "eddy current noise", "rauschen", "hf rauschen", "signalrauschen",
         "wirbelstromrauschen"), rms=True,
    ),
)  # fmt: skip
QUANTITIES: Final[Mapping[str, Quantity]] = {quantity.name: quantity for quantity in _ALL}
MEASURED: Final = ("root_tension", "radial_acceleration_rms", "axial_acceleration_rms", "rf_noise_rms")
"""What a log may lack."""
NAMED: Final = (*QUANTITIES, DATE)
"""What a column may be."""
_WORDS: Final = {word: quantity.name for quantity in _ALL for word in quantity.words} | dict.fromkeys(DATE_WORDS, DATE)
_UNIT: Final = re.compile(r"\s*(?:\[([^\[\]]*)\]|\(([^()]*)\)|\bin\s+([^\s\[\]()]+))\s*$")
"""At the end of a head: [mm/s], (m3/h), in mm/s."""
_TOKEN: Final = "(?:ms|min|mm|cm|um|µm|m3|ft|kn|[smhnlg])"
_SUFFIX: Final = re.compile(rf"(.+?)_({_TOKEN}(?:_per_{_TOKEN}2?)?)$")
_CAPITALS: Final = {"n": "N", "kn": "kN"}


def split_head(head: str) -> tuple[str, str]:
    """Words and unit of a head: "Vorschub [mm/s]", "flow (m3/h)", "Weg in mm", "feed_speed_mm_per_s"."""
    match = _UNIT.search(head)
    if match and match.start():
        return head[: match.start()].strip(), next(group for group in match.groups() if group is not None).strip()
    suffix = _SUFFIX.fullmatch(head.strip().lower())
    if suffix:
        unit = suffix[2].replace("_per_", "/")
        return head.strip()[: suffix.end(1)], _CAPITALS.get(unit, unit)
    return head.strip(), ""


def plain(words: str) -> str:
    """Words of a head as they are compared: small letters, single spaces."""
    return re.sub(r"[\s_.\-:]+", " ", words).strip().casefold()


def known_as(head: str) -> str | None:
    """The quantity, or the date, that a head means by itself; None: none that is known."""
    words = plain(split_head(head)[0])
    return _WORDS.get(words) or _WORDS.get(re.sub(r" (?:rms|eff|effektiv)$", "", words))


class Given(NamedTuple):
    """What ``--columns`` says of one column: "HEAD=QUANTITY" or "HEAD=QUANTITY[UNIT]"."""

    head: str
    quantity: str
    unit: str

    def means(self, head: str) -> bool:
        """Whether a head of the file, with or without its unit, is this one."""
        return plain(self.head) in (plain(head), plain(split_head(head)[0]))


def parse_columns(texts: Sequence[str]) -> tuple[Given, ...]:
    """What ``--columns`` says.

    Raises:
        ValueError: not HEAD=QUANTITY, no such quantity, or one quantity from two columns.
    """
    given: list[Given] = []
    for text in texts:
        head, _, right = text.rpartition("=")
        name, unit = split_head(right) if right.rstrip().endswith(("]", ")")) else (right.strip(), "")
        if not head.strip() or name not in NAMED:
            raise ValueError(
                f"columns = {text[:100]!r} is not HEAD=QUANTITY or HEAD=QUANTITY[UNIT], with one of {', '.join(NAMED)}"
            )
        if name in (other.quantity for other in given):
            raise ValueError(f"columns = {text[:100]!r}: {name} is named twice, and comes from one column")
        given.append(Given(head.strip(), name, unit))
    return tuple(given)
