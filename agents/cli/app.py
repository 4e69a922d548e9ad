"""Command app."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class App:
    """Open a page on this machine on which a schedule is dragged, run on your tube, watched and compared.

    Nothing leaves the machine, and nobody else is let in.
    """

    tube: Path | None = None
    """Your own plant (tube.toml) to begin with; default: the study's tubes."""
    port: int = 5006
    """To listen at; 0: any that is free."""
    output: Path = Path("output/app")
    """Folder of runs (ordinary evaluation folders), schedules and tubes; what is there is listed."""
    show: bool = True
    """Open a browser."""

    def run(self) -> None:
        """Serve until it is interrupted."""
        from agents.app.server import serve

        serve(self.tube, self.port, self.output, self.show)
