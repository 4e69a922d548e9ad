"""Recommendations for simulated tubes after one log of each, against the shipped schedule and knowing the tube."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from agents.calibration.simulated.groups import run_groups
from agents.calibration.simulated.insertions import Program, insert
from agents.calibration.simulated.trials import TUBES, Trial, trials
from agents.evaluation.statistics import student_interval
from agents.plant.calibration import Recorded, calibrate
from agents.plant.recommendation import recommended
from agents.plant.response import stored_response
from agents.policies.catalogue import DATA
from agents.processes.workers import Workers
from agents.records.provenance import provenance, write_atomically, write_json
from agents.records.tables import Columns
from agents.terminal.tables import print_terms
from probe_env import Context, Plant, StabilityWarning
from probe_env.arrays import FloatArray
from probe_env.envs.plants.tables import Tubes
from probe_env.envs.task import TaskConfig
from probe_env.fidelity import PRESETS
from probe_env.schedule import Schedule

SEED: Final = 23
"""Apart from those of the bank and of the calibrations."""
DRAWS: Final = 96
FEEDS: Final = ("recommended", "known", "best-schedule")
"""Recommended after a log, recommended where the tube is known, and the shipped schedule."""


def run_study(tubes: int, fidelity: str, output: Path, workers: Workers) -> dict[str, Any]:
    """Log, calibrate, recommend and simulate; stored a group at a time in ``output``.

    Raises:
        ValueError: not a whole number of groups.
        FileError: a stored group is damaged or of another fidelity.
    """
    if tubes < TUBES or tubes % TUBES:
        raise ValueError(f"tubes = {tubes!r} must be a multiple of {TUBES}, which are simulated side by side")
    columns: Columns = dict.fromkeys(FEEDS, "number")
    make = partial(_group, fidelity)
    table = run_groups(make, tubes // TUBES, fidelity, output, columns, workers, "recommend")
    summary = summarised(table)
    write_atomically(output / "recommendations.csv", table.to_csv(index=False, float_format="%.6g"))
    write_json(output / "summary.json", summary | {"provenance": provenance(commits=table["commit"])})
    print_terms({name: f"{value:.4g}" for name, value in summary.items()})
    return summary


def summarised(table: pd.DataFrame) -> dict[str, float]:
    """Mean gain in reward over the shipped schedule with its 95 % interval, and the share of what knowing brings."""
    gain, known = (table[name] - table["best-schedule"] for name in ("recommended", "known"))
    interval = student_interval(gain)
    return {
        "tubes": len(table),
        "gain": interval.mean, "gain, low": interval.low, "gain, high": interval.high,
        "gain by knowing the tube": float(known.mean()),
        "share of what knowing brings": float(gain.mean() / known.mean()),
    }  # fmt: skip


def _group(fidelity: str, group: int) -> list[list[dict[str, float]]]:
    """Rewards of the tubes of a group, a row each, as the one item of a task."""
    tubes = trials(group, "standard", SEED)
    plant = Plant(tube=Tubes(**tubes[0].scene.tube.model_dump(exclude={"helix_diameter", "ovality"})))
    config = plant.configured()
    best = Schedule.read(DATA / "best-schedule.csv")
    chosen = {
        "recommended": [_after_log(trial, config) for trial in tubes],
        "known": [_for(_draws(trial.truth[None], trial), trial.truth[3], config) for trial in tubes],
        "best-schedule": [best] * len(tubes),
    }
    rows: list[dict[str, float]] = [{"group": group, "tube": k, "friction": t.truth[0]} for k, t in enumerate(tubes)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StabilityWarning)
        for name in FEEDS:
            specimens = [trial.specimen for trial in tubes]
            insertions = insert(specimens, _by(chosen[name]), config, PRESETS[fidelity], [SEED, group])
            for row, insertion in zip(rows, insertions, strict=True):
                row[name] = insertion.reward
    return [rows]


def _after_log(trial: Trial, config: TaskConfig) -> Schedule:
    """What is recommended for a tube once a log of it was calibrated."""
    diameter = trial.scene.tube.helix_diameter
    plant = Plant(tube=Tubes(**trial.scene.tube.model_dump(exclude={"ovality"})))
    calibration = calibrate([Recorded("log", trial.log, "tube", diameter)], plant, stored_response(), progress=False)
    draws = calibration.posterior.draws[0]
    rows = np.linspace(0, len(draws) - 1, DRAWS).round().astype(int)
    return _for(_draws(draws[rows], trial), float(np.median(draws[:, 3])), config)


def _for(tubes: Sequence[Context], damping: float, config: TaskConfig) -> Schedule:
    scene = config.scene.model_copy(update={"probe": {"damping_time": float(damping)}})
    return recommended(tubes, stored_response(), config.model_copy(update={"scene": scene})).schedule


def _draws(table: FloatArray, trial: Trial) -> list[Context]:
    """Contexts of draws (n, 4) in the order of ``UNKNOWNS``."""
    usual, diameter = trial.scene.air.drag_coefficient, trial.scene.tube.helix_diameter
    return [
        Context(friction=mu, contact_stiffness=k, drag_factor=drag / usual, helix_diameter=diameter)
        for mu, k, drag, _ in table.tolist()
    ]


def _by(schedules: Sequence[Schedule]) -> Program:
    def program(length: FloatArray, time: FloatArray) -> tuple[FloatArray, FloatArray]:
        del time
        pairs = [schedule.at(place) for schedule, place in zip(schedules, length, strict=True)]
        return np.array([float(feed) for feed, _ in pairs]), np.array([float(air) for _, air in pairs])

    return program
