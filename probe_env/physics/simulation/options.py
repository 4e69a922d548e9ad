"""How a probe starts and is fed: the options of a simulator and what they are when not given."""

from __future__ import annotations

import math
from typing import Final, Literal, TypedDict


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
