"""Studies that are code: claims of the published study, accuracy against cost, stability, and the shipped data."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, Final, NamedTuple

from agents.evaluation.workers import Workers


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
    """A study that is code: module and function that takes a ``Request``, and what it answers or makes."""

    place: str
    question: str

    @property
    def run(self) -> Callable[[Request], Any]:
        """The function."""
        module, _, name = self.place.partition(":")
        return getattr(import_module(module), name)  # type: ignore[no-any-return]


def claims(request: Request) -> None:
    """The published study's claims; ``trials`` are perturbed runs of a case, any ``limit`` five cases."""
    from agents.studies.claims import run_claims

    request.without("tube")
    run_claims(
        request.output, request.budget("trials", 1, 1000), subset=request.limit is not None, jobs=request.workers.jobs
    )


def chart(request: Request) -> None:
    """Accuracy against cost."""
    from agents.studies.chart import run_chart

    request.without("tube", "limit", "trials")
    run_chart(request.output)


def stability(request: Request) -> None:
    """The map of time steps."""
    from agents.studies.stability import run_stability

    request.without("tube", "limit", "trials")
    run_stability(request.output, jobs=request.workers.jobs)


HERE: Final = "agents.studies"
BUILT_IN: Final[dict[str, BuiltIn]] = {
    "claims": BuiltIn(f"{HERE}.builtin:claims", "What of the published study's claims does the simulator confirm?"),
    "chart": BuiltIn(f"{HERE}.builtin:chart", "Which method is how accurate at which cost?"),
    "stability": BuiltIn(f"{HERE}.builtin:stability", "Which time steps hold, by method, stiffness and length?"),
    "vibration-map": BuiltIn(f"{HERE}.shipped.vibration_map:run", "Makes the vibration map, also of your own tube."),
    "best-schedules": BuiltIn(f"{HERE}.shipped.best_schedules:run", "Searches best-constant and best-schedule."),
    "best-round-trip": BuiltIn(f"{HERE}.shipped.best_round_trip:run", "Searches feed and air in and back."),
    "response": BuiltIn(f"{HERE}.shipped.response:run", "Makes the response that calibrations go by."),
    "plc-constants": BuiltIn(f"{HERE}.shipped.plc_constants:run", "Searches the constants of the PLC laws."),
}
"""Name -> study."""
