"""The pressed scenes run: which end finite, with the cable on the walls and without, and ``implicit`` beside.

A row is a scene under a setting. What diverges with the cable on the walls is run again at a quarter of the step; some
of the scenes that only the cable's contact holds are run again by ``implicit``, a few starts of each.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import pandas as pd
from tqdm import tqdm

from agents.chart.stability.pressed import AFTER, AIR_LAG, BEFORE, RAMP, SCENES, WAYS, Pressed, pressed_scene
from agents.records.code_hash import code_hash
from agents.records.store import Store
from agents.study.cases import PERTURBATION
from agents.terminal.work import Work, announce
from probe_env import SimulatorBatch, StabilityWarning
from probe_env.fidelity import BOTH_WAYS

CODE: Final = ("agents.chart.stability.pressed_runs:run_group",)
KEYS: Final = ("scene", "method", "time_step_s", "nodes_per_pitch", "cable", "member")
WINDOW: Final = 1.0  # [s], the last of a run, of the statistics
GROUP: Final = 40
MEMBERS: Final = 3
STUCK: Final = 10.0
BEYOND: Final = 1e4
"""Pressure of steady sliding over Euler's load from which on a scene is called stuck, and beyond all bounds."""


class Discretisation(NamedTuple):
    """How a scene is simulated."""

    method: str
    time_step: float  # [s]
    nodes_per_pitch: int
    cable: bool


FINE: Final = Discretisation("imex", BOTH_WAYS["standard"].time_step, BOTH_WAYS["standard"].nodes_per_pitch, True)
COARSE: Final = Discretisation("imex", BOTH_WAYS["fast"].time_step, BOTH_WAYS["fast"].nodes_per_pitch, True)
BARE: Final = COARSE._replace(cable=False)
SHORT: Final = COARSE._replace(time_step=5e-5)
IMPLICIT: Final = SHORT._replace(method="implicit")
EVERYWHERE: Final = (COARSE, BARE, FINE)
"""Settings that all scenes are run with: the meshes and steps of both presets of the way back."""


def run_group(scenes: Sequence[Pressed], setting: Discretisation, member: int, threads: int) -> list[dict[str, Any]]:
    """A row a scene: when it diverged, else root tension and the sensor's motion over the last second.

    Args:
        scenes: that start on the same wall.
        setting: of all.
        member: 0: from rest; others from a perturbed start each.
        threads: at most so many.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StabilityWarning)
        batch = SimulatorBatch(
            [pressed.with_cable(setting.cable) for pressed in scenes], setting.method, setting.time_step,
            setting.nodes_per_pitch, threads=threads, seeds=[member] * len(scenes), start=scenes[0].start,
            growing=True, ramp=RAMP, air_lag=AIR_LAG, perturbation=PERTURBATION if member else 0.0,
        )  # fmt: skip
    for pressed, simulator in zip(scenes, batch.simulators, strict=True):
        if not pressed.growing:
            simulator.hold_length()
    batch.advance(None, None, BEFORE)
    feed, air = np.array([pressed.turned for pressed in scenes]).T
    batch.advance(feed, air, AFTER - WINDOW)
    window = batch.advance(None, None, WINDOW)
    rows = []
    for k, (pressed, simulator) in enumerate(zip(scenes, batch.simulators, strict=True)):
        row: dict[str, Any] = dict(zip(KEYS, (pressed.number, *setting, member), strict=True))
        row |= {"way": pressed.way, "probe": pressed.probe, "over_euler": pressed.over_euler()}
        row["diverged_at_s"] = simulator.time if window.diverged[k] else float("nan")
        for name in ("tension_mean_n", "radial_mean_m", "radial_rms_m"):
            row[name] = float("nan") if window.diverged[k] else window.statistics[name][k]
        rows.append(row)
    return rows


def run_pressed(output: Path, limit: int = 0, threads: int = 1) -> pd.DataFrame:
    """What is not stored yet in scenes.csv.

    Args:
        output: folder of the table.
        limit: the first so many scenes; 0: all.
        threads: at most so many.
    """
    store = Store(output / "scenes.csv", KEYS, lambda row: code_hash(CODE, row["method"]))
    numbers = range(limit or SCENES)
    for setting in EVERYWHERE:
        _fill(store, numbers, setting, 0, threads)
    _fill(store, lost(store.table, COARSE), SHORT, 0, threads)
    for member in range(MEMBERS):
        for setting in (COARSE, IMPLICIT):
            _fill(store, contested(store.table), setting, member, threads)
    return store.table


def _fill(store: Store, numbers: Sequence[int], setting: Discretisation, member: int, threads: int) -> None:
    """Run and store what is missing of some scenes under a setting."""

    def missing() -> list[int]:
        return [number for number in numbers if not store.has(number, *setting, member)]

    todo = list(_groups([pressed_scene(number) for number in missing()]))
    name = f"{setting.method}, {setting.time_step:g} s, {setting.nodes_per_pitch} nodes, cable = {setting.cable}"
    announce(Work("scene", len(numbers), lambda: len(numbers) - len(missing()), store.path))
    for group in tqdm(todo, desc=name, unit="group", disable=not todo):
        store.add(*run_group(group, setting, member, threads))


def _groups(scenes: Sequence[Pressed]) -> Iterator[list[Pressed]]:
    """Scenes that start on the same wall, about equally long."""
    for start in ("inner", "outer"):
        same = sorted((p for p in scenes if p.start == start), key=lambda p: p.scene.inserted_length)
        yield from (same[begin : begin + GROUP] for begin in range(0, len(same), GROUP))


def rows_of(table: pd.DataFrame, setting: Discretisation, member: int = 0) -> pd.DataFrame:
    """The rows of a setting, by scene."""
    key = dict(zip(KEYS[1:], (*setting, member), strict=True))
    chosen = (table[list(key)] == list(key.values())).all(axis=1)
    return table[chosen].set_index("scene").sort_index()


def lost(table: pd.DataFrame, setting: Discretisation) -> list[int]:
    """Scenes that diverged under a setting."""
    diverged = rows_of(table, setting)["diverged_at_s"]
    return [int(number) for number in diverged.index[diverged.notna()]]


def contested(table: pd.DataFrame) -> list[int]:
    """Scenes that only the cable's contact holds, for ``implicit``: the shortest of every way and of what is stuck."""
    held = set(lost(table, BARE)) - set(lost(table, COARSE))
    scenes = sorted(map(pressed_scene, held), key=lambda pressed: (pressed.scene.inserted_length, pressed.number))
    free = [pressed for pressed in scenes if pressed.over_euler() <= STUCK]
    stuck = [pressed for pressed in scenes if pressed.over_euler() > STUCK]
    beyond = [pressed for pressed in stuck if pressed.over_euler() > BEYOND]
    first = {pressed.way: pressed for pressed in reversed(free)}
    return [pressed.number for pressed in (*(first[way] for way in WAYS if way in first), *stuck[:1], *beyond[:1])]
