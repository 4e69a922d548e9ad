"""The screen of the insertion: what is to be run, the line of runs, and the probe as it goes in."""

from __future__ import annotations

import math
import time
from html import escape
from typing import Any, Final

from bokeh.models import Button, MultiChoice, RadioButtonGroup, Select, Spinner, Switch

from agents.app.desk import Desk
from agents.app.page.flaw import PassedFlaw
from agents.app.page.runs import RunList
from agents.app.page.style import Live, below, chart, control_sheet, panel, problem, side_by_side, words
from agents.app.page.traces import Traces
from agents.app.page.unrolled import SlowMotion, Unrolled
from agents.app.runs.frames import COLUMNS, Frame, Order
from agents.app.runs.queue import Run
from agents.evaluation.plan import Unit
from agents.policies.catalogue import NAMES
from agents.records.shipped import shipped_agents, shipped_names
from agents.terminal.refusals import refusal
from probe_env.envs.contexts import SPLIT_SIZES
from probe_env.fidelity import PRESETS

PACES: Final = {"as fast as it goes": 0.0, "20 ×": 20.0, "5 ×": 5.0, "1 ×": 1.0}
"""What is said of a pace -> control periods a second; a period is a second."""
AROUND: Final = 0.4
"""Seconds between two pictures of all that is around the tube, which changes with every frame: drawing takes time of a
core that the simulation can use."""
SEEN: Final = {
    "inserted_length": ("inserted length", 1.0, "m"), "remaining_length": ("still to feed", 1.0, "m"),
    "feed_speed": ("feed speed", 1.0, "m/s"), "air_supply_rate": ("air supply", 3600.0, "m³/h"),
    "radial_acceleration": ("radial acceleration, rms", 1.0, "m/s²"),
    "axial_acceleration": ("axial acceleration, rms", 1.0, "m/s²"),
    "rf_noise": ("eddy-current noise, as radial rms", 1e3, "mm"), "root_tension": ("root tension", 1.0, "N"),
    "helix_diameter": ("helix diameter", 1.0, "m"),
}  # fmt: skip
"""Observation -> what it is called, factor and unit."""


class InsertionScreen:
    """Of one desk."""

    def __init__(self, desk: Desk) -> None:
        self.desk = desk
        self.unrolled, self.slow, self.flaw = Unrolled(), SlowMotion(), PassedFlaw()
        self.traces = Traces(("radial_rms_m", "feed_speed", "air_supply_rate"))
        self.signal = chart("time before now [s]", "sensor [mm]", 150)
        self.samples = self.signal.line([], [], line_width=1.2, color="#009E73").data_source
        self.status, self.seen, self.wrong = Live(name="run-words"), Live(), words(name="run-problem")
        self.list = RunList(desk, self._look_at)
        self._films, self._drawn_at = 0, -math.inf
        self.layout = below(
            words("<h2>Insertion</h2><p class='quiet'>Choose what to run; several runs wait in line. Everything that is"
                  " finished is stored as <code>probe-env evaluate</code> stores it.</p>"),
            side_by_side(*self._order_form()),
            self.wrong,
            side_by_side(*self._handles()),
            self.status.div,
            side_by_side(
                panel(below(self.unrolled.layout, self.slow.layout, self.signal, self.flaw.layout), 440, 3),
                panel(below(self.traces.layout, self.seen.div), 330, 2),
                styles={"align-items": "flex-start"},
            ),
            self.list.layout,
        )  # fmt: skip
        self.pictures = self.layout.children[-2]
        self.pictures.visible = False

    def refresh(self) -> None:
        """Show where the run is."""
        run = self.desk.run
        nothing = "<p class='quiet'>Nothing has been run yet: press <b>Run</b>.</p>"
        self.status.text = nothing if run is None else _status(run)  # first: it is what is waited for
        self.list.refresh()
        if run is None:
            return
        self._watchable(run)
        if run.frame is not None:
            self.pictures.visible = True
            self._show(run, run.frame)
        if run.film is not None and run.films != self._films:
            self._films = run.films
            self.slow.show(run.film)

    def _show(self, run: Run, frame: Frame) -> None:
        shape = frame.shape
        if shape is not None:
            self.unrolled.show(shape, everything=self.whole.active)
        now = time.monotonic()
        if now - self._drawn_at < AROUND and run.state == "running" and not frame.paused:
            return
        self._drawn_at = now
        if shape is not None:
            self.unrolled.show_along(shape)
            self.samples.data = {"x": shape.signal_time, "y": shape.signal_radial * 1e3}
            self.flaw.show(run.sensor, shape)
            self.seen.text = _seen(shape.seen, run, frame)
        unit = _watched(frame, run)
        same = {u[0]: run.trace(u) for u in run.traces if unit is not None and u[1:] == unit[1:]}
        self.traces.show(same, unit[0] if unit else "", None if run.limit is None else run.limit * 1e3)

    def _order_form(self) -> list[Any]:
        sheet = [control_sheet()]
        policies = [*NAMES, *shipped_agents(), *shipped_names("schedules")]
        self.policies = MultiChoice(title="beside my schedule", options=policies, value=["best-schedule"], width=330,
                                    stylesheets=sheet, name="policies")  # fmt: skip
        self.mine = Switch(active=True)
        self.limit = Spinner(title="tubes", low=1, high=SPLIT_SIZES["test"], step=1, value=1, width=80,
                             stylesheets=sheet, name="tubes")  # fmt: skip
        self.fidelity = Select(title="fidelity", options=list(PRESETS), value="fast", width=130, stylesheets=sheet)
        self.go = Button(label="Run", button_type="primary", stylesheets=sheet, width=90, name="run")
        self.go.on_click(self._start)
        schedule = side_by_side(
            self.mine, words("<p>my schedule</p>", width=100), width=150, styles={"flex": "0 0 160px"}
        )
        return [schedule, self.policies, self.limit, self.fidelity, self.go]

    def _handles(self) -> list[Any]:
        sheet = [control_sheet()]
        self.pause = Button(label="pause", stylesheets=sheet, width=80, name="pause")
        step = Button(label="step", stylesheets=sheet, width=70, name="step")
        look = Button(label="slow motion", stylesheets=sheet, width=120, name="look")
        stop = Button(label="stop", stylesheets=sheet, width=70, name="stop")
        self.pace = RadioButtonGroup(labels=list(PACES), active=0, stylesheets=sheet)
        self.watch = Select(title="watch", options=[], width=210, stylesheets=sheet)
        self.whole = Switch(active=False)
        whole = side_by_side(self.whole, words("<p>the whole probe</p>", width=130), width=190,
                             styles={"flex": "0 0 200px"})  # fmt: skip
        self.pause.on_click(lambda: self._order(Order("go" if self._is_paused() else "pause")))
        step.on_click(lambda: self._order(Order("step")))
        look.on_click(lambda: self._order(Order("look")))
        stop.on_click(lambda: self._order(Order("stop")))
        self.pace.on_change("active", lambda attr, old, new: self._order(self._pace()))
        self.watch.on_change("value", lambda attr, old, new: self._choose())
        self.whole.on_change("active", lambda attr, old, new: self.refresh())
        return [self.pause, step, look, stop, self.pace, self.watch, whole]

    def _start(self) -> None:
        """Run my schedule and the policies beside it."""
        try:
            self.wrong.text = ""
            mine = bool(self.mine.active)
            run = self.desk.start(list(self.policies.value), int(self.limit.value or 1), self.fidelity.value, mine)
        except (ValueError, OSError) as error:
            self.wrong.text = problem(refusal(error))
            return
        self.desk.office.queue.order(run, self._pace())
        self._look_at(run)

    def _look_at(self, run: Run) -> None:
        self.desk.run = run
        self._films, self.slow.layout.visible = run.films, False
        self._drawn_at = -math.inf
        self.refresh()

    def _pace(self) -> Order:
        return Order("pace", (list(PACES.values())[self.pace.active or 0],))

    def _order(self, order: Order) -> None:
        if self.desk.run is not None:
            self.desk.office.queue.order(self.desk.run, order)

    def _is_paused(self) -> bool:
        run = self.desk.run
        return run is not None and run.frame is not None and run.frame.paused and run.state == "running"

    def _watchable(self, run: Run) -> None:
        """Which insertions of the run can be watched just now."""
        units = run.frame.units if run.frame and run.state == "running" else ()
        options = [(str(k), _unit_name(unit)) for k, unit in enumerate(units) if unit is not None]
        if self.watch.options != options:
            self.watch.options = options
        if run.frame and options:
            self.watch.value = str(run.frame.watched)
        self.pause.label = "go on" if self._is_paused() else "pause"

    def _choose(self) -> None:
        run = self.desk.run
        if run and run.frame and self.watch.value and int(self.watch.value) != run.frame.watched:
            self._order(Order("watch", (float(self.watch.value),)))


def _watched(frame: Frame, run: Run) -> Unit | None:
    unit = frame.units[frame.watched] if frame.watched < len(frame.units) else None
    return unit or next(iter(run.traces), None)


def _unit_name(unit: Unit) -> str:
    return f"{unit[0]}, tube {unit[1]}"


def _status(run: Run) -> str:
    """Where a run is, in a line or two."""
    names = ", ".join(run.wanted.names)
    where = f"{run.done} of {run.planned} insertions" if run.planned else "beginning"
    unit = _watched(run.frame, run) if run.frame else None
    rows = run.trace(unit) if unit else None
    now = ""
    if unit is not None and rows is not None and len(rows):
        last = dict(zip(COLUMNS, rows[-1].tolist(), strict=True))
        now = (
            f" <b>{escape(_unit_name(unit))}</b>: {last['inserted_length']:.1f} m in after {last['time']:.0f} s,"
            f" radial rms {1e3 * last['radial_rms_m']:.3f} mm, reward {last['reward']:.2f}"
        )
    paused = ", paused" if run.frame and run.frame.paused and run.state == "running" else ""
    notes = "".join(f"<p class='quiet'>{escape(note)}</p>" for note in run.notes)
    state = f"<p class='big' data-state='{run.state}'>{escape(names)}: {run.state}{paused}, {where}.{now}</p>"
    return state + notes + problem(run.problem)


def _seen(seen: dict[str, float], run: Run, frame: Frame) -> str:
    """What the policy sees and does."""
    unit = _watched(frame, run)
    rows = run.trace(unit) if unit else None
    if unit is None or rows is None or not len(rows):
        return ""
    last = dict(zip(COLUMNS, rows[-1].tolist(), strict=True))
    cells = [
        f"<tr><td>{name}</td><td>{seen[key] * factor:.4g}</td><td>{unit_}</td></tr>"
        for key, (name, factor, unit_) in SEEN.items() if key in seen
    ]  # fmt: skip
    fed, blown = last["target_feed_speed"], 3600.0 * last["target_air_supply_rate"]
    return (
        f"<h2>What {escape(unit[0])} sees and does</h2>"
        f"<p>It asked for <b>{fed:.3f} m/s</b> and <b>{blown:.0f} m³/h</b>.</p>"
        f"<table class='folds'><tbody>{''.join(cells)}</tbody></table>"
    )
