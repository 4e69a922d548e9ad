"""Screen of the manual drive: feed and air by sliders, next to a policy in the same tube."""

from html import escape
from typing import Any, ClassVar, Final

from bokeh.models import Select, Slider

from probe_agents.app.runs import ACTIVE, MANUAL, Command
from probe_agents.app.schedules import HOUR
from probe_agents.app.screens import widgets as ui
from probe_agents.app.screens.charts import RMS, LengthCharts, UnrolledProbe
from probe_agents.app.screens.insertion import RunScreen
from probe_agents.app.state import Session
from probe_agents.policies.catalogue import NAMES
from probe_agents.records.shipped import shipped_agents

INTRO: Final = (
    "<h2>Manual drive</h2><p class='quiet'>Feed fast without vibration and slowly with vibration, with no more air than"
    " necessary. The policy drives in the same tube. Arrow keys move the sliders, the space bar pauses.</p>"
)
STATES: Final = {
    "finished": "<p class='big'><b>Finished</b> and stored: see <b>Compare</b>.</p>",
    "stopped": "<p>Stopped.</p>",
    "waiting": "<p>Waiting for the previous run.</p>",
}


class ManualScreen(RunScreen):
    """Manual drive of a session."""

    paces: ClassVar = {"1 ×": 1.0, "2 ×": 2.0, "4 ×": 4.0, "8 ×": 8.0}

    def __init__(self, session: Session) -> None:
        super().__init__(session, pace=2)
        rivals: dict[str, Any] = {"options": [*NAMES, *shipped_agents()], "value": "tension-scheduled"}
        check = self.guarded(lambda: ui.check_offered(self.rival))
        self.rival = ui.control(Select, "compare with", check, **rivals)
        start = ui.button("Start", self.guarded(self._start), 90, button_type="primary")
        feed = {"start": 0.02, "end": 0.4, "step": 0.005, "value": 0.2, "name": "hand-feed"}
        air = {"start": 30.0, "end": 130.0, "step": 1.0, "value": 63.0}
        self.feed = ui.control(Slider, "feed speed [m/s] (← →)", self._send_setting, 340, **feed)
        self.air = ui.control(Slider, "air supply [m³/h] (↓ ↑)", self._send_setting, 340, **air)
        self.space_bar = ui.counter(self.toggle)
        self.score = ui.Text()
        self.probe, self.charts = UnrolledProbe(with_forces=False), LengthCharts((RMS, "reward"), 230)
        self.pictures = ui.columns((self.probe.layout, 380, 1), (self.charts.layout, 380, 1))
        self.pictures.visible = False
        self.layout = ui.column(
            ui.Text(INTRO),
            ui.row(self.rival, self.pace, start, self.pause, self.stop),
            ui.row(self.feed, self.air, self.space_bar),
            self.problem,
            self.score,
            self.pictures,
        )
        self.tube_changed()

    def show_tube(self) -> None:
        """Set the sliders to the ranges of another tube."""
        config = self.session.case(1).config
        air = [HOUR * value for value in config.air_supply_rates]
        for slider, (low, high) in ((self.feed, config.feed_speeds), (self.air, air)):
            slider.update(start=round(low, 4), end=round(high, 4))
            slider.value = min(max(slider.value, slider.start), slider.end)

    def refresh(self) -> None:
        """Show both insertions."""
        super().refresh()
        run = self.session.run
        if run is None or not run.request.manual:
            self.score.text = "<p class='quiet'>Press <b>Start</b>.</p>"
            return
        traces = {unit[0]: run.trace(unit) for unit in run.traces}
        lines = "".join(_score(name, traces.get(name)) for name in run.request.names)
        self.score.text = lines + STATES.get(run.state, "") + ui.alert(run.problem)
        if run.frame is not None and run.frame.shape is not None and run.frame.unit is not None:
            self.pictures.visible = True
            self.probe.show(run.frame.shape, run.frame.unit)
        if self.charts_due(run):
            self.charts.show(traces, run.info.limit, run.request.names, MANUAL)

    def _start(self) -> None:
        ui.check_offered(self.rival)
        run = self.session.run
        if run is not None and run.request.manual and run.state in ACTIVE:
            self.send(Command("stop"))
        self.session.start([self.rival.value], [self.pace_command(), self._setting()], manual=True)
        self.refresh()

    def _send_setting(self) -> None:
        self.send(self._setting())

    def _setting(self) -> Command:
        return Command("setting", (float(self.feed.value), float(self.air.value) / HOUR))


def _score(name: str, trace: dict[str, Any] | None) -> str:
    if trace is None or not len(trace["time"]):
        return f"<p class='big'>{escape(name)}: settling</p>"
    last = {key: values[-1] for key, values in trace.items()}
    return (
        f"<p class='big'>{escape(name)}: reward <b>{last['reward']:.1f}</b>, {last['inserted_length']:.1f} m after"
        f" {last['time']:.0f} s, radial rms {1e3 * last[RMS]:.3f} mm, tension {last['tension_mean_n']:.1f} N</p>"
    )
