"""An output folder of probes is of one plant: it says so before the first probe is tried in it."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from agents.policies.places import TABLE_2, Named
from agents.records.models import Stored, read_json
from agents.records.provenance import write_json

FILE: Final = "tube.json"
HELD: Final = ("designs.jsonl", "study.db", "trials.csv")
"""What a folder without that file holds of table 2's tubes: it is older, or was never of a plant."""


class Tube(Stored):
    """``tube.json``."""

    name: str
    digest: str


def claim(output: Path, tube: Named) -> None:
    """Write down which plant the trials in a folder are of; what says nothing is of table 2's tubes.

    Raises:
        ValueError: it holds trials in another; nothing is changed.
    """
    path = output / FILE
    before = read_json(path, Tube) if path.exists() else None
    held = before is not None or any((output / name).exists() for name in HELD)
    name, digest = (before.name, before.digest) if before else (TABLE_2.name, TABLE_2.digest)
    if held and digest != tube.digest:
        other = "" if name != tube.name else ", as its file was then"
        raise ValueError(
            f"output = {str(output)!r} holds trials in the tubes of {name}{other}, not of {tube.name}: choose another"
            " folder"
        )
    if tube != TABLE_2:
        output.mkdir(parents=True, exist_ok=True)
        write_json(path, {"name": tube.name, "digest": tube.digest})
