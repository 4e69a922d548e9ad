"""Built-in studies: claims of the published study, accuracy and cost, stability, shipped data."""

from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, Final, NamedTuple

import pandas as pd

from probe_agents.evaluation.workers import Workers
from probe_agents.terminal.tables import print_table


class Count(NamedTuple):
    """What an option of a built-in study counts, and its largest value."""

    what: str
    largest: int = 10**9


class BuiltIn(NamedTuple):
    """A built-in study.

    Attributes:
        function: ``module.function``, called with the output folder, the options that are set, and ``workers``.
        question: question of the study, or what it makes.
        options: options that it has; None for one that is not a number.
    """

    function: str
    question: str
    options: Mapping[str, Count | None] = {}

    @property
    def summary(self) -> str:
        """The question, and what its options count."""
        counts = [f"--{name}: {count.what}" for name, count in self.options.items() if count]
        return " ".join((self.question, *([f"({'; '.join(counts)})"] if counts else ())))

    def run(self, output: Path, workers: Workers, **options: Any) -> Any:
        """Run what is not stored, write and print the results; returns them.

        Raises:
            ValueError: an option is set that the study does not have, or is out of range; nothing was run.
        """
        chosen = {name: value for name, value in options.items() if value not in (None, ())}
        for name, value in chosen.items():
            if name not in self.options:
                shown = ", ".join(value) if isinstance(value, tuple) else value
                raise ValueError(f"{name} = {shown}: this study has no such option")
            if (count := self.options[name]) and not 1 <= value <= count.largest:
                accepted = "1 and more" if count.largest == Count("").largest else f"1 to {count.largest}"
                raise ValueError(f"{name} = {value} is outside the accepted range {accepted} ({count.what})")
        module, _, function = self.function.partition(".")
        return getattr(import_module(f"probe_agents.studies.{module}"), function)(output, workers=workers, **chosen)


BUILT_IN: Final[dict[str, BuiltIn]] = {
    "claims": BuiltIn(
        "claims.run", "Which claims of the published study does the simulator confirm?",
        {"limit": Count("cases"), "trials": Count("runs of each case", 1000), "assumptions": None},
    ),
    "chart": BuiltIn("chart.run", "How accurate is each method, and at which cost?", {"assumptions": None}),
    "stability": BuiltIn(
        "stability.run", "Which time steps are stable, by method, stiffness and length?", {"assumptions": None}
    ),
    "effects": BuiltIn(
        "effects.run", "What do the parts of the whole model that the study leaves out, and further effects, change?",
        {"trials": Count("members of each setting", 1000)},
    ),
    "vibration-map": BuiltIn(
        "vibration_map.run", "Makes the vibration map of the study's tubes or of your plant.",
        {"trials": Count("insertions in each tube", 100), "tube": None},
    ),
    "best-schedules": BuiltIn(
        "searches.search_schedules", "Searches best-constant and best-schedule.",
        {"trials": Count("schedules in each search"), "tube": None},
    ),
    "response": BuiltIn(
        "response.run", "Makes the response model of calibrations.", {"limit": Count("groups of 32 insertions", 256)}
    ),
    "surrogate-noise": BuiltIn(
        "surrogate_noise.run", "Fits the noise of the surrogate.", {"limit": Count("groups of 16 insertions", 6)}
    ),
    "plc-constants": BuiltIn(
        "searches.search_plc", "Searches the constants of plc-integral.",
        {"limit": Count("tubes of a generation", 96), "trials": Count("insertions")},
    ),
    "plc-by-tube": BuiltIn(
        "searches.search_plc_by_tube", "What would plc-integral earn with constants for each tube?",
        {"limit": Count("test tubes", 48), "trials": Count("insertions in each tube")},
    ),
    "learning": BuiltIn(
        "readme.learn", "What does the README's recipe learn, with PPO and with another algorithm?",
        {"limit": Count("test tubes", 48), "trials": Count("training seeds of each recipe")},
    ),
    "speed": BuiltIn("readme.measure_speed", "How many environment steps a second does this machine run?"),
}  # fmt: skip
"""Name -> study."""


def print_frame(title: str, table: pd.DataFrame, columns: Sequence[str] = (), texts: int = 1) -> None:
    """Print columns (default: all) of a table, numbers with three digits; the first ``texts`` are aligned left."""
    chosen = list(columns or table.columns)
    rows = [
        [cell if isinstance(cell, str) else "-" if cell != cell else f"{cell:.3g}" for cell in row]
        for row in table[chosen].to_numpy(dtype=object)
    ]
    print_table(title, chosen, rows, left=texts)
