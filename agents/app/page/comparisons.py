"""What is drawn of a comparison: time against vibration, lines over the length, and curves of detection."""

from __future__ import annotations

from html import escape
from typing import Any, Final

import pandas as pd
from bokeh.models import ColumnDataSource, HoverTool, LabelSet, Span, Whisker

from agents.app.page.style import DASHES, GREY, INK, PALETTE, below, chart, legend_above, limit_line, words
from agents.evaluation import statistics as depths

UNITS: Final = (("feed speed [m/s]", 1e-4), ("air supply [m³/h]", 0.1), ("radial rms [mm]", 1e-4))
"""Of the columns of the report's traces: what they are and the unit in which they are whole numbers."""


class Front:
    """Time against vibration, a point a policy with its intervals."""

    def __init__(self) -> None:
        self.plot = chart("inspection time [s]", "radial rms [mm]", 330, y_axis_type="log",
                          tools="pan,wheel_zoom,reset", title="Down and left is better; bars: 95 %")  # fmt: skip
        self.plot.x_range.range_padding = self.plot.y_range.range_padding = 0.25  # room for names
        names = ("name", "colour", "x", "y", "x_low", "x_high", "y_low", "y_high", "offset", "align")
        self.source = ColumnDataSource({name: [] for name in names})
        for dimension, base, low, high in (("height", "x", "y_low", "y_high"), ("width", "y", "x_low", "x_high")):
            self.plot.add_layout(
                Whisker(source=self.source, base=base, lower=low, upper=high, dimension=dimension, line_color=INK)
            )
        dots = self.plot.scatter("x", "y", source=self.source, size=13, color="colour", line_color="white")
        self.plot.add_layout(
            LabelSet(source=self.source, x="x", y="y", text="name", x_offset="offset", y_offset=4, text_align="align",
                     text_font_size="12px")
        )  # fmt: skip
        tips = [("", "@name"), ("time [s]", "@x{0.}"), ("radial rms [mm]", "@y{0.000}")]
        self.plot.add_tools(HoverTool(renderers=[dots], tooltips=tips))

    def show(self, summary: Any, order: list[str]) -> None:
        """Draw the policies of a summary."""
        rows = {(r["policy"], r["kpi"]): r for r in summary.to_dict("records")}
        data: dict[str, list[Any]] = {name: [] for name in self.source.data}
        for number, policy in enumerate(order):
            time, rms = rows[policy, "inspection_time_s"], rows[policy, "radial_rms_m"]
            data["name"].append(policy)
            data["colour"].append(PALETTE[number % len(PALETTE)])
            for axis, row, factor in (("x", time, 1.0), ("y", rms, 1e3)):
                for end, key in (("", "mean"), ("_low", "low"), ("_high", "high")):
                    data[f"{axis}{end}"].append(row[key] * factor)
        right = [x > 0.5 * (min(data["x"]) + max(data["x"])) for x in data["x"]]  # whose names go inwards
        data["offset"], data["align"] = [-8 if r else 8 for r in right], ["right" if r else "left" for r in right]
        self.source.data = data


class OverLength:
    """Vibration, feed and air over the inserted length in one tube."""

    def __init__(self) -> None:
        self.sources: list[tuple[int, Any]] = []
        self.plots: list[Any] = []
        for number in (2, 0, 1):
            label, _ = UNITS[number]
            shared = {"x_range": self.plots[0].x_range} if self.plots else {}
            scale = "log" if number == 2 else "linear"
            plot = chart("inserted length [m]", label, 190, y_axis_type=scale, **shared)
            source = ColumnDataSource({name: [] for name in ("x", "y", "name", "colour", "dash")})
            plot.multi_line("x", "y", source=source, color="colour", line_dash="dash", line_width=2,
                            **({"legend_field": "name"} if number == 2 else {}))  # fmt: skip
            self.sources.append((number, source))
            self.plots.append(plot)
        legend_above(self.plots[0])
        self.limit = limit_line(self.plots[0], None)

    def show(self, drawn: dict[str, Any], tube: int) -> None:
        """Draw the policies that are shown first in a tube."""
        self.limit.update(location=drawn["limit"] or 0.0, visible=drawn["limit"] is not None)
        shown = [policy for policy in drawn["policies"] if policy["shown"] and policy["tubes"][tube]]
        for number, source in self.sources:
            _, unit = UNITS[number]
            values = [policy["tubes"][tube][number] for policy in shown]
            source.data = {
                "x": [drawn["metres"]] * len(shown),
                "y": [[float("nan") if v is None else max(v, number == 2) * unit for v in line] for line in values],
                "name": [policy["name"] for policy in shown],
                "colour": [PALETTE[k % len(PALETTE)] for k in range(len(shown))],
                "dash": [DASHES[k % len(DASHES)] for k in range(len(shown))],
            }


class Detection:
    """Probability of detection over the depth, a line a policy with its band, and the depths that are found."""

    def __init__(self) -> None:
        self.plot = chart("depth [% of the wall]", "probability of detection", 270, x_axis_type="log",
                          x_range=(2.0, 100.0), y_range=(0.0, 1.02), tools="reset")  # fmt: skip
        self.plot.xaxis[0].ticker = [2, 5, 10, 20, 50, 100]
        names = ("x", "pod", "name", "colour", "dash")
        self.lines = ColumnDataSource({name: [] for name in names}, name="pod")
        self.bands = ColumnDataSource({name: [] for name in ("x", "y", "colour")})
        self.plot.patches("x", "y", source=self.bands, color="colour", alpha=0.12, line_width=0)
        self.plot.multi_line("x", "pod", source=self.lines, color="colour", line_dash="dash", line_width=2.2,
                             legend_field="name")  # fmt: skip
        self.plot.add_layout(Span(location=0.9, dimension="width", line_color=GREY, line_dash="dotted"))
        legend_above(self.plot)
        self.caption = words(name="detection-words")
        self.layout = below(self.plot, self.caption)

    def show(self, table: pd.DataFrame, policies: list[str]) -> None:
        """Draw policies of a table of episodes; tables from before there was a sensor have no curves."""
        self.plot.visible = depths.has_curves(table)
        if not depths.has_curves(table):
            self.caption.text = "<p class='quiet'>No curves of detection: these episodes were stored without them.</p>"
            return
        part = table[table["policy"].isin(policies)]
        curves = {str(policy): rows for policy, rows in depths.bands(part).groupby("policy")}
        data: dict[str, list[Any]] = {name: [] for name in self.lines.data}
        bands: dict[str, list[Any]] = {name: [] for name in self.bands.data}
        for number, policy in enumerate(policies):
            rows, colour = curves[policy], PALETTE[number % len(PALETTE)]
            x, low, high = (rows[name].to_list() for name in ("depth_percent_wall", "low", "high"))
            values = (x, rows["pod"].to_list(), policy, colour, DASHES[number % len(DASHES)])
            for name, value in zip(data, values, strict=True):
                data[name].append(value)
            for name, line in (("x", x + x[::-1]), ("y", low + high[::-1]), ("colour", colour)):
                bands[name].append(line)
        self.lines.data, self.bands.data = data, bands
        depth, least = min((depths.a90_95(part, policy), policy) for policy in policies)
        self.caption.text = (
            f"<p>Least depth found with 90 %, with 95 % confidence over the tubes: <b>{depth:.1f} %</b> of the wall, by"
            f" {escape(least)}.</p>"
        )
