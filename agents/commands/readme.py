"""Command of the documentation."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Readme:
    """Rewrite the README's tables and figures from the stored results."""

    check: bool = False
    """Change nothing; fail if the README is not what the stored results say."""

    def run(self) -> None:
        """Rewrite or check."""
        from agents.commands.publishing import check_checkout
        from agents.pages.rewrite import check_readme, rewrite_readme

        check_checkout("readme")
        check_readme() if self.check else rewrite_readme()
