"""The screen of tube and probe: the fields of ``tube.toml``, the helix and the probe as they are, a calibration."""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import Any, Final

import numpy as np
from bokeh.models import Button, ColumnDataSource, Select, TextInput, Tooltip
from bokeh.models.dom import HTML
from bokeh.models.ui import UIElement

from agents.app.desk import Desk
from agents.app.forms.fields import Field, plant_fields
from agents.app.page.style import (
    BLUE,
    GREEN,
    GREY,
    INK,
    ORANGE,
    SKY,
    VERMILLION,
    below,
    chart,
    control_sheet,
    panel,
    problem,
    side_by_side,
    words,
)  # fmt: skip
from agents.records.shipped import shipped_names
from agents.terminal.refusals import refusal
from probe_env import Plant

TITLES: Final = {
    "tube": "Tube",
    "probe": "Probe",
    "contact": "Walls",
    "air": "Air",
    "feed": "Feed device",
    "sensor": "Sensor",
    "task": "Task",
}
STUDY: Final = "the study's tubes"
WIND: Final = 0.35
"""How far the drawn helix winds inwards, of its radius, so that its turns do not lie on each other."""


class TubeScreen:
    """Of one desk.

    Args:
        desk: whose.
        changed: is called when the tube has become another one.
    """

    def __init__(self, desk: Desk, changed: Any) -> None:
        self.desk, self._changed, self._busy = desk, changed, False
        self.wrong, self.summary = words(name="tube-problem"), words(name="tube-words")
        self.inputs: dict[str, Any] = {}
        self.errors: dict[str, Any] = {}
        self.helix, self.section = _Helix(), _Section()
        self.posterior = _Posterior()
        forms = [self._table(table, fields) for table, fields in plant_fields().items()]
        self.layout = below(
            words("<h2>Tube and probe</h2><p class='quiet'>What a field leaves out is the study's. Runs, the schedule's"
                  " expectation and the drawings are of this tube.</p>"),
            side_by_side(*self._files()),
            self.wrong,
            self.summary,
            side_by_side(
                panel(below(*forms), 430, 3),
                panel(below(self.helix.plot, self.section.plot, self.posterior.layout), 300, 2),
                styles={"align-items": "flex-start"},
            ),
        )  # fmt: skip
        self.fill()

    def refresh(self) -> None:
        """Nothing happens here by itself."""

    def fill(self) -> None:
        """Put what the file says into the fields, and draw it."""
        self._busy = True
        for fields in plant_fields().values():
            for field in fields:
                text = self.desk.tube.text(field)
                self.inputs[field.path].value = text or (field.default if field.kind == "choice" else "")
                self.errors[field.path].text = ""
        self.calibration.value = self.desk.tube.posterior
        self._busy = False
        self._draw()

    def _files(self) -> list[Any]:
        sheet = [control_sheet()]
        self.shipped = Select(title="begin with", options=[STUDY, *shipped_names("tubes")], value=STUDY, width=160,
                              stylesheets=sheet)  # fmt: skip
        self.open = TextInput(
            title="open a tube", placeholder="mine.toml", width=190, stylesheets=sheet, name="open-tube"
        )
        self.save = TextInput(title="save as", placeholder="mine.toml", width=190, stylesheets=sheet, name="save-tube")
        self.calibration = TextInput(title="calibration", placeholder="calibration.json", width=200, stylesheets=sheet,
                                     name="calibration")  # fmt: skip
        self.shipped.on_change("value", lambda attr, old, new: self._guarded(self._begin))
        self.open.on_change("value", lambda attr, old, new: self._guarded(self._open))
        self.save.on_change("value", lambda attr, old, new: self._guarded(self._save))
        self.calibration.on_change(
            "value", lambda attr, old, new: None if self._busy else self._guarded(self._calibrate)
        )
        return [self.shipped, self.open, self.calibration, self.save]

    def _table(self, table: str, fields: tuple[Field, ...]) -> UIElement:
        cells = [panel(below(*self._cell(field)), 190) for field in fields]
        grid = side_by_side(*cells, styles={"align-items": "flex-start"})
        title = words(f"<h2>{TITLES.get(table, table)}</h2>")
        if table != "task":
            return below(title, grid)
        grid.visible = False
        more = Button(label="show limits, weights and sensors of the task", stylesheets=[control_sheet()], width=330)
        more.on_click(lambda: setattr(grid, "visible", not grid.visible))
        return below(title, more, grid)

    def _cell(self, field: Field) -> tuple[Any, Any]:
        sheet, name = [control_sheet()], field.name.replace("_", " ")
        title = f"{name} [{field.unit}]" if field.unit else name
        tip = Tooltip(content=HTML(html=field.hint or name), position="bottom")
        given: Any
        if field.kind == "choice":
            given = Select(title=title, options=list(field.choices), stylesheets=sheet, description=tip,
                           sizing_mode="stretch_width")  # fmt: skip
        else:
            given = TextInput(title=title, placeholder=field.default or "none", stylesheets=sheet, description=tip,
                              sizing_mode="stretch_width", name=field.path)  # fmt: skip
        wrong = words(name=f"{field.path}-problem")
        given.on_change("value", lambda attr, old, new: self._typed(field))
        self.inputs[field.path], self.errors[field.path] = given, wrong
        return given, wrong

    def _typed(self, field: Field) -> None:
        if self._busy:
            return
        text = self.inputs[field.path].value
        left_out = field.kind == "choice" and text == field.default and not self.desk.tube.text(field)
        try:
            if not left_out:
                self.desk.tube.change(field, text)
            self.errors[field.path].text = ""
        except ValueError as error:
            self.errors[field.path].text = problem(refusal(error))
            return
        self._draw()
        self._changed()

    def _begin(self) -> None:
        if self.shipped.value == STUDY:
            self.desk.tube.close()
        else:
            self.desk.tube.open(Path(self.shipped.value))
        self._taken()

    def _open(self) -> None:
        if self.open.value.strip():
            self.desk.tube.open(Path(self.open.value.strip()))
            self.save.value = str(self.desk.tube.path)
            self._taken()

    def _calibrate(self) -> None:
        self.desk.tube.change_posterior(self.calibration.value)
        self._taken()

    def _save(self) -> None:
        given = self.save.value.strip()
        if given and (self.desk.tube.changed or Path(given) != self.desk.tube.path):
            self.desk.tube.save(Path(given))
            self._taken()
            self.summary.text += f"<p>written: <code>{escape(given)}</code></p>"

    def _taken(self) -> None:
        self.fill()
        self._changed()

    def _guarded(self, work: Any) -> None:
        try:
            self.wrong.text = ""
            work()
        except (ValueError, OSError) as error:
            self.wrong.text = problem(refusal(error))

    def _draw(self) -> None:
        tube = self.desk.tube
        if tube.is_study:
            self.summary.text = "<p>The study's tubes: the shipped list, which nothing was tuned on.</p>"
        else:
            known = f"from <code>{escape(str(tube.path))}</code>" if tube.path else "not saved yet"
            changes = ", with changes that are not saved" if tube.changed and tube.path else ""
            self.summary.text = (
                f"<p>Your own tube, {known}{changes}; what is not known exactly is drawn anew for every tube.</p>"
            )
        self.helix.show(tube.plant)
        self.section.show(tube.plant)
        self.posterior.show(tube.plant)


class _Helix:
    """The helix from above, as a spiral inwards, and the probe in it."""

    def __init__(self) -> None:
        self.plot = chart(
            "east [m]", "north [m]", 300, match_aspect=True, tools="reset", title="Helix and inserted probe"
        )
        self.tube, self.probe, self.sensor = (ColumnDataSource({"x": [], "y": []}) for _ in range(3))
        self.plot.line("x", "y", source=self.tube, color="#c9c9c9", line_width=3)
        self.plot.line("x", "y", source=self.probe, color=BLUE, line_width=1)
        self.plot.scatter("x", "y", source=self.sensor, size=11, color=GREEN, line_color="white")

    def show(self, plant: Plant) -> None:
        """Draw a plant's first helix, with as much of the probe in it as goes in, up to 50 m of carrier."""
        scene = plant.scene
        length, radius = scene.tube.helix_length, 0.5 * scene.tube.helix_diameter
        places = (np.linspace(0.0, length, 1500), np.linspace(0.0, scene.inserted_length, 1200), [scene.carrier_length])
        for source, place in zip((self.tube, self.probe, self.sensor), places, strict=True):
            s = np.asarray(place)
            drawn = radius * (1.0 - WIND * s / length)
            source.data = {"x": drawn * np.cos(s / radius), "y": drawn * np.sin(s / radius)}
        turns = length / (2.0 * np.pi * radius)
        self.plot.title.text = f"{length:g} m of helix, {turns:.1f} turns of {2.0 * radius:g} m, drawn as a spiral"


class _Section:
    """Bore, float and cable to scale."""

    def __init__(self) -> None:
        self.plot = chart(
            "across [mm]", "from the inner wall [mm]", 250, match_aspect=True, tools="reset", title="Section"
        )
        self.source = ColumnDataSource({"y": [], "radius": [], "fill": [], "what": []})
        self.plot.circle(0.0, "y", radius="radius", source=self.source, fill_color="fill", line_color=INK,
                         line_width=1.5, legend_field="what")  # fmt: skip
        self.plot.legend.label_text_font_size = "11px"
        self.plot.add_layout(self.plot.legend[0], "right")

    def show(self, plant: Plant) -> None:
        """Draw the floats where they lie on the inner wall."""
        probe, bore = plant.probe, 1e3 * plant.tube.inner_diameter
        carrier, guide = 1e3 * probe.carrier_float_diameter, 1e3 * probe.guide_float_diameter
        cable = 1e3 * probe.cable_diameter
        self.source.data = {
            "y": [0.5 * bore, 0.5 * carrier, 0.5 * guide, 0.5 * carrier],
            "radius": [0.5 * bore, 0.5 * carrier, 0.5 * guide, 0.5 * cable],
            "fill": ["#f4f4f4", SKY, ORANGE if guide != carrier else SKY, GREY],
            "what": [
                f"bore {bore:g} mm",
                f"carrier float {carrier:g} mm",
                f"guide float {guide:g} mm",
                f"cable {cable:g} mm",
            ],
        }


class _Posterior:
    """Histograms of a calibration's draws."""

    def __init__(self) -> None:
        self.layout = below()

    def show(self, plant: Plant) -> None:
        """Draw what is known of each quantity; nothing without a calibration."""
        units = {"friction": "-", "contact_stiffness": "N/m", "drag_coefficient": "-", "damping_time": "s"}
        plots = []
        for name, draws in plant.posterior.draws.items() if plant.posterior else ():
            counts, edges = np.histogram(draws, bins=24)
            plot = chart(f"{name.replace('_', ' ')} [{units[name]}]", "draws", 150, tools="reset")
            plot.quad(left=edges[:-1], right=edges[1:], bottom=0, top=counts, color=VERMILLION, alpha=0.7)
            plots.append(plot)
        title = [words("<h2>What the calibration found</h2>")] if plots else []
        self.layout.children = [*title, *plots]
