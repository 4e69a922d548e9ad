"""The feedback law for a PLC: IEC 61131-3 structured text, a table over friction and length, and its constants."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from agents.policies import plc_law
from agents.policies.cases import EvaluationCase
from agents.policies.plc_law import SHORTEST, Constants, PlantData, Trim, law_at
from agents.policies.policy import Domain, check_domains
from agents.records.atomic import write_atomically
from agents.terminal.tables import print_table
from probe_env.envs.task import TaskConfig
from probe_env.envs.vibration_map import stored_map

TEMPLATE: Final = Path(__file__).parent / "data" / "feed-law.st.j2"
TABLE_FRICTIONS: Final = tuple(round(0.08 + 0.02 * k, 2) for k in range(11))
TABLE_STEP: Final = 2.5
"""Between the lengths of a table [m]."""
DESCRIPTIONS: Final = {
    "average": ("s", "time constant of the averages of friction and noise"),
    "onset_length": ("m", "slow with strong air from here on, at friction 0.175 and 1.5 m"),
    "onset_friction": ("", "... times friction to the minus this"),
    "onset_diameter": ("", "... times helix diameter to this"),
    "slow_feed": ("m/s", "feed once past the onset, where 30 m are in, at friction 0.175 and 1.5 m"),
    "slow_length": ("", "... times length to the minus this"),
    "slow_friction": ("", "... times friction to the minus this"),
    "slow_diameter": ("", "... times helix diameter to this"),
    "quiet": ("m", "noise at which length counts as it is"),
    "shift": ("", "... else with (noise / quiet) to this"),
    "aim": ("m", "past the onset the feed is trimmed until this is the noise,"),
    "time": ("s", "... by a factor of e in this time where noise is off by e"),
}
"""Constant of the law, then of the trim -> unit and meaning."""
PLANT_DATA: Final = {
    "AIR_SPEED": "m/s of wind a m3/s of supply",
    "DRAG": "N s2/m3, of the floats a metre",
    "FLOAT_DIAMETER": "m",
    "LEAST_FEED": "m/s",
    "MOST_FEED": "m/s",
    "LEAST_AIR": "m3/s",
    "MOST_AIR": "m3/s",
}


def structured_text(constants: Constants, plant: PlantData, trim: Trim | None = None) -> str:
    """The law as a function block; with a trim, the feed has integral action on the noise."""
    from jinja2 import Environment, StrictUndefined

    values = (plant.air_speed_per_supply, plant.drag, plant.float_diameter, *plant.feed_speeds, *plant.air_supply_rates)
    own = [(n.upper(), value, DESCRIPTIONS[n][0] or "-") for n, value in constants.model_dump().items()]
    if trim:
        own += [("AIM", trim.aim, "m"), ("TRIM_TIME", trim.time, "s")]
    environment = Environment(
        trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True, undefined=StrictUndefined, autoescape=False
    )
    environment.filters["real"] = _real
    return environment.from_string(TEMPLATE.read_text(encoding="utf-8")).render(
        law=plc_law,
        trim=trim,
        constants=own,
        plant=[(name, value, unit) for (name, unit), value in zip(PLANT_DATA.items(), values, strict=True)],
    )


def _real(value: float) -> str:
    """A REAL literal with seven digits, all that a REAL has; without an exponent, which some compilers refuse."""
    text = np.format_float_positional(value, precision=7, unique=False, fractional=False, trim="-")
    return text if "." in text else f"{text}.0"


def table(
    constants: Constants, plant: PlantData, diameters: Sequence[float], helix_length: float, noise: float | None = None
) -> pd.DataFrame:
    """Feed and air by helix diameter, friction and inserted length [m], for a controller that stores tables.

    ``noise`` is a radial rms [m]; default: that at which it shifts nothing.
    """
    lengths = np.append(np.arange(SHORTEST, helix_length, TABLE_STEP), helix_length)
    grid = np.meshgrid(diameters, TABLE_FRICTIONS, lengths, indexing="ij")
    diameter, friction, length = (values.ravel() for values in grid)
    logarithm = np.full(len(length), np.log(noise or constants.quiet))
    feed, air = law_at(constants, plant, (length, friction, logarithm, diameter))
    columns = {"helix_diameter_m": diameter, "friction": friction, "inserted_length_m": length}
    return pd.DataFrame(columns | {"feed_speed_m_per_s": feed, "air_supply_m3_per_h": 3600.0 * air})


def print_law(constants: Constants, trim: Trim | None = None) -> None:
    """Print the constants of the law, and of a trim."""
    values = constants.model_dump() | (trim.model_dump() if trim else {})
    rows = [(name, f"{value:.4g}", *DESCRIPTIONS[name]) for name, value in values.items()]
    print_table("The law's constants", ("constant", "value", "unit", ""), rows, left=4)


def write_law(
    constants: Constants,
    plant: PlantData,
    place: EvaluationCase,
    st: Path | None,
    csv: Path | None,
    trim: Trim | None = None,
) -> None:
    """Write the law as structured text (with a trim, if any) and as a table.

    Warns if the plant needs more tension than the law's fixed least air was chosen for, or other tubes.
    """
    needed, usual = place.config.required_tension, TaskConfig().required_tension
    if needed > usual:
        warnings.warn(
            f"required_tension = {needed:g} N: the law's least air, {3600.0 * plant.air_supply_rates[0]:.4g} m3/h, was"
            f" chosen for {usual:g} N and can lose the drive; raise air_supply_rates[0] in [air] of the tube's file, or"
            " evaluate shielded:plc-proportional",
            stacklevel=2,
        )
    check_domains({"the law": Domain.of_map(stored_map())}, place.config, place.contexts, strict=False)
    if st:
        write_atomically(st, structured_text(constants, plant, trim))
        print(f"written: {st}")
    if csv:
        diameters = sorted({context.helix_diameter for context in place.contexts})
        rows = table(constants, plant, diameters, place.config.scene.tube.helix_length)
        write_atomically(csv, rows.to_csv(index=False, float_format="%.6g"))
        print(f"written: {csv}")
