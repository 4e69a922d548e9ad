"""Studies that are code: claims of the published study, accuracy against cost, stability, and the shipped data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, Final, NamedTuple

import pandas as pd

from agents.evaluation.workers import Workers
from agents.terminal.tables import print_table


@dataclass(frozen=True)
class Request:
    """Options of a study that is code.

    Attributes:
        output: folder of what is made; runs that are there already are not repeated.
        limit: tubes, cases or groups, the first so many; None: as for the shipped data.
        trials: designs, laws or seeds that are tried; None: as for the shipped data.
        tube: a plant's file or name; default: table 2.
        workers: that simulate.
    """

    output: Path
    limit: int | None = None
    trials: int | None = None
    tube: Path | None = None
    workers: Workers = field(default_factory=Workers)

    def without(self, *names: str) -> None:
        """Raise ValueError where an option is given that a study does not have."""
        for name in names:
            if getattr(self, name) is not None:
                raise ValueError(f"{name} = {str(getattr(self, name))!r}: this study has no such option")

    def budget(self, name: str, usual: int, most: int = 10**9) -> int:
        """``limit`` or ``trials``, the usual one if it is not given; ValueError if it is not 1 to ``most``."""
        value: int = usual if getattr(self, name) is None else getattr(self, name)
        if not 1 <= value <= most:
            accepted = "1 and more" if most == 10**9 else f"1 to {most}"
            raise ValueError(f"{name} = {value!r} is outside the accepted range {accepted}")
        return value


class BuiltIn(NamedTuple):
    """A study that is code: the module whose ``run`` takes a ``Request``, and what it answers or makes."""

    module: str
    question: str

    def run(self, request: Request) -> Any:
        """Run what is not stored yet, write and print the results; returns them."""
        return import_module(f"agents.studies.{self.module}").run(request)


BUILT_IN: Final[dict[str, BuiltIn]] = {
    "claims": BuiltIn("claims", "What of the published study's claims does the simulator confirm?"),
    "chart": BuiltIn("chart", "Which method is how accurate at which cost?"),
    "stability": BuiltIn("stability", "Which time steps hold, by method, stiffness and length?"),
    "vibration-map": BuiltIn("shipped.vibration_map", "Makes the vibration map, also of your own tube."),
    "best-schedules": BuiltIn("shipped.best_schedules", "Searches best-constant and best-schedule."),
    "best-round-trip": BuiltIn("shipped.best_round_trip", "Searches feed and air in and back."),
    "response": BuiltIn("shipped.response", "Makes the response that calibrations go by."),
    "plc-constants": BuiltIn("shipped.plc_constants", "Searches the constants of the PLC laws."),
}
"""Name -> study."""


def print_frame(title: str, table: pd.DataFrame, columns: Sequence[str] = (), texts: int = 1) -> None:
    """Print columns (default: all) of a table, numbers with three digits; the first ``texts`` stand to the left."""
    chosen = list(columns or table.columns)
    rows = [
        [cell if isinstance(cell, str) else "-" if cell != cell else f"{cell:.3g}" for cell in row]
        for row in table[chosen].to_numpy(dtype=object)
    ]
    print_table(title, chosen, rows, left=texts)
