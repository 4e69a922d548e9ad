"""Checks of arguments: an error names the argument, its value and what is accepted."""

from __future__ import annotations

import math


def within(name: str, value: float, low: float, high: float, unit: str, exclude_low: bool = False) -> None:
    """Raise ValueError unless ``value`` is finite or infinite within [low, high] (or (low, high])."""
    if not low <= value <= high or (exclude_low and value == low):  # also catches NaN
        excluded = " (excluded)" if exclude_low else ""
        unit = unit and f" {unit}"
        raise ValueError(f"{name} = {value!r}{unit} is outside the accepted range {low:g}{excluded} to {high:g}{unit}")


def whole_steps(name: str, value: float | None, time_step: float) -> int:
    """Number of time steps in a time.

    Raises:
        ValueError: not a whole number within 1e-9, or less than one.
    """
    ratio = math.nan if value is None else value / time_step
    if not (math.isfinite(ratio) and round(ratio) >= 1 and abs(ratio - round(ratio)) <= 1e-9 * ratio):
        raise ValueError(f"{name} = {value!r} s is not a whole number (1 or more) of time steps of {time_step:g} s")
    return round(ratio)
