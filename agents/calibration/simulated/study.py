"""Calibrations of simulated logs against their truths: coverage, error, uniform ranks, and logs of another world."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np
import pandas as pd
from scipy.stats import kstest

from agents.calibration.simulated.groups import run_groups
from agents.calibration.simulated.trials import TUBES, Trial, trials
from agents.plant.calibration import Recorded, calibrate
from agents.plant.logs import Log
from agents.plant.prior import UNKNOWNS
from agents.plant.response import CHANNELS, Response, stored_response
from agents.processes.workers import Workers
from agents.records.provenance import provenance, write_atomically, write_json
from agents.records.tables import Columns
from agents.terminal.tables import print_terms
from probe_env import Plant
from probe_env.envs.plants.tables import Tubes

SETS: Final = {"with tension": CHANNELS, "without tension": CHANNELS[1:]}
WORLDS: Final = ("tension scaled", "time shift", "random numbers")
SCALED: Final = 1.5
SHIFT: Final = 60.0
"""[s] that what was felt is behind what was fed."""
SEED: Final = 22
"""Apart from that of the bank, and from 21, whose logs ``inference`` was found on."""
FOREIGN: Final = 4
"""Logs of a group that are made foreign."""
Row = dict[str, Any]


def run_study(logs: int, fidelity: str, output: Path, workers: Workers) -> dict[str, Any]:
    """Simulate logs (stored a group at a time in ``output``), calibrate each, store and print what came out.

    Raises:
        ValueError: not a whole number of groups.
        FileError: a stored group is damaged or of another fidelity.
    """
    if logs < TUBES or logs % TUBES:
        raise ValueError(f"logs = {logs!r} must be a multiple of {TUBES}, which are simulated side by side")
    columns: Columns = {"set": "text", "misspecified": "truth", "refused": "truth", "alone_mean": "maybe"}
    columns = {**columns, **dict.fromkeys((name for unknown in UNKNOWNS for name in _columns_of(unknown)), "number")}
    make = partial(_rows, fidelity)
    table = run_groups(make, logs // TUBES, fidelity, output, columns, workers, "calibrate")
    summary = summarised(table)
    write_atomically(output / "calibrations.csv", table.to_csv(index=False, float_format="%.6g"))
    write_json(output / "summary.json", summary | {"provenance": provenance(commits=table["commit"])})
    print_terms({name: f"{value:.4g}" for name, value in summary.items()})
    return summary


def _columns_of(unknown: str) -> tuple[str, ...]:
    return unknown, *(f"{unknown}_{part}" for part in ("mean", "low", "high", "rank"))


def summarised(table: pd.DataFrame) -> dict[str, Any]:
    """Coverage, errors, p-values of uniform ranks, and the shares of foreign logs that are told."""
    summary: dict[str, Any] = {"logs": int((table["set"] == "with tension").sum())}
    for name in SETS:
        part = table[table["set"] == name]
        for unknown in UNKNOWNS:
            truth, low, high = (part[f"{unknown}{suffix}"] for suffix in ("", "_low", "_high"))
            summary[f"{name}: {unknown} covered"] = float(((low <= truth) & (truth <= high)).mean())
            summary[f"{name}: {unknown} ranks uniform, p"] = float(kstest(part[f"{unknown}_rank"], "uniform").pvalue)
        summary[f"{name}: friction, median error"] = float((part["friction_mean"] - part["friction"]).abs().median())
        summary[f"{name}: wrongly misspecified"] = float(part["misspecified"].mean())
        summary[f"{name}: wrongly doubtful"] = float((part["refused"] & ~part["misspecified"]).mean())
    alone = table[table["set"] == "with tension"]
    inside = (alone["alone_low"] <= alone["friction"]) & (alone["friction"] <= alone["alone_high"])
    summary["tension alone: friction covered"] = float(inside.mean())
    summary["tension alone: friction, median error"] = float((alone["alone_mean"] - alone["friction"]).abs().median())
    for world in WORLDS:
        part = table[table["set"] == world]
        summary[f"{world}: logs"] = len(part)
        summary[f"{world}: called misspecified"] = float(part["misspecified"].mean())
        summary[f"{world}: called misspecified or doubtful"] = float(part["refused"].mean())
    return summary


def _rows(fidelity: str, group: int) -> list[list[Row]]:
    """All calibrations of a group's logs, as the one item of a task."""
    response, rows = stored_response(), []
    rng = np.random.default_rng([SEED, group, 1])
    for number, trial in enumerate(trials(group, fidelity, SEED)):
        sets = {name: _only(trial.log, channels) for name, channels in SETS.items()}
        if number < FOREIGN:
            sets |= {world: foreign(trial.log, world, rng) for world in WORLDS}
        rows += [_row(response, trial, name, log) | {"group": group, "log": number} for name, log in sets.items()]
    return [rows]


def _row(response: Response, trial: Trial, name: str, log: Log) -> Row:
    """One calibration: truths, intervals, ranks, verdict."""
    plant = Plant(tube=Tubes(**trial.scene.tube.model_dump(exclude={"ovality"})))
    recorded = Recorded("log", log, "tube", trial.scene.tube.helix_diameter)
    calibration = calibrate([recorded], plant, response, progress=False)
    row: Row = {
        "set": name,
        "misspecified": bool(calibration.misfits),
        "refused": bool(calibration.misfits or calibration.leaning),
    }
    for k, unknown in enumerate(UNKNOWNS):
        draws = calibration.posterior.draws[0, :, k]
        row[unknown] = float(trial.truth[k])
        row |= {f"{unknown}_{part}": value for part, value in calibration.summary(unknown).items()}
        row[f"{unknown}_rank"] = float((draws < trial.truth[k]).mean())
    alone = calibration.sliding[0].friction if calibration.sliding[0] else (np.nan,) * 3
    row |= dict(zip(("alone_mean", "alone_low", "alone_high"), alone, strict=True))
    gauge = calibration.gains[0]
    row |= {"gain": gauge.gain if gauge else np.nan, "gain_ratio": gauge.ratio if gauge else np.nan}
    misfit = calibration.posterior.misfit[0]
    return row | {f"misfit_{channel}": value for channel, value in zip((*CHANNELS, "all"), misfit, strict=True)}


def foreign(log: Log, world: str, rng: np.random.Generator) -> Log:
    """The log as no such probe would have made it."""
    measured = dict(log.measured)
    if world == "tension scaled":
        measured["root_tension"] = SCALED * measured["root_tension"]
    elif world == "time shift":
        rows = np.searchsorted(log.time, np.maximum(log.time - SHIFT, log.time[0]), side="right") - 1
        measured = {name: values[rows] for name, values in measured.items()}
    else:
        for name, values in log.measured.items():
            low, high = np.log(np.maximum(np.quantile(values, [0.05, 0.95]), 1e-9)).tolist()
            measured[name] = np.exp(rng.uniform(low, high, len(values)))
    return Log(log.time, log.inserted_length, log.feed_speed, log.air_supply_rate, MappingProxyType(measured))


def _only(log: Log, channels: tuple[str, ...]) -> Log:
    measured = MappingProxyType({name: log.measured[name] for name in channels})
    return Log(log.time, log.inserted_length, log.feed_speed, log.air_supply_rate, measured)
