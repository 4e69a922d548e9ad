"""What a metre is expected to cost, and how taut the cable is, over draws of what is not known of a plant's tubes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from agents.calibration.metres import CHANNELS, Metres
from agents.calibration.response import Response
from agents.calibration.unknowns import UNKNOWNS
from probe_env import Context, Scene
from probe_env.arrays import FloatArray
from probe_env.envs.surrogate.vibration_map import expected_cost
from probe_env.envs.task import TaskConfig
from probe_env.physics.closed_forms import sliding_tension

MEASURES: Final = {
    "displacement": ("rf_noise_rms", 1e-4),
    "acceleration": ("radial_acceleration_rms", 20.0),
}
"""Vibration measure of a task -> channel of the response."""


def check_measure(config: TaskConfig) -> None:
    """Raise ValueError if the response does not tell the task's vibration measure."""
    if config.vibration_measure not in MEASURES:
        raise ValueError(
            f"task.vibration_measure = {config.vibration_measure!r}: recommendations know {' and '.join(MEASURES)}"
        )


def beyond(tubes: Sequence[Context], response: Response, config: TaskConfig) -> list[str]:
    """What of a task's tubes lies beyond what the response was learnt from, one sentence each."""
    nothing, lines = np.zeros(0), dict[str, None]()
    for diameter in dict.fromkeys(tube.helix_diameter for tube in tubes):
        scene = config.scene.model_copy(update={"tube": {"helix_diameter": diameter}})
        lines |= dict.fromkeys(response.outside(Metres(nothing, nothing, nothing, {}), scene))
    table = np.concatenate([_table(tube, config.scene) for tube in tubes])
    for values, unknown in zip(table.T, UNKNOWNS.values(), strict=True):
        if values.min() < unknown.low or values.max() > unknown.high:
            span = f"{values.min():.4g} to {values.max():.4g}"
            lines[f"{unknown.text} {span}, beyond {unknown.low:g} to {unknown.high:g} {unknown.unit}".strip()] = None
    return list(lines)


def expected_costs(tubes: Sequence[Context], response: Response, config: TaskConfig, metres: Metres) -> FloatArray:
    """(tubes, m) expected cost of each metre in each tube: vibration, time and air by the task's weights.

    Args:
        tubes: draws of what is not known.
        response: what is felt.
        config: the task, with the scene that tubes change.
        metres: length, feed and air, m of each.
    """
    channel, _ = MEASURES[config.vibration_measure]
    column = CHANNELS.index(channel)
    plain = config.model_copy(update={"vibration_measure": "displacement", "vibration_limit": 1e-4})
    costs = []
    for tube in tubes:
        mean, spread = response.tells(_table(tube, config.scene), metres, _scene(tube, config.scene))
        louder = mean[0, :, column] - np.log10(config.limit)
        costs.append(expected_cost(louder, spread[0, :, column], metres.feed, metres.air, plain))
    return np.array(costs)


def tensions(tubes: Sequence[Context], config: TaskConfig, metres: Metres) -> FloatArray:
    """(tubes, m) root tension of steady sliding [N]."""
    rows = []
    for tube in tubes:
        seen = {
            "inserted_length": metres.length, "feed_speed": metres.feed, "air_supply_rate": metres.air,
            "helix_diameter": np.full(len(metres), tube.helix_diameter),
        }  # fmt: skip
        friction = np.full((1, 1), max(tube.friction, 1e-6))
        rows.append(tube.drag_factor * sliding_tension(friction, seen, config.scene)[0])
    return np.array(rows)


def _table(tube: Context, scene: Scene) -> FloatArray:
    drag = scene.air.drag_coefficient * tube.drag_factor
    return np.array([[max(tube.friction, 1e-6), tube.contact_stiffness, drag, scene.probe.damping_time]])


def _scene(tube: Context, scene: Scene) -> Scene:
    return scene.model_copy(update={"tube": {"helix_diameter": tube.helix_diameter}})
