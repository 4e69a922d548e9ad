"""Screen of comparisons: the report of a stored evaluation, or the table of a comparison of designs."""

from html import escape
from pathlib import Path
from typing import Final
from urllib.parse import quote

from bokeh.models import Select, TextInput

from probe_agents.app.run_store import stored_runs
from probe_agents.app.screens import widgets as ui
from probe_agents.app.state import Session
from probe_agents.design.compare import STORED, read_comparison, summarise, texts_of
from probe_agents.evaluation.report import write_report

INTRO: Final = "<h2>Compare</h2><p class='quiet'>Reports of stored evaluations, and comparisons of probe designs.</p>"
FRAME: Final = (
    "sandbox='allow-scripts allow-downloads allow-popups' title='report'"
    " style='width: 100%; box-sizing: border-box; height: 80vh; min-height: 480px; border: 1px solid #ccc'"
)


class CompareScreen(ui.Screen):
    """Stored evaluations."""

    def __init__(self, session: Session) -> None:
        super().__init__(session)
        text = {"placeholder": "results/evaluation", "name": "open-evaluation"}
        self.chosen = ui.control(Select, "run", self.guarded(self._choose), 300, options=[])
        self.open = ui.control(TextInput, "open an evaluation folder", self.guarded(self._open), 260, **text)
        self.content = ui.Text()
        self.layout = ui.column(ui.Text(INTRO), ui.row(self.chosen, self.open), self.problem, self.content)

    def refresh(self) -> None:
        """List the stored runs and show a new one."""
        names = [run.folder.name for run in reversed(stored_runs(self.session.app.output))]
        if names != self.chosen.options:
            self.chosen.options = names
            if self.chosen.value != names[0]:
                self.chosen.value = names[0]
            else:
                self.guarded(self._choose)()

    def _choose(self) -> None:
        if self.chosen.value:
            self._show(self.session.app.output / self.chosen.value)

    def _open(self) -> None:
        if self.open.value.strip():
            self._show(Path(self.open.value.strip()))

    def _show(self, folder: Path) -> None:
        if (folder / STORED).exists():  # a comparison of designs
            summary = summarise(read_comparison(folder))
            header, rows = texts_of(summary)
            self.content.text = ui.table_html(header, (map(escape, texts) for texts in rows))
            return
        report = folder / "report.html"
        stored_at = max((path.stat().st_mtime for path in folder.glob("episodes.*")), default=0.0)
        if not report.exists() or report.stat().st_mtime < stored_at:
            write_report(folder)
        self.session.app.reports.add(folder)
        link = f"{ui.REPORT_URL}?folder={quote(str(folder))}&written={report.stat().st_mtime_ns}"
        self.content.text = (
            f"<p><a href='{link}' target='_blank'>open the report</a>, <a href='{link}'"
            f" download='{escape(folder.name, quote=True)}.html'>download</a> <code>{escape(str(report))}</code></p>"
            f"<iframe {FRAME} src='{link}'></iframe>"
        )
