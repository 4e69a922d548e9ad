"""Command app."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class App:
    """Open the app in the browser: edit a schedule, run it in your tube, watch and compare.

    The page is served to this machine only.

    Example: probe-env app --tube mine.toml
    """

    tube: Path | None = None
    """Tube file (tube.toml) to open; default: the study's tubes."""
    port: int = 5006
    """Port of the server; 0: any free port."""
    output: Path = Path("output/app")
    """Folder of runs, schedules and tubes."""
    show: bool = True
    """Open the page in the default browser."""

    def run(self) -> None:
        """Serve until it is interrupted."""
        from agents.app.server import serve

        serve(self.tube, self.port, self.output, self.show)
