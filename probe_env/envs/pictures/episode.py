"""Pictures of an episode: the helix from above with the probe in it, and strips of what was done and felt."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from probe_env.arrays import FloatArray
from probe_env.envs.episodes import Episodes
from probe_env.envs.pictures.helix import Helix
from probe_env.envs.pictures.plate import DPI, SIZE, Picture, Plate, Screen
from probe_env.envs.pictures.traces import COLUMNS, Traces
from probe_env.physics.simulation.window import Window


class Renderer:
    """Draws one probe of some episodes; keeps what was done since the episode began.

    Args:
        episodes: where the probe and its last window are.
        index: which probe.
    """

    def __init__(self, episodes: Episodes, index: int = 0) -> None:
        self.episodes, self.index = episodes, index
        self.history: list[tuple[float, ...]] = []
        self._felt: Window | None = None  # of the last period
        self._drawn: tuple[Plate, Helix, Traces] | None = None
        self._screen = Screen()

    def begin(self, info: dict[str, Any]) -> None:
        """Begin with the info of a reset; the last episode is forgotten, and its tube may have been another."""
        self.history, self._drawn, self._felt = [], None, None
        self._note(info, 0.0, np.zeros(1))

    def add(self, info: dict[str, Any], reward: float) -> None:
        """Note a period's info and reward."""
        self._felt = self.episodes.window
        assert self._felt is not None
        assert self._felt.radial is not None
        self._note(info, reward, self._felt.radial[:, self.index])

    def _note(self, info: dict[str, Any], reward: float, radial: FloatArray) -> None:
        row = (*(float(info[name]) for name in COLUMNS), reward, float(radial.min()), float(radial.max()))
        self.history.append(row)

    def picture(self) -> Picture:
        """(h, w, 3) RGB picture; needs no display."""
        simulator = self.episodes.batch.simulators[self.index]
        plate, helix, traces = self._drawn = self._drawn or self._draw()
        helix.update(simulator)
        changed = traces.update(self._felt, self.index, np.array(self.history))
        return plate.picture(changed)

    def show(self) -> None:
        """Show the picture in a window (needs a display and an interactive matplotlib backend)."""
        self._screen.show(self.picture())

    def close(self) -> None:
        """Close the window, if there is one."""
        self._screen.close()

    def _draw(self) -> tuple[Plate, Helix, Traces]:
        """Everything that stays for an episode."""
        simulator, config = self.episodes.batch.simulators[self.index], self.episodes.config
        figure = Figure(figsize=SIZE, dpi=DPI)
        halves: Any = figure.subfigures(1, 2, width_ratios=(1.0, 1.05))
        helix = Helix(halves[0], simulator)
        fidelity = self.episodes.fidelity
        everywhere = fidelity.steady_feed is None and not config.returns
        period = config.period / (fidelity.time_lapse if everywhere else 1.0)  # the longest there is
        traces = Traces(halves[1], config, period, simulator.scene.tube.helix_length)
        return Plate(figure, (*helix.moving, *traces.moving)), helix, traces

    def __getstate__(self) -> dict[str, Any]:
        """Copies draw anew: neither pixels nor windows are copied."""
        return self.__dict__ | {"_drawn": None, "_screen": Screen()}
