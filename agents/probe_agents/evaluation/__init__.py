"""Evaluation of policies on the same tubes: KPIs, paired statistics, reports, films and inspection signals."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from probe_agents.evaluation.run import evaluate as evaluate


def __getattr__(name: str) -> Any:
    """``evaluate``, whose imports take a second."""
    if name == "evaluate":
        from probe_agents.evaluation.run import evaluate

        return evaluate
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
