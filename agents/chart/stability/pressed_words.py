"""What the pressed scenes say: tables of settings and of ``implicit`` beside ``imex``, sentences of what diverged."""

from __future__ import annotations

from typing import Final

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
    STUCK,
    Discretisation,
    contested,
    lost,
    rows_of,
)

SHOWN: Final = (
    ("root tension [N]", "tension_mean_n", 1.0),
    ("sensor off the inner wall [mm]", "radial_mean_m", 1e3),
    ("radial rms [mm]", "radial_rms_m", 1e3),
)
"""Words, column and factor of what is compared with ``implicit``."""


def markdown(table: pd.DataFrame) -> str:
    """A row a way: how many of its scenes end finite, a column a setting; sentences, and ``implicit`` beside."""
    heads = ["way", "scenes", *(_words(setting) for setting in EVERYWHERE)]
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    for way in (*WAYS, "all"):
        parts = [rows_of(table, setting) for setting in EVERYWHERE]
        parts = [part if way == "all" else part[part["way"] == way] for part in parts]
        finite = [str(int(part["diverged_at_s"].isna().sum())) for part in parts]
        lines.append(f"| {way} | {len(parts[0])} | " + " | ".join(finite) + " |")
    remarks = "\n".join(f"* {sentence}" for sentence in sentences(table))
    gap = len(set(lost(table, BARE)) - set(lost(table, COARSE)))
    beside = (
        f"Of the {gap} that only the cable's contact holds, the shortest of every way that is not stuck, the shortest"
        f" that is and one that is beyond all bounds, beside `implicit` at {IMPLICIT.time_step:g} s; mean and standard"
        f" deviation of {MEMBERS} starts, over the last second:"
    )
    return "\n".join(lines) + f"\n\n{remarks}\n\n{beside}\n\n{beside_implicit(table)}"


def _words(setting: Discretisation) -> str:
    walls = "cable on the walls" if setting.cable else "floats alone"
    return f"`{setting.method}`, {setting.time_step:g} s, {setting.nodes_per_pitch} nodes a pitch, {walls}"


def sentences(table: pd.DataFrame) -> list[str]:
    """How hard the scenes press, what diverged with the cable on the walls, and what mends it."""
    coarse = rows_of(table, COARSE)
    over = coarse["over_euler"]
    gone = lost(table, COARSE)
    remarks = [
        f"In {int((over > 1.0).sum())} of {len(over)} scenes steady sliding would press the root beyond Euler's load"
        f" between two floats, in {int((over > STUCK).sum())} beyond {STUCK:g} times it: there the probe is stuck."
    ]
    if gone:
        force = {number: pressed_scene(number).bending_force(COARSE.nodes_per_pitch) for number in coarse.index}
        most = max(force[number] for number in gone)
        short, fine = (len(set(gone) - set(lost(table, setting))) for setting in (SHORT, FINE))
        as_weak = sum(value <= most for value in force.values())
        remarks.append(
            f"The {len(gone)} that diverge on four nodes a pitch with the cable on the walls are weak cables, whose"
            f" bending is finer than that mesh from an axial force of {most:.1f} N or less on (EI/h²; {as_weak} scenes"
            f" have such). A quarter of the step holds {short} of them, eight nodes a pitch hold {fine}: it is the"
            " mesh, not the step."
        )
    return remarks


def beside_implicit(table: pd.DataFrame) -> str:
    """A row a scene of those that only the cable's contact holds: means over the starts, and their scatter."""
    heads = [
        "scene", "inserted [m]", "pressure over Euler's load, sliding",
        *(f"{words}, `{setting.method}`" for words, _, _ in SHOWN for setting in (COARSE, IMPLICIT)),
    ]  # fmt: skip
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    for number in compared(table):
        pressed, cells = pressed_scene(number), []
        for _, column, factor in SHOWN:
            for setting in (COARSE, IMPLICIT):
                values = factor * members(table, setting, column).loc[number]
                cells.append(f"{values.mean():.4g} ± {values.std():.2g}")
        lines.append(
            f"| {number}: {pressed.way}, {pressed.probe} | {pressed.scene.inserted_length:.1f} |"
            f" {pressed.over_euler():.2g} | " + " | ".join(cells) + " |"
        )
    return "\n".join(lines)


def members(table: pd.DataFrame, setting: Discretisation, column: str) -> pd.DataFrame:
    """Scene x member of a column."""
    return pd.DataFrame({member: rows_of(table, setting, member)[column] for member in range(MEMBERS)})


def compared(table: pd.DataFrame) -> list[int]:
    """The scenes that ``implicit`` has run with all starts."""
    done = members(table, IMPLICIT, "tension_mean_n").dropna().index
    return [number for number in contested(table) if number in done]
