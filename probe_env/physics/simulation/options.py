"""How a probe starts and is fed: the options of a simulator, what they are when not given, what is accepted."""

from __future__ import annotations

import math
from typing import Final, Literal, TypedDict

from probe_env.physics.methods import method_named
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


def check_options(method: str, time_step: float, nodes_per_pitch: int, options: Options) -> None:
    """Raise ValueError where a step, a mesh or an option is out of range."""
    within("time_step", time_step, 0.0, 1.0, "s", exclude_low=True)
    method_named(method).check_step(time_step)
    within("time_lapse", options["time_lapse"], 1.0, 1000.0, "")
    within("ramp", options["ramp"], 0.0, math.inf, "m/s2", exclude_low=True)
    within("air_lag", options["air_lag"], 0.0, 1e3, "s")
    within("perturbation", options["perturbation"], 0.0, 1e-3, "m")
    if options["start"] not in ("inner", "outer"):
        raise ValueError(f"start = {options['start']!r} is not one of inner, outer")
    if isinstance(nodes_per_pitch, bool) or nodes_per_pitch != int(nodes_per_pitch) or not 1 <= nodes_per_pitch <= 64:
        raise ValueError(f"nodes_per_pitch = {nodes_per_pitch!r} is not a whole number from 1 to 64")
