"""The page: screens, keyboard, and the timer that shows changes of the queue."""

import time
from pathlib import Path
from typing import Final

from bokeh import models
from bokeh.document import Document
from bokeh.events import DocumentReady

from probe_agents.app.screens import widgets as ui
from probe_agents.app.screens.compare import CompareScreen
from probe_agents.app.screens.insertion import InsertionScreen
from probe_agents.app.screens.manual import ManualScreen
from probe_agents.app.screens.schedule import ScheduleScreen
from probe_agents.app.screens.tube import TubeScreen
from probe_agents.app.state import AppState, Session

TITLES: Final = ("1 Tube", "2 Schedule", "3 Insertion", "4 Compare", "5 Manual")
FIRST: Final = 1
TICK: Final = 100
"""Time between two checks of the queue [ms]."""
PATIENCE: Final = 3.0
"""Time after which an update counts as painted without confirmation of the browser [s]."""
PAINTED_JS: Final = "requestAnimationFrame(() => setTimeout(() => { painted.value = sent.value; }, 0));"
"""Confirms an update after it is painted."""
READY_JS: Final = """
if (window.probe_env_is_ready) return;
window.probe_env_is_ready = true;
document.documentElement.lang = "en";
// by default a drag that begins 300 ms after the mouse button was pressed, or on a busy page, counts as a long press
Bokeh.index.find_one(chart).canvas_view.ui_event_bus.ui_gestures.constructor.press_threshold = 1e9;
// Bokeh's websocket takes 20 MB, in base64 15 MB: of a larger file only the name is sent, which the server refuses
document.addEventListener("input", (event) => {
    const input = event.composedPath()[0];
    if (input.type != "file" || input.files.length == 0 || input.files[0].size <= 14e6) return;
    const nothing = new DataTransfer();
    nothing.items.add(new File([], input.files[0].name));
    input.files = nothing.files;
}, true);
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
    """One browser page, with a new session.

    Args:
        app: state shared with other pages.
        tube: tube file, or the name of a shipped one; None: the study's tubes.
    """

    def __init__(self, app: AppState, tube: Path | str | None = None) -> None:
        self.session = session = Session(app, run=next(reversed(app.queue.runs), None))
        if tube is not None:
            session.tube.open(Path(tube))
        self.schedule, self.insertion = ScheduleScreen(session), InsertionScreen(session)
        self.compare, self.manual = CompareScreen(session), ManualScreen(session)
        self.tube = TubeScreen(session, self._tube_changed)
        self.screens: list[ui.Screen] = [self.tube, self.schedule, self.insertion, self.compare, self.manual]
        self.chosen = ui.choice(TITLES, FIRST, self.turn)
        self.sent, self.painted = ui.counter(), ui.counter()  # number of the last sent and painted update
        numbers = {"sent": self.sent, "painted": self.painted}
        self.sent.js_on_change("value", models.CustomJS(args=numbers, code=PAINTED_JS))
        self._changes, self._sent_at, self._state = -1, 0.0, ""
        title = ui.Text("<h1>probe-env</h1>", styles={"flex": "0 0 130px"})
        layouts = (screen.layout for screen in self.screens)
        self.root = ui.column(ui.row(title, self.chosen), *layouts, self.sent, self.painted)
        self.root.stylesheets = [models.GlobalInlineStyleSheet(css=ui.PAGE_CSS)]
        self.turn()

    def add_to(self, document: Document) -> None:
        """Add the page to a document."""
        document.title, document.theme = "probe-env", ui.THEME
        document.add_root(self.root)
        arguments = {"feed": self.manual.feed, "air": self.manual.air, "space_bar": self.manual.space_bar}
        arguments |= {"screens": self.chosen, "chart": self.schedule.charts[0]}
        document.js_on_event(DocumentReady, models.CustomJS(args=arguments, code=READY_JS))
        document.add_periodic_callback(self.tick, TICK)

    def turn(self) -> None:
        """Show the chosen screen."""
        for number, screen in enumerate(self.screens):
            screen.layout.visible = number == self.chosen.active
        self._changes = -1

    def tick(self) -> None:
        """Show files that were read, and changes of the queue.

        These wait until the last update has been painted, except the begin and the end of a run.
        """
        self.schedule.collect()
        changes, state = self.session.app.queue.changes, self.session.run.state if self.session.run else ""
        painted = self.painted.value == self.sent.value or time.monotonic() - self._sent_at > PATIENCE
        if changes != self._changes and (painted or state != self._state):
            self.screens[self.chosen.active or 0].refresh()  # if it fails, the next tick repeats it
            self._changes, self._sent_at, self._state = changes, time.monotonic(), state
            self.sent.value = (int(self.sent.value) + 1) % int(self.sent.end)

    def _tube_changed(self) -> None:
        for screen in self.screens:
            screen.tube_changed()
