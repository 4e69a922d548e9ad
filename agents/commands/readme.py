"""Command of the documentation."""

from __future__ import annotations

from dataclasses import dataclass


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
