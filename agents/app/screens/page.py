"""The page: screens, keyboard, and the timer that shows changes of the queue."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any, Final

from bokeh import models
from bokeh.document import Document
from bokeh.events import DocumentReady

from agents.app.screens import widgets as ui
from agents.app.screens.compare import CompareScreen
from agents.app.screens.insertion import InsertionScreen
from agents.app.screens.manual import ManualScreen
from agents.app.screens.schedule import ScheduleScreen
from agents.app.screens.tube import TubeScreen
from agents.app.state import AppState, Session

TITLES: Final = ("1 Tube", "2 Schedule", "3 Insertion", "4 Compare", "5 Manual")
FIRST: Final = 1
TICK: Final = 100
"""Time between two looks at the queue [ms]."""
PATIENCE: Final = 3.0
"""Time after which an update counts as drawn, though the browser has not confirmed it [s]."""
MAX_COUNT: Final = 1_000_000
DRAWN_JS: Final = "requestAnimationFrame(() => setTimeout(() => { drawn.value = sent.value; }, 0));"
"""Confirms an update after it is painted."""
WELCOME: Final = (
    "<p>A cable with floats is blown into a helical tube. Beyond some length it vibrates; you choose the feed speed and"
    " the air supply. Drag the points of the schedule below, then run it under <b>Insertion</b>, in the study's tubes"
    " or in your own, which you describe under <b>Tube</b>. <b>Compare</b> shows the result next to other policies;"
    " under <b>Manual</b> you drive by hand.</p>"
)
KEYS_JS: Final = """
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
        const [slider, sign] = moves[event.key];
        slider.value = Math.min(Math.max(slider.value + sign * 2 * slider.step, slider.start), slider.end);
        event.preventDefault();
    } else if (event.key == " ") { space_bar.value += 1; event.preventDefault(); }
});
"""


class Page:
    """One browser page."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self.schedule, self.insertion = ScheduleScreen(session), InsertionScreen(session)
        self.compare, self.manual = CompareScreen(session), ManualScreen(session)
        self.tube = TubeScreen(session, self._tube_changed)
        self.screens: list[ui.Screen] = [self.tube, self.schedule, self.insertion, self.compare, self.manual]
        self.chosen = ui.choice(TITLES, FIRST, self.turn)
        close = ui.button("close", lambda: setattr(self.welcome, "visible", False), 70)
        text = ui.Text(WELCOME, styles={"flex": "1 1 300px"})
        self.welcome = ui.row(text, close, background="#eef6fb", padding="6px 10px")
        count: dict[str, Any] = {"start": 0, "end": MAX_COUNT, "step": 1, "value": 0, "visible": False}
        self.sent, self.drawn = models.Slider(**count), models.Slider(**count)  # numbers of the last updates
        self.sent.js_on_change("value", models.CustomJS(args={"sent": self.sent, "drawn": self.drawn}, code=DRAWN_JS))
        self._changes, self._sent_at, self._state = -1, 0.0, ""
        title = ui.Text("<h1>probe-env</h1>", styles={"flex": "0 0 130px"})
        layouts = (screen.layout for screen in self.screens)
        self.root = ui.column(ui.row(title, self.chosen), self.welcome, *layouts, self.sent, self.drawn)
        self.root.stylesheets = [models.GlobalInlineStyleSheet(css=ui.PAGE_CSS)]
        self.turn()

    def add_to(self, document: Document) -> None:
        """Add the page to a document."""
        document.title, document.theme = "probe-env", ui.THEME
        document.add_root(self.root)
        sliders = {"feed": self.manual.feed, "air": self.manual.air, "space_bar": self.manual.space_bar}
        document.js_on_event(DocumentReady, models.CustomJS(args={"screens": self.chosen, **sliders}, code=KEYS_JS))
        document.add_periodic_callback(self.tick, TICK)

    def turn(self) -> None:
        """Show the chosen screen."""
        for number, screen in enumerate(self.screens):
            screen.layout.visible = number == self.chosen.active
        self._changes = -1

    def tick(self) -> None:
        """Show the changes of the queue when the browser has drawn the last update, or when a run begins or ends."""
        changes, state = self.session.app.queue.changes, self.session.run.state if self.session.run else ""
        drawn = self.drawn.value == self.sent.value or time.monotonic() - self._sent_at > PATIENCE
        if changes != self._changes and (drawn or state != self._state):
            self._changes, self._sent_at, self._state = changes, time.monotonic(), state
            self.screens[self.chosen.active or 0].refresh()
            self.sent.value = (int(self.sent.value) + 1) % MAX_COUNT

    def _tube_changed(self) -> None:
        for screen in self.screens:
            screen.tube_changed()


def open_page(app: AppState, tube: Path | str | None = None) -> Page:
    """A page with a new session, with a tube file or the name of a shipped one; None: the study's tubes."""
    session = Session(app, run=next(reversed(app.queue.runs), None))
    if tube is not None:
        session.tube.open(Path(tube))
    return Page(session)
