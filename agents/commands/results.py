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

    confirm: bool = False
    """Where code was rewritten: run a sample with the commit that made the results and with this one, and keep the
    results if all numbers are the same."""

    since: str = ""
    """With --confirm: one commit at which all were up to date, to compare with; its kernels are compiled once."""

    def run(self) -> None:
        """Say what is stale, run it, publish it."""
        from agents.publishing.confirm import confirm_results
        from agents.publishing.places import check_checkout
        from agents.publishing.stages import run_results

        if self.since and not self.confirm:
            raise ValueError(f"since = {self.since!r} goes with --confirm")
        check_checkout("results")
        if self.confirm:
            confirm_results(self.stages, self.since)
        else:
            run_results(self.stages, self.plan)


@dataclass(frozen=True)
class Readme:
    """Rewrite the tables and figures of the README and of docs/ from the stored results."""

    check: bool = False
    """Change nothing; fail if a page is not what the stored results say."""

    def run(self) -> None:
        """Rewrite or check."""
        from agents.pages.rewrite import check_readme, rewrite_readme
        from agents.publishing.places import check_checkout

        check_checkout("readme")
        check_readme() if self.check else rewrite_readme()
