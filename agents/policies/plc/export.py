"""The law for a plant's PLC: IEC 61131-3 structured text, and a table by helix diameter, friction and length."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import pandas as pd

from agents.policies.plc_law import (
    CREDIBLE,
    DIAMETER,
    FRICTION,
    ITERATIONS,
    LENGTH,
    LOWERED,
    MOST_SHIFT,
    MOST_TRIM,
    NOISE_AVERAGE,
    RAISED,
    SHORTEST,
    UNKNOWN_NOISE,
    Constants,
    PlantData,
    Trim,
    law_at,
)

TABLE_FRICTIONS: Final = tuple(round(0.08 + 0.02 * k, 2) for k in range(11))
TABLE_STEP: Final = 2.5
"""[m] between the lengths of a table."""

_TEXT: Final = """\
(* Feed and air of an eddy-current probe in a helical tube, by inserted length, root tension and noise.
   {count} constants; the rest are data of the plant. SI units. IEC 61131-3 structured text.
   Call it once every Period, with Start = TRUE in the first cycle of an insertion. *)
FUNCTION_BLOCK ProbeFeedLaw
VAR_INPUT
    Start : BOOL;              (* an insertion begins *)
    Period : REAL;             (* s, between two calls *)
    InsertedLength : REAL;     (* m, cable in the helix *)
    RootTension : REAL;        (* N, at the entrance of the helix *)
    Noise : REAL;              (* m, eddy-current noise as radial rms *)
    FeedNow : REAL;            (* m/s, applied *)
    AirNow : REAL;             (* m3/s, applied *)
    HelixDiameter : REAL;      (* m *)
END_VAR
VAR_OUTPUT
    Feed : REAL;               (* m/s, to apply *)
    Air : REAL;                (* m3/s, to apply *)
END_VAR
VAR
    Friction : REAL;           (* average *)
    LogNoise : REAL;           (* average of LN(Noise) *)
{trim_variables}    Length : REAL;
    Wind : REAL;
    Share : REAL;
    X : REAL;
    Fallen : REAL;
    Gain : REAL;
    Louder : REAL;
    Onset : REAL;
    Slow : REAL;
    K : INT;
END_VAR
VAR CONSTANT
    (* the constants *)
{constants}
    (* data of the plant *)
{plant}
END_VAR

IF Start THEN
    Friction := {friction};
    LogNoise := LN(QUIET);
{trim_start}END_IF;

(* friction of steady sliding: Share = (1 - EXP(-X)) / X by Newton, X = friction * length / radius *)
Length := MAX(InsertedLength, {shortest});
Wind := AIR_SPEED * AirNow - FeedNow;
Share := LIMIT(0.01, RootTension / MAX(DRAG * Wind * Wind * Length, 0.000001), 0.95);
X := 1.0 / Share;
FOR K := 1 TO {iterations} DO
    Fallen := EXP(-X);
    X := X - (X * Share - 1.0 + Fallen) / (Share - Fallen);
END_FOR;
X := X * 0.5 * HelixDiameter / Length / (1.0 - FLOAT_DIAMETER / HelixDiameter);
X := LIMIT({least}, X, {most});

Gain := 1.0 - EXP(-Period / AVERAGE);
Friction := Friction + Gain * (X - Friction);
LogNoise := LogNoise + Gain * (LN(MAX(Noise, 0.0000001)) - LogNoise);
{trim_noise}
(* noise makes the probe act as if more or less of it were in the tube *)
Louder := LIMIT(-{shift}, SHIFT * (LogNoise - LN(QUIET)), {shift});
Length := InsertedLength * EXP(Louder);
Onset := ONSET_LENGTH * EXP(ONSET_DIAMETER * LN(HelixDiameter / {diameter})
                            - ONSET_FRICTION * LN(Friction / {friction}));
Slow := SLOW_FEED * EXP(SLOW_DIAMETER * LN(HelixDiameter / {diameter})
                        - SLOW_FRICTION * LN(Friction / {friction})
                        - SLOW_LENGTH * LN(MAX(Length, 0.1) / {length}));
IF Length < Onset THEN
    Feed := MOST_FEED;
    Air := LEAST_AIR;
ELSE
    Feed := LIMIT(LEAST_FEED, Slow, MOST_FEED);
    Air := MOST_AIR;
END_IF;
{trim_feed}END_FUNCTION_BLOCK
"""

_TRIM: Final = {
    "trim_variables": """\
    NoiseNow : REAL;           (* shorter average of LN(Noise) *)
    Trim : REAL;               (* LN of a factor on the feed *)
""",
    "trim_start": """\
    NoiseNow := LN({unknown});
    Trim := 0.0;
""",
    "trim_noise": """\
NoiseNow := NoiseNow + (1.0 - EXP(-Period / {average})) * (LN(MAX(Noise, 0.0000001)) - NoiseNow);
""",
    "trim_feed": """\
(* past the onset, where more air is blown, the feed is trimmed until the noise is what is aimed at *)
IF Air > LEAST_AIR THEN
    Trim := Trim + Period / TRIM_TIME * LIMIT(-{lowered}, LN(AIM) - NoiseNow, {raised});
    Trim := LIMIT(-{most}, Trim, {most});
    Feed := LIMIT(LEAST_FEED, Feed * EXP(Trim), MOST_FEED);
END_IF;
""",
}
"""What integral action adds."""


def structured_text(constants: Constants, plant: PlantData, trim: Trim | None = None) -> str:
    """The law as a function block, with its feed trimmed where there is a trim."""
    (slow, fast), (least, most) = plant.feed_speeds, plant.air_supply_rates
    data = {
        "AIR_SPEED": (plant.air_speed_per_supply, "m/s of wind a m3/s of supply"),
        "DRAG": (plant.drag, "N s2/m3, of the floats a metre"),
        "FLOAT_DIAMETER": (plant.float_diameter, "m"),
        "LEAST_FEED": (slow, "m/s"), "MOST_FEED": (fast, "m/s"),
        "LEAST_AIR": (least, "m3/s"), "MOST_AIR": (most, "m3/s"),
    }  # fmt: skip
    units = {"average": "s", "onset_length": "m", "slow_feed": "m/s", "quiet": "m"}
    own = {name.upper(): (value, units.get(name, "-")) for name, value in constants.model_dump().items()}
    if trim:
        own |= {"AIM": (trim.aim, "m"), "TRIM_TIME": (trim.time, "s")}
    numbers = {"unknown": UNKNOWN_NOISE, "average": NOISE_AVERAGE, "lowered": LOWERED, "raised": RAISED}
    numbers |= {"most": MOST_TRIM}
    written = {name: _real(value) for name, value in numbers.items()}
    trimming = {name: text.format(**written) if trim else "" for name, text in _TRIM.items()}
    return _TEXT.format(
        count="Twelve" if trim else "Ten", constants=_declared(own), plant=_declared(data), friction=_real(FRICTION),
        diameter=_real(DIAMETER), length=_real(LENGTH), shortest=_real(SHORTEST), shift=_real(MOST_SHIFT),
        iterations=ITERATIONS, least=_real(CREDIBLE[0]), most=_real(CREDIBLE[1]), **trimming,
    )  # fmt: skip


def _declared(values: dict[str, tuple[float, str]]) -> str:
    return "\n".join(f"    {name} : REAL := {_real(value)};  (* {unit} *)" for name, (value, unit) in values.items())


def _real(value: float) -> str:
    """A REAL literal with seven digits, all that a REAL has; never with an exponent, which some compilers refuse."""
    text = np.format_float_positional(value, precision=7, unique=False, fractional=False, trim="-")
    return text if "." in text else f"{text}.0"


def table(
    constants: Constants, plant: PlantData, diameters: Sequence[float], helix_length: float, noise: float | None = None
) -> pd.DataFrame:
    """Feed and air by helix diameter, friction and inserted length, for a controller that holds tables.

    Args:
        constants: of the law.
        plant: its data.
        diameters: of the helices [m].
        helix_length: [m].
        noise: as radial rms [m]; default: that at which it shifts nothing.
    """
    lengths = np.append(np.arange(SHORTEST, helix_length, TABLE_STEP), helix_length)
    grid = np.meshgrid(diameters, TABLE_FRICTIONS, lengths, indexing="ij")
    diameter, friction, length = (values.ravel() for values in grid)
    logarithm = np.full(len(length), np.log(noise or constants.quiet))
    feed, air = law_at(constants, plant, (length, friction, logarithm, diameter))
    columns = {
        "helix_diameter_m": diameter, "friction": friction, "inserted_length_m": length,
        "feed_speed_m_per_s": feed, "air_supply_m3_per_h": 3600.0 * air,
    }  # fmt: skip
    return pd.DataFrame(columns)
