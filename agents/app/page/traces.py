"""Lines of several insertions over the inserted length: what was felt, what was fed and blown, what it came to."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from bokeh.models import ColumnDataSource, HoverTool

from agents.app.page.style import DASHES, PALETTE, below, chart, legend_above, limit_line
from agents.app.runs.frames import COLUMNS
from probe_env.arrays import FloatArray

KINDS: Final = {
    "radial_rms_m": ("radial rms [mm]", 1e3, "log"),
    "feed_speed": ("feed speed [m/s]", 1.0, "linear"),
    "air_supply_rate": ("air supply [m³/h]", 3600.0, "linear"),
    "tension_mean_n": ("root tension [N]", 1.0, "linear"),
    "reward": ("reward", 1.0, "linear"),
}
"""Column -> axis, factor, scale."""
LEAST: Final = 1e-4
"""Of an axis in decades [mm]: a probe at rest has no rms at all."""


class Traces:
    """A chart a column, a line an insertion.

    Args:
        columns: of ``KINDS``.
        height: of each [pixels].
    """

    def __init__(self, columns: tuple[str, ...], height: int = 200) -> None:
        self.columns = columns
        self.source = ColumnDataSource(_empty(columns))
        self.charts: list[Any] = []
        for number, column in enumerate(columns):
            label, _, scale = KINDS[column]
            shared = {"x_range": self.charts[0].x_range} if self.charts else {}
            plot = chart("inserted length [m]", label, height, y_axis_type=scale, **shared)
            drawn = plot.multi_line(
                "length", column, source=self.source, color="colour", line_dash="dash", line_width="width",
                **({"legend_field": "name"} if number == 0 else {}),
            )  # fmt: skip
            plot.add_tools(HoverTool(renderers=[drawn], tooltips=[("", "@name"), ("m", "$x{0.0}"), (label, "$y")]))
            self.charts.append(plot)
        legend_above(self.charts[0])
        self.limit = limit_line(self.charts[columns.index("radial_rms_m")], None) if "radial_rms_m" in columns else None
        self.layout = below(*self.charts)

    def show(self, lines: Mapping[str, FloatArray], watched: str = "", limit_mm: float | None = None) -> None:
        """Draw insertions by name, each (p, columns) as ``frames.COLUMNS``; the watched one is thicker."""
        data = _empty(self.columns)
        for number, (name, rows) in enumerate(lines.items()):
            data["name"].append(name)
            data["colour"].append(PALETTE[number % len(PALETTE)])
            data["dash"].append(DASHES[number % len(DASHES)])
            data["width"].append(3.0 if name == watched else 1.8)
            data["length"].append(rows[:, COLUMNS.index("inserted_length")])
            for column in self.columns:
                values = rows[:, COLUMNS.index(column)] * KINDS[column][1]
                data[column].append(np.maximum(values, LEAST) if KINDS[column][2] == "log" else values)
        self.source.data = data
        if self.limit is not None:
            self.limit.update(location=limit_mm or 0.0, visible=limit_mm is not None)


def _empty(columns: tuple[str, ...]) -> dict[str, list[Any]]:
    return {name: [] for name in ("name", "colour", "dash", "width", "length", *columns)}
