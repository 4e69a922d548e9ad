"""Quantities of a log: columns of a clean file, headings and units of rigs, accepted ranges, ``--columns``."""

import re
from collections.abc import Mapping, Sequence
from math import inf, isfinite
from typing import Final, NamedTuple

from probe_env.schedule import AIR, FEED, POSITIONS, RANGES

HOUR: Final = 3600.0


class Quantity(NamedTuple):
    """A quantity of a log, as in ``--columns`` and in a clean file."""

    name: str
    unit: str  # in a clean file
    si: str  # SI unit for pint
    low: float  # accepted [SI]
    high: float
    scale: float = 1.0  # value of ``unit`` [SI]
    noise: float = 0.0  # accepted noise below ``low`` [SI]; the value is clipped to ``low``
    rms: bool = False  # whether it is averaged as a root mean square

    @property
    def column(self) -> str:
        """Head of the column of a clean file."""
        return f"{self.name}_{self.unit.lower().replace('/', '_per_')}"


_LENGTH, _FEED, _AIR = POSITIONS["inserted_length_m"][1], RANGES[FEED][1], RANGES[AIR][1] / HOUR
_ALL = (
    Quantity("time", "s", "s", -inf, inf),
    Quantity("inserted_length", "m", "m", 0.0, _LENGTH, noise=0.02),
    Quantity("feed_speed", "m/s", "m/s", -_FEED, _FEED),
    Quantity("air_supply", "m3/h", "m**3/s", 0.0, _AIR, scale=1.0 / HOUR, noise=1.0 / HOUR),
    Quantity("root_tension", "N", "N", -1e5, 1e5),
    Quantity("radial_acceleration_rms", "m/s2", "m/s**2", 0.0, 1e6, rms=True),
    Quantity("axial_acceleration_rms", "m/s2", "m/s**2", 0.0, 1e6, rms=True),
    Quantity("rf_noise_rms", "m", "m", 0.0, 1.0, rms=True),
    Quantity("inlet_pressure", "Pa", "Pa", 0.0, 1e7, noise=2e3),
    Quantity("return_feed_speed", "m/s", "m/s", 0.0, _FEED),
    Quantity("return_air_supply", "m3/h", "m**3/s", 0.0, _AIR, scale=1.0 / HOUR),
)
QUANTITIES: Final[Mapping[str, Quantity]] = {quantity.name: quantity for quantity in _ALL}
MEASURED: Final = tuple(QUANTITIES)[4:-2]
"""Quantities that a log may lack."""
RETURN: Final = tuple(QUANTITIES)[-2:]
"""Quantities of withdrawal in a schedule."""
DATE, FRACTION, IGNORED = "date", "fraction", "none"
"""Date, and fraction of a second, of a clock time in another column; a column that is left out."""
FRACTION_UNITS: Final = dict.fromkeys(("ms", "msec", "millisecond", "milliseconds", "millisekunden"), "ms") | {
    "fraction": "s", "time fraction": "s", "fractional seconds": "s"
}  # fmt: skip
"""Heading -> unit."""
NAMES: Final = (*(name for name in QUANTITIES if name not in RETURN), DATE, FRACTION, IGNORED)
"""Names accepted by ``--columns``."""
_HEADS: Final = {
    "time": "t, timestamp, time stamp, t stamp, datetime, date time, date&time, elapsed time, zeit, zeitstempel,"
    " uhrzeit, zeitpunkt, datum uhrzeit, messzeit, x value, time time, clock, clock time",
    "inserted_length": "insertion length, length, position, encoder, encoder position, länge, laenge, weg, weggeber,"
    " drehgeber, eingeschobene länge, einschublänge, einschublaenge, einfahrlänge, pay out, payout",
    "feed_speed": "feed, feed rate, speed, velocity, vorschub, vorschubgeschwindigkeit, geschwindigkeit,"
    " einschubgeschwindigkeit, haspelgeschwindigkeit, reel speed",
    "air_supply": "air supply rate, air, air flow, airflow, flow, flow rate, luft, luftmenge, luftstrom, luftzufuhr,"
    " volumenstrom, luftvolumenstrom, druckluft, compressed air",
    "root_tension": "tension, cable tension, force, load cell, kraft, zugkraft, kabelzug, kabelzugkraft, cable pull",
    "radial_acceleration_rms": "radial acceleration, acceleration radial, radialbeschleunigung, beschleunigung radial",
    "axial_acceleration_rms": "axial acceleration, acceleration axial, axialbeschleunigung, beschleunigung axial",
    "rf_noise_rms": "rf noise, noise, eddy current noise, rauschen, hf rauschen, signalrauschen, wirbelstromrauschen",
    "inlet_pressure": "air pressure at the inlet, pressure at the inlet, eingangsdruck",
    "return_feed_speed": "return feed, return speed",
    "return_air_supply": "return air, return air flow",
    DATE: "day, datum, tag, messdatum",
    FRACTION: ", ".join(FRACTION_UNITS),
}
"""Accepted headings in addition to the name: lower case, without unit."""
_BY_HEAD: Final = {
    head: name for name, heads in _HEADS.items() for head in (name.replace("_", " "), *heads.split(", "))
}
_NUMBERED: Final = re.compile(r"((?:time|zeit)) \d+(?: (?:standardmessrate|default sample rate))?")
"""One of several columns of time, also of catman."""
_UNIT: Final = re.compile(r"\s*(?:\[([^\[\]]*)\]|\(([^()]*)\)|\bin\s+([^\s\[\]()]+))\s*$")
"""At the end of a head: [mm/s], (m3/h), in mm/s."""
_TOKEN: Final = "(?:ns|us|ms|sec|min|mm|cm|um|µm|n?m3|ft|in|kn|lbf|s?cfm|s?lpm|fpm|k?pa|m?bar|[smhnlg])"
_BEHIND: Final = re.compile(
    rf"(.+?)(_|,?\s+|\s*/\s*)({_TOKEN}(?:(?:/|_per_){_TOKEN}[2²]?)?|n?m³(?:/{_TOKEN})?)", re.IGNORECASE
)
"""A unit behind an underscore, space or slash: feed_mm_per_s, "Feed Speed m/s", "Weg / mm", "Tension, N"."""
_NUMBER: Final = r"\d+(?:\.\d+)?(?:[eE][+-]?\d+)?"
_SCALED: Final = re.compile(rf"([+-]?)\s*(?:({_NUMBER})\s*\*\s*)?(.*?)(?:\s*([*/])\s*({_NUMBER}))?")
"""A unit with a sign and a factor: -m, m/4096, 1.07*m3/h."""
_CAPITALS: Final = {"n": "N", "kn": "kN", "pa": "Pa", "kpa": "kPa"}

_CLOCK_FORM: Final = re.compile(r"[ymdhstj]+(?:[:./ -]+[ymdhstjf0]+)+", re.IGNORECASE)
"""Form of a time in a row of units: hh:mm:ss, TT.MM.JJJJ hh:mm:ss."""
MAX_UNIT_LENGTH: Final = 40
"""Characters."""
_SUPERSCRIPTS: Final = str.maketrans({"²": "2", "³": "3", "¹": "1", "⁻": "-", "·": "*", "⋅": "*", "μ": "µ"})
_POWER: Final = re.compile(r"(?<=[A-Za-zµ])(?:\^|\*\*)?(-?[1-3])(?![\w^*])")
_SHAPE: Final = re.compile(r"[A-Za-zµ_]+(?:\*\*-?[1-3])?(?:[*/ ][A-Za-zµ_]+(?:\*\*-?[1-3])?)*")
"""Units that are passed to pint, which would also compute powers of large numbers."""
_WORDS: Final = {
    "sek": "s", "sec": "s", "sekunden": "s", "minuten": "min", "std": "h", "stunden": "h", "tage": "d",
    "msec": "ms", "hrs": "h",
    "scfm": "ft**3/min", "cfm": "ft**3/min", "acfm": "ft**3/min", "scfh": "ft**3/h", "cfh": "ft**3/h",
    "slpm": "l/min", "lpm": "l/min", "nlpm": "l/min", "slm": "l/min", "lps": "l/s",
    "fpm": "ft/min", "fps": "ft/s", "ipm": "inch/min", "ips": "inch/s", "cmh": "m**3/h",
    "kn": "kN", "dan": "daN", "kp": "kgf",
}  # fmt: skip
_GAS: Final = {r"n(?:m\W*3|l|cm)|sl(?:pm|m\b|/)": (0.0, 1.073), r"s(?:m\W*3|cfm|cfh)": (15.0, 1.017)}
"""How units of normal and standard volumes begin -> their temperature [°C], and the ratio of the volume at 20 °C."""
_OF_DIMENSION: Final = {
    "m/s**2": (r"^(m?)(?:g|G|gn|g_n)$", lambda match: f"{'milli' * bool(match[1])}standard_gravity"),
    "m**3/s": (r"^[NnSs](?=(?:[mM]\*\*3|[lL])(?:/|$))", lambda _: ""),  # normal or standard
}
"""SI unit -> pattern of a unit that pint misreads, and its replacement."""


def split_head(head: str) -> tuple[str, str]:
    """Words and unit of a heading: "Vorschub [mm/s]", "flow (m3/h)", "Weg in mm", "feed_speed_mm_per_s"."""
    match = _UNIT.search(head)
    if match and match.start():
        return head[: match.start()].strip(), next(group for group in match.groups() if group is not None).strip()
    behind = _BEHIND.fullmatch(head.strip())
    if not behind or (behind[2] != "_" and normalized(behind[1]) not in _BY_HEAD):
        return head.strip(), ""
    unit = behind[3].lower().replace("_per_", "/")
    return behind[1], _CAPITALS.get(unit, unit) if behind[2] == "_" else behind[3]


def normalized(words: str) -> str:
    """Words of a heading for comparison: lower case, single spaces."""
    return re.sub(r"[\s_.,\-:/]+", " ", words).strip().casefold()


def quantity_of(head: str) -> str | None:
    """Quantity (or ``DATE``) of a heading; None if it is unknown."""
    words = _NUMBERED.sub(r"\1", normalized(split_head(head)[0]))
    name = _BY_HEAD.get(words) or _BY_HEAD.get(re.sub(r" (?:avg|mean|smp|rms|eff|effektiv)$", "", words))
    is_rms = name is not None and name in QUANTITIES and QUANTITIES[name].rms
    return None if is_rms and re.search(r" (?:avg|mean|smp)$", words) else name


class ColumnOption(NamedTuple):
    """One value of ``--columns``: "HEAD=QUANTITY", "HEAD=QUANTITY[UNIT]" or, with a factor, "HEAD=QUANTITY[-m/4]"."""

    head: str
    quantity: str
    unit: str
    factor: float | None = None  # of ``unit``; None without

    def means(self, head: str) -> bool:
        """Whether a heading of the file, with or without its unit, equals ``head``."""
        return normalized(self.head) in (normalized(head), normalized(split_head(head)[0]))


def parse_columns(texts: Sequence[str]) -> tuple[ColumnOption, ...]:
    """Parse the values of ``--columns``."""
    options: dict[str, ColumnOption] = {}
    for text in texts:
        head, _, right = text.rpartition("=")
        name, unit = split_head(right) if right.rstrip().endswith(("]", ")")) else (right.strip(), "")
        if not head.strip() or name not in NAMES:
            problem = f"columns = {text[:100]!r} is not HEAD=QUANTITY, HEAD=QUANTITY[UNIT] or HEAD=QUANTITY[-UNIT/4096]"
            raise ValueError(f"{problem}, with one of {', '.join(NAMES)}")
        if name in options:
            raise ValueError(f"columns = {text[:100]!r}: {name} is named twice, but comes from one column")
        factor = None
        if unit and (match := _SCALED.fullmatch(unit)) and any(match.group(1, 2, 4)):
            sign, times, unit, operator, number = match.groups()
            factor, more = float(f"{sign}1") * float(times or 1.0), float(number or 1.0)
            factor = factor * more if operator != "/" else factor / more if more else inf
            if not unit or not isfinite(factor) or factor == 0.0:
                raise ValueError(f"columns = {text[:100]!r}: a factor is a finite number with a unit, like [-m/4096]")
        options[name if name != IGNORED else text] = ColumnOption(head.strip(), name, unit, factor)
    return tuple(options.values())


class UnknownUnitError(ValueError):
    """A text that is not a unit."""


def si_factor(unit: str, quantity: Quantity) -> float:
    """Factor from ``unit`` to the SI unit of a quantity, by pint. Capitals may stand for small letters: M/MIN, Seconds.

    Raises:
        UnknownUnitError: an unknown unit.
        ValueError: a unit of another dimension.
        ModuleNotFoundError: pint is not installed; the units of clean files do not need it.
    """
    if unit == quantity.unit:
        return quantity.scale
    text = re.sub(r"\s+(?:rms|eff\.?)$", "", unit.strip().rstrip("."), flags=re.IGNORECASE).translate(_SUPERSCRIPTS)
    text = _POWER.sub(r"**\1", re.sub(r"\s*([/*])\s*", r"\1", text))
    text = _WORDS.get(text.lower(), text)
    if quantity.si in _OF_DIMENSION:
        text = re.sub(*_OF_DIMENSION[quantity.si], text)
    unit_option, none = f"--columns 'HEAD={quantity.name}", f"--columns 'HEAD={IGNORED}'"
    scale = f"convert the column to {quantity.unit} in the file, give a factor, {unit_option}[{quantity.unit}/1000]'"
    scale += f", or leave it out, {none}"
    spell = f"write it like {quantity.unit}, {unit_option}[UNIT]'; if it is no such unit, {scale}"
    of_other = ValueError(f"{unit!r} is not a unit of {quantity.name} - {scale}")
    if re.match(r"[%‰°]|1/", text):
        raise of_other
    if len(text) > MAX_UNIT_LENGTH or not _SHAPE.fullmatch(text):
        raise UnknownUnitError(f"{unit[:MAX_UNIT_LENGTH]!r} is not a unit - {spell}")
    import pint

    problem: ValueError = UnknownUnitError(f"the unit {unit!r} is unknown - {spell}")
    for spelling in (text, text.lower()) if text.isupper() or text.istitle() else (text,):
        try:
            return float(pint.Quantity(1.0, pint.Unit(spelling)).to(quantity.si).magnitude)
        except pint.DimensionalityError:
            problem = of_other
        except (pint.PintError, ValueError, TypeError, ArithmeticError, AttributeError):
            continue
    raise problem


def gas_amount(unit: str) -> tuple[float, float] | None:
    """Temperature [°C] of the normal or standard volume that a unit counts, and the ratio of its volume at 20 °C."""
    text = unit.strip().lower().translate(_SUPERSCRIPTS)
    return next((state for begin, state in _GAS.items() if re.match(begin, text)), None)


def looks_like_unit(cell: str) -> bool:
    """Whether a cell below a heading may be its unit."""
    text = cell.strip("[]() ").translate(_SUPERSCRIPTS)
    is_word = not text.isdigit() and re.fullmatch(rf"[A-Za-zµ°%/*^ \d-]{{0,{MAX_UNIT_LENGTH}}}\.?", text)
    return bool(is_word or _CLOCK_FORM.fullmatch(text))
