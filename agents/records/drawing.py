"""What all pictures share: colours, grid, and how they are written.

Drawn without a screen: importing this chooses matplotlib's backend.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from agents.records.atomic import write_atomically

MM = 1e3
GRID: dict[str, Any] = {"color": "0.9", "linewidth": 0.8}
BLUE, RED, GREY = "#1f5fa8", "#c0392b", "0.45"


def save(figure: Figure, path: Path, dpi: int = 110) -> Path:
    """Write a figure as a whole, and close it."""
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=dpi, format=path.suffix.removeprefix("."))
    write_atomically(path, buffer.getvalue())
    plt.close(figure)
    return path


def escape_dollars(name: str) -> str:
    """A name as it is: between dollar signs would be a formula."""
    return name.replace("$", r"\$")


def colours() -> list[Any]:
    """Twenty colours, the strong ones first."""
    return list(plt.get_cmap("tab20").colors[::2] + plt.get_cmap("tab20").colors[1::2])  # type: ignore[attr-defined]
