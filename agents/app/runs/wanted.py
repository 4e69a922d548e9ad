"""What is to be run: the arguments of ``probe-env evaluate``, by which it is also kept and gone on with."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from agents.app.runs.driven import BY_HAND, Driven
from agents.evaluation.plan import Plan
from agents.evaluation.run import plan_of
from agents.policies.catalogue import name_and_spec, own_policies
from agents.policies.places import place_at

COMMAND: Final = "probe-env evaluate"
OPTIONS: Final = {"limit": int, "seeds": int, "fidelity": str, "tube": Path}
HAND_DRIVEN: Final = "probe-env app"
"""What made a folder that nobody can make again by a command."""


@dataclass(frozen=True)
class Wanted:
    """Policies in some tubes, into a folder.

    Attributes:
        policies: by their specs, see ``agents.policies.catalogue``.
        output: the folder of the evaluation.
        tube: a plant's file; None: the shipped list.
        limit: so many tubes.
        seeds: of each tube.
        fidelity: of the simulation.
        driven: whether somebody drives by hand beside the policies.
    """

    policies: tuple[str, ...]
    output: Path
    tube: Path | None = None
    limit: int = 1
    seeds: int = 1
    fidelity: str = "fast"
    driven: bool = False

    @property
    def names(self) -> list[str]:
        """Of the policies, as tables give them."""
        return [BY_HAND] * self.driven + [name_and_spec(spec)[0] for spec in self.policies]

    @property
    def arguments(self) -> list[str]:
        """Of the command that does the same, without its name."""
        tube = [] if self.tube is None else ["--tube", str(self.tube)]
        figures = ["--limit", str(self.limit), "--seeds", str(self.seeds), "--fidelity", self.fidelity]
        return [*self.policies, *tube, *figures, "--output", str(self.output)]

    @property
    def command(self) -> str:
        """That does the same from a terminal; of what was driven by hand there is none."""
        return HAND_DRIVEN if self.driven else f"{COMMAND} {shlex.join(self.arguments)}"

    @classmethod
    def of_command(cls, command: str, output: Path) -> Wanted:
        """What a command asks for that ``command`` has written; the folder is where it was found.

        Raises:
            ValueError: another command.
        """
        words = shlex.split(command)
        if words[:2] != COMMAND.split():
            raise ValueError(f"command = {command!r} is not one that goes on here: it begins with {COMMAND!r}")
        specs: list[str] = []
        given: dict[str, str] = {}
        rest = iter(words[2:])
        for word in rest:
            if word.startswith("--"):
                given[word[2:]] = next(rest, "")
            else:
                specs.append(word)
        unknown = sorted(set(given) - {*OPTIONS, "output"})
        if unknown or not specs:
            reason = f"--{unknown[0]} is an option that this page does not have" if unknown else "it names no policy"
            raise ValueError(f"command = {command!r}: {reason}; the command itself goes on")
        fields = {name: kind(given[name]) for name, kind in OPTIONS.items() if name in given}
        return replace(cls(tuple(specs), output), **fields)

    def plan(self) -> Plan:
        """The evaluation.

        Raises:
            FileNotFoundError: no such tube or schedule.
            ValueError: what the command would refuse.
        """
        place = place_at(self.tube, "test", self.limit)
        if not self.driven:
            return plan_of(self.policies, place, self.seeds, self.fidelity)
        plan = plan_of(self.policies or ("constant",), place, self.seeds, self.fidelity)
        rivals = plan.policies if self.policies else {}
        return replace(plan, policies={BY_HAND: Driven(plan.config), **rivals})

    @property
    def own(self) -> Sequence[str]:
        """Names of the policies that are the user's."""
        return [BY_HAND] * self.driven + own_policies(self.policies)
