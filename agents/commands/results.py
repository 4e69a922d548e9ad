"""The command that makes everything published again."""

from __future__ import annotations

from dataclasses import dataclass

import tyro


@dataclass(frozen=True)
class Results:
    """Make published results again where they are stale, in order, from a clean commit; what is interrupted goes on."""

    stages: tyro.conf.Positional[tuple[str, ...]] = ()
    """Stages of configs/results.toml, made with what they read; none: all."""
    plan: bool = False
    """Only say what is stale, why, and how long it takes."""

    def run(self) -> None:
        """Say what is stale, run it, publish it."""
        from agents.records.stages import run_results

        run_results(self.stages, self.plan)
