"""Options and targets of simulators, and their accepted ranges."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from typing import Final, Literal, TypedDict

import numpy as np

from probe_env.errors import StabilityWarning
from probe_env.physics.methods import check_step, names_of
from probe_env.physics.methods.method import Method
from probe_env.scene import Scene
from probe_env.settings import within


class Options(TypedDict, total=False):
    """How a probe starts and is fed; see ``Simulator`` for what they mean."""

    solver: str
    growing: bool
    time_lapse: float
    ramp: float
    air_lag: float
    perturbation: float
    start: Literal["inner", "outer"]


DEFAULTS: Final[Options] = {
    "solver": "ticm", "growing": False, "time_lapse": 1.0, "ramp": math.inf, "air_lag": 0.0, "perturbation": 0.0,
    "start": "inner",
}  # fmt: skip


def check_options(method: Method, time_step: float, nodes_per_pitch: int, options: Options) -> None:
    """Raise ValueError where a step, a mesh or an option is out of range."""
    within("time_step", time_step, 0.0, 1.0, "s", exclude_low=True)
    check_step(method, time_step)
    within("time_lapse", options["time_lapse"], 1.0, 1000.0, "")
    within("ramp", options["ramp"], 0.0, math.inf, "m/s2", exclude_low=True)
    within("air_lag", options["air_lag"], 0.0, 1e3, "s")
    within("perturbation", options["perturbation"], 0.0, 1e-3, "m")
    if options["start"] not in ("inner", "outer"):
        raise ValueError(f"start = {options['start']!r} is not one of inner, outer")
    if isinstance(nodes_per_pitch, bool) or nodes_per_pitch != int(nodes_per_pitch) or not 1 <= nodes_per_pitch <= 64:
        raise ValueError(f"nodes_per_pitch = {nodes_per_pitch!r} is not a whole number from 1 to 64")


def check_targets(scene: Scene, method: Method, feed_speed: float | None, air_supply_rate: float | None) -> None:
    """Raise ValueError if a target, [m/s] or [m3/s], is out of range or not for this method; None is none.

    Warns where a probe is pressed or drawn back and the couple of (9) is not fit for it.
    """
    if feed_speed is not None:
        within("feed_speed", feed_speed, -2.0, 2.0, "m/s")
        _check_return(scene, method, "feed_speed", feed_speed, "m/s")
    if air_supply_rate is not None:
        within("air_supply_rate", air_supply_rate, -0.2, 0.2, "m3/s")
        _check_return(scene, method, "air_supply_rate", air_supply_rate, "m3/s")


def check_which(which: Sequence[int], count: int) -> None:
    """Raise ValueError if not every one of ``which`` is a probe of so many."""
    for place, k in enumerate(which):
        if not isinstance(k, int | np.integer) or not -count <= k < count:
            raise ValueError(f"which[{place}] = {k!r} is none of {count} probes, counted from 0")


def check_active(active: object, count: int) -> None:
    """Raise ValueError if ``active`` is neither None nor one truth value for each of so many probes."""
    given = (count,) if active is None else np.asarray(active).shape
    if given != (count,):
        raise ValueError(f"active of shape {given}: one truth value for each of {count} probes")


def _check_return(scene: Scene, method: Method, name: str, value: float, unit: str) -> None:
    """Raise ValueError if a method cannot press or draw back a probe; warn where the couple of (9) is not fit."""
    if value >= 0.0:
        return
    if not method.draws_back:
        able = names_of(lambda known: known.draws_back)
        raise ValueError(f"{name} = {value!r} {unit}: {method.name} does not simulate the return; {able} do")
    if scene.couple == "frame":
        warnings.warn(
            f'{name} = {value:g} {unit} with couple = "frame": counted from the frame the couple of (9) feeds a'
            ' pressed probe, whose root force is some three times too large; couple = "tangent" does not',
            StabilityWarning,
            stacklevel=5,
        )
