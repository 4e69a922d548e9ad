"""Colours, grid and writer of all figures.

The import selects matplotlib's backend without a display.
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
    """Write a figure atomically and close it."""
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=dpi, format=path.suffix.removeprefix("."))
    write_atomically(path, buffer.getvalue())
    plt.close(figure)
    return path


def escape_dollars(name: str) -> str:
    """A name with its dollar signs escaped, so that matplotlib does not read a formula."""
    return name.replace("$", r"\$")


def colours() -> list[Any]:
    """Twenty colours, the dark ones first."""
    return list(plt.get_cmap("tab20").colors[::2] + plt.get_cmap("tab20").colors[1::2])  # type: ignore[attr-defined]
