"""What the root's place does to the vibration, as tables: means with 95 % intervals over the members."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from agents.rollouts.statistics import student_factor
from agents.study.claims import Ensemble, short
from agents.study.root_waves import conversion
from agents.study.roots import CLOSE, FINE_STEP, LENGTHS, MESHES, PLACES, SCENE, Root
from probe_env import Scene

BETWEEN = tuple(place for place in PLACES if 0.0 < place < 1.0)


def mean_and_half(values: np.ndarray, scale: float = 1e3) -> str:
    """Mean and half of its interval, by default of metres in millimetres."""
    mean = scale * values.mean()
    if len(values) < 2:
        return short(mean)
    half = scale * student_factor(len(values)) * values.std(ddof=1) / np.sqrt(len(values))
    return f"{mean:.3g} ± {half:.1g}"


def ratio(over: np.ndarray, under: np.ndarray) -> str:
    """Ratio of two means with its interval, from the logarithms' scatter."""
    value = over.mean() / under.mean()
    if min(len(over), len(under)) < 2:
        return short(value)
    parts = [(v.std(ddof=1) / v.mean()) ** 2 / len(v) for v in (over, under)]
    reach = student_factor(min(len(over), len(under))) * np.sqrt(sum(parts))
    return f"{value:.2f} [{value * np.exp(-reach):.2f}, {value * np.exp(reach):.2f}]"


def lengths(table: pd.DataFrame, statistic: str = "radial_rms_m") -> list[tuple[str, ...]]:
    """Of each length: the statistic [mm] at every place, growing, and the mean of the places between over a float's."""
    e, rows = Ensemble(table), []
    for length in LENGTHS:
        held = [e.values(Root(length, place).name, statistic) for place in PLACES]
        grown = e.values(Root(length, grows=True).name, statistic)
        if all(len(values) for values in (*held, grown)):
            at = np.concatenate([held[0], held[-1]])
            between = np.concatenate([values for place, values in zip(PLACES, held, strict=True) if place in BETWEEN])
            rows.append((str(length), *(mean_and_half(v) for v in (*held, grown)), ratio(between, at)))
    return rows


def meshes(table: pd.DataFrame) -> list[tuple[str, ...]]:
    """Of each mesh at 30 m: radial rms [mm] at a float's place and half a pitch on, their ratio, the axial one's."""
    e = Ensemble(table)
    rows: list[tuple[str, ...]] = []
    usual = Root(30)
    tried = [usual, *(replace(usual, method=m, nodes_per_pitch=n, time_step=FINE_STEP) for m, n in MESHES)]
    for at in tried:
        half = replace(at, place=0.5)
        if e.has(at.name, half.name):
            radial, axial = (
                [e.values(case.name, name) for case in (half, at)] for name in ("radial_rms_m", "axial_rms_m")
            )
            rows.append(
                (
                    at.method, str(at.nodes_per_pitch), f"{at.time_step:g} s",
                    mean_and_half(radial[1]), mean_and_half(radial[0]), ratio(*radial), ratio(*axial),
                )
            )  # fmt: skip
    return rows


def close(table: pd.DataFrame, scenes: Path = Path("configs/scenes")) -> list[tuple[str, ...]]:
    """Of places close to a float's at 10 m: distance of the first float, conversion by the closed form, rms."""
    e, rows = Ensemble(table), []
    scene = Scene.from_toml(scenes / f"{SCENE}.toml")
    for case in sorted(CLOSE, key=lambda case: case.place or 1.0):  # at a float's place the first one is a pitch ahead
        if e.has(case.name):
            first = case.place or 1.0
            rms = (mean_and_half(e.values(case.name, name), scale) for name, scale in COLUMNS)
            rows.append((f"{16 * first:g}/16", f"{1e3 * conversion(scene, first):.2f}", *rms))
    return rows


COLUMNS = (("axial_rms_m", 1e3), ("radial_rms_m", 1e6))
"""Shown of places close to a float's, with what they are multiplied with."""


def root_markdown(table: pd.DataFrame) -> str:
    """All three tables."""
    names = [f"{place:g}" for place in PLACES]
    return "\n\n".join(
        (
            "Radial rms at the sensor [mm], the root held at a place or growing past all of them"
            " (`superelement32`, 2e-4 s):",
            _lines(("l [m]", *names, "growing", "between over at a float's"), lengths(table)),
            "Axial rms at the sensor [mm], likewise:",
            _lines(("l [m]", *names, "growing", "between over at a float's"), lengths(table, "axial_rms_m")),
            "Radial rms at 30 m [mm] by mesh:",
            _lines(("method", "nodes a pitch", "step", "0", "0.5", "ratio", "ratio of axial rms"), meshes(table)),
            "Near a float's place at 10 m (`imex32`, 16 nodes a pitch, 1e-4 s): distance a of the first float from the"
            " root, conversion by the closed form, axial rms and radial rms at the sensor:",
            _lines(("a/p", "conversion [mm/rad]", "axial [mm]", "radial [µm]"), close(table)),
        )
    )


def _lines(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    return "\n".join(f"| {' | '.join(line)} |" for line in (header, ["---"] * len(header), *rows))
