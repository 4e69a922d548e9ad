"""What the stored descriptions of an evaluation say of its policies."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from agents.evaluation.page.stored import Evaluation
from agents.policies.on_map import Privileged
from agents.policies.planning.inspection import InspectionPlanner
from agents.policies.planning.planner import Planner
from agents.rollouts.statistics import method_and_seed

KNOWING: Final = frozenset(kind.__name__ for kind in (Privileged, Planner, InspectionPlanner))
WRAPPED: Final = ("forth", "of")
"""Where the description of a policy holds that of the one that it makes use of: on the way in, shielded, in steps."""

Description = Mapping[str, Any]


def descriptions(done: Evaluation) -> dict[str, Description]:
    """The description of every method, of its first training seed; empty if what made the evaluation is not known."""
    methods: dict[str, Description] = {}
    for name, description in (done.record.policies if done.record else {}).items():
        methods.setdefault(method_and_seed(name)[0], description)
    return methods


def within(description: Description) -> Description:
    """The policy that decides, whatever keeps its drive, rounds its feed or draws the probe back for it."""
    for key in WRAPPED:
        if isinstance(description.get(key), Mapping):
            return within(description[key])
    return description


def informed(done: Evaluation) -> set[str]:
    """Methods that know what no rig does: measures, no rivals."""
    return {name for name, given in descriptions(done).items() if within(given).get("policy") in KNOWING}
