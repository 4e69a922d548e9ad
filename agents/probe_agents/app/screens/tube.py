"""Screen of tube and probe: the fields of the tube file, drawings to scale, and a calibration."""

from collections.abc import Callable
from html import escape
from pathlib import Path
from typing import Any, Final

import numpy as np
from bokeh import models
from bokeh.models.dom import HTML

from probe_agents.app.forms import Field, tube_fields
from probe_agents.app.screens import widgets as ui
from probe_agents.app.screens.charts import empty_source
from probe_agents.app.state import Session
from probe_agents.records.shipped import shipped_names
from probe_env import Plant
from probe_env.envs.plants import unusual

TITLES: Final = {"contact": "Walls", "feed": "Feed device"}
FOLDED: Final = {"sensor": "the sensor model", "task": "limits, weights and sensors of the task"}
"""Table that is hidden at first -> its contents."""
STUDY, OPENED = "study tubes", "your tube"
INTRO: Final = (
    "<h2>Tube and probe</h2><p class='quiet'>An empty field has its grey value, of the study or the calibration. Runs"
    " and predictions use this tube.</p>"
)


class TubeScreen(ui.Screen):
    """Tube and probe of a session; calls ``changed`` after changes."""

    def __init__(self, session: Session, changed: Callable[[], None]) -> None:
        super().__init__(session)
        self._changed, self._busy = changed, False
        self.summary = ui.Text()
        self.inputs: dict[str, Any] = {}
        self.errors: dict[str, ui.Text] = {}
        self._draw_section, section = _section_drawing()
        choice = {"options": [STUDY, OPENED, *shipped_names("tubes")], "value": STUDY}
        self.shipped = ui.control(models.Select, "start with", self.guarded(self._select), 160, **choice)
        self.open = ui.control(models.TextInput, "open a tube file", self.guarded(self._open), placeholder="mine.toml")
        self.save = ui.SaveAs(self, self._save, placeholder="mine.toml")
        choose = ui.upload("from this computer", ".toml", self.open, self)
        self.file = models.Div()  # the tube file, to download
        calibrated, example = self.guarded(self._calibrate), "calibration.json"
        self.calibration = ui.control(models.TextInput, "calibration", calibrated, placeholder=example)
        tables = ui.column(*(self._table(table, fields) for table, fields in tube_fields().items()))
        self.layout = ui.column(
            ui.Text(INTRO),
            ui.row(self.shipped, self.open, choose, self.calibration),
            ui.row(self.save.name, self.save.button, ui.download(self.file, self.save.name, ".toml")),
            self.problem,
            self.summary,
            ui.columns((tables, 430, 3), (section, 300, 2)),
        )
        self.fill()

    def fill(self) -> None:
        """Show the contents of the tube file in the fields and drawings."""
        self._busy, tube = True, self.session.tube
        name = tube.path.stem if tube.path else ""
        self.shipped.value = STUDY if tube.is_study else name if name in self.shipped.options else OPENED
        draws = tube.plant.posterior.draws if tube.plant.posterior else {}
        for field in (field for fields in tube_fields().values() for field in fields):
            text = tube.text(field)
            values = draws.get(field.name, draws.get(f"{field.table}_{field.name}"))
            if field.kind != "choice":
                grey = field.default or "none"
                if values is not None:
                    grey = "{:.3g} to {:.3g}".format(*field.factor * np.quantile(values, (0.05, 0.95)))
                self.inputs[field.path].placeholder = grey
            self.inputs[field.path].value = text or (field.default if field.kind == "choice" else "")
            self.errors[field.path].text = ""
        self.calibration.value = tube.posterior
        self._busy = False
        self._draw()

    def _table(self, table: str, fields: tuple[Field, ...]) -> Any:
        cells = ui.columns(*((self._cell(field), 190, 1) for field in fields))
        title = ui.Text(f"<h2>{TITLES.get(table, table.capitalize())}</h2>")
        if table not in FOLDED:
            return ui.column(title, cells)
        cells.visible = False
        more = ui.button(f"show {FOLDED[table]}", lambda: setattr(cells, "visible", not cells.visible), 330)
        return ui.column(title, more, cells)

    def _cell(self, field: Field) -> Any:
        tip = models.Tooltip(content=HTML(html=escape(field.hint)), position="bottom")
        options = {"description": tip, "sizing_mode": "stretch_width", "name": field.path}
        if field.kind == "choice":
            kind, options["options"] = models.Select, list(field.choices)
        else:
            kind = models.TextInput
        widget = ui.control(kind, field.title, lambda: self._edited(field), **options)
        self.inputs[field.path], self.errors[field.path] = widget, ui.Text()
        return ui.column(widget, self.errors[field.path])

    def _edited(self, field: Field) -> None:
        text, tube = self.inputs[field.path].value, self.session.tube
        if self._busy:
            return
        try:
            if field.kind != "choice" or text != field.default or tube.text(field):  # defaults are not stored
                tube.change(field, text)
            self.errors[field.path].text = ""
        except ValueError as error:
            self.errors[field.path].text = ui.alert(error)
            return
        self._draw()
        self._changed()

    def _select(self) -> None:
        if self._busy or self.shipped.value == OPENED:
            return
        if self.shipped.value == STUDY:
            self.session.tube.close()
        else:
            self.session.tube.open(Path(self.shipped.value))
        self._opened()

    def _open(self) -> None:
        if self.open.value.strip():
            self.session.tube.open(Path(self.open.value.strip()))
            self.save.set(str(self.session.tube.path))
            self._opened()

    def _calibrate(self) -> None:
        if not self._busy:
            self.session.tube.change_posterior(self.calibration.value)
            self._opened()

    def _save(self, name: str, replace: bool) -> None:
        path = str(self.session.save_tube(name, replace))
        self._opened()
        self.summary.text += f"<p>written: <code>{escape(path)}</code></p>"

    def _opened(self) -> None:
        self.fill()
        self._changed()

    def _draw(self) -> None:
        tube = self.session.tube
        self.file.text = tube.toml
        if tube.is_study:
            text = "The study's tubes: the shipped test list, which was not used for tuning."
        else:
            source = f"from <code>{escape(str(tube.path))}</code>" if tube.path else "not saved yet"
            changes = ", with unsaved changes" if tube.changed and tube.path else ""
            text = f"Your tube, {source}{changes}. Uncertain values are sampled for every tube."
        length, diameter = tube.plant.scene.tube.helix_length, tube.plant.scene.tube.helix_diameter
        self.summary.text = f"<p>{text} {length:g} m, {length / (np.pi * diameter):.1f} turns of {diameter:g} m.</p>"
        self.summary.text += "".join(map(ui.alert, unusual(tube.plant)))
        self._draw_section(tube.plant)


def _section_drawing() -> tuple[Callable[[Plant], None], Any]:
    """Bore, floats and cable to scale, the floats on the inner wall."""
    plot = ui.chart("across [mm]", "from the inner wall [mm]", 250, "reset", match_aspect=True, title="Section")
    source = empty_source(("y", "radius", "fill", "name"))
    style = {"source": source, "fill_color": "fill", "line_color": ui.INK, "line_width": 1.5, "legend_field": "name"}
    plot.circle(0.0, "y", radius="radius", **style)
    plot.legend.label_text_font_size = "11px"
    plot.add_layout(plot.legend[0], "right")

    def draw(plant: Plant) -> None:
        probe, bore = plant.probe, plant.tube.inner_diameter
        carrier, guide = probe.carrier_float_diameter, probe.guide_float_diameter
        names = ("bore", "carrier float", "guide float", "cable")
        diameters = 1e3 * np.array([bore, carrier, guide, probe.cable_diameter])
        source.data = {
            "y": 0.5e3 * np.array([bore, carrier, guide, carrier]),
            "radius": 0.5 * diameters,
            "fill": ["#f4f4f4", ui.SKY, ui.ORANGE if guide != carrier else ui.SKY, ui.GREY],
            "name": [f"{name} {diameter:g} mm" for name, diameter in zip(names, diameters, strict=True)],
        }

    return draw, plot
