"""The page: its screens, the keyboard, and the clock that asks ten times a second what has happened."""

from __future__ import annotations

import time
from typing import Any, Final

from bokeh.document import Document
from bokeh.events import DocumentReady
from bokeh.models import Button, CustomJS, RadioButtonGroup, Slider

from agents.app.desk import Desk, Office
from agents.app.page.compare import CompareScreen
from agents.app.page.insertion import InsertionScreen
from agents.app.page.manual import ManualScreen
from agents.app.page.schedule import ScheduleScreen
from agents.app.page.style import below, control_sheet, page_sheet, side_by_side, words
from agents.app.page.tube import TubeScreen

TITLES: Final = ("1 Tube", "2 Schedule", "3 Insertion", "4 Compare", "5 Manual")
BEGIN: Final = 1
TICK: Final = 100
"""Milliseconds between two looks at what has happened."""
PATIENCE: Final = 3.0
"""Seconds after which a picture counts as drawn though the browser has not said so."""
MOST_SENT: Final = 1_000_000
DRAWN: Final = "requestAnimationFrame(() => setTimeout(() => { drawn.value = sent.value; }, 0));"
"""In the browser, behind what came with it: once all of that is painted."""
WELCOME: Final = (
    "<p>A cable of floats is blown into a helical tube, and above some length it rings: how fast to feed it, and with"
    " how much air, is yours to choose. Drag the points of the feed schedule below, then run it under <b>Insertion</b>"
    " on the study's tubes or on your own, which <b>Tube</b> describes. <b>Compare</b> says how it did against the"
    " others, and <b>Manual</b> lets you drive.</p>"
)
KEYS: Final = """
if (window.probe_keys) return;
window.probe_keys = true;
document.documentElement.lang = "en";
const typed = (event) => event.composedPath().some((e) => ["INPUT", "TEXTAREA", "SELECT"].includes(e.tagName)
                                                         || (e.classList && e.classList.contains("slick-cell")));
document.addEventListener("keydown", (event) => {
    if (typed(event) || event.ctrlKey || event.metaKey || event.altKey) return;
    const number = parseInt(event.key) - 1;
    if (number >= 0 && number < screens.labels.length) { screens.active = number; return; }
    if (screens.active != 4) return;
    const moves = {ArrowRight: [feed, 1], ArrowLeft: [feed, -1], ArrowUp: [air, 1], ArrowDown: [air, -1]};
    if (event.key in moves) {
        const [slider, way] = moves[event.key];
        const value = slider.value + way * 2 * slider.step;
        slider.value = Math.min(Math.max(value, slider.start), slider.end);
        event.preventDefault();
    } else if (event.key == " ") { pressed.value += 1; event.preventDefault(); }
});
"""


class Page:
    """One browser's page."""

    def __init__(self, desk: Desk) -> None:
        self.desk = desk
        self.schedule = ScheduleScreen(desk)
        self.manual = ManualScreen(desk)
        self.tube = TubeScreen(desk, self._tube_changed)
        self.insertion, self.compare = InsertionScreen(desk), CompareScreen(desk)
        self.screens: list[Any] = [self.tube, self.schedule, self.insertion, self.compare, self.manual]
        self.chosen = RadioButtonGroup(labels=list(TITLES), active=BEGIN, stylesheets=[control_sheet()], name="screens")
        frame = {"background": "#eef6fb", "padding": "6px 10px"}
        self.welcome = side_by_side(words(WELCOME, styles={"flex": "1 1 300px"}), styles=frame)
        close = Button(label="close", stylesheets=[control_sheet()], width=70)
        close.on_click(lambda: setattr(self.welcome, "visible", False))
        self.welcome.children.append(close)
        self.chosen.on_change("active", lambda attr, old, new: self.turn())
        self._seen, self._sent_at, self._state = -1, 0.0, ""
        count: dict[str, Any] = {"start": 0, "end": MOST_SENT, "step": 1, "value": 0, "visible": False}
        self.sent, self.drawn = Slider(**count), Slider(**count)  # pictures: numbers of the last ones
        self.sent.js_on_change("value", CustomJS(args={"sent": self.sent, "drawn": self.drawn}, code=DRAWN))
        self.root = below(
            side_by_side(words("<h1>probe-env</h1>", width=120, styles={"flex": "0 0 130px"}), self.chosen),
            self.welcome,
            *(screen.layout for screen in self.screens),
            self.sent,
            self.drawn,
        )
        self.turn()

    def add_to(self, document: Document) -> None:
        """Put it on a document."""
        document.title = "probe-env"
        self.root.stylesheets = [page_sheet()]
        document.add_root(self.root)
        arguments = {
            "screens": self.chosen, "feed": self.manual.feed, "air": self.manual.air,
            "pressed": self.manual.pressed,
        }  # fmt: skip
        document.js_on_event(DocumentReady, CustomJS(args=arguments, code=KEYS))
        for text in (
            self.schedule.summary, self.insertion.status, self.insertion.seen, self.insertion.flaw.caption,
            self.insertion.list.table, self.manual.score,
        ):  # fmt: skip
            document.js_on_event(DocumentReady, text.show)  # what was said before there was a browser to show it
        document.add_periodic_callback(self.tick, TICK)

    def turn(self) -> None:
        """Show the chosen screen."""
        for number, screen in enumerate(self.screens):
            screen.layout.visible = number == self.chosen.active
        self._seen = -1

    def tick(self) -> None:
        """Show what has happened since the last look, once the browser has drawn that: else it falls behind.

        That a run begins or ends is shown at once.
        """
        changes, state = self.desk.office.queue.changes, self.desk.run.state if self.desk.run else ""
        drawn = self.drawn.value == self.sent.value or time.monotonic() - self._sent_at > PATIENCE
        if changes != self._seen and (drawn or state != self._state):
            self._seen, self._sent_at, self._state = changes, time.monotonic(), state
            self.screens[self.chosen.active or 0].refresh()
            self.sent.value = (int(self.sent.value) + 1) % MOST_SENT

    def _tube_changed(self) -> None:
        self.schedule.refresh_place()
        self.manual.refresh_place()


def page_of(office: Office, tube: Any = None) -> Page:
    """A new page at a new desk.

    Args:
        office: what it shares with the others.
        tube: a plant's file or the name of one that ships; None: the study's tubes.
    """
    desk = Desk(office, run=next(reversed(office.queue.runs), None))
    if tube is not None:
        desk.tube.open(tube)
    return Page(desk)
