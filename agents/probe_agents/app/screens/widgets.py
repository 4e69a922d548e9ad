"""Appearance of the pages: theme, text, controls, layout, charts, and the base of the screens."""

from collections.abc import Callable, Iterable
from html import escape
from typing import Any, Final

from bokeh import models
from bokeh.models import Button, Column, Pane, PrintfTickFormatter, RadioButtonGroup, Row, Slider, Span
from bokeh.models.dom import HTML
from bokeh.plotting import figure
from bokeh.themes import Theme

from probe_agents.app.forms import ReplaceError
from probe_agents.app.state import Session
from probe_agents.records.drawing import PALETTE, colours, policy_colours
from probe_agents.terminal.messages import format_error
from probe_env.settings import closest, within

REPORT_URL: Final = "/report/"
BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY, INK, GREY = PALETTE
DASHES: Final = ("solid", "dashed", "dotdash", "dotted", "dashdot", "solid", "dashed", "dotted")
PAGE_CSS: Final = """
html { color-scheme: light; }
body { margin: 0; padding: 10px 16px 40px; font: 15px/1.45 system-ui, sans-serif; color: #222; background: #fff; }
"""
TEXT_CSS: Final = """
:host { display: block; max-width: 100%; overflow-x: auto; margin: 0 5px; font-size: 15px; line-height: 1.45; }
h1 { font-size: 21px; margin: 0; } h2 { font-size: 17px; margin: 12px 0 2px; } p { margin: 3px 0; }
.problem { color: #a33a00; font-weight: 600; } .problem::before { content: "\\26A0\\00A0"; }
.quiet { color: #555; } .big { font-size: 19px; } small { color: #555; display: block; }
table { border-collapse: collapse; font-size: 14px; border: none; }
th, td { text-align: right; padding: 3px 7px; border: none; border-bottom: 1px solid #ddd; white-space: nowrap; }
th:first-child, td:first-child { text-align: left; } thead th { white-space: normal; vertical-align: bottom; }
table.wide td { text-align: left; } table.wide td:last-child { white-space: normal; }
code { background: #f2f2f2; padding: 1px 4px; overflow-wrap: anywhere; }
"""
CONTROL_CSS: Final = """
:host { max-width: 100%; font-size: 14px; } .bk-btn-group { flex-wrap: wrap; }
label { font-size: 13px; }
@media (max-width: 500px) { label { font-size: 12px; } }
.bk-input, .bk-btn { font-size: 15px; min-height: 34px; }
.bk-btn:focus-visible, .bk-input:focus-visible { outline: 3px solid #0072B2; outline-offset: 1px; }
"""
AXIS: Final = {
    "axis_label_text_font_size": "13px",
    "axis_label_text_font_style": "normal",
    "major_label_text_font_size": "12px",
    "minor_tick_line_color": None,
}
THEME: Final = Theme(
    json={
        "attrs": {
            "Axis": AXIS,
            "Grid": {"grid_line_color": "#ececec"},
            "Legend": {"label_text_font_size": "12px", "padding": 2, "border_line_color": None},
            "Plot": {"outline_line_color": "#cccccc", "min_border_left": 62, "toolbar_location": None},
            "Widget": {"stylesheets": [CONTROL_CSS]},
        }
    }
)


DOWNLOAD_JS: Final = """
const link = document.createElement("a");
link.href = URL.createObjectURL(new Blob([file.text], {type: "text/plain"}));
link.download = (name.value.split("/").pop() || "mine").replace(/\\.(csv|toml)$/, "") + ending;
link.click();
URL.revokeObjectURL(link.href);
"""


class Text:
    """HTML text that is changed without a new layout of the page; text from files and users must be escaped."""

    def __init__(self, html: str = "", **options: Any) -> None:
        self._html = HTML(html=html)
        self.pane = Pane(elements=[self._html], stylesheets=[TEXT_CSS], **options)

    @property
    def text(self) -> str:
        """The HTML."""
        return str(self._html.html)

    @text.setter
    def text(self, html: str) -> None:
        self._html.html = html


class Screen:
    """Base of the screens of a session: a ``layout``, and a line for errors."""

    layout: Any

    def __init__(self, session: Session) -> None:
        self.session = session
        self.problem = Text()

    def refresh(self) -> None:
        """Show the changes in the queue of runs."""

    def show_tube(self) -> None:
        """Show the tube that was opened or changed."""

    def tube_changed(self) -> None:
        """Show the tube, or its error."""
        self.guarded(self.show_tube)()

    def guarded(self, work: Callable[[], None]) -> Callable[[], None]:
        """A callback that shows the errors of user input."""

        def call() -> None:
            try:
                self.problem.text = ""
                work()
            except (ValueError, OSError) as error:
                self.problem.text = alert(error)

        return call


def alert(problem: Exception | str) -> str:
    """An error as HTML; empty for an empty text."""
    text = format_error(problem) if isinstance(problem, Exception) else problem
    return f'<p class="problem" role="alert">{escape(text)}</p>' if text else ""


def table_html(header: Iterable[str], rows: Iterable[Iterable[str]], style: str = "") -> str:
    """An HTML table; cells are HTML."""
    head = "".join(f"<th>{escape(name)}</th>" for name in header)
    body = "".join(f"<tr>{''.join(f'<td>{cell}</td>' for cell in row)}</tr>" for row in rows)
    return f"<table class='{style}'><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def control(kind: Any, title: str, changed: Callable[[], None] | None = None, width: int = 190, **options: Any) -> Any:
    """A widget that calls ``changed`` when its value changes to anything but null or NaN."""
    widget = kind(title=title, width=width, **options)
    if changed is not None:
        widget.on_change("value", lambda attr, old, new: changed() if new is not None and new == new else None)
    return widget


def check_offered(*widgets: Any) -> None:
    """Check that the values of widgets are among those that they offer; a request need not come from a browser."""
    for widget in widgets:
        if isinstance(widget, models.Spinner):
            within(widget.title, widget.value or widget.low, widget.low, widget.high, "")
            continue
        for value in widget.value if isinstance(widget.value, list) else [widget.value]:
            if value not in widget.options:
                accepted = f"accepted: {', '.join(widget.options)}{closest(value, widget.options)}"
                raise ValueError(f"{widget.title} = {value!r} is not offered; {accepted}")


def button(label: str, clicked: Callable[[], None], width: int = 100, **options: Any) -> Button:
    """A button."""
    widget = Button(label=label, width=width, **options)
    widget.on_click(clicked)
    return widget


class SaveAs:
    """A field for a file name, and a button, which asks before a file is replaced.

    Args:
        screen: screen that shows the errors.
        save: function that saves under a name and raises ``ReplaceError`` if the file exists and its second argument
            is not set.
        width: of the field.
        options: of the field.
    """

    def __init__(self, screen: Screen, save: Callable[[str, bool], None], width: int = 190, **options: Any) -> None:
        self._save_under, self._busy = save, False
        self.name = control(models.TextInput, "save as", screen.guarded(self._save), width, **options)
        self.button = button("save", screen.guarded(lambda: self._save(self.button.label == "replace")), 80)

    def set(self, name: str) -> None:
        """Show the name of an opened file, without saving."""
        self._busy = True
        self.name.value = name
        self._busy, self.button.label = False, "save"

    def _save(self, replace: bool = False) -> None:
        name, self.button.label = self.name.value.strip(), "save"
        if not name or self._busy:
            return
        try:
            self._save_under(name, replace)
        except ReplaceError:
            self.button.label = "replace"
            raise


def upload(title: str, accept: str, target: models.TextInput, screen: Screen) -> models.FileInput:
    """A file chooser; the file is stored in the app's folder and its path set in ``target``."""
    widget = models.FileInput(title=title, accept=accept, width=230)

    def store() -> None:
        target.value = str(screen.session.store_upload(str(widget.filename), str(widget.value)))

    # in the next tick: the content arrives before the name
    widget.on_change("value", lambda attr, old, new: widget.document.add_next_tick_callback(screen.guarded(store)))
    return widget


def download(file: models.Div, name: models.TextInput, ending: str) -> Button:
    """A button that saves the text of a model, which is not displayed, under the name in ``name``."""
    widget = Button(label="download", width=100)
    widget.js_on_event(
        "button_click", models.CustomJS(args={"file": file, "name": name, "ending": ending}, code=DOWNLOAD_JS)
    )
    return widget


def line_styles(names: Iterable[str]) -> dict[str, tuple[str, str]]:
    """Colour and dash of the lines of policies, the same on all screens."""
    order = colours()
    return {name: (colour, DASHES[order.index(colour) % len(DASHES)]) for name, colour in policy_colours(names).items()}


def counter(changed: Callable[[], None] | None = None) -> Any:
    """An invisible number that the browser and the server can increase."""
    return control(Slider, "", changed, start=0, end=1_000_000, step=1, value=0, visible=False)


def choice(labels: Iterable[str], active: int, changed: Callable[[], None]) -> RadioButtonGroup:
    """A row of buttons, one of which is active."""
    group = RadioButtonGroup(labels=list(labels), active=active)
    group.on_change("active", lambda attr, old, new: changed())
    return group


def row(*children: Any, **styles: str) -> Row:
    """Children next to each other, wrapped on a narrow page."""
    wrapped = {"flex-wrap": "wrap", "align-items": "flex-end", "gap": "2px 8px"} | styles
    return Row(children=_models(children), sizing_mode="stretch_width", styles=wrapped)


def columns(*children: tuple[Any, int, int]) -> Row:
    """Columns (child, minimum width in pixels, share of the width), one below the other on a narrow page."""
    for child, minimum, fraction in children:
        child.styles = {**child.styles, "flex": f"{fraction} 1 {minimum}px", "min-width": "0"}
    return row(*(child for child, *_ in children), **{"align-items": "flex-start"})


def column(*children: Any, **options: Any) -> Column:
    """Children one below the other."""
    return Column(children=_models(children), sizing_mode="stretch_width", **options)


def _models(children: Iterable[Any]) -> list[Any]:
    return [child.pane if isinstance(child, Text) else child for child in children]


def chart(x: str, y: str, height: int = 230, tools: str = "xpan,xwheel_zoom,box_zoom,reset", **options: Any) -> Any:
    """An empty chart; ``x`` and ``y`` are axis labels with units."""
    size = {"height": height, "min_width": options.pop("min_width", 300), "sizing_mode": "stretch_width"}
    plot: Any = figure(tools=tools, x_axis_label=x, y_axis_label=y, active_scroll=None, **size, **options)
    # labels of constant width: when an axis gets wider, the browser lays out the whole page again
    plot.yaxis[0].update(formatter=PrintfTickFormatter(format="%6.3g"), major_label_text_font="monospace")
    if options.get("y_axis_type") != "log":
        plot.yaxis[0].ticker.desired_num_ticks = max(height // 50, 2)
    return plot


def limit_line(plot: Any) -> Callable[[float | None], None]:
    """Add a dashed line at the limit of the radial rms [m]; returns a function that moves it, or hides it for None."""
    line = Span(location=0.0, dimension="width", line_dash="dashed", line_width=1.5, visible=False)
    plot.add_layout(line)
    return lambda limit: line.update(location=1e3 * (limit or 0.0), visible=limit is not None)
