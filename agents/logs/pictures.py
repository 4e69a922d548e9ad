"""A picture of a log: all channels over time and over inserted length."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from agents.logs.log import Log
from agents.logs.quantities import QUANTITIES
from agents.logs.telling import channels

FORMATS: Final = (".png", ".pdf", ".svg")


def check_picture(path: Path) -> None:
    """Raise ValueError if a file of this name cannot hold a picture."""
    if path.suffix not in FORMATS:
        raise ValueError(f"plot = {str(path)!r} is not a picture: it must end with one of {', '.join(FORMATS)}")


def draw_log(log: Log, path: Path) -> Path:
    """Draw a log; a row a channel, over time on the left and over inserted length on the right."""
    from matplotlib.figure import Figure

    from agents.records.drawing import BLUE, GRID, save

    values = channels(log)
    figure = Figure(figsize=(10.0, 1.0 + 1.6 * len(values)), layout="constrained")
    axes = figure.subplots(len(values), 2, sharex="col", sharey="row", squeeze=False)
    for (left, right), (name, column) in zip(axes, values.items(), strict=True):
        left.set_ylabel(f"{name.replace('_', ' ')}\n[{QUANTITIES[name].unit}]", fontsize=8)
        for axis, where in ((left, log.time), (right, log.inserted_length)):
            if name == "inserted_length":
                axis.plot(where, column, color=BLUE, linewidth=1.0)
            else:
                axis.step(where, column, where="post", color=BLUE, linewidth=1.0)
            axis.grid(**GRID)
    axes[-1][0].set_xlabel("time [s]")
    axes[-1][1].set_xlabel("inserted length [m]")
    return save(figure, path)
