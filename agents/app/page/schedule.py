"""The screen of the schedule: points to drag and a table of them, what the map expects, and lines to compare with."""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import Any, Final

from bokeh.models import (
    BoxAnnotation,
    Button,
    ColumnDataSource,
    CustomJS,
    DataTable,
    MultiChoice,
    NumberEditor,
    NumberFormatter,
    PointDrawTool,
    Range1d,
    Select,
    TableColumn,
    TextInput,
)  # fmt: skip

from agents.app.desk import Desk
from agents.app.forms.expected import expected
from agents.app.forms.overlays import Line, line_of, line_of_log, overlay_names
from agents.app.forms.points import HOUR, LENGTH, MISSING, NAMES, points_of, schedule_of, tidied, with_point
from agents.app.page.style import (
    BLUE,
    DASHES,
    ORANGE,
    PALETTE,
    VERMILLION,
    Live,
    below,
    chart,
    control_sheet,
    limit_line,
    panel,
    problem,
    side_by_side,
    words,
)  # fmt: skip
from agents.evaluation.report import limit_of
from agents.policies.places import Place
from agents.records.shipped import policy_file, shipped_names
from agents.terminal.refusals import refusal
from probe_env.schedule import AIR, FEED, Schedule

MM: Final = 1e3
AT_ONCE: Final = 20
"""Milliseconds between two looks at points that are being dragged."""
WHILE_DRAGGED: Final = """
window.probe_moved = true;
const look = () => {
    window.probe_moved = false;
    const copy = {};
    for (const name of names) copy[name] = Array.from(points.data[name]);
    mirror.data = copy;
    window.probe_dragged = setTimeout(() => {
        window.probe_dragged = null;
        if (window.probe_moved) look();
    }, wait);
};
if (!window.probe_dragged) look();
"""
CHARTS: Final = ((FEED, "feed speed [m/s]"), (AIR, "air supply [m³/h]"))


class ScheduleScreen:
    """Of one desk."""

    def __init__(self, desk: Desk) -> None:
        self.desk = desk
        self.place: Place = desk.place()
        self.points = ColumnDataSource(dict(desk.points), name="points")
        self.mirror = ColumnDataSource(dict(desk.points), name="mirror")
        self.band = ColumnDataSource({"length": [], "low": [], "middle": [], "high": []}, name="expected")
        self.lines = ColumnDataSource({"name": [], "colour": [], "dash": [], "length": [], FEED: [], AIR: []})
        self.summary, self.wrong = Live(name="expected-words"), words(name="schedule-problem")
        self._busy = False
        self.along = Range1d(0.0, 60.0)
        self.charts = [self._editable(column, label) for column, label in CHARTS]
        self.vibration = self._vibration()
        self.table = self._table()
        self._listen()
        self.layout = below(
            words(
                "<h2>Schedule</h2><p class='quiet'>Drag the points, tap to add one, or type into the table; the lowest"
                " chart is what the vibration map expects, at once. Run it under <b>Insertion</b>.</p>"
            ),
            side_by_side(*self._files()),
            self.wrong,
            self.summary.div,
            side_by_side(
                panel(below(*self.charts, self.vibration), 420, 3), panel(below(*self._beside()), 280, 1),
                styles={"align-items": "flex-start"},
            ),
        )  # fmt: skip
        self.refresh_place()

    def refresh(self) -> None:
        """Nothing happens here by itself."""

    def refresh_place(self) -> None:
        """The tube is another one: ranges, limit and expectation as well."""
        try:
            self.place = self.desk.place()
        except (ValueError, OSError) as error:
            self.wrong.text = problem(refusal(error))
            return
        config = self.place.config
        for plot, column, (low, high) in zip(self.charts, (FEED, AIR), self._ranges(), strict=True):
            plot.y_range.update(start=0.0, end=1.12 * max(high, *self.desk.points[column]))
            plot.center[-1].update(bottom=low, top=high)
        self.along.update(start=0.0, end=config.scene.tube.helix_length * 1.01)
        displaced = config.vibration_measure == "displacement"
        self.limit.update(location=config.limit * MM if displaced else 0.0, visible=displaced)
        self._expect()
        self._overlay()

    def _ranges(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Feed speeds [m/s] and air supplies [m3/h] that the task gives."""
        low, high = self.place.config.air_supply_rates
        return self.place.config.feed_speeds, (low * HOUR, high * HOUR)

    def _editable(self, column: str, label: str) -> Any:
        plot = chart("inserted length [m]", label, 210, x_range=self.along, y_range=(0.0, 1.0), tools="", name=column)
        plot.multi_line("length", column, source=self.lines, color="colour", line_dash="dash", line_width=1.6,
                        alpha=0.9, **({"legend_field": "name"} if column == FEED else {}))  # fmt: skip
        plot.line(LENGTH, column, source=self.points, color=BLUE, line_width=3)
        dots = plot.scatter(LENGTH, column, source=self.points, size=15, color=BLUE, line_color="white", line_width=2)
        draw = PointDrawTool(renderers=[dots], empty_value=MISSING, add=True)
        plot.add_tools(draw)
        plot.toolbar.active_tap = draw
        plot.toolbar.active_drag = draw
        plot.add_layout(BoxAnnotation(fill_alpha=0.06, fill_color=BLUE, line_color=None))
        return plot

    def _vibration(self) -> Any:
        plot = chart("inserted length [m]", "expected radial rms [mm]", 220, y_axis_type="log",
                     x_range=self.along, y_range=(1e-3, 2.0), tools="reset")  # fmt: skip
        plot.varea("length", "low", "high", source=self.band, color=ORANGE, alpha=0.25)
        plot.line("length", "middle", source=self.band, color=VERMILLION, line_width=2.5)
        self.limit = limit_line(plot, 0.1)
        return plot

    def _table(self) -> DataTable:
        names = (("length [m]", LENGTH, "0.00"), ("feed [m/s]", FEED, "0.000"), ("air [m³/h]", AIR, "0.0"))
        columns = [
            TableColumn(field=field, title=title, editor=NumberEditor(), formatter=NumberFormatter(format=form))
            for title, field, form in names
        ]
        return DataTable(source=self.points, columns=columns, editable=True, height=300, index_position=None,
                         sizing_mode="stretch_width", sortable=False, reorderable=False)  # fmt: skip

    def _files(self) -> list[Any]:
        sheet = [control_sheet()]
        self.open = TextInput(title="open a schedule file", placeholder="my.csv, or a name", width=190,
                              stylesheets=sheet, name="open-schedule")  # fmt: skip
        self.save = TextInput(title="save as", value=self.desk.name, width=150, stylesheets=sheet, name="save-schedule")
        self.overlay = MultiChoice(title="lay over", options=list(overlay_names()), value=["constant"], width=260,
                                   stylesheets=sheet)  # fmt: skip
        self.log = TextInput(title="lay a log over", placeholder="rig.csv or example-rig", width=180, stylesheets=sheet)
        self.kind = Select(title="between the points", options=["linear", "steps"], value=self.desk.interpolation,
                           width=135, stylesheets=sheet)  # fmt: skip
        self.open.on_change("value", lambda attr, old, new: self._guarded(self._open))
        self.save.on_change("value", lambda attr, old, new: self._guarded(self._save))
        for widget in (self.overlay, self.log):
            widget.on_change("value", lambda attr, old, new: self._overlay())
        self.kind.on_change("value", lambda attr, old, new: self._retyped())
        return [self.open, self.save, self.kind, self.overlay, self.log]

    def _beside(self) -> list[Any]:
        add = Button(label="add a point", stylesheets=[control_sheet()], width=110)
        remove = Button(label="remove the chosen", stylesheets=[control_sheet()], width=150)
        add.on_click(lambda: self._put(with_point(self.desk.points, self.place.config)))
        remove.on_click(self._remove)
        return [self.table, side_by_side(add, remove)]

    def _listen(self) -> None:
        arguments = {"points": self.points, "mirror": self.mirror, "names": list(NAMES), "wait": AT_ONCE}
        self.points.js_on_change("change", CustomJS(args=arguments, code=WHILE_DRAGGED))
        self.mirror.on_change("data", lambda attr, old, new: self._dragged())
        self.points.on_change("data", lambda attr, old, new: self._dropped())

    def _dragged(self) -> None:
        """Points move: what they are expected to do follows."""
        if not self._busy:
            self._expect(tidied(self._columns(self.mirror), self.place.config))

    def _dropped(self) -> None:
        """Points have been moved, added or typed."""
        if self._busy:
            return
        given = self._columns(self.points)
        typed = {name: [None if v == MISSING else v for v in given[name]] for name in NAMES}
        try:
            if not any(None in values for values in typed.values()):
                schedule_of(_in_order(given), self.desk.interpolation)
        except ValueError as error:
            self._wrong(error)
            self._put(self.desk.points)
            return
        self.wrong.text = ""
        self._put(tidied(given, self.place.config))

    def _retyped(self) -> None:
        self.desk.interpolation = "steps" if self.kind.value == "steps" else "linear"
        self._expect()

    def _remove(self) -> None:
        chosen = set(self.points.selected.indices)
        left = [k for k in range(len(self.desk.points[LENGTH])) if k not in chosen]
        if chosen and left:
            self._put({name: [values[k] for k in left] for name, values in self.desk.points.items()})
        self.points.selected.indices = []

    def _put(self, points: dict[str, list[float]]) -> None:
        """Show points, and keep them on the desk."""
        self.desk.points = points
        self._busy = True
        self.points.data = dict(points)
        self.mirror.data = dict(points)
        self._busy = False
        self._expect()

    def _expect(self, points: dict[str, list[float]] | None = None) -> None:
        try:
            prediction = expected(schedule_of(points or self.desk.points, self.desk.interpolation), self.place)
        except ValueError as error:
            self._wrong(error)
            return
        self.band.data = {
            "length": prediction.length,
            **{n: getattr(prediction, n) * MM for n in ("low", "middle", "high")},
        }
        tubes = len(self.place.contexts)
        self.summary.text = (
            f"<p class='big'>Expected: <b>{prediction.seconds:.0f} s</b>, <b>{100.0 * prediction.within:.0f} %</b>"
            f" of the length within {limit_of(self.place.config)}, {prediction.air:.1f} m³ of air,"
            f" reward <b>{prediction.reward:.1f}</b></p>"
            f"<p class='quiet'>By the vibration map, median and 80 % band over {tubes} tubes; the simulation"
            " confirms.</p>"
        )

    def _overlay(self) -> None:
        lines: dict[str, Line] = {}
        try:
            for name in self.overlay.value:
                lines[name] = line_of(name, self.place)
            if self.log.value.strip():
                lines["log"] = line_of_log(Path(self.log.value.strip()))
        except (ValueError, OSError) as error:
            self._wrong(error)
            return
        count = len(lines)
        self.lines.data = {
            "name": list(lines), "colour": [PALETTE[1 + k % 7] for k in range(count)],
            "dash": [DASHES[1 + k % 7] for k in range(count)], "length": [line.length for line in lines.values()],
            FEED: [line.feed for line in lines.values()], AIR: [line.air * HOUR for line in lines.values()],
        }  # fmt: skip

    def _open(self) -> None:
        given = self.open.value.strip()
        if not given:
            return
        if given in self.overlay.options and given not in shipped_names("schedules"):
            line = line_of(given, self.place)
            kept = slice(None, None, max(len(line.length) // 12, 1))
            length, feed, air = (tuple(map(float, c[kept])) for c in line)
            schedule = Schedule("inserted_length", "linear", length, feed, air)
            self.desk.points, self.desk.name = points_of(schedule), f"my-{given}"
        else:
            self.desk.open_schedule(Path(policy_file(given)))
        self.kind.value, self.save.value = self.desk.interpolation, self.desk.name
        self._put(self.desk.points)

    def _save(self) -> None:
        if self.save.value.strip():
            path = self.desk.save_schedule(self.save.value.strip())
            self.summary.text += f"<p>written: <code>{escape(str(path))}</code></p>"

    def _guarded(self, work: Any) -> None:
        try:
            self.wrong.text = ""
            work()
        except (ValueError, OSError) as error:
            self._wrong(error)

    def _wrong(self, error: Exception) -> None:
        self.wrong.text = problem(refusal(error))

    def _columns(self, source: ColumnDataSource) -> dict[str, list[float]]:
        return {name: list(source.data[name]) for name in NAMES}


def _in_order(points: dict[str, list[float]]) -> dict[str, list[float]]:
    order = sorted(range(len(points[LENGTH])), key=lambda k: points[LENGTH][k])
    return {name: [values[k] for k in order] for name, values in points.items()}
