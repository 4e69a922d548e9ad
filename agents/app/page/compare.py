"""The screen of comparisons: any stored evaluation, with a verdict in words, intervals, and its report by one click."""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import Any, Final

import pandas as pd
from bokeh.models import Button, Select, TextInput

from agents.app.desk import Desk
from agents.app.page.comparisons import Detection, Front, OverLength
from agents.app.page.runs import report_link
from agents.app.page.style import (
    below,
    control_sheet,
    panel,
    problem,
    side_by_side,
    words,
)  # fmt: skip
from agents.app.runs.shelf import stored_runs
from agents.design.compare import STORED, cells, header, read_comparison
from agents.design.compare import summarise as summarise_designs
from agents.evaluation.folder import Evaluation, read_evaluation
from agents.evaluation.profiles import traces
from agents.evaluation.report import Cell, Row, by_diameter, by_tube, informed, limit_of, ranked, verdict
from agents.evaluation.statistics import Interval, ranking, sentences, summarise
from agents.terminal.refusals import refusal

SHOWN: Final = 6
"""Policies whose lines are drawn, the best first."""


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
        self.front = Front()
        self.over_length = OverLength()
        self.detection = Detection()
        self._drawn: dict[str, Any] = {}
        self._folders: tuple[str, ...] = ()
        self.chosen.on_change("value", lambda attr, old, new: self._choose())
        self.open.on_change(
            "value",
            lambda attr, old, new: self._read(Path(self.open.value.strip())) if self.open.value.strip() else None,
        )
        self.tube.on_change("value", lambda attr, old, new: self._draw_tube())
        report.on_click(self._report)
        self.pictures = side_by_side(
            panel(below(self.front.plot, self.detection.layout), 360, 2),
            panel(below(self.tube, *self.over_length.plots), 400, 3),
            styles={"align-items": "flex-start"},
        )
        self.layout = below(
            words("<h2>Compare</h2><p class='quiet'>Everything here is read from the folder, with the statistics of the"
                  " report.</p>"),
            side_by_side(self.chosen, self.open, report),
            self.wrong,
            self.link,
            self.verdict,
            self.pictures,
            self.tables,
        )  # fmt: skip

    def refresh(self) -> None:
        """List what is stored by now; the newest is shown first."""
        folders = tuple(entry.folder.name for entry in stored_runs(self.desk.office.output))
        if folders != self._folders:
            self._folders = folders
            self.chosen.options = list(reversed(folders))
            if folders and self.chosen.value != folders[-1]:
                self.chosen.value = folders[-1]
            elif folders:
                self._choose()

    def _choose(self) -> None:
        if self.chosen.value:
            self._read(self.desk.office.output / self.chosen.value)

    def _read(self, folder: Path) -> None:
        designs = (folder / STORED).exists()
        try:
            done = read_comparison(folder) if designs else read_evaluation(folder)
        except (ValueError, OSError) as error:
            self.wrong.text = problem(refusal(error))
            return
        self.folder, self.wrong.text, self.link.text = folder, "", ""
        self.pictures.visible = not designs
        if isinstance(done, Evaluation):
            self._show(done)
        else:
            self._show_designs(done)

    def _show_designs(self, table: pd.DataFrame) -> None:
        """Of a comparison of probe designs what the command prints."""
        summary, (first, *_) = summarise_designs(table), table["design"]
        rewards = summary[summary["kpi"] == "reward"].sort_values("mean", ascending=False)
        best = rewards.iloc[0]
        change = Interval(best["change"], best["change_low"], best["change_high"]).text()
        against = "" if best["design"] == first else f", {change} against {escape(str(first))}"
        self.verdict.text = (
            f"<p class='big'><b>{escape(str(best['design']))}</b> has the highest reward{against}.</p>"
            f"<p class='quiet'>Designs on {table['context'].nunique()} tubes; means with 95 % intervals.</p>"
        )
        rows = [Row(name, "", tuple(Cell(text) for text in texts)) for name, *texts in cells(summary)]
        self.tables.text = "<h2>Designs</h2>" + _html(header(summary), rows)

    def _show(self, done: Evaluation) -> None:
        table, task = done.table, done.setting.task
        knowing = informed(done)
        judged = done.own or (done.against,)
        verdicts = [verdict(table, policy, knowing, limit_of(task)) for policy in judged]
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
            "<h2>Ranking</h2>" + _html(*ranked(table, summary, done.own, knowing))
            + (f"<h2>Against {escape(done.against)}</h2><ul>{differences}</ul>" if differences else "")
            + _titled("By helix diameter", *by_diameter(table, knowing))
            + _titled("Tube by tube", *by_tube(table, knowing))
        )  # fmt: skip
        order = ranking(table)
        self.front.show(summary, order)
        self.detection.show(table, order[:SHOWN])
        limit = task.limit * 1e3 if task.vibration_measure == "displacement" else None
        self._drawn = traces(table, done.profile, order[:SHOWN], limit)
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
