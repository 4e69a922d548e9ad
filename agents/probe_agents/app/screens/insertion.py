"""Screen of insertions: what to run, the running insertion, and the list of runs."""

import math
import time
from html import escape
from typing import Any, ClassVar, Final

from bokeh import models

from probe_agents.app.run_store import read_request, stored_runs
from probe_agents.app.runs import ACTIVE, Command, Frame, Run
from probe_agents.app.screens import widgets as ui
from probe_agents.app.screens.charts import MM, RMS, FlawChart, LengthCharts, SlowMotion, UnrolledProbe
from probe_agents.app.state import Session
from probe_agents.evaluation.folder import read_evaluation
from probe_agents.evaluation.plan import EpisodeId
from probe_agents.evaluation.repeat import is_judged
from probe_agents.evaluation.report import first_page
from probe_agents.policies.catalogue import NAMES
from probe_agents.records.shipped import shipped_agents, shipped_names
from probe_env.envs.contexts import SPLIT_SIZES
from probe_env.envs.pictures.strip import Motion
from probe_env.fidelity import PRESETS

CHART_PERIOD: Final = 0.4
"""Shortest time between two updates of the charts of a run [s]."""
TUBES: Final = 6
"""Default number of tubes, as in the prediction of a schedule; the interval of one tube is not known."""
OBSERVATIONS: Final = {
    "inserted_length": ("inserted length", 1.0, "m"),
    "remaining_length": ("remaining length", 1.0, "m"),
    "feed_speed": ("feed speed", 1.0, "m/s"),
    "air_supply_rate": ("air supply", 3600.0, "m³/h"),
    "radial_acceleration": ("radial acceleration, rms", 1.0, "m/s²"),
    "axial_acceleration": ("axial acceleration, rms", 1.0, "m/s²"),
    "rf_noise": ("eddy-current noise, as radial rms", 1e3, "mm"),
    "root_tension": ("root tension", 1.0, "N"),
    "helix_diameter": ("helix diameter", 1.0, "m"),
}
"""Label, factor and unit."""
INTRO: Final = (
    "<h2>Insertion</h2><p class='quiet'>Choose what to run; further runs wait in a queue. Results are stored as by"
    " <code>probe-env evaluate</code>.</p>"
)


class RunScreen(ui.Screen):
    """Base of screens that control a run, at a pace in control periods (of 1 s) per second."""

    paces: ClassVar[dict[str, float]]

    def __init__(self, session: Session, pace: int = 0) -> None:
        super().__init__(session)
        self.pace = ui.choice(self.paces, pace, lambda: self.send(self.pace_command()))
        self.pause = ui.button("pause", self.toggle, 90)
        self.stop = ui.button("stop", lambda: self.send(Command("stop")), 90)
        self.drawn_at = -math.inf  # time of the last update of the charts

    def send(self, command: Command) -> None:
        """Send a command to the run."""
        if self.session.run is not None:
            self.session.app.queue.send(self.session.run, command)

    def charts_due(self, run: Run) -> bool:
        """Whether to update the charts; updates slow the simulation down."""
        now = time.monotonic()
        due = now - self.drawn_at >= CHART_PERIOD or run.state != "running" or run.paused
        self.drawn_at = now if due else self.drawn_at
        return due

    def pace_command(self) -> Command:
        """The chosen pace."""
        return Command("pace", (list(self.paces.values())[self.pace.active or 0],))

    def toggle(self) -> None:
        """Pause or continue."""
        self.send(Command("continue" if self.session.run is not None and self.session.run.paused else "pause"))

    def refresh(self) -> None:
        """Update the label of the pause button."""
        self.pause.label = "continue" if self.session.run is not None and self.session.run.paused else "pause"


class InsertionScreen(RunScreen):
    """Runs of a session."""

    paces: ClassVar = {"no limit": 0.0, "20 ×": 20.0, "5 ×": 5.0, "1 ×": 1.0}

    def __init__(self, session: Session) -> None:
        super().__init__(session)
        self.probe, self.slow_motion, self.flaw = UnrolledProbe(), SlowMotion(), FlawChart()
        self.charts = LengthCharts((RMS, "feed_speed", "air_supply_rate"))
        signal = ui.chart("time before now [s]", "sensor [mm]", 150)
        self.signal = signal.line([], [], line_width=1.2, color=ui.GREEN).data_source
        self.status, self.verdict, self.observation = ui.Text(name="run-status"), ui.Text(), ui.Text()
        self._judged: Run | None = None  # run whose end is in ``verdict``
        self._motion: Motion | None = None
        self._unit: EpisodeId | None = None  # episode in the charts
        left = ui.column(self.probe.layout, self.slow_motion.layout, signal, self.flaw.layout)
        self.pictures = ui.columns((left, 440, 3), (ui.column(self.charts.layout, self.observation), 330, 2))
        self.pictures.visible = False
        names = [*NAMES, *shipped_agents(), *shipped_names("schedules")]
        options = {"options": names, "value": ["best-schedule"], "name": "policies"}
        check = self.guarded(self._check)
        self.policies = ui.control(models.MultiChoice, "compare with", check, 330, **options)
        self.with_schedule = models.Switch(label="my schedule", active=True)
        self.limit = ui.control(
            models.Spinner, "tubes", check, 80, low=1, high=SPLIT_SIZES["test"], step=1, value=TUBES
        )
        self.fidelity = ui.control(models.Select, "fidelity", check, 130, options=list(PRESETS), value="fast")
        start = ui.button("Run", self.guarded(self._start), 90, button_type="primary")
        step = ui.button("step", lambda: self.send(Command("step")), 70)
        look = ui.button("slow motion", lambda: self.send(Command("slow motion")), 120)
        self.watch = ui.control(models.Select, "watch", self._watch, 210, options=[])
        self.table = ui.Text()
        self._listed: Any = None
        self.chosen = ui.control(models.Select, "run", None, 300, options=[])
        resume = ui.button("watch or resume", self.guarded(self._resume), 150)
        self.layout = ui.column(
            ui.Text(INTRO),
            ui.row(self.with_schedule, self.policies, self.limit, self.fidelity, start),
            self.problem,
            ui.row(self.pause, step, look, self.stop, self.pace, self.watch),
            self.status,
            self.verdict,
            self.pictures,
            ui.Text("<h2>Runs</h2>"),
            self.table,
            ui.row(self.chosen, resume),
        )

    def refresh(self) -> None:
        """Show the state of the run and the list of runs."""
        super().refresh()
        run = self.session.run
        nothing = "<p class='quiet'>No run yet: press <b>Run</b>.</p>"
        self.status.text = nothing if run is None else _status(run)
        finished = run if run is not None and run.state == "finished" else None
        if finished is not self._judged:
            self._judged, self.verdict.text = finished, ""
            self.guarded(self._judge)()
        self._list_runs()
        if run is None:
            return
        self._list_episodes(run)
        if run.frame is not None:
            self.pictures.visible = True
            self._show(run, run.frame)
        if run.motion is not None and run.motion is not self._motion:
            self._motion = run.motion
            self.slow_motion.show(run.motion)

    def _show(self, run: Run, frame: Frame) -> None:
        unit, shape = frame.unit, frame.shape
        if unit is None or shape is None:
            return
        self.probe.show(shape, unit)
        if unit != self._unit:  # the next episode is watched: none of its charts may be of the last one
            self._unit, self.drawn_at = unit, -math.inf
        if not self.charts_due(run):
            return
        self.probe.show_forces(shape)
        self.signal.data = {"x": shape.signal_time, "y": shape.signal_radial * MM}
        self.flaw.show(run.info.sensor, shape)
        self.observation.text = _observation(shape.observation, unit, _last(run, unit))
        same_tube = {other[0]: run.trace(other) for other in run.traces if other[1:] == unit[1:]}
        self.charts.show(same_tube, run.info.limit, run.request.names, unit[0])

    def _check(self) -> None:
        ui.check_offered(self.policies, self.limit, self.fidelity)

    def _start(self) -> None:
        self._check()
        options = {"limit": int(self.limit.value or 1), "fidelity": self.fidelity.value}
        policies, with_schedule = list(self.policies.value), bool(self.with_schedule.active)
        self._show_run(self.session.start(policies, [self.pace_command()], with_schedule, **options))

    def _judge(self) -> None:
        """Show verdict, metres to repeat and hours as on the first page of the report; unless the tube has neither."""
        if self._judged is None:
            return
        done = read_evaluation(self._judged.request.output)
        if not done.report.bundle and not is_judged(done.setting.task):
            return
        first = first_page(done)
        text = f"<p class='big'><b>{escape(first.policy)}</b> is {escape('. It is '.join(first.verdict))}.</p>"
        if first.to_repeat:
            header, rows = first.repeat
            cells = ((cell.text for cell in row) for row in rows)
            text += f"<p>Metres to repeat: {first.to_repeat}</p>" + (ui.table_html(header, cells) if rows else "")
        if done.report.bundle:
            hours = "; ".join(f"{name}: {value}" for name, value in first.hours.items())
            text += f"<p>Hours for {done.report.bundle.tubes} tubes: {hours}</p>"
        self.verdict.text = text

    def _show_run(self, run: Run) -> None:
        self.session.run = run
        self._motion, self.slow_motion.layout.visible = run.motion, False
        self.drawn_at = -math.inf
        self.refresh()

    def _list_episodes(self, run: Run) -> None:
        """List the episodes in progress."""
        units = run.frame.units if run.frame and run.state == "running" else ()
        options = [(str(k), f"{unit[0]}, tube {unit[1]}") for k, unit in enumerate(units) if unit is not None]
        if run.frame and options:
            self.watch.update(options=options, value=str(run.frame.watched))

    def _watch(self) -> None:
        run = self.session.run
        if run and run.frame and self.watch.value and int(self.watch.value) != run.frame.watched:
            self.send(Command("watch", (float(self.watch.value),)))

    def _list_runs(self) -> None:
        runs = self.session.app.queue.runs
        states = [(run.state, run.done) for run in runs]
        if states == self._listed:
            return
        self._listed = states
        entries = stored_runs(self.session.app.output)
        lines = {run.folder.name: ("stored" if run.complete else "interrupted", run.outcome) for run in entries}
        for run in runs:
            name = run.request.output.name
            done = f"{run.done} of {run.info.planned} insertions" if run.info.planned else ""
            outcome = lines.get(name, ("", ""))[1] if run.state == "finished" else run.problem or done
            lines[name] = (run.state, outcome)
        names = sorted(lines, reverse=True)
        rows = ((escape(name), *map(escape, lines[name])) for name in names)
        self.table.text = ui.table_html(("run", "state", "result"), rows, "wide")
        if names and self.chosen.options != names:
            self.chosen.update(options=names, value=names[0])

    def _resume(self) -> None:
        """Watch an active or finished run of this process; resume any other run."""
        runs = [run for run in self.session.app.queue.runs if run.request.output.name == self.chosen.value]
        if runs and runs[-1].state in (*ACTIVE, "finished"):
            self._show_run(runs[-1])
        elif self.chosen.value:
            request = read_request(self.session.app.output / self.chosen.value)
            self._show_run(self.session.app.queue.add(request))


def _last(run: Run, unit: EpisodeId) -> dict[str, float]:
    """The last period of an episode; empty before the first."""
    return {key: float(values[-1]) for key, values in run.trace(unit).items() if len(values)}


def _status(run: Run) -> str:
    """Watched episode and progress of the run, as HTML."""
    unit, now = run.frame.unit if run.frame else None, ""
    if unit and (last := _last(run, unit)):
        now = (
            f" <b>{escape(unit[0])}, tube {unit[1]}</b>: {last['inserted_length']:.1f} m after {last['time']:.0f} s,"
            f" radial rms {MM * last[RMS]:.3f} mm, reward {last['reward']:.2f}"
        )
    done = f"{run.done} of {run.info.planned} insertions" if run.info.planned else "starting"
    state = f"{escape(', '.join(run.request.names))}: {run.state}{', paused' if run.paused else ''}, {done}.{now}"
    notes = "".join(f"<p class='quiet'>{escape(note)}</p>" for note in run.info.notes)
    attributes = f"class='big' data-run='{run.request.output.name}' data-state='{run.state}'"
    return f"<p {attributes}>{state}</p>{notes}{ui.alert(run.problem)}"


def _observation(observation: dict[str, float], unit: EpisodeId, last: dict[str, float]) -> str:
    """Observation of a policy and its last request, as HTML."""
    if not last:
        return ""
    rows = (
        (label, f"{observation[key] * factor:.4g}", symbol)
        for key, (label, factor, symbol) in OBSERVATIONS.items()
        if key in observation
    )
    feed, air = last["target_feed_speed"], 3600.0 * last["target_air_supply_rate"]
    return (
        f"<h2>Observation of {escape(unit[0])}</h2><p>It requests <b>{feed:.3f} m/s</b> and <b>{air:.0f} m³/h</b>.</p>"
        + ui.table_html((), rows)
    )
