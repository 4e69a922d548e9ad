"""Picture of compared designs: the cable around the sensor to scale, and the radial rms along the tube."""

from collections.abc import Mapping
from itertools import cycle
from pathlib import Path
from typing import Any, Final

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from probe_agents.design.trials import PEAK_AT, RMS_AT
from probe_agents.records.drawing import GREY, MM, colours, escape_dollars, save
from probe_env import Design
from probe_env.envs.task.config import TaskConfig
from probe_env.scene import Probe

HALF: Final = 0.4
"""Length drawn on either side of the sensor [m]."""


def draw_designs(designs: Mapping[str, Design], table: pd.DataFrame, config: TaskConfig, path: Path) -> None:
    """Draw the designs of a comparison, whose table is that of ``compare``; whole insertions have no frequencies."""
    scene, count = config.scene, len(designs)
    figure = plt.figure(figsize=(9.0, 5.5 + 0.75 * count), layout="constrained")
    *cables, level, peak = figure.subplots(count + 2, 1, gridspec_kw={"height_ratios": [0.75] * count + [3.5, 1.5]})
    at = [str(name).removeprefix(RMS_AT) for name in table.columns if str(name).startswith(RMS_AT)]
    for axis, (name, design), colour in zip(cables, designs.items(), cycle(colours()), strict=False):
        probe = design.probe(scene.probe)
        _draw_cable(axis, probe, scene.tube.inner_diameter, colour)
        guide, carrier = (MM * d for d in (probe.guide_float_diameter, probe.carrier_float_diameter))
        title = f"{escape_dollars(name)}: guide {probe.guide_length:g} m, pitch {MM * probe.float_pitch:g} mm, floats"
        axis.set_title(f"{title} {carrier:g} mm, ahead of the sensor {guide:g} mm", loc="left", fontsize=9)
        rows, style = table[table["design"] == name], {"color": colour, "label": escape_dollars(name)}
        level.plot([float(x) for x in at], [MM * rows[RMS_AT + x].mean() for x in at], "o-", **style)
        peaks = rows.reindex(columns=[PEAK_AT + x for x in at])
        peak.plot([float(x) for x in at], peaks.median().to_numpy(), "o-", **style)
    if config.vibration_measure == "displacement":
        level.axhline(MM * config.limit, color=GREY, linestyle="--", label="limit")
    level.set(ylabel="radial rms, mean [mm]", yscale="log")
    level.legend(frameon=False, fontsize=9)
    peak.set(xlabel="sensor, from the entrance [m]", ylabel="its frequency,\nmedian [Hz]")
    peak.sharex(level)
    for axis in (level, peak):
        axis.grid(color="0.9")
    save(figure, path, grid=False)


def _draw_cable(axis: Any, probe: Probe, bore: float, colour: str) -> None:
    """The cable in its tube at equal scales, the tip to the right; the model has no length of floats."""
    reach = int(HALF / probe.float_pitch + 1e-9)
    places = probe.float_pitch * np.arange(-reach, min(reach, round(probe.guide_length / probe.float_pitch)) + 1)
    radius = 0.5 * np.where(places >= 0.0, probe.guide_float_diameter, probe.carrier_float_diameter)
    tip = min(HALF, probe.guide_length)
    axis.fill_between([-HALF, tip], -0.5 * probe.cable_diameter, 0.5 * probe.cable_diameter, color="0.5")
    axis.vlines(places, -radius, radius, color=colour, linewidth=5)
    axis.plot(0.0, 0.0, "o", color="white", markeredgecolor="black", markersize=5)
    axis.hlines([-0.5 * bore, 0.5 * bore], -HALF, HALF, color="black", linewidth=1)
    axis.set(xlim=(-HALF, HALF), aspect="equal")
    axis.axis("off")
