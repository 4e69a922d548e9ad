"""Charts of insertions: lines over the length, the unrolled tube, slow motion, and signals with a flaw."""

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any, Final

import numpy as np
from bokeh import models

from probe_agents.app.runs import ProbeShape, flaw_signal
from probe_agents.app.screens import widgets as ui
from probe_agents.evaluation.plan import EpisodeId
from probe_env.arrays import FloatArray
from probe_env.envs.pictures.strip import FRAME_PERIOD, Motion
from probe_env.inspection.sensor import Sensor

MM: Final = 1e3
RMS: Final = "radial_rms_m"
AXES: Final = {
    RMS: ("radial rms [mm]", MM),
    "feed_speed": ("feed speed [m/s]", 1.0),
    "air_supply_rate": ("air supply [m³/h]", 3600.0),
    "reward": ("reward", 1.0),
}
"""Label and factor of a column."""
RMS_RANGE: Final = (1e-3, 3.0)
"""Ends of the logarithmic axis of the radial rms [mm]."""
TIP_LENGTH: Final = 10.0
"""Length behind the tip in the drawing [m]."""
SLOWED: Final = 8.0
FLOAT_COLUMNS: Final = ("position", "low", "high", "colour")
PLAY_JS: Final = """
clearInterval(window.slow_motion);
let k = 0;
window.slow_motion = setInterval(() => {
    if (k >= film.data.low.length) { clearInterval(window.slow_motion); return; }
    floats.data = Object.fromEntries(Object.entries(film.data).map(([name, frames]) => [name, frames[k]]));
    k += 1;
}, period);
"""
CONTACTS: Final = ((ui.SKY, "free float"), (ui.VERMILLION, "on the inner wall"), (ui.ORANGE, "on the outer wall"))


def empty_source(names: Sequence[str], **options: Any) -> models.ColumnDataSource:
    """A source without rows."""
    return models.ColumnDataSource({name: [] for name in names}, **options)


class LengthCharts:
    """A chart for each of some columns over the inserted length, with a line for each insertion."""

    def __init__(self, keys: Sequence[str], height: int = 195) -> None:
        self.keys = keys
        self.source = empty_source(("name", "colour", "dash", "width", "inserted_length", *keys))
        style = {"color": "colour", "line_dash": "dash", "line_width": "width", "source": self.source}
        plots: list[Any] = []
        for key in keys:
            shared: dict[str, Any] = {"x_range": plots[0].x_range} if plots else {}
            label = AXES[key][0]
            if key == RMS:  # the same range in every run, with the limit in it
                shared |= {"y_axis_type": "log", "y_range": RMS_RANGE}
            plot = ui.chart("inserted length [m]", label, height, **shared)
            lines = plot.multi_line("inserted_length", key, **style, **({} if plots else {"legend_field": "name"}))
            tips = [("", "@name"), ("m", "$x{0.0}"), (label, "$y")]
            plot.add_tools(models.HoverTool(renderers=[lines], tooltips=tips))
            plots.append(plot)
        plots[0].legend[0].orientation = "horizontal"
        plots[0].add_layout(plots[0].legend[0], "above")
        self.show_limit = ui.limit_line(plots[0])
        self.layout = ui.column(*plots)

    def show(
        self, lines: Mapping[str, Mapping[str, Any]], limit: float | None, names: Sequence[str], bold: str = ""
    ) -> None:
        """Draw insertions by name.

        Args:
            lines: (p,) values of the columns of each, SI units.
            limit: of the radial rms [m].
            names: all policies of the run, which have the colours of its report.
            bold: name of a thicker line.
        """
        data: dict[str, list[Any]] = {name: [] for name in self.source.data}
        styles = ui.line_styles(names)
        for name, values in lines.items():
            colour, dash = styles[name]
            line: dict[str, Any] = {"name": name, "colour": colour, "dash": dash}
            line["width"] = 3.0 if name == bold else 1.8
            line["inserted_length"] = values["inserted_length"]
            line |= {key: np.asarray(values[key]) * AXES[key][1] for key in self.keys}
            line[RMS] = np.maximum(line[RMS], RMS_RANGE[0])
            for key, value in line.items():
                data[key].append(value)
        self.source.data = data
        self.show_limit(limit)


class TubeChart:
    """Floats between the walls of the unrolled tube, coloured by contact."""

    def __init__(self, x: str, height: int) -> None:
        self.floats = empty_source(FLOAT_COLUMNS)
        self.plot = ui.chart(x, "from the inner wall [mm]", height, x_range=(0.0, TIP_LENGTH), y_range=(-3.0, 27.0))
        self.plot.segment("position", "low", "position", "high", source=self.floats, color="colour", line_width=3)
        style = {"dimension": "width", "line_color": ui.INK, "line_width": 2}
        self._walls = [models.Span(location=at, **style) for at in (0.0, 24.2)]
        for wall in self._walls:
            self.plot.add_layout(wall)

    def set_range(self, start: float, end: float, bore: float) -> None:
        """Show the tube from start to end, with a bore [m]."""
        self.plot.x_range.update(start=start, end=end)
        self.plot.y_range.update(start=-0.15 * bore * MM, end=1.15 * bore * MM)
        self._walls[1].location = bore * MM


def float_columns(position: FloatArray, radial: FloatArray, lever: FloatArray, outer_gap: FloatArray) -> dict[str, Any]:
    """Columns of floats [m] for ``TubeChart``."""
    colour = np.where(radial < 0.0, ui.VERMILLION, np.where(radial > outer_gap, ui.ORANGE, ui.SKY)).tolist()
    return {"position": position, "low": radial * MM, "high": (radial + 2.0 * lever) * MM, "colour": colour}


class UnrolledProbe:
    """The probe in the unrolled tube, with axial displacement and tension below."""

    def __init__(self, with_forces: bool = True) -> None:
        self.tube = TubeChart("from the entrance [m]", 240)
        self.cable, self.sensor = empty_source(("position", "centre")), empty_source(("position", "centre"))
        self.forces = empty_source(("position", "axial", "tension"))
        self.tube.plot.line("position", "centre", source=self.cable, color=ui.INK)
        self.tube.plot.scatter("position", "centre", source=self.sensor, size=11, color=ui.GREEN, line_color="white")
        plots = []
        for key, label, colour in (("axial", "axial [mm]", ui.PURPLE), ("tension", "tension [N]", ui.VERMILLION)):
            plot = ui.chart("from the entrance [m]", label, 140, x_range=self.tube.plot.x_range)
            plot.line("position", key, source=self.forces, color=colour, line_width=1.5)
            plots.append(plot)
        blocks = " &nbsp; ".join(f'<span style="color:{colour}">■</span>&nbsp;{text}' for colour, text in CONTACTS)
        legend = f'<p class="quiet">{blocks} &nbsp; <span style="color:{ui.GREEN}">●</span>&nbsp;sensor</p>'
        self.title = ui.Text()
        self.layout = ui.column(self.title, ui.Text(legend), self.tube.plot, *(plots if with_forces else ()))

    def show(self, shape: ProbeShape, unit: EpisodeId) -> None:
        """Draw the last metres of the probe of an episode."""
        self.title.text = f"<h2>Probe of {escape(unit[0])}, tube {unit[1]}</h2>"
        centre = (shape.radial + shape.lever) * MM
        self.tube.floats.data = float_columns(shape.position, shape.radial, shape.lever, shape.outer_gap)
        self.cable.data = {"position": shape.position, "centre": centre}
        self.sensor.data = {"position": shape.position[[shape.sensor]], "centre": centre[[shape.sensor]]}
        tip = float(shape.position.max())
        self.tube.set_range(max(tip - TIP_LENGTH, 0.0), tip + 0.3, shape.bore)

    def show_forces(self, shape: ProbeShape) -> None:
        """Draw axial displacement and tension."""
        self.forces.data = {"position": shape.position, "axial": shape.axial * MM, "tension": shape.tension}


class SlowMotion:
    """The last metres in slow motion, played in the browser."""

    def __init__(self) -> None:
        self.tube, self.film = TubeChart("from the tip [m]", 210), empty_source(FLOAT_COLUMNS)
        self.caption = ui.Text()
        replay = models.Button(label="play again", width=120)
        arguments = {"film": self.film, "floats": self.tube.floats, "period": FRAME_PERIOD * SLOWED * 1e3}
        play = models.CustomJS(args=arguments, code=PLAY_JS)
        self.film.js_on_change("data", play)
        replay.js_on_event("button_click", play)
        self.layout = ui.column(self.caption, self.tube.plot, replay, visible=False)

    def show(self, motion: Motion) -> None:
        """Play a motion."""
        nodes = motion.floats
        position, walls = -motion.distance[nodes], (motion.lever[nodes], motion.outer_gap[nodes])
        frames = [float_columns(position, radial[nodes], *walls) for radial in motion.radial]
        self.film.data = {name: [frame[name] for frame in frames] for name in FLOAT_COLUMNS}
        rms = float(motion.signal_radial[motion.signal_time >= 0.0].std()) * MM
        self.caption.text = (
            f"<h2>Slow motion</h2><p>The next {motion.time[-1]:.2f} s, played {SLOWED:g} times slower, at"
            f" {motion.inserted_length[0]:.2f} m. Radial rms of the sensor in this time: {rms:.3f} mm.</p>"
        )
        self.tube.set_range(-float(motion.distance.max()) - 0.2, 0.3, motion.scene.tube.inner_diameter)
        self.layout.visible = True


class FlawChart:
    """X and Y of the last second with a flaw that can be dragged, and its Lissajous figure."""

    def __init__(self) -> None:
        self.last: tuple[Sensor, ProbeShape] | None = None
        self.signals = empty_source(("time", "x", "y"), name="signals")
        self.loop = empty_source(("x", "y"), name="loop")
        self.flaw = models.ColumnDataSource({"time": [-0.5], "at": [0.0]}, name="flaw")
        time = {"start": 0.0, "end": 1.0, "step": 0.01, "value": 0.5, "name": "flaw-before"}
        depth = {"start": 1.0, "end": 100.0, "step": 1.0, "value": 20.0}
        self.before = ui.control(models.Slider, "flaw, seconds before now", self._draw, 210, **time)
        self.depth = ui.control(models.Slider, "depth [% of the wall]", self._draw, 210, **depth)
        self.caption = ui.Text()
        self.flaw.on_change("data", lambda attr, old, new: self._dragged())
        strip, figure = self._strip(), ui.chart("X [V]", "Y [V]", 190, tools="", min_width=180, match_aspect=True)
        figure.line("x", "y", source=self.signals, color=ui.GREY, line_width=0.8, alpha=0.7)
        figure.line("x", "y", source=self.loop, color=ui.INK, line_width=2.5)
        title = "<p class='quiet'>X and Y with a flaw within the last second: drag the diamond.</p>"
        charts = ui.columns((strip, 300, 3), (figure, 190, 1))
        self.layout = ui.column(ui.Text(title), ui.row(self.before, self.depth), charts, self.caption)

    def show(self, sensor: Sensor, shape: ProbeShape) -> None:
        """Draw the last second of a probe."""
        self.last = sensor, shape
        self._draw()

    def _strip(self) -> Any:
        plot = ui.chart("time before now [s]", "X and Y [V]", 190, "", x_range=(-1.0, 0.0), name="strip")
        style = {"source": self.signals, "line_width": 1.3}
        plot.line("time", "x", color=ui.BLUE, legend_label="X", **style)
        plot.line("time", "y", color=ui.VERMILLION, legend_label="Y", line_dash="dashed", **style)
        dot = plot.scatter("time", "at", source=self.flaw, size=17, marker="diamond", color=ui.INK, line_color="white")
        drag = models.PointDrawTool(renderers=[dot], add=False)
        plot.add_tools(drag)
        plot.toolbar.active_tap = plot.toolbar.active_drag = drag
        plot.legend[0].update(orientation="horizontal", location="top_left", background_fill_alpha=0.6)
        return plot

    def _dragged(self) -> None:
        if len(self.flaw.data["time"]):  # the tool removes the diamond on backspace; _draw restores it
            self.before.value = float(np.clip(-self.flaw.data["time"][0], 0.0, 1.0))
        self._draw()

    def _draw(self) -> None:
        data = {"time": [-self.before.value], "at": [0.0]}
        if {name: list(values) for name, values in self.flaw.data.items()} != data:
            self.flaw.data = data  # which calls this method again
            return
        signal = flaw_signal(*self.last, self.before.value, self.depth.value / 100.0) if self.last else None
        if signal is None:
            self.caption.text = "<p class='quiet'>Too few samples yet.</p>"
            return
        x, y = signal.voltages.T
        self.signals.data = {"time": signal.time, "x": x, "y": y}
        self.loop.data = {"x": x[signal.near], "y": y[signal.near]}
        verdict = "detected" if signal.filtered > signal.threshold else "not detected"
        self.caption.text = (
            f"<p>A flaw of {self.depth.value:.0f} %: S/N {signal.snr:.1f}; after the filter {signal.filtered:.1f}"
            f" (threshold {signal.threshold:.1f}): <b>{verdict}</b>.</p>"
        )
