"""For a PLC: the recommended schedule as a recipe, and a feedback law as IEC 61131-3 structured text or as a table."""

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd

from probe_agents.plant.recommendation import is_misspecified, optimal_schedule, route_air
from probe_agents.plant.response import stored_response
from probe_agents.policies import plc_law
from probe_agents.policies.cases import EvaluationCase, load_case
from probe_agents.policies.on_map import WORST, min_air
from probe_agents.policies.plc_law import SHORTEST, TRIM, Constants, PlantData, law_at
from probe_agents.policies.policy import Domain, check_domains
from probe_agents.records.atomic import write_text
from probe_agents.terminal.tables import print_table
from probe_env import Plant
from probe_env.envs.vibration_map import stored_map
from probe_env.inspection.sensor import REFERENCE_RMS, Sensor
from probe_env.schedule import Schedule

RECIPE: Final = "linear between rows"
RECIPE_HEADER: Final = ("length [m]", "feed [mm/s]", "air [m3/h]")
TEMPLATE: Final = Path(__file__).parent / "data" / "feed-law.st.j2"
TABLE_FRICTIONS: Final = (*(round(0.08 + 0.02 * k, 2) for k in range(14)), 0.4, 0.5, 0.7, 1.0)
"""As estimated: weight and expanding air count as friction."""
TABLE_STEP: Final = 2.5
"""Step of the length in a table [m]."""
DESCRIPTIONS: Final = {
    "average": ("s", "time constant of the average of mu"),
    "noise_average": ("s", "time constant of the average of v for L'"),
    "fast_feed": ("", "feed up to L0 over the fastest"),
    "fast_air": ("", "air up to L0, from 0 (least) to 1 (most)"),
    "slow_air": ("", "air beyond L0, from 0 (least) to 1 (most)"),
    "onset_length": ("m", "L0 at mu = 0.175 and D = 1.5 m"),
    "onset_friction": ("", "L0 ~ mu^-onset_friction"),
    "onset_diameter": ("", "L0 ~ D^onset_diameter"),
    "slow_feed": ("m/s", "u at L' = 30 m, mu = 0.175, D = 1.5 m"),
    "slow_length": ("", "u ~ L'^-slow_length"),
    "slow_friction": ("", "u ~ mu^-slow_friction"),
    "slow_diameter": ("", "u ~ D^slow_diameter"),
    "quiet": ("m", "noise v at which L' = L"),
    "shift": ("", "L' = L (v / quiet)^shift"),
    "max_shift": ("", "limit of |ln(L' / L)|"),
    "margin": ("", "root tension over the required one, with the least air"),
    "aim": ("m", "target of v beyond L0"),
    "trim_time": ("s", "d(ln u)/dt = ln(aim / v) / trim_time"),
    "trim_average": ("s", "time constant of the average of this v"),
    "max_excess": ("", "limit of ln(v / aim)"),
    "max_deficit": ("", "limit of ln(aim / v)"),
    "max_decrease": ("", "limit of the decrease of ln(u)"),
    "max_increase": ("", "limit of the increase of ln(u)"),
}
"""Constant -> unit and formula in ``SYMBOLS``."""
SYMBOLS: Final = "mu friction, D helix diameter, L inserted length, L0 onset, u feed beyond L0, v noise"
PLANT_DATA: Final = {
    "AIR_SPEED": "m/s of wind per m3/s of supply",
    "DRAG": "N s2/m3, floats per metre",
    "FLOAT_DIAMETER": "m",
    "LEAST_FEED": "m/s",
    "MOST_FEED": "m/s",
    "LEAST_AIR": "m3/s",
    "MOST_AIR": "m3/s",
    "REQUIRED_TENSION": "N, root tension below which the drive is lost",
}


def recipe_of(plant: Plant | None) -> Schedule | str:
    """The recommended schedule for a plant (None: the study's), or why there is none."""
    if is_misspecified(plant):
        return "the calibration of the plant is misspecified: calibrate again"
    case = load_case(plant, "train")
    try:
        start_air = route_air(plant, case.contexts)
        bundle = plant.bundle_for(case.config) if plant else None
        return optimal_schedule(case.contexts, stored_response(), case.config, start_air, bundle).schedule
    except ValueError as error:
        return str(error)


def recipe_rows(schedule: Schedule) -> list[tuple[str, str, str]]:
    """Inserted length [m], feed [mm/s] and air [m3/h] of a schedule, as text."""
    columns = zip(schedule.position, schedule.feed_speed, schedule.air_supply_rate, strict=True)
    return [(f"{length:g}", f"{1e3 * feed:.1f}", f"{3600.0 * air:.1f}") for length, feed, air in columns]


def print_recipe(recipe: Schedule | str) -> None:
    """Print a recipe, or why there is none."""
    if isinstance(recipe, str):
        print(f"no recommended schedule: {recipe}")
    else:
        print_table(f"Recommended schedule, {RECIPE}", RECIPE_HEADER, recipe_rows(recipe))


def structured_text(
    constants: Constants,
    plant: PlantData,
    integral: bool = False,
    recipe: Schedule | str = "",
    sensor: Sensor | None = None,
) -> str:
    """Write recipe, law as a function block, and the scaling of its inputs.

    Args:
        constants: the constants.
        plant: data of the plant.
        integral: with integral action on the noise.
        recipe: the recommended schedule, or why there is none.
        sensor: sensor of the plant, for the scaling of the noise; default: that of the study's plant.
    """
    from jinja2 import Environment, StrictUndefined

    values = [plant.air_speed_per_supply, plant.drag, plant.float_diameter, *plant.feed_speeds]
    values += [*plant.air_supply_rates, plant.required_tension]
    entries = [(n.upper(), v, DESCRIPTIONS[n][0] or "-") for n, v in _values(constants, integral).items()]
    environment = Environment(
        trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True, undefined=StrictUndefined, autoescape=False
    )
    environment.filters["real"] = _real
    return environment.from_string(TEMPLATE.read_text(encoding="utf-8")).render(
        law=plc_law,
        trim=integral,
        header=RECIPE_HEADER,
        about_recipe=RECIPE,
        recipe=recipe if isinstance(recipe, str) else recipe_rows(recipe),
        sensor=sensor or Sensor(),
        reference_rms=REFERENCE_RMS,
        constants=entries,
        plant=[(name, value, unit) for (name, unit), value in zip(PLANT_DATA.items(), values, strict=True)],
    )


def _real(value: float) -> str:
    """A REAL literal with seven digits (the precision of a REAL), without an exponent, which some compilers refuse."""
    text = np.format_float_positional(value, precision=7, unique=False, fractional=False, trim="-")
    return text if "." in text else f"{text}.0"


def table(constants: Constants, plant: PlantData, diameters: Sequence[float], helix_length: float) -> pd.DataFrame:
    """Feed and air by helix diameter, friction and inserted length [m], at the reference noise of the law."""
    lengths = np.append(np.arange(SHORTEST, helix_length, TABLE_STEP), helix_length)
    grid = np.meshgrid(diameters, TABLE_FRICTIONS, lengths, indexing="ij")
    diameter, friction, length = (values.ravel() for values in grid)
    logarithm = np.full(len(length), np.log(constants.quiet))
    feed, air, _ = law_at(constants, plant, (length, friction, logarithm, diameter))
    columns = {"helix_diameter_m": diameter, "friction": friction, "inserted_length_m": length}
    return pd.DataFrame(columns | {"feed_speed_m_per_s": feed, "air_supply_m3_per_h": 3600.0 * air})


def _values(constants: Constants, integral: bool) -> dict[str, float]:
    return constants.model_dump(exclude=None if integral else set(TRIM))


def print_law(constants: Constants, integral: bool = False) -> None:
    """Print the constants of the law, and those of the integral action if ``integral``."""
    rows = [(name, f"{value:.4g}", *DESCRIPTIONS[name]) for name, value in _values(constants, integral).items()]
    print_table(f"The law's constants ({SYMBOLS})", ("constant", "value", "unit", ""), rows, left=4)


def write_law(
    constants: Constants,
    plant: PlantData,
    case: EvaluationCase,
    st: Path | None,
    csv: Path | None,
    integral: bool = False,
    recipe: Schedule | str = "",
) -> None:
    """Write the law as structured text (with integral action if ``integral``, and a recipe) and as a table.

    Warns if the plant requires more tension than the most air gives in all tubes, or is outside the law's domain.
    """
    most = plant.air_supply_rates[1]
    if min_air(case.config) == most:
        warnings.warn(
            f"required_tension = {case.config.required_tension:.3g} N: the most air, {3600.0 * most:.4g} m3/h, can lose"
            f" the drive in a helix of {WORST.helix_diameter:g} m with friction {WORST.friction:g}",
            stacklevel=2,
        )
    check_domains({"the law": Domain.of_map(stored_map())}, case.config, case.contexts, strict=False)
    if st:
        write_text(st, structured_text(constants, plant, integral, recipe, case.config.sensor))
    if csv:
        diameters = sorted({context.helix_diameter for context in case.contexts})
        rows = table(constants, plant, diameters, case.config.scene.tube.helix_length)
        write_text(csv, rows.to_csv(index=False, float_format="%.6g"))
