"""What the pressed scenes say: a table of settings, and sentences of what diverged and of ``implicit`` beside it."""

from __future__ import annotations

from typing import Final

import numpy as np
import pandas as pd

from agents.chart.stability.pressed import WAYS, pressed_scene
from agents.chart.stability.pressed_runs import (
    BARE,
    COARSE,
    EVERYWHERE,
    FINE,
    IMPLICIT,
    MEMBERS,
    SHORT,
    Setting,
    contested,
    lost,
    rows_of,
)

COMPARED: Final = {"tension_mean_n": "root tension", "radial_mean_m": "mean radial place of the sensor"}


def markdown(table: pd.DataFrame) -> str:
    """A row a way: how many of its scenes end finite, a column a setting; sentences below."""
    heads = ["way", "scenes", *(_words(setting) for setting in EVERYWHERE)]
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    for way in (*WAYS, "all"):
        parts = [rows_of(table, setting) for setting in EVERYWHERE]
        parts = [part if way == "all" else part[part["way"] == way] for part in parts]
        finite = [str(int(part["diverged_at_s"].isna().sum())) for part in parts]
        lines.append(f"| {way} | {len(parts[0])} | " + " | ".join(finite) + " |")
    return "\n".join(lines) + "\n\n" + "\n".join(f"* {sentence}" for sentence in sentences(table))


def _words(setting: Setting) -> str:
    walls = "cable on the walls" if setting.cable else "floats alone"
    return f"`{setting.method}`, {setting.time_step:g} s, {setting.nodes_per_pitch} nodes a pitch, {walls}"


def sentences(table: pd.DataFrame) -> list[str]:
    """How hard the scenes press, what diverged with the cable on the walls and what mends it, ``implicit`` beside."""
    coarse = rows_of(table, COARSE)
    over = coarse["over_euler"]
    gone = lost(table, COARSE)
    told = [
        f"In {int((over > 1.0).sum())} of {len(over)} scenes steady sliding would press the root beyond Euler's load"
        f" between two floats, in {int((over > 100.0).sum())} of them beyond a hundred times it: so far the probe is"
        " stuck before, and steady sliding is never reached."
    ]
    if gone:
        rigidity = {number: pressed_scene(number).scene.probe.flexural_rigidity for number in coarse.index}
        weakest = max(rigidity[number] for number in gone)
        as_weak = sum(value <= weakest for value in rigidity.values())
        short = len(set(gone) - set(lost(table, SHORT)))
        fine = len(set(gone) - set(lost(table, FINE)))
        told.append(
            f"The {len(gone)} that diverge on four nodes a pitch with the cable on the walls are cables of at most"
            f" {weakest:.2g} N m² ({as_weak} scenes have such). A quarter of the step holds {short} of them, eight"
            f" nodes a pitch {fine}: it is the mesh, not the step."
        )
    return [*told, *_beside_implicit(table)]


def _beside_implicit(table: pd.DataFrame) -> list[str]:
    """Scenes that only the cable's contact holds: greatest differences of the means of the starts, with the scatter."""
    chosen = contested(table)
    lines = []
    for column, words in COMPARED.items():
        fast, slow = (_members(table, setting, column).reindex(chosen) for setting in (COARSE, IMPLICIT))
        if chosen and fast.notna().all(axis=None) and slow.notna().all(axis=None):
            cells = (
                f"{a.mean() * s:.2f} ± {a.std() * s:.2f} and {b.mean() * s:.2f} ± {b.std() * s:.2f} {unit}"
                for s, unit in [(1.0, "N") if column.endswith("_n") else (1e3, "mm")]
                for (_, a), (_, b) in zip(fast.iterrows(), slow.iterrows(), strict=True)
            )
            lines.append(f"`imex` and `implicit` at {IMPLICIT.time_step:g} s, {words}: " + "; ".join(cells) + ".")
    if lines:
        lengths = ", ".join(f"{pressed_scene(number).scene.inserted_length:.1f}" for number in chosen)
        lines[0] = (
            f"Of the {len(set(lost(table, BARE)) - set(lost(table, COARSE)))} that only the cable's contact holds, the"
            f" {len(chosen)} shortest ({lengths} m), {MEMBERS} starts each: " + lines[0]
        )
    return lines


def _members(table: pd.DataFrame, setting: Setting, column: str) -> pd.DataFrame:
    """Scene x member."""
    return pd.DataFrame({member: rows_of(table, setting, member)[column] for member in range(MEMBERS)})


def agreement(table: pd.DataFrame, column: str) -> np.ndarray:
    """(scenes,) difference of the means of ``imex`` and ``implicit`` over its standard error from the starts."""
    chosen = contested(table)
    fast, slow = (_members(table, setting, column).loc[chosen] for setting in (COARSE, IMPLICIT))
    error = np.sqrt((fast.var(axis=1) + slow.var(axis=1)) / MEMBERS)
    return np.asarray((fast.mean(axis=1) - slow.mean(axis=1)) / error)
