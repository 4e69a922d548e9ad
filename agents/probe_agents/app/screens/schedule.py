"""Screen of the schedule: points to drag and type, the prediction of the vibration map, and overlays."""

from collections.abc import Callable
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from html import escape
from pathlib import Path
from typing import Any, Final

from bokeh import models

from probe_agents.app import schedules
from probe_agents.app.schedules import HOUR, LENGTH, MISSING, NAMES, Line, Points
from probe_agents.app.screens import widgets as ui
from probe_agents.app.screens.charts import MM, RMS_RANGE, empty_source
from probe_agents.app.state import Session
from probe_agents.evaluation.report import limit_of
from probe_agents.records.reader import read_schedule
from probe_agents.records.shipped import file_or_shipped, policy_file, shipped_names, ships
from probe_env.schedule import AIR, FEED, Schedule

MOVED_JS: Final = """
window.points_moved = true;
const copy = () => {
    window.points_moved = false;
    moving.data = Object.fromEntries(names.map((name) => [name, Array.from(points.data[name])]));
    window.points_timer = setTimeout(() => { window.points_timer = null; if (window.points_moved) copy(); }, 20);
};
if (!window.points_timer) copy();
"""
"""Sends points while they are dragged, at most every 20 ms; Bokeh sends them only when they are dropped."""
MAP_ERROR: Final = (
    "The map expects too much vibration: the simulation of six schedules (fast, six test tubes) gave -1 to +16 % of"
    " the length within the limit, and a reward 6 to 31 higher. Run the schedule for its own figures."
)
INTRO: Final = (
    "<h2>Schedule</h2><p class='quiet'>Choose feed speed and air so that the probe does not vibrate: drag the points,"
    " tap to add one, or type into the table. Shaded is what device and instrument permit. The lowest chart is the"
    " prediction of the vibration map. Run the schedule under <b>Insertion</b>.</p>"
)


class ScheduleScreen(ui.Screen):
    """Schedule of a session."""

    def __init__(self, session: Session) -> None:
        super().__init__(session)
        self.case = session.case()
        self.points = models.ColumnDataSource(dict(session.points), name="points")
        self.moving = models.ColumnDataSource(dict(session.points), name="moving")
        self.band = empty_source(("length", "low", "middle", "high"))
        self.lines = empty_source(("name", "colour", "dash", "length", FEED, AIR))
        self.summary = ui.Text()
        self._busy = False
        self._log: Line | None = None
        self._reading: dict[str, tuple[Future[Any], Callable[[Any], None]]] = {}  # files, and what to do with them
        self.length_range = models.Range1d(0.0, 60.0)
        self.charts = [self._editable(FEED, "feed speed [m/s]"), self._editable(AIR, "air supply [m³/h]")]
        label = "predicted radial rms [mm]"
        axes: dict[str, Any] = {"x_range": self.length_range, "y_range": RMS_RANGE, "y_axis_type": "log"}
        vibration = ui.chart("inserted length [m]", label, 220, "reset", **axes)
        vibration.varea("length", "low", "high", source=self.band, color=ui.ORANGE, alpha=0.25)
        vibration.line("length", "middle", source=self.band, color=ui.VERMILLION, line_width=2.5)
        self.show_limit = ui.limit_line(vibration)
        remove = ui.button("remove selected", self._remove, 150)
        charts, table = ui.column(*self.charts, vibration), ui.column(remove, self._table())
        opened, overlays = self.guarded(self._open), self.guarded(self._show_overlays)
        example = "my.csv, or a name"
        self.open = ui.control(models.TextInput, "open a schedule", opened, placeholder=example)
        text = {"value": session.name, "name": "save-schedule"}
        self.save = ui.SaveAs(self, self._save, 150, **text)
        choice = {"options": ["linear", "steps"], "value": session.interpolation}
        self.kind = ui.control(models.Select, "between points", self._interpolated, 135, **choice)
        choice = {"options": [*schedules.BY_LENGTH, *shipped_names("schedules")], "value": ["constant"]}
        self.overlay = ui.control(models.MultiChoice, "overlay", overlays, 260, **choice)
        log = self.guarded(self._read_log)
        self.log = ui.control(models.TextInput, "overlay of a log", log, placeholder="rig.csv or example-rig")
        self.file = models.Div()  # the schedule file, to download
        choose = ui.upload("from this computer", ".csv,.toml,.xlsx", self.open, self)
        choose_log = ui.upload("log from this computer", "", self.log, self)
        self.layout = ui.column(
            ui.Text(INTRO),
            ui.row(self.open, choose, self.kind),
            ui.row(self.save.name, self.save.button, ui.download(self.file, self.save.name, ".csv")),
            ui.row(self.overlay, self.log, choose_log),
            self.problem,
            self.summary,
            ui.columns((charts, 420, 3), (table, 280, 1)),
        )
        arguments = {"points": self.points, "moving": self.moving, "names": list(NAMES)}
        self.points.js_on_change("change", models.CustomJS(args=arguments, code=MOVED_JS))
        self.file.text = schedules.csv_text(session.points, session.interpolation)
        self.moving.on_change("data", lambda attr, old, new: self._moving())
        self.points.on_change("data", lambda attr, old, new: self._moved())
        self.tube_changed()

    def show_tube(self) -> None:
        """Show ranges, limit and prediction of another tube."""
        self.case = self.session.case()
        config = self.case.config
        feeds = config.feed_speeds[0], config.permitted_feed
        ranges = (feeds, tuple(HOUR * value for value in config.air_supply_rates))
        for plot, key, (low, high) in zip(self.charts, (FEED, AIR), ranges, strict=True):
            plot.y_range.update(start=0.0, end=1.12 * max(high, *self.session.points[key]))
            plot.center[-1].update(bottom=low, top=high)
        self.length_range.end = config.scene.tube.helix_length * 1.03
        self.show_limit(config.limit if config.vibration_measure == "displacement" else None)
        self._predict()
        self._show_overlays()

    def _editable(self, key: str, label: str) -> Any:
        axes: dict[str, Any] = {"x_range": self.length_range, "y_range": (0.0, 1.0)}
        plot = ui.chart("inserted length [m]", label, 210, "", name=key, **axes)
        legend = {"legend_field": "name"} if key == FEED else {}
        plot.multi_line(
            "length", key, source=self.lines, color="colour", line_dash="dash", line_width=1.6, alpha=0.9, **legend
        )
        plot.line(LENGTH, key, source=self.points, color=ui.BLUE, line_width=3)
        dots = plot.scatter(LENGTH, key, source=self.points, size=15, color=ui.BLUE, line_color="white", line_width=2)
        tool = models.PointDrawTool(renderers=[dots], empty_value=MISSING, add=True)
        plot.add_tools(tool)
        plot.toolbar.active_tap = plot.toolbar.active_drag = tool
        plot.add_layout(models.BoxAnnotation(fill_alpha=0.06, fill_color=ui.BLUE, line_color=None))
        return plot

    def _table(self) -> models.DataTable:
        names = (("length [m]", LENGTH, "0.00"), ("feed [m/s]", FEED, "0.000"), ("air [m³/h]", AIR, "0.0"))
        cells = []
        for title, key, digits in names:
            form = {"editor": models.NumberEditor(), "formatter": models.NumberFormatter(format=digits)}
            cells.append(models.TableColumn(field=key, title=title, **form))
        options = {"editable": True, "sortable": False, "reorderable": False, "index_position": None}
        return models.DataTable(source=self.points, columns=cells, height=300, sizing_mode="stretch_width", **options)

    def _moving(self) -> None:
        if not self._busy:
            self._predict(schedules.sorted_points(self.moving.data, self.case.config))

    def _moved(self) -> None:
        """Validate points that were moved, added or typed."""
        if self._busy:
            return
        points = {name: list(self.points.data[name]) for name in NAMES}
        try:
            if not any(MISSING in values for values in points.values()):
                order = sorted(range(len(points[LENGTH])), key=lambda k: points[LENGTH][k])
                ordered = {name: [values[k] for k in order] for name, values in points.items()}
                schedules.schedule_of(ordered, self.session.interpolation)
            self.guarded(lambda: self._put(schedules.sorted_points(points, self.case.config)))()
        except ValueError as error:
            self._put(self.session.points)
            self.problem.text = ui.alert(error)

    def _interpolated(self) -> None:
        self.session.interpolation = "steps" if self.kind.value == "steps" else "linear"
        self._put(self.session.points)

    def _remove(self) -> None:
        chosen = set(self.points.selected.indices)
        left = [k for k in range(len(self.session.points[LENGTH])) if k not in chosen]
        if chosen and left:
            self._put({name: [values[k] for k in left] for name, values in self.session.points.items()})
        self.points.selected.indices = []

    def _put(self, points: Points) -> None:
        self.session.points = points
        self.file.text = schedules.csv_text(points, self.session.interpolation)
        self._busy = True
        self.points.data, self.moving.data = dict(points), dict(points)
        self._busy = False
        self._predict()

    def _predict(self, points: Points | None = None) -> None:
        try:
            prediction = schedules.predict(
                schedules.schedule_of(points or self.session.points, self.session.interpolation), self.case
            )
        except ValueError as error:
            self.problem.text = ui.alert(error)
            return
        band = {name: getattr(prediction, name) * MM for name in ("low", "middle", "high")}
        self.band.data = {"length": prediction.length, **band}
        self.summary.text = (
            f"<p class='big'>Expected: <b>{prediction.seconds:.0f} s</b>, <b>{100.0 * prediction.within:.0f} %</b>"
            f" of the length within {limit_of(self.case.config)}, {prediction.air:.1f} m³ of air,"
            f" reward <b>{prediction.reward:.1f}</b></p><p class='quiet'>Vibration map, median and 80 % band over"
            f" {len(self.case.contexts)} tubes. {MAP_ERROR}</p>"
        )

    def collect(self) -> None:
        """Show the files that have been read."""
        for kind, (future, show) in list(self._reading.items()):
            if future.done():
                del self._reading[kind]
                self.guarded(partial(self._finish, future, show))()

    def _finish(self, future: Future[Any], show: Callable[[Any], None]) -> None:
        try:
            content, notes = future.result()
            show(content)
            self.problem.text = "".join(f"<p class='quiet'>{escape(note)}</p>" for note in notes)
        except BrokenProcessPool as error:
            raise ValueError("the process that read the file was killed: is the file too large?") from error

    def _read(self, read: Callable[[Path], Any], path: Path, show: Callable[[Any], None]) -> None:
        self._reading[read.__name__] = schedules.read_in_child(read, path), show
        self.problem.text = f"<p class='quiet'>reading {escape(str(path))} ...</p>"

    def _read_log(self) -> None:
        self._show_log(None)
        if name := self.log.value.strip():
            self._read(schedules.log_line, file_or_shipped("logs", name), self._show_log)

    def _show_log(self, line: Line | None) -> None:
        self._log = line
        self._show_overlays()

    def _show_overlays(self) -> None:
        lines: dict[str, Line] = {name: schedules.policy_line(name, self.case) for name in self.overlay.value}
        if self._log:
            lines["log"] = self._log
        styles = ui.line_styles([self.session.name, *lines])
        self.lines.data = {
            "name": list(lines),
            "colour": [styles[name][0] for name in lines],
            "dash": [styles[name][1] for name in lines],
            "length": [line.length for line in lines.values()],
            FEED: [line.feed for line in lines.values()],
            AIR: [line.air * HOUR for line in lines.values()],
        }

    def _open(self) -> None:
        name = self.open.value.strip()
        if not name:
            return
        if name in schedules.BY_LENGTH:
            line = schedules.policy_line(name, self.case)
            every = max(len(line.length) // 12, 1)
            length, feed, air = (tuple(map(float, values[::every])) for values in line)
            self.session.points = schedules.points_of(Schedule("inserted_length", "linear", length, feed, air))
            self.session.name = f"my-{name}"
            self._show_opened()
            return
        path = Path(policy_file(name))
        if ships("schedules", path):
            self._take(path, Schedule.read(path))
        else:
            self._read(read_schedule, path, lambda schedule: self._take(path, schedule))

    def _take(self, path: Path, schedule: Schedule) -> None:
        self.session.open_schedule(path, schedule)
        self._show_opened()

    def _show_opened(self) -> None:
        self.save.set(self.session.name)
        self.kind.value = self.session.interpolation
        self._put(self.session.points)

    def _save(self, name: str, replace: bool) -> None:
        path = self.session.save_schedule(name, replace)
        self.summary.text += f"<p>written: <code>{escape(str(path))}</code></p>"
