"""Chaotic regime: statistics of ensembles at constant length and of insertions, by method, step and mesh.

Where the probe vibrates trajectories diverge, so statistics of runs with a start perturbation of 0.1 um are compared.
All runs of a setting share a batch.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from itertools import product
from typing import Any

import numpy as np
from tqdm import tqdm

from probe_agents.studies.claims.cases import PERTURBATION
from probe_env import Scene, SimulatorBatch, StabilityWarning, Window
from probe_env.physics.simulation.signals import SAMPLE_PERIOD, dominant_frequencies

SETTLE, DURATION = 2.0, 6.0  # [s]
STATISTICS = (
    *("radial_rms_m", "radial_p99_m", "lift_off_share", "axial_rms_m", "axial_mean_m"),
    *("radial_acceleration_rms_m_per_s2", "tension_mean_n"),
)
PEAK = "axial_peak_hz"
COLUMNS = {"time_step": "time_step_s", "length": "carrier_length_m", "stiffness": "contact_stiffness_n_per_m"}
"""Field -> column with unit."""
FEED_SPEED, START, END = 0.2, 5.0, 60.0  # [m/s], [m], [m], of an insertion
SEGMENT = 5.0  # [m], of a row of an insertion


class Run:
    """Members of one setting in a batch."""

    members: int

    @property
    def key(self) -> dict[str, Any]:
        """All fields except the number of members, as columns."""
        fields = asdict(self)  # type: ignore[call-overload]
        return {COLUMNS.get(name, name): value for name, value in fields.items() if name != "members"}

    @property
    def last(self) -> tuple[Any, ...]:
        """Key of the last row in the table."""
        return (*self.key.values(), self.members - 1)


@dataclass(frozen=True)
class Setting(Run):
    """Method, mesh and scene of runs with table 2's probe at constant length."""

    method: str = "imex"
    time_step: float = 2e-4
    nodes_per_pitch: int = 4
    length: float = 50.0
    """Carrier length [m]."""
    stiffness: float = 1e5
    """Contact stiffness [N/m]."""
    friction: float = 0.15
    walls: str = "both"
    members: int = 16

    def batch(self, count: int, threads: int | None = None) -> SimulatorBatch:
        """``count`` runs with perturbed starts."""
        contact = {"stiffness": self.stiffness, "friction": self.friction, "walls": self.walls}
        scene = Scene.model_validate({"carrier_length": self.length, "contact": contact})
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", StabilityWarning)  # steps beyond the limit are tested on purpose
            numerics = self.method, self.time_step, self.nodes_per_pitch
            return SimulatorBatch([scene] * count, *numerics, threads=threads, perturbation=PERTURBATION)

    def rows(self) -> list[dict[str, Any]]:
        """One row per member: its statistics, missing if it diverged."""
        batch = self.batch(self.members)
        batch.advance(None, None, SETTLE, SAMPLE_PERIOD)
        window = batch.advance(None, None, DURATION, SAMPLE_PERIOD, keep_samples=True)
        rows = []
        for member, diverged in enumerate(window.diverged.tolist()):
            row = self.key | {"member": member, "diverged": diverged}
            rows.append(row | ({} if diverged else _statistics(window, member)))
        return rows


@dataclass(frozen=True)
class Insertion(Run):
    """Method and mesh of insertions from 5 to 60 m at 0.2 m/s."""

    method: str = "imex"
    time_step: float = 2e-4
    time_lapse: float = 1.0
    nodes_per_pitch: int = 4
    members: int = 8

    @property
    def last(self) -> tuple[Any, ...]:
        """Key of the last row in the table."""
        return (*super().last, END - SEGMENT)

    def rows(self, end: float = END) -> list[dict[str, Any]]:
        """One row per segment of length and member.

        Raises:
            RuntimeError: a probe diverged.
        """
        scenes = [Scene(carrier_length=START - 2.5, feed_speed=FEED_SPEED)] * self.members
        options = {"growing": True, "time_lapse": self.time_lapse, "perturbation": PERTURBATION}
        batch = SimulatorBatch(scenes, self.method, self.time_step, self.nodes_per_pitch, **options)  # type: ignore[arg-type]
        rows: list[dict[str, Any]] = []
        for start in tqdm(np.arange(START, end, SEGMENT), desc=str(self), unit="segment"):
            window = batch.advance(None, None, SEGMENT / FEED_SPEED / self.time_lapse, SAMPLE_PERIOD, keep_samples=True)
            if window.diverged.any():
                raise RuntimeError(f"{self}: {window.diverged.sum()} probes diverged beyond {start:g} m")
            for member in range(self.members):
                rows.append(self.key | {"member": member, "from_m": float(start)} | _statistics(window, member))
        return rows


LENGTHS = (10.0, 30.0, 50.0)  # [m]
STIFFNESSES = (1e4, 1e5, 1e6)  # [N/m]
STEPS = (5e-5, 1e-4, 1.25e-4, 1e-3 / 7, 1e-3 / 6, 2e-4, 2.5e-4, 5e-4)  # whole parts of the sampling period
MODEL_STEP = 1e-4  # [s], at which model choices are compared with each other
CHOICES: dict[str, dict[str, Any]] = {
    **{f"{n} node{'s' * (n > 1)} a pitch": {"nodes_per_pitch": n} for n in (1, 2, 8, 16)},
    "inner wall only": {"walls": "inner"},
    "contact half as stiff": {"stiffness": 5e4},
    "contact twice as stiff": {"stiffness": 2e5},
    "friction 0.14": {"friction": 0.14},
    "friction 0.16": {"friction": 0.16},
}
"""Single changes of table 2's mesh and model."""
CONVERGED_STEP, CONVERGED_NODES = 5e-5, 16  # [s], of imex: the reference
CONVERGED_LENGTHS = {10.0: 8, 30.0: 48, 40.0: 32, 50.0: 32}
"""Length [m] -> members of the converged reference at table 2's stiffness; 8 at others."""
SUPERELEMENT_STEPS = {1e4: (1e-4, 2e-4, 2.5e-4, 5e-4), 1e5: (5e-5, 1e-4, 2e-4, 2.5e-4), 1e6: (5e-5,)}
"""Contact stiffness [N/m] -> steps [s]: the longest stable one, and shorter ones."""
CONVERGED = Insertion("imex32", 5e-5, nodes_per_pitch=16)
"""The reference insertion."""
INSERTIONS = (
    *(Insertion("imex32", time_lapse=factor) for factor in (20.0, 10.0, 4.0, 2.0, 1.0)),
    *(Insertion("imex32", 1e-4, factor) for factor in (4.0, 1.0)),
    *(Insertion(time_lapse=factor) for factor in (4.0, 1.0)),
    Insertion(time_step=5e-5),
    *(Insertion("superelement32", time_lapse=factor, members=16) for factor in (20.0, 10.0, 4.0, 2.0, 1.0)),
    Insertion("superelement32", 1e-4),
    Insertion("superelement", 5e-5),
    Insertion("newmark", 1e-4, 4.0, members=4),
    CONVERGED,
)


def _settings() -> Iterator[Setting]:
    for stiffness, length in product(STIFFNESSES, LENGTHS):  # steps on table 2's mesh; slow methods: those of `claims`
        members = 32 if stiffness == Setting.stiffness else 16
        for method, steps in (("imex", (2.5e-5, *STEPS)), ("imex32", STEPS)):
            yield from (Setting(method, dt, length=length, stiffness=stiffness, members=members) for dt in steps)
    for length in LENGTHS[1:]:
        yield Setting("implicit", MODEL_STEP, length=length, members=8)
        yield from (Setting(**({"time_step": MODEL_STEP, "length": length} | change)) for change in CHOICES.values())
    for length, members in CONVERGED_LENGTHS.items():
        yield converged(length, Setting.stiffness, members)
        for dt in SUPERELEMENT_STEPS[Setting.stiffness]:
            many = length != 10.0 and dt >= 1e-4  # candidates of a preset
            yield Setting("superelement32", dt, length=length, members=128 if many else 16)
    for stiffness, length in product((1e4, 1e6), LENGTHS):
        yield converged(length, stiffness)
        for dt in SUPERELEMENT_STEPS[stiffness]:
            yield Setting("superelement32", dt, length=length, stiffness=stiffness)
    for length in (30.0, 40.0, 50.0):
        yield Setting("superelement", 2e-4, length=length, members=32)
        yield Setting("superelement", 5e-5, length=length)
        yield from (Setting("imex32", 2e-4, nodes, length, members=32) for nodes in (4, 8, 16))
    yield Setting("imex32", CONVERGED_STEP, CONVERGED_NODES, length=30.0, members=32)


def converged(length: float, stiffness: float, members: int = 8) -> Setting:
    """The reference of a length [m] and contact stiffness [N/m]."""
    return Setting("imex", CONVERGED_STEP, CONVERGED_NODES, length, stiffness, members=members)


SETTINGS = tuple(dict.fromkeys(_settings()))


def _statistics(window: Window, member: int) -> dict[str, float]:
    """``STATISTICS`` and ``PEAK`` (NaN for one at rest) of one run of a batch; the window must hold the samples."""
    assert window.axial is not None
    peaks = dominant_frequencies(window.axial[:, member], SAMPLE_PERIOD, 1)
    values = {name: float(window.statistics[name][member]) for name in STATISTICS}
    return values | {PEAK: peaks[0] if peaks else float("nan")}
