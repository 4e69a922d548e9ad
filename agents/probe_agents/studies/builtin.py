"""Built-in studies: claims of the published study, accuracy and cost, stability, predictability, shipped data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, Final, NamedTuple

import pandas as pd

from probe_agents.evaluation.workers import Workers
from probe_agents.terminal.tables import print_table


@dataclass(frozen=True)
class Request:
    """Options of a built-in study.

    Attributes:
        output: folder of the results; stored runs are not repeated.
        limit: number of tubes, cases or groups; None: as for the shipped data.
        trials: number of designs, laws or seeds; None: as for the shipped data.
        tube: a plant's file or name; default: table 2.
        workers: workers that run the simulations.
    """

    output: Path
    limit: int | None = None
    trials: int | None = None
    tube: Path | None = None
    workers: Workers = field(default_factory=Workers)

    def reject(self, *names: str) -> None:
        """Raise ValueError if an option is set that the study does not have."""
        for name in names:
            if getattr(self, name) is not None:
                raise ValueError(f"{name} = {str(getattr(self, name))!r}: this study has no such option")

    def budget(self, name: str, default: int, largest: int = 10**9) -> int:
        """``limit`` or ``trials``, or its default; ValueError if it is not 1 to ``largest``."""
        value: int = default if getattr(self, name) is None else getattr(self, name)
        if not 1 <= value <= largest:
            accepted = "1 and more" if largest == 10**9 else f"1 to {largest}"
            raise ValueError(f"{name} = {value!r} is outside the accepted range {accepted}")
        return value


class BuiltIn(NamedTuple):
    """A built-in study: the module whose ``run`` takes a ``Request``, and its question."""

    module: str
    question: str

    def run(self, request: Request) -> Any:
        """Run what is not stored, write and print the results; returns them."""
        return import_module(f"probe_agents.studies.{self.module}").run(request)


BUILT_IN: Final[dict[str, BuiltIn]] = {
    "claims": BuiltIn("claims", "Which claims of the published study does the simulator confirm?"),
    "chart": BuiltIn("chart", "How accurate is each method, and at which cost?"),
    "stability": BuiltIn("stability", "Which time steps are stable, by method, stiffness and length?"),
    "predictability": BuiltIn(
        "predictability", "How fast do perturbations grow, and how far ahead can a planner look?"
    ),
    "vibration-map": BuiltIn("shipped.vibration_map", "Makes the vibration map of the study's tubes or of your plant."),
    "best-schedules": BuiltIn("shipped.best_schedules", "Searches best-constant and best-schedule."),
    "best-round-trip": BuiltIn("shipped.best_round_trip", "Searches feed and air of insertion and withdrawal."),
    "response": BuiltIn("shipped.response", "Makes the response model of calibrations."),
    "plc-constants": BuiltIn("shipped.plc_constants", "Searches the constants of the PLC laws."),
}
"""Name -> study."""


def print_frame(title: str, table: pd.DataFrame, columns: Sequence[str] = (), texts: int = 1) -> None:
    """Print columns (default: all) of a table, numbers with three digits; the first ``texts`` are aligned left."""
    chosen = list(columns or table.columns)
    rows = [
        [cell if isinstance(cell, str) else "-" if cell != cell else f"{cell:.3g}" for cell in row]
        for row in table[chosen].to_numpy(dtype=object)
    ]
    print_table(title, chosen, rows, left=texts)
