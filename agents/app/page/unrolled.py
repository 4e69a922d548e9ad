"""The probe in its tube, unrolled: walls, floats at their own diameters, contacts; and slow motion near the tip."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from bokeh.models import Button, ColumnDataSource, CustomJS, Span

from agents.app.page.style import GREEN, INK, ORANGE, PURPLE, SKY, VERMILLION, below, chart, control_sheet, words
from agents.app.runs.frames import Shape
from probe_env.arrays import BoolArray
from probe_env.envs.pictures.strip import FRAME_PERIOD, Motion

MM: Final = 1e3
NEAR: Final = 10.0
"""How much of the probe is shown, behind the tip [m]."""
ROOM: Final = 0.15
"""Beyond the walls, of the bore."""
SLOWED: Final = 8.0
EMPTY: Final[dict[str, list[float]]] = {"place": [], "low": [], "high": [], "colour": []}
PLAY: Final = """
if (window.probe_film) { clearInterval(window.probe_film); window.probe_film = null; }
const looks = film.data.low.length;
if (looks == 0 || !play) return;
let k = 0;
window.probe_film = setInterval(() => {
    if (k >= looks) { clearInterval(window.probe_film); window.probe_film = null; return; }
    shown.data = {place: film.data.place[k], low: film.data.low[k], high: film.data.high[k],
                  colour: film.data.colour[k]};
    k += 1;
}, period);
"""


class Unrolled:
    """The tube along its axis, with displacements and tension below."""

    def __init__(self, whole: bool = True) -> None:
        self.floats = ColumnDataSource(dict(EMPTY))
        self.cable = ColumnDataSource({"place": [], "centre": []})
        self.sensor = ColumnDataSource({"place": [], "centre": []})
        self.tube = _tube("from the entrance [m]", self.floats, 240)
        self.tube.line("place", "centre", source=self.cable, color=INK, line_width=1.0)
        self.tube.scatter("place", "centre", source=self.sensor, size=11, color=GREEN, line_color="white")
        self.walls = _walls(self.tube)
        self.along = ColumnDataSource({"place": [], "axial": [], "tension": []})
        self.axial = chart("from the entrance [m]", "axial [mm]", 140, x_range=self.tube.x_range)
        self.axial.line("place", "axial", source=self.along, color=PURPLE, line_width=1.5)
        self.tension = chart("from the entrance [m]", "tension [N]", 140, x_range=self.tube.x_range)
        self.tension.line("place", "tension", source=self.along, color=VERMILLION, line_width=1.5)
        parts = (self.tube, self.axial, self.tension) if whole else (self.tube,)
        self.layout = below(words(legend()), *parts)

    def show(self, shape: Shape, everything: bool = False) -> None:
        """A probe in its tube; ``everything``: from the entrance on, not its last metres alone."""
        low, high = shape.radial * MM, (shape.radial + 2.0 * shape.lever) * MM
        centre = (shape.radial + shape.lever) * MM
        self.floats.data = {
            "place": shape.place, "low": low, "high": high,
            "colour": colours(shape.radial < 0.0, shape.radial > shape.outer_gap),
        }  # fmt: skip
        self.cable.data = {"place": shape.place, "centre": centre}
        self.sensor.data = {"place": shape.place[[shape.sensor]], "centre": centre[[shape.sensor]]}
        tip = float(shape.place.max())
        self.tube.x_range.update(start=0.0 if everything else max(tip - NEAR, 0.0), end=tip + 0.3)
        _to_bore(self.tube, self.walls, shape.bore)

    def show_along(self, shape: Shape) -> None:
        """Its axial displacement and tension."""
        self.along.data = {"place": shape.place, "axial": shape.axial * MM, "tension": shape.tension}


class SlowMotion:
    """The last metres as they move, a picture each 5 ms; played in the browser."""

    def __init__(self) -> None:
        self.shown = ColumnDataSource(dict(EMPTY))
        self.film = ColumnDataSource(dict(EMPTY))
        self.tube = _tube("from the tip [m]", self.shown, 210)
        self.walls = _walls(self.tube)
        self.caption = words()
        self.replay = Button(label="play again", stylesheets=[control_sheet()], width=120)
        arguments = {"film": self.film, "shown": self.shown, "period": FRAME_PERIOD * SLOWED * 1e3, "play": True}
        play = CustomJS(args=arguments, code=PLAY)
        self.film.js_on_change("data", play)
        self.replay.js_on_event("button_click", play)
        self.layout = below(self.caption, self.tube, self.replay, visible=False)

    def show(self, motion: Motion) -> None:
        """Play a motion."""
        frames = len(motion.time)
        low, high = motion.radial * MM, (motion.radial + 2.0 * motion.lever) * MM
        kept = motion.floats
        on_inner, on_outer = motion.on_inner_wall, motion.on_outer_wall
        self.film.data = {
            "place": [-motion.distance[kept]] * frames,
            "low": [row[kept] for row in low],
            "high": [row[kept] for row in high],
            "colour": [colours(on_inner[k, kept], on_outer[k, kept]) for k in range(frames)],
        }
        rms = float(motion.signal_radial[motion.signal_time >= 0.0].std()) * MM
        self.caption.text = (
            f"<h2>Slow motion</h2><p>What comes next, {motion.time[-1]:.2f} s played {SLOWED:g} times slower, at"
            f" {motion.inserted_length[0]:.2f} m. Radial rms of the sensor meanwhile {rms:.3f} mm.</p>"
        )
        self.tube.x_range.update(start=-float(motion.distance.max()) - 0.2, end=0.3)
        _to_bore(self.tube, self.walls, motion.scene.tube.inner_diameter)
        self.layout.visible = True


def colours(inner: BoolArray, outer: BoolArray) -> list[str]:
    """Of floats by what they press on."""
    return list(np.where(inner, VERMILLION, np.where(outer, ORANGE, SKY)).tolist())


def legend() -> str:
    """What the colours mean."""
    kinds = ((SKY, "float, free"), (VERMILLION, "presses on the inner wall"), (ORANGE, "on the outer wall"))
    blocks = "".join(f'<span style="color:{colour}">■</span>&nbsp;{text} &nbsp; ' for colour, text in kinds)
    return f'<p class="quiet">{blocks}<span style="color:{GREEN}">●</span>&nbsp;sensor</p>'


def _tube(x: str, source: ColumnDataSource, height: int) -> Any:
    plot = chart(x, "from the inner wall [mm]", height, x_range=(0.0, NEAR), y_range=(-3.0, 27.0))
    plot.segment("place", "low", "place", "high", source=source, color="colour", line_width=3)
    return plot


def _walls(plot: Any) -> tuple[Span, Span]:
    walls = tuple(Span(location=at, dimension="width", line_color=INK, line_width=2) for at in (0.0, 24.2))
    for wall in walls:
        plot.add_layout(wall)
    return walls[0], walls[1]


def _to_bore(plot: Any, walls: tuple[Span, Span], bore: float) -> None:
    walls[1].location = bore * MM
    plot.y_range.update(start=-ROOM * bore * MM, end=(1.0 + ROOM) * bore * MM)
