"""The game that teaches the problem: feed and air by hand, in slowed or hurried time, against a policy's score."""

from __future__ import annotations

from html import escape
from typing import Any, Final

from bokeh.models import Button, RadioButtonGroup, Select, Slider

from agents.app.desk import Desk
from agents.app.forms.points import HOUR
from agents.app.page.style import Live, below, control_sheet, panel, problem, side_by_side, words
from agents.app.page.traces import Traces
from agents.app.page.unrolled import Unrolled
from agents.app.runs.driven import BY_HAND
from agents.app.runs.frames import COLUMNS, Order
from agents.app.runs.queue import Run
from agents.policies.catalogue import NAMES
from agents.records.shipped import shipped_agents
from agents.terminal.refusals import refusal

PACES: Final = {"1 ×": 1.0, "2 ×": 2.0, "4 ×": 4.0, "8 ×": 8.0}
"""What is said of a pace -> control periods of a second in a second."""
USUAL_PACE: Final = 2
READINGS: Final = (("inserted_length", "{:.1f} m in", 1.0), ("time", "{:.0f} s", 1.0),
                   ("radial_rms_m", "{:.3f} mm", 1e3), ("tension_mean_n", "{:.1f} N", 1.0))  # fmt: skip


class ManualScreen:
    """Of one desk."""

    def __init__(self, desk: Desk) -> None:
        self.desk = desk
        self.run: Run | None = None
        self._round = 0
        sheet = [control_sheet()]
        self.rival = Select(title="against", options=[*NAMES, *shipped_agents()], value="tension-scheduled", width=190,
                            stylesheets=sheet, name="rival")  # fmt: skip
        self.pace = RadioButtonGroup(labels=list(PACES), active=USUAL_PACE, stylesheets=sheet)
        start = Button(label="Start", button_type="primary", stylesheets=sheet, width=90, name="start-manual")
        self.hold = Button(label="pause", stylesheets=sheet, width=90, name="hold-manual")
        give_up = Button(label="give up", stylesheets=sheet, width=90)
        self.feed = Slider(title="feed speed [m/s] (← →)", start=0.02, end=0.4, step=0.005, value=0.2, width=340,
                           stylesheets=sheet, name="hand-feed")  # fmt: skip
        self.air = Slider(title="air supply [m³/h] (↓ ↑)", start=30.0, end=130.0, step=1.0, value=63.0, width=340,
                          stylesheets=sheet, name="hand-air")  # fmt: skip
        self.pressed = Slider(start=0, end=1_000_000, step=1, value=0, visible=False)  # counts the space bar
        self.score, self.wrong = Live(name="score"), words()
        self.unrolled = Unrolled(whole=False)
        self.traces = Traces(("radial_rms_m", "reward"), 230)
        start.on_click(self._start)
        self.hold.on_click(self._toggle)
        self.pressed.on_change("value", lambda attr, old, new: self._toggle())
        give_up.on_click(lambda: self._order(Order("stop")))
        self.pace.on_change("active", lambda attr, old, new: self._order(self._pace()))
        for slider in (self.feed, self.air):
            slider.on_change("value", lambda attr, old, new: self._order(self._hand()))
        self.layout = below(
            words("<h2>Drive it yourself</h2><p class='quiet'>Feed fast while it is free and slowly where it"
                  " rings, with no more air than it takes; the policy goes into the same tube beside you. Arrow keys"
                  " move the sliders, the space bar pauses.</p>"),
            side_by_side(self.rival, self.pace, start, self.hold, give_up),
            side_by_side(self.feed, self.air, self.pressed),
            self.wrong,
            self.score.div,
            side_by_side(panel(below(self.unrolled.layout), 380), panel(self.traces.layout, 380),
                         styles={"align-items": "flex-start"}),
        )  # fmt: skip
        self.pictures = self.layout.children[-1]
        self.pictures.visible = False
        self.refresh_place()
        self.refresh()

    def refresh_place(self) -> None:
        """The tube is another one: what can be fed and blown as well."""
        try:
            config = self.desk.place(1).config
        except (ValueError, OSError) as error:
            self.wrong.text = problem(refusal(error))
            return
        for slider, (low, high), factor in (
            (self.feed, config.feed_speeds, 1.0), (self.air, config.air_supply_rates, HOUR),
        ):  # fmt: skip
            slider.update(start=round(low * factor, 4), end=round(high * factor, 4))
            slider.value = min(max(slider.value, slider.start), slider.end)

    def refresh(self) -> None:
        """Show the race."""
        run = self.run
        if run is None:
            self.score.text = "<p class='quiet'>Press <b>Start</b>.</p>"
            return
        names = [BY_HAND, *run.wanted.policies]
        rows = {unit[0]: run.trace(unit) for unit in run.traces}
        lines = [self._line(name, rows) for name in names]
        over = {"finished": "<p class='big'><b>It is over.</b> It is stored: compare the two under <b>Compare</b>.</p>",
                "stopped": "<p>Given up.</p>", "waiting": "<p>It waits for the run before it.</p>"}  # fmt: skip
        self.score.text = "".join(lines) + over.get(run.state, "") + problem(run.problem)
        self.hold.label = "go on" if self._paused() else "pause"
        if run.frame is not None and run.frame.shape is not None:
            self.pictures.visible = True
            self.unrolled.show(run.frame.shape)
        self._round += 1
        if self._round % 3 == 0 or run.state != "running":
            self.traces.show(rows, BY_HAND, None if run.limit is None else run.limit * 1e3)

    def _line(self, name: str, rows: dict[str, Any]) -> str:
        of = rows.get(name)
        if of is None or not len(of):
            return f"<p class='big'>{escape(name)}: settles</p>"
        last = dict(zip(COLUMNS, of[-1].tolist(), strict=True))
        readings = ", ".join(form.format(last[key] * factor) for key, form, factor in READINGS)
        return f"<p class='big'>{escape(name)}: score <b>{last['reward']:.1f}</b>, {readings}</p>"

    def _start(self) -> None:
        try:
            self.wrong.text = ""
            if self.run is not None and self.run.state in ("running", "waiting"):
                self.desk.office.queue.order(self.run, Order("stop"))
            self.run = self.desk.drive(self.rival.value, "fast", [self._pace(), self._hand()])
        except (ValueError, OSError) as error:
            self.wrong.text = problem(refusal(error))
        self.refresh()

    def _toggle(self) -> None:
        self._order(Order("go" if self._paused() else "pause"))

    def _pace(self) -> Order:
        return Order("pace", (list(PACES.values())[self.pace.active or 0],))

    def _hand(self) -> Order:
        return Order("hand", (float(self.feed.value), float(self.air.value) / HOUR))

    def _order(self, order: Order) -> None:
        if self.run is not None:
            self.desk.office.queue.order(self.run, order)

    def _paused(self) -> bool:
        run = self.run
        return run is not None and run.frame is not None and run.frame.paused and run.state == "running"
