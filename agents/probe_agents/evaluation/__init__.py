"""Evaluation of policies on the same tubes: KPIs, paired statistics, reports, films and inspection signals."""

from typing import TYPE_CHECKING

from probe_env.lazy import lazy

if TYPE_CHECKING:
    from probe_agents.evaluation.plan import Plan, run_plan
    from probe_agents.evaluation.run import evaluate
    from probe_agents.evaluation.statistics import (
        Interval,
        paired_difference,
        performance_profile,
        probability_of_improvement,
        summarise,
    )

__all__ = [
    "Interval", "Plan", "evaluate", "paired_difference", "performance_profile", "probability_of_improvement",
    "run_plan", "summarise",
]  # fmt: skip
__getattr__, __dir__ = lazy(__name__)
