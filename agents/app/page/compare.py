"""The screen of comparisons: any stored evaluation, with a verdict in words, intervals, and its report by one click."""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import Any, Final

from bokeh.models import Button, ColumnDataSource, HoverTool, LabelSet, Select, TextInput, Whisker

from agents.app.desk import Desk
from agents.app.page.runs import report_link
from agents.app.page.style import (
    DASHES,
    INK,
    PALETTE,
    below,
    chart,
    control_sheet,
    legend_above,
    limit_line,
    panel,
    problem,
    side_by_side,
    words,
)  # fmt: skip
from agents.app.runs.shelf import stored_runs
from agents.evaluation.page.stored import Evaluation, read_evaluation
from agents.evaluation.page.tables import Row, by_diameter, by_tube, ranked
from agents.evaluation.page.traces import traces
from agents.evaluation.page.verdict import limit_of, ranking, verdict
from agents.policies.on_map import Privileged
from agents.rollouts.statistics import method_and_seed, sentences, summarise
from agents.terminal.refusals import refusal

UNITS: Final = (("feed speed [m/s]", 1e-4), ("air supply [m³/h]", 0.1), ("radial rms [mm]", 1e-4))
"""Of the columns of the report's traces: what they are and the unit in which they are whole numbers."""


class CompareScreen:
    """Of one desk."""

    def __init__(self, desk: Desk) -> None:
        self.desk = desk
        sheet = [control_sheet()]
        self.folder: Path | None = None
        self.chosen = Select(title="a run of this folder", options=[], width=300, stylesheets=sheet, name="compare-run")
        self.open = TextInput(title="any stored evaluation", placeholder="results/evaluation", width=260,
                              stylesheets=sheet, name="open-evaluation")  # fmt: skip
        report = Button(label="write its report", stylesheets=sheet, width=140, name="write-report")
        self.wrong, self.verdict = words(name="compare-problem"), words(name="verdict")
        self.link, self.tables = words(name="compare-report"), words(name="ranking")
        self.tube = Select(title="tube", options=[], width=280, stylesheets=sheet)
        self.front = _Front()
        self.over_length = _OverLength()
        self._drawn: dict[str, Any] = {}
        self._folders: tuple[str, ...] = ()
        self.chosen.on_change("value", lambda attr, old, new: self._choose())
        self.open.on_change(
            "value",
            lambda attr, old, new: self._read(Path(self.open.value.strip())) if self.open.value.strip() else None,
        )
        self.tube.on_change("value", lambda attr, old, new: self._draw_tube())
        report.on_click(self._report)
        self.layout = below(
            words("<h2>Compare</h2><p class='quiet'>Everything here is read from the folder, with the statistics of the"
                  " report.</p>"),
            side_by_side(self.chosen, self.open, report),
            self.wrong,
            self.link,
            self.verdict,
            side_by_side(panel(self.front.plot, 360, 2), panel(below(self.tube, *self.over_length.plots), 400, 3),
                         styles={"align-items": "flex-start"}),
            self.tables,
        )  # fmt: skip

    def refresh(self) -> None:
        """List what is stored by now; the newest is shown first."""
        found = tuple(entry.folder.name for entry in stored_runs(self.desk.office.output))
        if found != self._folders:
            self._folders = found
            self.chosen.options = list(reversed(found))
            if found and self.chosen.value != found[-1]:
                self.chosen.value = found[-1]
            elif found:
                self._choose()

    def _choose(self) -> None:
        if self.chosen.value:
            self._read(self.desk.office.output / self.chosen.value)

    def _read(self, folder: Path) -> None:
        try:
            done = read_evaluation(folder)
        except (ValueError, OSError) as error:
            self.wrong.text = problem(refusal(error))
            return
        self.folder, self.wrong.text, self.link.text = folder, "", ""
        self._show(done)

    def _show(self, done: Evaluation) -> None:
        table, task = done.table, done.setting.task
        described = done.record.policies if done.record else {}
        kinds = {method_and_seed(name)[0]: d.get("policy") for name, d in described.items()}
        told = {name for name, kind in kinds.items() if kind == Privileged.__name__}
        judged = done.own or (done.against,)
        verdicts = [verdict(table, policy, told, limit_of(task)) for policy in judged]
        missing = ""
        if done.missing is not None:
            missing = f"<p class='quiet'>Not finished: {done.missing.stored} of {done.missing.planned} insertions.</p>"
        lines = "".join(
            f"<p class='big'><b>{escape(v.policy)}</b>: {escape(v.headline)}</p><p>{escape(v.detail)}</p>"
            for v in verdicts
        )
        self.verdict.text = lines + missing
        summary = summarise(table)
        differences = "".join(f"<li>{escape(line)}</li>" for line in sentences(table, done.against))
        self.tables.text = (
            "<h2>Ranking</h2>" + _html(*ranked(table, summary, done.own, told))
            + (f"<h2>Against {escape(done.against)}</h2><ul>{differences}</ul>" if differences else "")
            + _titled("By helix diameter", *by_diameter(table, told)) + _titled("Tube by tube", *by_tube(table, told))
        )  # fmt: skip
        order = ranking(table)
        self.front.show(summary, order)
        limit = task.limit * 1e3 if task.vibration_measure == "displacement" else None
        self._drawn = traces(table, done.profile, order[:6], limit)
        options = [(str(k), f"{t['number']}: {t['text']}".rstrip(": ")) for k, t in enumerate(self._drawn["tubes"])]
        self.tube.options = options
        self.tube.value = "0"
        self._draw_tube()

    def _draw_tube(self) -> None:
        if self._drawn and self.tube.value:
            self.over_length.show(self._drawn, int(self.tube.value))

    def _report(self) -> None:
        try:
            if self.folder is None:
                raise ValueError("a run = none: choose one, or open a folder")
            self.link.text = report_link(self.folder)
        except (ValueError, OSError) as error:
            self.link.text = problem(refusal(error))


class _Front:
    """Time against vibration, a point a policy with its intervals."""

    def __init__(self) -> None:
        self.plot = chart("inspection time [s]", "radial rms [mm]", 330, y_axis_type="log",
                          tools="pan,wheel_zoom,reset", title="Down and left is better; bars: 95 %")  # fmt: skip
        self.plot.x_range.range_padding = self.plot.y_range.range_padding = 0.25  # room for names
        names = ("name", "colour", "x", "y", "x_low", "x_high", "y_low", "y_high")
        self.source = ColumnDataSource({name: [] for name in names})
        for dimension, base, low, high in (("height", "x", "y_low", "y_high"), ("width", "y", "x_low", "x_high")):
            self.plot.add_layout(
                Whisker(source=self.source, base=base, lower=low, upper=high, dimension=dimension, line_color=INK)
            )
        dots = self.plot.scatter("x", "y", source=self.source, size=13, color="colour", line_color="white")
        self.plot.add_layout(
            LabelSet(source=self.source, x="x", y="y", text="name", x_offset=8, y_offset=4, text_font_size="12px")
        )
        tips = [("", "@name"), ("time [s]", "@x{0.}"), ("radial rms [mm]", "@y{0.000}")]
        self.plot.add_tools(HoverTool(renderers=[dots], tooltips=tips))

    def show(self, summary: Any, order: list[str]) -> None:
        """Draw the policies of a summary."""
        rows = {(r["policy"], r["kpi"]): r for r in summary.to_dict("records")}
        data: dict[str, list[Any]] = {name: [] for name in self.source.data}
        for number, policy in enumerate(order):
            time, rms = rows[policy, "inspection_time_s"], rows[policy, "radial_rms_m"]
            data["name"].append(policy)
            data["colour"].append(PALETTE[number % len(PALETTE)])
            for axis, row, factor in (("x", time, 1.0), ("y", rms, 1e3)):
                for end, key in (("", "mean"), ("_low", "low"), ("_high", "high")):
                    data[f"{axis}{end}"].append(row[key] * factor)
        self.source.data = data


class _OverLength:
    """Vibration, feed and air over the inserted length in one tube."""

    def __init__(self) -> None:
        self.sources: list[tuple[int, Any]] = []
        self.plots: list[Any] = []
        for number in (2, 0, 1):
            label, _ = UNITS[number]
            shared = {"x_range": self.plots[0].x_range} if self.plots else {}
            scale = "log" if number == 2 else "linear"
            plot = chart("inserted length [m]", label, 190, y_axis_type=scale, **shared)
            source = ColumnDataSource({name: [] for name in ("x", "y", "name", "colour", "dash")})
            plot.multi_line("x", "y", source=source, color="colour", line_dash="dash", line_width=2,
                            **({"legend_field": "name"} if number == 2 else {}))  # fmt: skip
            self.sources.append((number, source))
            self.plots.append(plot)
        legend_above(self.plots[0])
        self.limit = limit_line(self.plots[0], None)

    def show(self, drawn: dict[str, Any], tube: int) -> None:
        """Draw the policies that are shown first in a tube."""
        self.limit.update(location=drawn["limit"] or 0.0, visible=drawn["limit"] is not None)
        shown = [policy for policy in drawn["policies"] if policy["shown"] and policy["tubes"][tube]]
        for number, source in self.sources:
            _, unit = UNITS[number]
            values = [policy["tubes"][tube][number] for policy in shown]
            source.data = {
                "x": [drawn["metres"]] * len(shown),
                "y": [[float("nan") if v is None else max(v, number == 2) * unit for v in line] for line in values],
                "name": [policy["name"] for policy in shown],
                "colour": [PALETTE[k % len(PALETTE)] for k in range(len(shown))],
                "dash": [DASHES[k % len(DASHES)] for k in range(len(shown))],
            }


def _titled(title: str, header: list[str], rows: list[Row]) -> str:
    return f"<h2>{title}</h2>{_html(header, rows)}" if rows else ""


def _html(header: list[str], rows: list[Row]) -> str:
    """A table of the report."""
    head = "".join(f"<th>{escape(name)}</th>" for name in header)
    body = []
    for row in rows:
        cells = "".join(
            f"<td{' class=best' if cell.best else ''}>{escape(cell.text)}<small>{escape(cell.below)}</small></td>"
            for cell in row.cells
        )
        body.append(f"<tr><th>{escape(row.head)}<small>{escape(row.below)}</small></th>{cells}</tr>")
    return f"<div class='scroll'><table><thead><tr>{head}</tr></thead><tbody>{''.join(body)}</tbody></table></div>"
