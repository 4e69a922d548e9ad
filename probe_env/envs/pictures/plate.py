"""Pictures that are drawn again and again: what stays is kept as pixels, and only what moves is drawn anew."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.transforms import IdentityTransform

from probe_env.arrays import FloatArray
from probe_env.scene import Scene

Picture = npt.NDArray[np.uint8]
"""(h, w, 3) RGB."""
SIZE: Final = (10.0, 6.0)
"""Inches."""
DPI: Final = 100
QUIET_MM: Final = 1e-3
"""Least height of an axis of displacements."""
BLUE, GREEN, RED, ORANGE = "#1f5fa8", "#1a7f37", "#c0392b", "#d98000"


class Plate:
    """A figure of which a picture costs what moves in it; needs no display.

    Args:
        figure: with everything that stays and everything that moves.
        moving: artists that change from picture to picture, drawn over what stays, in this order.
    """

    def __init__(self, figure: Figure, moving: Sequence[Any]) -> None:
        canvas: Any = FigureCanvasAgg(figure)
        self._canvas, self._figure, self._moving = canvas, figure, moving
        for artist in moving:
            artist.set_animated(True)  # left out where the figure is drawn as a whole
        canvas.draw()
        self._background = canvas.copy_from_bbox(figure.bbox)
        self._extent: dict[Axes, Any] = {axes: axes.get_tightbbox(canvas.get_renderer()) for axes in figure.axes}

    def picture(self, changed: Sequence[Axes] = ()) -> Picture:
        """The figure as it is now.

        Args:
            changed: axes whose limits are other than in the last picture; nothing else may be where their labels are.
        """
        self._canvas.restore_region(self._background)
        for axes in changed:
            self._redraw(axes)
        if changed:
            self._background = self._canvas.copy_from_bbox(self._figure.bbox)
        for artist in self._moving:
            artist.draw(self._canvas.get_renderer())
        return np.asarray(self._canvas.buffer_rgba())[:, :, :3].copy()

    def _redraw(self, axes: Axes) -> None:
        """Draw axes over what they were in what stays."""
        renderer, old = self._canvas.get_renderer(), self._extent[axes].padded(2.0)  # pixels, for smoothed edges
        blank = Rectangle(old.min, old.width, old.height, facecolor="white", transform=IdentityTransform())
        blank.set_figure(self._figure)
        blank.draw(renderer)
        axes.draw(renderer)
        self._extent[axes] = axes.get_tightbbox(renderer)


def label_of(scene: Scene) -> str:
    """Tube and floats in a few words."""
    floats = sorted({scene.probe.carrier_float_diameter, scene.probe.guide_float_diameter})
    diameters = " and ".join(f"{diameter * 1e3:g}" for diameter in floats)
    return f"bore {scene.tube.inner_diameter * 1e3:g} mm, floats {diameters} mm"


def outward(value: float) -> float:
    """The next of 1, 2, 5, 10, ... away from zero: limits of axes that seldom change."""
    if value == 0.0:
        return 0.0
    decade = 10.0 ** math.floor(math.log10(abs(value)))
    factor = next(f for f in (1.0, 2.0, 5.0, 10.0) if abs(value) <= f * decade * (1.0 + 1e-9))
    return math.copysign(factor * decade, value)


def limits_around(values: FloatArray, least: tuple[float, float]) -> tuple[float, float]:
    """Rounded limits that hold finite values and ``least``."""
    known = values[np.isfinite(values)]
    low, high = (min(known), max(known)) if len(known) else least
    return outward(min(low, least[0])), outward(max(high, least[1]))
