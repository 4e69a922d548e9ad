"""The study's experiment (e) as an ensemble: the probe drawn back beside the probe fed in, under the same settings.

Drawn back, feed and air are reversed and the probe starts on the outer wall, against which it is pressed. The couple of
(9) is counted from the frame where the probe is pulled, as the study has it, and from the tube's tangent where it is
pressed (docs/simulation/return.md).
"""

from __future__ import annotations

import itertools
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Literal

import numpy as np
import pandas as pd

from agents.records.code_hash import code_hash
from agents.records.store import Store
from agents.study.cases import DURATION, PERTURBATION
from agents.study.members import KEYS, load_members, run_members
from agents.study.spectra import SHOWN, densities, highest_peak
from probe_env import Run, Scene, SimulationError, Simulator, StabilityWarning
from probe_env.physics.closed_forms import steady_tensions
from probe_env.physics.model.chain import RISE
from probe_env.physics.simulation.signals import point_statistics

CODE: Final = ("agents.study.back:run_trip",)
PROBES: Final = {"original": "fig11_l50", "improved": "fig20_improved"}
"""Scenes that have the probes, in the study's tube with its air."""


@dataclass(frozen=True)
class Trip:
    """A probe of constant length on its way in or back.

    Attributes:
        probe: one of ``PROBES``.
        way: "in" or "back".
        carrier_length: [m].
        feed: magnitude of the feed speed [m/s].
        friction: Coulomb's coefficient.
        method: of the simulation.
        time_step: [s].
        couple: from where (9) counts the rotation; None: as is right for the way.
        settling: time before the run [s] in which the start dies.
    """

    probe: str
    way: Literal["in", "back"]
    carrier_length: int
    feed: float = 0.2
    friction: float = 0.15
    method: str = "imex"
    time_step: float = 2e-4
    couple: Literal["frame", "tangent"] | None = None
    settling: float = 0.0

    @property
    def name(self) -> str:
        """Of its rows: probe, length, feed, what differs from the usual, way."""
        parts = [self.probe, f"l{self.carrier_length}", f"u{1e3 * self.feed:.0f}"]
        parts += [f"mu{1e2 * self.friction:.0f}"] if self.friction != Trip.friction else []
        parts += [self.method] if self.method != Trip.method else []
        parts += [self.couple] if self.couple else []
        parts += [f"after{self.settling:.0f}"] if self.settling else []
        return "-".join([*parts, self.way])

    def beside(self) -> Trip:
        """The insertion under the same settings."""
        return replace(self, way="in")

    def scene(self, scenes: Path) -> Scene:
        """What is simulated; ``scenes`` holds the files of ``PROBES``."""
        base = Scene.from_toml(scenes / f"{PROBES[self.probe]}.toml")
        sign = -1.0 if self.way == "back" else 1.0
        return base.model_copy(
            update={
                "carrier_length": float(self.carrier_length),
                "feed_speed": sign * self.feed,
                "air_supply_rate": sign * base.air_supply_rate,
                "couple": self.couple or ("tangent" if self.way == "back" else "frame"),
                "contact": {"friction": self.friction},
            }
        )


def _backs() -> tuple[Trip, ...]:
    """The settings of the return, in the order of the table."""
    trips = []
    for probe in PROBES:
        lengths = (10, 30, 50, 55) if probe == "original" else (10, 30, 50)  # its guide ends at the helix's end
        trips += [Trip(probe, "back", length) for length in lengths]
        trips += [Trip(probe, "back", 50, feed) for feed in (0.1, 0.4)]
        trips += [Trip(probe, "back", length, method="newmark", time_step=1e-4) for length in (30, 50)]
        trips += [Trip(probe, "back", 50, feed, 0.25) for feed in ((0.2,) if probe == "original" else (0.1, 0.2, 0.4))]
    return tuple(trips)


SETTLING: Final = 12.0  # [s]; the start of the return dies within 10 s where it rings longest
BACKS: Final = _backs()
SETTLED: Final = (
    *(Trip(probe, "back", 50, settling=SETTLING) for probe in PROBES),
    *(Trip("improved", "back", 50, feed, 0.25, settling=SETTLING) for feed in (0.1, 0.2, 0.4)),
)
"""Returns whose start has died."""
TANGENTS: Final = tuple(Trip(probe, "in", length, couple="tangent") for probe in PROBES for length in (30, 50))
"""Insertions in which the couple is counted as in the return."""
TRIPS: Final = (*itertools.chain(*((trip, trip.beside()) for trip in BACKS)), *SETTLED, *TANGENTS)
SLOW_MEMBERS: Final = 2
SUBSET: Final = tuple(trip.name for trip in TRIPS if trip.probe == "original" and trip.carrier_length == 10)


def run_trip(trip: Trip, scenes: Path, member: int, duration: float) -> dict[str, object]:
    """One member of a trip as a row: statistics and spectra of the sensor after a quarter, or when it diverged."""
    scene = trip.scene(scenes)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StabilityWarning)  # that the frame's couple is not fit for pressure
        simulator = Simulator(
            scene,
            trip.method,
            trip.time_step,
            perturbation=PERTURBATION if member else 0.0,
            seed=member,
            start="outer" if trip.way == "back" else "inner",
        )
    row: dict[str, object] = {
        "case": trip.name,
        "member": member,
        "duration_s": duration,
        "diverged_at_s": float("nan"),
    }
    before = round(0.25 * duration, 2)
    try:
        simulator.advance(duration=trip.settling + before)
        run = simulator.advance(duration=duration - before, points=("sensor", "root"))
    except SimulationError as error:
        return row | {"diverged_at_s": error.time}
    row |= point_statistics(run, "sensor", 0.0)
    row["root_tension_mean_n"] = point_statistics(run, "root", 0.0)["tension_mean_n"]
    row["tension_error"] = _tension_error(run, scene)
    for name, signal in (("axial", run.axial[:, 0]), ("radial", run.radial[:, 0])):
        row[f"{name}_highest_hz"], row[f"{name}_highest_m"] = highest_peak(signal, run.sample_period)
        values = densities(signal, run.sample_period)
        row |= {density(name, hertz): value for hertz, value in zip(SHOWN, values, strict=True)}
    return row


def density(direction: str, hertz: int) -> str:
    """Column of an amplitude spectral density [m/sqrt(Hz)]."""
    return f"{direction}_{hertz}_hz_m_per_root_hz"


def _tension_error(run: Run, scene: Scene) -> float:
    """Greatest difference of the mean axial force from the closed form along the probe, as a share of the root's.

    Floats nearer than ``RISE`` to the entrance, where a pressed probe comes to the wall, and to the sensor, where
    floats may be of two sizes and the cable bends from one clearance to the other, are left out.
    """
    expected = steady_tensions(scene)[::-1]
    pitch = len(run.mean_tension) // len(expected)
    behind = run.mean_tension[pitch - 1 :: pitch]
    place = np.arange(len(expected)) * scene.probe.float_pitch
    away = (place >= RISE) & (np.abs(place - scene.carrier_length) >= RISE)
    return float(np.abs(behind - expected)[away].max() / abs(expected[0]))


def run_back(
    scenes: Path, output: Path, members: int, duration: float, names: tuple[str, ...] = (), jobs: int = 2
) -> pd.DataFrame:
    """All members of the named trips (default: all), stored in ``output``/back.csv as they finish.

    Of Newmark there are two at most: it checks the fast scheme, and takes most of the time. Rows that are stored
    already, for the same duration and code, are not run again.
    """
    chosen = [trip for trip in TRIPS if not names or trip.name in names]
    store = open_store(output)
    for trip in chosen:
        code_hash(CODE, trip.method)  # here, and not in the threads
    most = {trip.name: members if trip.method == Trip.method else min(members, SLOW_MEMBERS) for trip in chosen}
    wanted = [(trip, member) for member in range(members) for trip in chosen if member < most[trip.name]]
    return run_members(wanted, lambda trip, member: run_trip(trip, scenes, member, duration), store, duration, jobs)


def open_store(output: Path) -> Store:
    """The stored runs."""
    methods = {trip.name: trip.method for trip in TRIPS}
    return Store(output / "back.csv", KEYS, lambda row: code_hash(CODE, methods.get(row["case"])))


def load_rows(output: Path, duration: float = DURATION) -> pd.DataFrame:
    """Stored rows of a duration [s]; none if there is no file."""
    return load_members(output / "back.csv", duration)
