"""Ensembles of the published study's cases, resumable.

Where the probe vibrates, its motion is chaotic: a claim is tested on statistics of members whose start is perturbed by
0.1 um. Member 0 has the study's start.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from scipy.signal import welch

from probe_agents.records.shipped import file_or_shipped
from probe_agents.records.store import Store, stored_rows
from probe_env import Scene, SimulationError, Simulator, StabilityWarning
from probe_env.arrays import FloatArray
from probe_env.physics.simulation.signals import LOWEST_FREQUENCY, point_statistics

PERTURBATION: Final = 1e-7  # [m]; a float rests a few micrometres deep in its contact spring
DURATION: Final = 8.0  # [s] of the published runs
KEYS: Final = ("case", "member", "duration_s")
USUAL_FEED, USUAL_FRICTION = 0.2, 0.15  # [m/s], Coulomb's coefficient
HIGHEST_FREQUENCY: Final = 100.0  # [Hz]
SPECTRUM_WINDOW, PEAK_REACH = 2.0, 1.0
"""Length of a Hann window [s]; the band on either side of a peak [Hz] is the width of the window's main lobe."""


@dataclass(frozen=True)
class Case:
    """A scene file with changes and a method.

    Attributes:
        settles: statistics over the last third, not after the first quarter.
        carrier_length: [m]; None: the file's.
        feed_speed: magnitude [m/s]; None: the file's.
        withdrawn: feed and air are reversed and the probe starts on the outer wall.
        skips_start: the first quarter is not recorded; the row has the highest peaks of the spectra.
    """

    name: str
    scene: str
    method: str = "newmark"
    time_step: float = 1e-4
    walls: str = "both"
    settles: bool = False
    carrier_length: float | None = None
    feed_speed: float | None = None
    friction: float = USUAL_FRICTION
    withdrawn: bool = False
    skips_start: bool = False

    @property
    def is_plain(self) -> bool:
        """Whether only method and step differ from the defaults."""
        return self == Case(self.name, self.scene, self.method, self.time_step)

    def load_scene(self) -> Scene:
        """The scene to simulate."""
        base = Scene.from_toml(file_or_shipped("scenes", self.scene))
        sign, couple = (-1.0, "tangent") if self.withdrawn else (1.0, "frame")
        feed = base.feed_speed if self.feed_speed is None else self.feed_speed
        changes = {"feed_speed": sign * feed, "air_supply_rate": sign * base.air_supply_rate, "couple": couple}
        changes |= {"contact": {"walls": self.walls, "friction": self.friction}}
        changes |= {} if self.carrier_length is None else {"carrier_length": self.carrier_length}
        return base.model_copy(update=changes)


INSERTED: Final = (
    *(Case(f"l{length}", f"fig11_l{length}") for length in (10, 20, 30, 40, 50)),
    Case("l55", "fig12_l55"),
    Case("u0", "fig15_u0", settles=True),
    Case("u100", "fig16_u100"),
    Case("u400", "fig16_u400"),
    Case("dh2500", "fig17_dh2500"),
    Case("q40", "fig18_q40"),
    Case("improved", "fig20_improved"),
    Case("l10-wilson", "fig11_l10", method="wilson"),
    Case("l50-wilson", "fig11_l50", method="wilson"),
    Case("l50-inner", "fig11_l50", walls="inner"),
    Case("l50-dt2e-4", "fig11_l50", time_step=2e-4),
    Case("l50-dt5e-4", "fig11_l50", time_step=5e-4),
    *(Case(f"l{length}-explicit", f"fig11_l{length}", "explicit", 5e-6) for length in (30, 50)),
    *(Case(f"l{length}-implicit", f"fig11_l{length}", "implicit", 2.5e-5) for length in (30, 50)),
)
"""Insertions, as in the study's figures."""
PROBES: Final = {"original": "fig11_l50", "improved": "fig20_improved"}
"""Probes of the study's experiment (e) and their scenes."""


def trip(
    probe: str,
    length: int,
    feed: float = USUAL_FEED,
    friction: float = USUAL_FRICTION,
    method: str = "imex",
    withdrawn: bool = True,
) -> Case:
    """Insertion or withdrawal at constant length [m] and speed [m/s]; the name has the differences from the usual."""
    parts = [probe, f"l{length}", f"u{1e3 * feed:.0f}"]
    parts += [f"mu{1e2 * friction:.0f}"] if friction != USUAL_FRICTION else []
    parts += [method] if method != "imex" else []
    return Case(
        "-".join([*parts, "back" if withdrawn else "in"]), PROBES[probe], method, 1e-4 if method == "newmark" else 2e-4,
        carrier_length=float(length), feed_speed=feed, friction=friction, withdrawn=withdrawn, skips_start=True,
    )  # fmt: skip


def insertion_of(withdrawal: str) -> str:
    """Name of the reference insertion of a withdrawal."""
    return withdrawal.removesuffix("back") + "in"


def _trips() -> Iterator[Case]:
    for probe, withdrawn in product(PROBES, (True, False)):
        lengths = (10, 30, 50, 55) if probe == "original" else (10, 30, 50)  # its guide ends at the helix's end
        weak = (0.2,) if probe == "original" else (0.1, 0.2, 0.4)
        yield from (trip(probe, length, withdrawn=withdrawn) for length in lengths)
        yield from (trip(probe, 50, feed, withdrawn=withdrawn) for feed in (0.1, 0.4))
        yield from (trip(probe, length, method="newmark", withdrawn=withdrawn) for length in (30, 50))
        yield from (trip(probe, 50, feed, 0.25, withdrawn=withdrawn) for feed in weak)


TRIPS: Final = tuple(_trips())
"""Experiment (e): withdrawals, and insertions under the same settings."""
FIRST: Final = ("l10", "l30", "l50", "u0", "improved", "original-l10-u200-back", "original-l10-u200-in")
CASES: Final = tuple(sorted((*INSERTED, *TRIPS), key=lambda case: case.name not in FIRST))
"""All cases, ``FIRST`` first: few of these have a claim each."""


def run_case(case: Case, member: int, duration: float) -> dict[str, object]:
    """One member of a case as a row: statistics of sensor, tip and root, or the time of divergence."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StabilityWarning)  # some cases are beyond the limit on purpose
        start, perturbation = "outer" if case.withdrawn else "inner", PERTURBATION if member else 0.0
        options = {"perturbation": perturbation, "seed": member, "start": start}
        simulator = Simulator(case.load_scene(), case.method, case.time_step, **options)  # type: ignore[arg-type]
    row: dict[str, object] = {"case": case.name, "member": member, "duration_s": duration, "diverged_at_s": np.nan}
    skipped = round(0.25 * duration, 2) if case.skips_start else 0.0
    try:
        if skipped:
            simulator.advance(duration=skipped)
        run = simulator.advance(duration=duration - skipped, points=("sensor", "tip", "root"))
    except SimulationError as error:
        return row | {"diverged_at_s": error.time}
    since = 0.0 if case.skips_start else duration * (2.0 / 3.0 if case.settles else 0.25)
    row |= point_statistics(run, "sensor", since)
    row["root_tension_mean_n"] = point_statistics(run, "root", since)["tension_mean_n"]
    if not case.skips_start:
        return row | {"tip_radial_max_m": float(run.radial[:, run.column("tip")].max())}  # includes the start
    for name, signal in (("axial", run.axial[:, 0]), ("radial", run.radial[:, 0])):
        row[f"{name}_highest_hz"], row[f"{name}_highest_m"] = highest_peak(signal, run.sample_period)
    return row


def highest_peak(signal: FloatArray, sample_period: float) -> tuple[float, float]:
    """Frequency [Hz] and amplitude of the highest peak between 2 and 100 Hz of a signal (k,) of any unit.

    The amplitude is that of a sine with the power within 1 Hz of the highest value of the Welch spectrum (Hann windows
    of 2 s, half overlapping): A = sqrt(2 P).
    """
    segment = min(len(signal), round(SPECTRUM_WINDOW / sample_period))
    frequency, density = welch(signal, 1.0 / sample_period, nperseg=segment)
    chosen = (frequency >= LOWEST_FREQUENCY) & (frequency <= HIGHEST_FREQUENCY)
    peak = float(frequency[chosen][np.argmax(density[chosen])])
    near = np.abs(frequency - peak) <= PEAK_REACH + 1e-9
    return peak, float(np.sqrt(2.0 * density[near].sum() * frequency[1]))


def run_cases(output: Path, members: int, cases: Sequence[Case] = CASES, jobs: int = 2) -> pd.DataFrame:
    """Run members of cases for ``DURATION``, in ``jobs`` threads; each is stored in ensemble.csv.

    Stored rows of the same duration are not run again.
    """
    store = Store(output / "ensemble.csv", KEYS)
    runs = {(case.name, member, DURATION): (case, member) for member in range(members) for case in cases}
    table = store.fill(runs, lambda run: [run_case(*run, DURATION)], jobs=jobs)
    return _in_order(table[[key in runs for key in table[list(KEYS)].itertuples(index=False, name=None)]])


def load_rows(folder: Path) -> pd.DataFrame:
    """Stored rows of ``DURATION``; empty without a file."""
    path = folder / "ensemble.csv"
    if not path.exists():
        return pd.DataFrame()
    table = stored_rows(path)
    return _in_order(table[table["duration_s"] == DURATION])


def _in_order(table: pd.DataFrame) -> pd.DataFrame:
    return table.sort_values(["case", "member"]).reset_index(drop=True)
