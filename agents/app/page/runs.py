"""The line of runs and what is stored: how each ended, what goes on, and the report by one click."""

from __future__ import annotations

from collections.abc import Callable
from html import escape
from pathlib import Path
from typing import Any
from urllib.parse import quote

from bokeh.models import Button, Select

from agents.app.desk import Desk
from agents.app.page.style import Live, below, control_sheet, problem, side_by_side, words
from agents.app.runs.queue import Run
from agents.app.runs.shelf import Stored, stored_runs, unfinished
from agents.evaluation.report import write_report
from agents.terminal.refusals import refusal

REPORT = "/report/"


class RunList:
    """Runs of this process, and folders that are stored.

    Args:
        desk: whose.
        look_at: is called with a run that is chosen.
    """

    def __init__(self, desk: Desk, look_at: Callable[[Run], None]) -> None:
        self.desk, self.look_at = desk, look_at
        sheet = [control_sheet()]
        self.table = Live(name="runs")
        self.chosen = Select(title="a run", options=[], width=300, stylesheets=sheet, name="chosen-run")
        show = Button(label="watch it", stylesheets=sheet, width=90)
        resume = Button(label="go on with it", stylesheets=sheet, width=120, name="go-on")
        report = Button(label="write its report", stylesheets=sheet, width=140, name="report")
        self.notice = words(name="report-link")
        self._stored: list[Stored] = []
        self._seen: Any = None
        show.on_click(self._show)
        resume.on_click(lambda: self._guarded(self._go_on))
        report.on_click(lambda: self._guarded(self._report))
        self.layout = below(
            words("<h2>Runs</h2>"), self.table.div, side_by_side(self.chosen, show, resume, report), self.notice
        )

    def refresh(self) -> None:
        """Show how the runs are doing."""
        runs = self.desk.office.queue.runs
        states = tuple((run.state, run.done) for run in runs)
        if states == self._seen:
            return
        self._seen = states
        self._stored = stored_runs(self.desk.office.output)
        self.table.text = _table(runs, self._stored)
        names = [run.wanted.output.name for run in runs]
        names += [entry.folder.name for entry in self._stored if entry.folder.name not in names]
        names = sorted(set(names), reverse=True)
        if self.chosen.options != names:
            self.chosen.options = names
            self.chosen.value = names[0] if names else ""

    @property
    def _folder(self) -> Path:
        return self.desk.office.output / str(self.chosen.value)

    def _run(self) -> Run | None:
        matches = [run for run in self.desk.office.queue.runs if run.wanted.output.name == self.chosen.value]
        return matches[-1] if matches else None

    def _show(self) -> None:
        run = self._run()
        if run is not None:
            self.notice.text = ""
            self.look_at(run)
        else:
            self.notice.text = "<p>It was run before this page was opened: look at it under <b>Compare</b>.</p>"

    def _go_on(self) -> None:
        run = self._run()
        if run is not None and run.state in ("waiting", "running"):
            raise ValueError(f"{self.chosen.value} is {run.state} already")
        self.look_at(self.desk.office.queue.add(unfinished(self._folder)))

    def _report(self) -> None:
        if not self.chosen.value:
            raise ValueError("a run = none: there is nothing to report of yet")
        self.notice.text = report_link(self._folder)

    def _guarded(self, work: Callable[[], None]) -> None:
        try:
            self.notice.text = ""
            work()
        except (ValueError, OSError) as error:
            self.notice.text = problem(refusal(error))


def report_link(folder: Path) -> str:
    """Write the report of a stored evaluation; where it is, as a link that this server answers."""
    path = write_report(folder)
    link = f'<a href="{REPORT}?folder={quote(str(folder))}" target="_blank">open the report</a>'
    return f"<p>written: <code>{escape(str(path))}</code> {link}</p>"


def _table(runs: list[Run], stored: list[Stored]) -> str:
    ended = {entry.folder: entry.outcome for entry in stored}
    rows = [(entry.folder.name, "stored" if entry.whole else "interrupted", entry.outcome) for entry in stored]
    lines = {name: (state, outcome) for name, state, outcome in rows}
    for run in runs:
        done = f"{run.done} of {run.planned} insertions" if run.planned else ""
        outcome = ended.get(run.wanted.output, "") if run.state == "finished" else run.problem or done
        lines[run.wanted.output.name] = (run.state, outcome)
    if not lines:
        return "<p class='quiet'>None yet.</p>"
    body = "".join(
        f"<tr><td>{escape(name)}</td><td style='text-align:left'>{escape(state)}</td>"
        f"<td style='text-align:left;white-space:normal'>{escape(outcome)}</td></tr>"
        for name, (state, outcome) in sorted(lines.items(), reverse=True)
    )
    head = "<tr><th>run</th><th>state</th><th>how it ended</th></tr>"
    return f"<div class='scroll'><table><thead>{head}</thead><tbody>{body}</tbody></table></div>"
