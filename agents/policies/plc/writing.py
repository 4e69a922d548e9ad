"""The law told and written: files for a PLC, and its constants in words."""

from __future__ import annotations

import warnings
from pathlib import Path

from agents.policies.domain import Domain, check_domains
from agents.policies.places import Place
from agents.policies.plc.export import structured_text, table
from agents.policies.plc.law import Constants, PlantData
from agents.policies.plc.trimmed import Trim
from agents.records.provenance import write_atomically
from agents.terminal.tables import print_table
from probe_env.envs.task import TaskConfig
from probe_env.envs.vibration_map import stored_map

DESCRIPTIONS = {
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
}
"""Constant -> unit and what it is."""
OF_TRIM = {
    "aim": ("m", "past the onset the feed is trimmed until this is the noise,"),
    "time": ("s", "... by a factor of e in this time where noise is off by e"),
}
"""Alike, of the trim."""
HEADER = ("constant", "value", "unit", "")


def rows_of(constants: Constants) -> list[tuple[str, ...]]:
    """A row a constant."""
    values = constants.model_dump()
    return [(name, f"{values[name]:.4g}", unit, what) for name, (unit, what) in DESCRIPTIONS.items()]


def print_law(constants: Constants, trim: Trim | None = None) -> None:
    """Its constants, with those of a trim."""
    rows = rows_of(constants)
    if trim:
        values = trim.model_dump()
        rows += [(name, f"{values[name]:.4g}", unit, what) for name, (unit, what) in OF_TRIM.items()]
    print_table("The law's constants", HEADER, rows, left=4)


def write_law(
    constants: Constants, plant: PlantData, place: Place, st: Path | None, csv: Path | None, trim: Trim | None = None
) -> None:
    """Write it as structured text, with its feed trimmed where there is a trim, and as a table, where asked for.

    Its least air is a fixed one: a plant that asks for more tension than the task does is told so.
    """
    needed, usual = place.config.required_tension, TaskConfig().required_tension
    if needed > usual:
        warnings.warn(
            f"required_tension = {needed:g} N: the law's least air, {3600.0 * plant.air_supply_rates[0]:.4g} m3/h, was"
            f" chosen for {usual:g} N and can lose the drive; raise air_supply_rates[0] in [air] of the tube's file, or"
            " evaluate shielded:plc-law",
            stacklevel=2,
        )
    domain = Domain.of_map(stored_map())
    check_domains({"the law": domain}, place.config, place.contexts, strict=False)
    if st:
        write_atomically(st, structured_text(constants, plant, trim))
        print(f"written: {st}")
    if csv:
        diameters = sorted({context.helix_diameter for context in place.contexts})
        tabulated = table(constants, plant, diameters, place.config.scene.tube.helix_length)
        write_atomically(csv, tabulated.to_csv(index=False, float_format="%.6g"))
        print(f"written: {csv}")
