"""Fast repeated pictures of a figure: the background is stored as pixels, and only moving artists are drawn."""

import math
from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from probe_env.arrays import FloatArray
from probe_env.scene import Scene

Picture = npt.NDArray[np.uint8]
"""(h, w, 3) RGB."""
SIZE: Final = (10.0, 6.0)
"""Figure size in inches."""
DPI: Final = 100
QUIET_MM: Final = 1e-3
"""Minimum height of an axis of displacements [mm]."""
BLUE, GREEN, RED, ORANGE = "#1f5fa8", "#1a7f37", "#c0392b", "#d98000"


class Plate:
    """A figure with a stored background; needs no display.

    Args:
        figure: the complete figure.
        moving: artists that change between pictures, drawn over the background in this order.
    """

    def __init__(self, figure: Figure, moving: Sequence[Any]) -> None:
        self._canvas: Any = FigureCanvasAgg(figure)
        self._figure, self._moving, self._background = figure, moving, None
        for artist in moving:
            artist.set_animated(True)  # not part of the background

    def picture(self, changed: bool = False) -> Picture:
        """Current picture of the figure; ``changed``: something else than the moving artists changed, too."""
        if changed or self._background is None:
            self._canvas.draw()
            self._background = self._canvas.copy_from_bbox(self._figure.bbox)
        self._canvas.restore_region(self._background)
        for artist in self._moving:
            artist.draw(self._canvas.get_renderer())
        return np.asarray(self._canvas.buffer_rgba())[:, :, :3].copy()


def label_of(scene: Scene) -> str:
    """Bore and dimensions of the probe as text."""
    floats = sorted({scene.probe.carrier_float_diameter, scene.probe.guide_float_diameter})
    diameters = " and ".join(f"{diameter * 1e3:g}" for diameter in floats)
    probe = f"floats {diameters} mm, pitch {scene.probe.float_pitch * 1e3:g} mm, guide {scene.probe.guide_length:g} m"
    return f"bore {scene.tube.inner_diameter * 1e3:g} mm, {probe}"


def outward(value: float) -> float:
    """Round away from zero to 1, 2, 5, 10, ..., so that axis limits change seldom."""
    if value == 0.0:
        return 0.0
    decade = 10.0 ** math.floor(math.log10(abs(value)))
    factor = next(f for f in (1.0, 2.0, 5.0, 10.0) if abs(value) <= f * decade * (1.0 + 1e-9))
    return math.copysign(factor * decade, value)


def limits_around(values: FloatArray, minimum: tuple[float, float]) -> tuple[float, float]:
    """Rounded limits that include the finite values and ``minimum``."""
    finite = values[np.isfinite(values)]
    low, high = (min(finite), max(finite)) if len(finite) else minimum
    return outward(min(low, minimum[0])), outward(max(high, minimum[1]))
