"""What a plant's file may say and cannot be meant: other units, and steps in which a device has nothing to give."""

from __future__ import annotations

import math
from typing import Final

from probe_env.envs.plants.figures import Figure, Normal
from probe_env.envs.task import TaskConfig

STEPS: Final = (
    ("feed", "feed_speed_step", "feed_speeds", "m/s"),
    ("air", "air_supply_step", "air_supply_rates", "m3/s"),
)
"""Table, step, range that it divides, unit."""


def check_device(config: TaskConfig) -> None:
    """Raise ValueError unless feed device and air supply have a whole step within their ranges."""
    for table, name, of, unit in STEPS:
        step, (low, high) = getattr(config, name), getattr(config, of)
        if step > 0.0 and step * math.floor(high / step * (1.0 + 1e-9)) < low * (1.0 - 1e-9):
            raise ValueError(
                f"{table}.{name} = {step:g} {unit}: no whole step lies within {of}, {low:g} to {high:g} {unit}; give 0"
                " for any, or a smaller one"
            )


def check_limit(config: TaskConfig) -> None:
    """Raise ValueError if a displacement is allowed that no float has room for."""
    scene = config.scene
    floats = min(scene.probe.guide_float_diameter, scene.probe.carrier_float_diameter)
    clearance = scene.tube.clear_diameter - floats
    if config.vibration_measure == "displacement" and config.limit > clearance:
        raise ValueError(
            f"task.vibration_limit = {config.limit:g} m is more than the {clearance:.3g} m that the floats have in the"
            " tube: give it in metres, 0.1 mm as 1e-4"
        )


def check_scatter(name: str, figure: Figure) -> None:
    """Raise ValueError if a quantity that cannot be negative scatters by more than its mean."""
    if isinstance(figure, Normal) and figure.std > figure.mean:
        raise ValueError(
            f"{name}.std = {figure.std:g} is more than the mean, {figure.mean:g}: of what is hardly known give low and"
            " high"
        )
