"""Predictability: growth of a perturbation of 1e-9 m by inserted length, friction and air supply.

A twin is a copy of a settled probe whose nodes are displaced radially by independent normal numbers. The separation of
a pair is the rms over its floats of the difference in radial displacement [m]. It is fitted by exp(rate t) between ten
times the perturbation, where the growing shape has outgrown those that decay, and a tenth of the saturation, which is
the separation of independent runs. Rounding leaves about 1e-13 m, far below the window. The doubling time is
ln 2 / rate.
"""

import math
from dataclasses import asdict, astuple, dataclass
from itertools import product
from pathlib import Path
from typing import Any, Final

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from scipy.stats import linregress

from probe_agents.evaluation.statistics import Interval, mean_interval
from probe_agents.evaluation.workers import HERE, Workers
from probe_agents.policies.planner import InsertionPlanner
from probe_agents.records.drawing import GREY, PALETTE, save
from probe_agents.records.manifest import write_manifest
from probe_agents.records.store import Store
from probe_agents.studies.builtin import print_frame
from probe_agents.studies.claims import PERTURBATION
from probe_agents.terminal.tables import print_line
from probe_env import Scene, SimulatorBatch, TaskConfig
from probe_env.arrays import FloatArray

SETTLE, DURATION, CHUNK, SAMPLE_PERIOD = 2.0, 2.0, 0.25, 2e-3
"""[s]: run before the twins are made; longest run of the twins, which ends after the chunk in which all have separated
or decayed."""
CLEAR: Final = 10.0
"""Ratio of the window's ends to the perturbation and to the saturation."""
DECAYED: Final = 1e-3
"""Separation over perturbation below which a perturbation has died out."""
MIN_R2: Final = 0.7
"""Mean coefficient of determination of the fits, below which no doubling time is given."""
MIN_SAMPLES: Final = 5
"""Samples in a window, below which it holds a jump and the growth is irregular."""
UNKNOWN: Final = Interval(*(math.nan,) * 3)
LENGTHS, FRICTIONS, AIRS = (10.0, 20.0, 30.0, 40.0, 50.0, 60.0), (0.1, 0.15, 0.25), (40.0, 63.0, 100.0)
HORIZON: Final = InsertionPlanner.periods * TaskConfig().period
"""Time that the planner looks ahead [s]."""


@dataclass(frozen=True)
class Setting:
    """Scene, numerics (those of the preset ``reference``) and twins of one row."""

    inserted_length_m: float = 50.0
    friction: float = 0.15
    air_supply_m3_per_h: float = 63.0
    method: str = "superelement"
    time_step_s: float = 5e-5
    nodes_per_pitch: int = 4
    perturbation_m: float = 1e-9
    """Standard deviation of the displacement of a twin's nodes."""
    members: int = 8
    """Number of pairs, with different starts and perturbations."""

    def separations(self) -> tuple[FloatArray, FloatArray, float]:
        """Times (k,) [s], separations (k, m) of the pairs and the saturation [m]."""
        contact, count = {"friction": self.friction}, self.members
        carrier = self.inserted_length_m - Scene().probe.guide_length
        changes = {"carrier_length": carrier, "air_supply_rate": self.air_supply_m3_per_h / 3600.0, "contact": contact}
        numerics = self.method, self.time_step_s, self.nodes_per_pitch
        scenes = [Scene.model_validate(changes)] * count
        batch = SimulatorBatch(scenes, *numerics, threads=1, perturbation=PERTURBATION)
        batch.advance(duration=SETTLE)
        pairs = batch.branch([*range(count), *range(count)])
        for seed, twin in enumerate(pairs.simulators[count:]):
            twin.displace(self.perturbation_m * np.random.default_rng(seed).normal(size=twin.root))
        separations: list[FloatArray] = []
        independent: list[float] = []
        for step in range(1, round(DURATION / SAMPLE_PERIOD) + 1):
            if pairs.advance(duration=SAMPLE_PERIOD, sample_period=SAMPLE_PERIOD).diverged.any():
                raise RuntimeError(f"{self}: a probe diverged")
            radial = np.array([s.state.d[: s.root : s.nodes_per_pitch, 1] for s in pairs.simulators])
            first, second = radial[:count], radial[count:]
            separations.append(np.sqrt(((second - first) ** 2).mean(axis=1)))
            independent.append(float(((first - np.roll(first, 1, axis=0)) ** 2).mean()))
            if step % round(CHUNK / SAMPLE_PERIOD) == 0:
                high = math.sqrt(np.mean(independent)) / CLEAR
                decayed = separations[-1].max() < DECAYED * self.perturbation_m
                if decayed or (np.max(separations, axis=0) > high).all():
                    break
        times = SAMPLE_PERIOD * np.arange(1, len(separations) + 1)
        return times, np.array(separations), math.sqrt(np.mean(independent))

    def rows(self) -> list[dict[str, Any]]:
        """The row of this setting: its fields and ``growth``."""
        return [asdict(self) | growth(*self.separations(), self.perturbation_m)]


def growth(times: FloatArray, separations: FloatArray, saturation: float, perturbation: float) -> dict[str, Any]:
    """Fit the growth of the separation of m pairs.

    Args:
        times: (k,) [s].
        separations: (k, m), positive, in the unit of the saturation and the perturbation.
        saturation: separation of independent pairs.
        perturbation: initial separation.

    Returns:
        result ("grows", "irregular", "decays"), number of separated pairs, mean time until they separate to a tenth of
        the saturation, mean rate, doubling time, each with its 95 % interval, mean r2 of the fits, saturation and the
        largest separation at the end. Rate and doubling time are given only for "grows": all pairs separate, and mean
        r2 is at least ``MIN_R2``.
    """
    low, high = CLEAR * perturbation, saturation / CLEAR
    rates, r2, waits = [], [], []
    for values in separations.T:
        above = np.flatnonzero(values > high)
        if high <= low or not len(above):
            continue
        below = np.flatnonzero(values[: above[0]] < low)
        window = slice(int(below[-1]) + 1 if len(below) else 0, int(above[0]) + 1)
        slope, r = math.nan, math.nan
        if len(times[window]) >= MIN_SAMPLES:
            slope, _, r, *_ = linregress(times[window], np.log(values[window]))
        rates.append(slope)
        r2.append(r**2)
        waits.append(times[above[0]])
    last = float(separations[-1].max())
    result = "decays" if not rates and last < DECAYED * perturbation else "irregular"
    if len(rates) == separations.shape[1] and np.mean(r2) >= MIN_R2:
        result = "grows"
    row: dict[str, Any] = {"result": result, "separated": len(rates)}
    wait = mean_interval(np.array(waits)) if waits else UNKNOWN
    rate = mean_interval(np.array(rates)) if result == "grows" else UNKNOWN
    doubling = Interval(*(math.log(2.0) / value for value in (rate.mean, rate.high, rate.low)))
    for name, values in (("separated_after_s", wait), ("rate_per_s", rate), ("doubling_s", doubling)):
        row |= {name: values.mean, f"{name}:low": values.low, f"{name}:high": values.high}
    return row | {"r2": np.mean(r2) if r2 else math.nan, "saturation_m": saturation, "last_separation_m": last}


def run(output: Path, workers: Workers = HERE) -> pd.DataFrame:
    """Run the settings that are not stored; writes predictability.csv and predictability.png."""
    store = Store(output / "predictability.csv", tuple(asdict(Setting())))
    table = store.fill({astuple(s): s for s in SETTINGS}, Setting.rows, "setting", workers.jobs)
    seeds = range(Setting.members)
    write_manifest(output, ["predictability.csv"], seeds=seeds, commits=table["commit"])
    draw(table, output / "predictability.png")
    shown = ("result", "inserted_length_m", "friction", "air_supply_m3_per_h", "doubling_s", "separated_after_s", "r2")
    print_frame("Doubling time of a perturbation [s], and time until trajectories have separated", table, shown)
    print_line(f"written: {output}/ (predictability.csv, predictability.png)")
    return table


CHECKED: Final = ((50.0, 0.15), (30.0, 0.25))
"""Inserted lengths [m] and frictions of the checks by a halved perturbation and other methods."""
CHECKS: Final[tuple[dict[str, Any], ...]] = (
    {"perturbation_m": 5e-10},
    {"method": "imex", "nodes_per_pitch": 16},
    {"method": "newmark", "time_step_s": 1e-4},
)
SETTINGS: Final = (
    *(Setting(length, friction, air) for air, friction, length in product(AIRS, FRICTIONS, LENGTHS)),
    *(Setting(*scene, **change) for scene, change in product(CHECKED, CHECKS)),
)


def draw(table: pd.DataFrame, path: Path) -> None:
    """Doubling time (above) and time until a tenth of the saturation (below) over the length, one column per air."""
    names = ("method", "time_step_s", "nodes_per_pitch", "perturbation_m")
    main = table[(table[list(names)] == [getattr(Setting(), name) for name in names]).all(axis=1)]
    airs = sorted(main["air_supply_m3_per_h"].unique())
    figure, axes = plt.subplots(
        2, len(airs), figsize=(12, 6), layout="constrained", sharex=True, sharey="row", squeeze=False
    )
    for (doubling, wait), air in zip(axes.T, airs, strict=True):
        at_air = main[main["air_supply_m3_per_h"] == air]
        for colour, (friction, part) in zip(PALETTE, at_air.groupby("friction"), strict=False):
            for axis, column, factor in ((doubling, "doubling_s", 1e3), (wait, "separated_after_s", 1.0)):
                rows = part[part[column].notna()]
                mean, low, high = (factor * rows[f"{column}{end}"] for end in ("", ":low", ":high"))
                style: dict[str, Any] = {"color": colour, "label": f"friction {friction:g}", "fmt": "o-", "ms": 4}
                axis.errorbar(rows["inserted_length_m"], mean, yerr=[mean - low, high - mean], capsize=3, **style)
            decays = part.loc[part["result"] == "decays", "inserted_length_m"]
            wait.plot(decays, [2.0 * HORIZON] * len(decays), "v", color=colour)
        wait.plot([], [], "v", color=GREY, label="perturbation dies out")
        wait.axhline(HORIZON, color=GREY, linestyle="--", label="planner's horizon")
        doubling.set(title=f"air supply {air:g} m³/h")
        wait.set(xlabel="inserted length [m]", yscale="log")
    axes[0, 0].set_ylim(0.0)
    axes[0, 0].set_ylabel("doubling time [ms]")
    axes[1, 0].set_ylabel("from 1e-9 m to a tenth\nof the saturation [s]")
    handles = dict(zip(*reversed(axes[1, 0].get_legend_handles_labels()), strict=True))
    figure.legend(list(handles.values()), list(handles), loc="outside lower center", ncols=5, frameon=False)
    save(figure, path, dpi=90)
