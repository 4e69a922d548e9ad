"""X and Y of the sensor's last second with a flaw in it that can be dragged, and its Lissajous figure."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from bokeh.models import ColumnDataSource, PointDrawTool, Range1d, Slider

from agents.app.page.style import (
    BLUE,
    GREY,
    INK,
    VERMILLION,
    Live,
    below,
    chart,
    control_sheet,
    panel,
    side_by_side,
    words,
)  # fmt: skip
from agents.app.runs.frames import Shape
from agents.app.runs.passing import Passed, passed
from probe_env.inspection.sensor import Sensor

START: Final = (0.5, 20.0)
"""Where the flaw is at first, seconds before now and % of the wall."""


class PassedFlaw:
    """Of one desk."""

    def __init__(self) -> None:
        sheet = [control_sheet()]
        self.last: tuple[Sensor, Shape] | None = None
        self.signals = ColumnDataSource({"time": [], "x": [], "y": []}, name="signals")
        self.loop = ColumnDataSource({"x": [], "y": []}, name="loop")
        self.flaw = ColumnDataSource({"time": [-START[0]], "at": [0.0]}, name="flaw")
        self.before = Slider(title="flaw, seconds before now", start=0.0, end=1.0, step=0.01, value=START[0],
                             width=210, stylesheets=sheet, name="flaw-before")  # fmt: skip
        self.depth = Slider(title="its depth [% of the wall]", start=1.0, end=100.0, step=1.0, value=START[1],
                            width=210, stylesheets=sheet, name="flaw-depth")  # fmt: skip
        self.caption = Live(name="flaw-words")
        self.layout = below(
            words("<p class='quiet'>X and Y with a flaw where the sensor has just been: drag the diamond.</p>"),
            side_by_side(self.before, self.depth),
            side_by_side(panel(self._strip(), 300, 3), panel(self._figure(), 190, 1)),
            self.caption.div,
        )
        self.flaw.on_change("data", lambda attr, old, new: self._dragged())
        for slider in (self.before, self.depth):
            slider.on_change("value", lambda attr, old, new: self._draw())

    def show(self, sensor: Sensor, shape: Shape) -> None:
        """Take the last second of a probe."""
        self.last = sensor, shape
        self._draw()

    def _strip(self) -> Any:
        plot = chart("time before now [s]", "X and Y [V]", 190, x_range=Range1d(-1.0, 0.0), tools="", name="strip")
        plot.line("time", "x", source=self.signals, color=BLUE, line_width=1.3, legend_label="X")
        plot.line("time", "y", source=self.signals, color=VERMILLION, line_width=1.3, legend_label="Y",
                  line_dash="dashed")  # fmt: skip
        dot = plot.scatter("time", "at", source=self.flaw, size=17, marker="diamond", color=INK, line_color="white")
        drag = PointDrawTool(renderers=[dot], add=False)
        plot.add_tools(drag)
        plot.toolbar.active_tap = plot.toolbar.active_drag = drag
        plot.legend[0].update(orientation="horizontal", location="top_left", padding=2, background_fill_alpha=0.6)
        return plot

    def _figure(self) -> Any:
        plot = chart("X [V]", "Y [V]", 190, match_aspect=True, tools="")
        plot.line("x", "y", source=self.signals, color=GREY, line_width=0.8, alpha=0.7)
        plot.line("x", "y", source=self.loop, color=INK, line_width=2.5)
        plot.min_width = 180
        return plot

    def _dragged(self) -> None:
        """The diamond has been put somewhere: it stays on its line, within the second."""
        times = self.flaw.data["time"]
        if len(times):  # the tool deletes what is chosen when backspace is pressed: it comes back
            self.before.value = float(np.clip(-times[0], self.before.start, self.before.end))
        self._draw()

    def _draw(self) -> None:
        there = {"time": [-self.before.value], "at": [0.0]}
        if {name: list(values) for name, values in self.flaw.data.items()} != there:
            self.flaw.data = there  # which comes back here, with nothing left to change
            return
        seen = passed(*self.last, self.before.value, self.depth.value / 100.0) if self.last else None
        if seen is None:
            self.caption.text = "<p class='quiet'>Nothing has moved yet.</p>"
            return
        x, y = seen.voltages.T
        self.signals.data = {"time": seen.time, "x": x, "y": y}
        self.loop.data = {"x": x[seen.near], "y": y[seen.near]}
        self.caption.text = _outcome(seen, self.depth.value)


def _outcome(seen: Passed, percent: float) -> str:
    """What becomes of the flaw, in a line."""
    how = "<b>called</b>" if seen.called else "<b>not called</b>"
    return (
        f"<p>A flaw of {percent:.0f} % has a signal-to-noise of {seen.snr:.1f}; behind the filter it shows"
        f" {seen.shown:.1f} of the {seen.threshold:.1f} that it takes: {how}.</p>"
    )
