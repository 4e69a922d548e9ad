"""The map of steps that hold, for the return: drawn back against the outer wall, the cable on the walls, for what can.

Steps are multiples of the same named limits as in ``map``. What bounces lose or gain is a matter of omega dt alone and
stands there.
"""

from __future__ import annotations

import warnings
from itertools import product
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from tqdm import tqdm

from agents.chart.ensembles import STIFFNESSES
from agents.chart.stability.map import named_step
from agents.records.code_hash import code_hash
from agents.records.store import Store
from agents.terminal.work import Work, announce
from probe_env import Scene, SimulationError, Simulator, StabilityWarning
from probe_env.physics.methods import METHODS

Cell = tuple[str, float, float, float, float]
CODE: Final = ("agents.chart.stability.returns:run_return",)
KEYS: Final = ("method", "stiffness_n_per_m", "length_m", "friction", "ratio")
BACK: Final = {"feed_speed": -0.4, "air_supply_rate": -130.0 / 3600.0, "couple": "tangent"}
"""The hardest that the tasks' feed device draws and blows."""
BOTH: Final = tuple(name for name, method in METHODS.items() if method.draws_back)
RATIOS: Final = (0.5, 1.0, 1.33, 1.67, 2.2, 4.4)
LENGTHS: Final = (10.0, 30.0)  # [m]
FRICTIONS: Final = (0.15, 0.3)
DURATION: Final = {"explicit": 0.1}  # [s], else 0.5


def cells() -> list[Cell]:
    """Method, contact stiffness [N/m], length [m], friction and step over the named limit, of all runs."""
    return list(product(BOTH, STIFFNESSES, LENGTHS, FRICTIONS, RATIOS))


def run_return(method: str, stiffness: float, length: float, friction: float, ratio: float) -> dict[str, Any]:
    """One run from rest on the outer wall: the step, and when it diverged (NaN: it held)."""
    contact = {"stiffness": stiffness, "friction": friction, "cable": True}
    scene = Scene.model_validate(BACK | {"carrier_length": length, "contact": contact})
    time_step = ratio * named_step(method, scene)
    steps = int(np.ceil(DURATION.get(method, 0.5) / time_step))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StabilityWarning)  # steps beyond the limit are the point
        simulator = Simulator(scene, method, time_step, start="outer")
    diverged = float("nan")
    try:
        simulator.run(steps * time_step, time_step * steps)
    except SimulationError as error:
        diverged = error.time
    key = dict(zip(KEYS, (method, stiffness, length, friction, ratio), strict=True))
    return key | {"time_step_s": time_step, "diverged_at_s": diverged}


def run_returns(output: Path, limit: int = 0) -> pd.DataFrame:
    """What is not stored yet in map.csv.

    Args:
        output: folder of the table.
        limit: the first so many cells of every method; 0: all.
    """
    store = Store(output / "map.csv", KEYS, lambda row: code_hash(CODE, row["method"]))
    of_method = len(cells()) // len(BOTH)
    wanted = [cell for k, cell in enumerate(cells()) if not limit or k % of_method < limit]
    todo = [cell for cell in wanted if not store.has(*cell)]
    announce(Work("run", len(wanted), lambda: sum(store.has(*cell) for cell in wanted), store.path))
    for begin in tqdm(range(0, len(todo), of_method), desc="return", unit="method", disable=not todo):
        store.add(*(run_return(*cell) for cell in todo[begin : begin + of_method]))
    return store.table


def markdown(table: pd.DataFrame) -> str:
    """For every method the steps that held everywhere, somewhere and nowhere."""
    lines = ["| drawn back | held in all runs | held in some | held in none |", "|---|---|---|---|"]
    for method in BOTH:
        held = table[table["method"] == method].groupby("ratio")["diverged_at_s"].apply(lambda at: at.isna().mean())
        groups = held[held == 1.0], held[(held > 0.0) & (held < 1.0)], held[held == 0.0]
        lines.append(
            f"| {method} | "
            + " | ".join(", ".join(f"{ratio:g}" for ratio in group.index) or "-" for group in groups)
            + " |"
        )
    return "\n".join(lines)
