"""Colours, grid and writer of all figures.

The import selects matplotlib's backend without a display.
"""

import io
from collections.abc import Iterable
from itertools import cycle
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from probe_agents.records.atomic import write_atomically

MM = 1e3
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#222222", "#8a8a8a")
"""Colour-blind safe palette of Okabe and Ito."""
BLUE, RED, GREY = "#1f5fa8", "#c0392b", "0.45"


def picture(figure: Figure, dpi: int = 110, kind: str = "png", grid: bool = True) -> bytes:
    """A figure as a file of a kind of picture, with grid lines in all axes; the figure is closed."""
    for axis in figure.axes if grid else ():
        axis.grid(color="0.9", linewidth=0.8)
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=dpi, format=kind)
    plt.close(figure)
    return buffer.getvalue()


def save(figure: Figure, path: Path, dpi: int = 110, grid: bool = True) -> Path:
    """Write a figure atomically and close it, see ``picture``."""
    write_atomically(path, picture(figure, dpi, path.suffix.removeprefix("."), grid))
    return path


def escape_dollars(name: str) -> str:
    """A name with its dollar signs escaped, so that matplotlib does not read a formula."""
    return name.replace("$", r"\$")


def colours() -> list[str]:
    """Different colours for 22 lines, first those of ``PALETTE``."""
    tab = [to_hex(colour) for colour in plt.get_cmap("tab20").colors]  # type: ignore[attr-defined]
    return [*PALETTE, *tab[8:12:2], *tab[16:20:2], *tab[1::2]]


def policy_colours(names: Iterable[str]) -> dict[str, str]:
    """Colours of policies, the same in the report and in the app; best-schedule always has the second one."""
    first, second, *others = colours()
    free = cycle([first, *others])
    return {name: second if name == "best-schedule" else next(free) for name in dict.fromkeys(names)}
