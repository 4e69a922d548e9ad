"""How the page looks: colours that the colour-blind can tell, charts whose axes have units, lines of text."""

from __future__ import annotations

from html import escape
from typing import Any, Final

from bokeh.models import (
    Column,
    ColumnDataSource,
    CustomJS,
    Div,
    GlobalInlineStyleSheet,
    InlineStyleSheet,
    PrintfTickFormatter,
    Row,
    Span,
    UIElement,
)  # fmt: skip
from bokeh.plotting import figure

BLUE, VERMILLION, GREEN, ORANGE, PURPLE, SKY, INK, GREY = (
    "#0072B2", "#D55E00", "#009E73", "#E69F00", "#CC79A7", "#56B4E9", "#222222", "#8a8a8a",
)  # fmt: skip
"""Okabe and Ito's, which people with any colour vision can tell apart."""
PALETTE: Final = (BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY, INK, GREY)
DASHES: Final = ("solid", "dashed", "dotdash", "dotted", "dashdot", "solid", "dashed", "dotted")
"""Told apart without colours too."""
NUMBER: Final = "%6.3g"
"""At an axis: always as wide, as a browser lays the whole page out anew where an axis gets wider."""
PAGE: Final = """
html { color-scheme: light; }
body { margin: 0; padding: 10px 16px 40px; font: 15px/1.45 system-ui, sans-serif; color: #222; background: #fff; }
"""
TEXT: Final = """
:host { font-size: 15px; line-height: 1.45; max-width: 100%; overflow-x: auto; }
h1 { font-size: 21px; margin: 0; } h2 { font-size: 17px; margin: 12px 0 2px; } p { margin: 3px 0; }
.problem { color: #a33a00; font-weight: 600; } .problem::before { content: "\\26A0\\00A0"; }
.quiet { color: #555; } .big { font-size: 19px; }
.bk-clearfix { max-width: 100%; } .scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: 14px; }
th, td { text-align: right; padding: 3px 7px; border-bottom: 1px solid #ddd; white-space: nowrap; }
th:first-child, td:first-child { text-align: left; } thead th { white-space: normal; vertical-align: bottom; }
table.folds td { white-space: normal; } small { color: #555; display: block; } td.best { font-weight: 700; }
code { background: #f2f2f2; padding: 1px 4px; overflow-wrap: anywhere; }
"""
PUT: Final = """
const html = source.data.html[0];
div.setv({text: html}, {silent: true});
const view = Bokeh.index.find_one(div);
if (view != null && view.markup_el != null) view.markup_el.innerHTML = html;
"""
CONTROL: Final = """
:host { max-width: 100%; } .bk-btn-group { flex-wrap: wrap; }
.bk-input, .bk-btn { font-size: 15px; min-height: 34px; } label { font-size: 14px; }
.bk-btn:focus-visible, .bk-input:focus-visible { outline: 3px solid #0072B2; outline-offset: 1px; }
"""


def page_sheet() -> GlobalInlineStyleSheet:
    """Of the whole page."""
    return GlobalInlineStyleSheet(css=PAGE)


def control_sheet() -> InlineStyleSheet:
    """Of buttons and fields: large enough for a finger, and it is seen where the keyboard is."""
    return InlineStyleSheet(css=CONTROL)


def words(html: str = "", **options: Any) -> Div:
    """Text; ``html`` is ours, what comes from files or people is escaped before."""
    given: dict[str, Any] = {"sizing_mode": "stretch_width", "margin": (0, 5, 0, 5)} | options
    return Div(text=html, stylesheets=[InlineStyleSheet(css=TEXT)], **given)


class Live:
    """Text that changes many times a second: put where it stands, for a ``Div`` alone lays out all charts anew.

    Attributes:
        div: where it stands.
        show: puts it there, in the browser.
    """

    def __init__(self, **options: Any) -> None:
        self.div = words(**options)
        self._source = ColumnDataSource({"html": [""]})
        self.show = CustomJS(args={"source": self._source, "div": self.div}, code=PUT)
        self._source.js_on_change("data", self.show)
        self.div.tags = [self._source]  # which makes it a part of the page

    @property
    def text(self) -> str:
        """As in ``words``."""
        return str(self._source.data["html"][0])

    @text.setter
    def text(self, html: str) -> None:
        if self.div.document is None:
            self.div.text = html
        self._source.data = {"html": [html]}


def problem(text: str) -> str:
    """An error as text of ``words``; nothing for none."""
    return f'<p class="problem" role="alert">{escape(text)}</p>' if text else ""


def chart(x: str, y: str, height: int = 230, **options: Any) -> Any:
    """An empty chart; ``x`` and ``y`` name the axes with their units."""
    tools = options.pop("tools", "xpan,xwheel_zoom,box_zoom,reset")
    plot: Any = figure(
        height=height, sizing_mode="stretch_width", tools=tools, x_axis_label=x, y_axis_label=y, min_width=300,
        toolbar_location=options.pop("toolbar_location", None), active_scroll=None, **options,
    )  # fmt: skip
    plot.toolbar.logo = None
    plot.outline_line_color = "#cccccc"
    for grid in plot.grid:
        grid.grid_line_color = "#ececec"
    for axis in plot.axis:
        axis.minor_tick_line_color = None
        axis.axis_label_text_font_size = "13px"
        axis.axis_label_text_font_style = "normal"
        axis.major_label_text_font_size = "12px"
    plot.yaxis[0].update(formatter=PrintfTickFormatter(format=NUMBER), major_label_text_font="monospace")
    if options.get("y_axis_type") != "log":
        plot.yaxis[0].ticker.desired_num_ticks = max(height // 50, 2)
    plot.min_border_left = 62
    return plot


def legend_above(plot: Any) -> None:
    """Put a chart's legend where it covers nothing."""
    legend = plot.legend[0]
    legend.update(orientation="horizontal", border_line_color=None, padding=2, label_text_font_size="12px")
    plot.add_layout(legend, "above")


def limit_line(plot: Any, at: float | None) -> Span:
    """The dashed line of the vibration limit [mm]."""
    line = Span(
        location=at if at is not None else 0.0, dimension="width", line_color=INK, line_dash="dashed",
        line_width=1.5, visible=at is not None,
    )  # fmt: skip
    plot.add_layout(line)
    return line


def side_by_side(*children: UIElement, **options: Any) -> Row:
    """Next to each other where there is room, else below."""
    styles = {"flex-wrap": "wrap", "align-items": "flex-end", "gap": "2px 8px"} | options.pop("styles", {})
    return Row(children=list(children), sizing_mode="stretch_width", styles=styles, **options)


def below(*children: UIElement, **options: Any) -> Column:
    """One below the other."""
    return Column(children=list(children), sizing_mode="stretch_width", **options)


def panel(child: Any, least: int, share: int = 1) -> Any:
    """A part of ``side_by_side`` that takes its share of the width, and at least so many pixels."""
    child.styles = {**child.styles, "flex": f"{share} 1 {least}px", "min-width": "0"}
    return child
