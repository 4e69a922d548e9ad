"""Commands for what controllers can reach."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Plc:
    """A feedback law of ten constants, as structured text and table for your plant."""

    st: Path | None = None
    """Write the law as IEC 61131-3 structured text here."""
    csv: Path | None = None
    """Write it as a table by helix diameter, friction and length here."""
    trimmed: bool = False
    """With --st: with integral action on the noise, as the policy trimmed-law acts."""
    tube: Path | None = None
    """Your own plant (tube.toml), whose bore, air, probe and ranges the law takes."""

    def run(self) -> None:
        """Write, print."""
        from agents.plant.plc_export import print_law, write_law
        from agents.policies.places import place_at
        from agents.policies.plc_law import PlantData, read_constants, read_trim

        if self.trimmed and not self.st:
            raise ValueError("trimmed = True needs --st: a table has no memory to trim with")
        constants = read_constants()
        place = place_at(self.tube, "test")
        trim = read_trim() if self.trimmed else None
        write_law(constants, PlantData.of(place.config), place, self.st, self.csv, trim)
        print_law(constants, trim)
