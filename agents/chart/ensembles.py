"""The chaotic regime: statistics of ensembles at constant length, for every method, step, mesh and model choice.

Beyond about 30 m no two trajectories agree for long, so what is compared are the statistics of many runs that differ
by a start perturbation of 0.1 micrometre. All runs of one setting share a batch; a row is one run.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import pandas as pd
from tqdm import tqdm

from agents.records.code_hash import code_hash
from agents.records.store import Store
from agents.study.cases import PERTURBATION
from agents.terminal.work import Work, announce
from probe_env import Scene, SimulatorBatch, StabilityWarning, Window
from probe_env.physics.methods import METHODS
from probe_env.physics.simulation.signals import SAMPLE_PERIOD, dominant_frequencies

SETTLE, DURATION = 2.0, 6.0  # [s]
STATISTICS = (
    "radial_rms_m", "radial_p99_m", "lift_off_share", "axial_rms_m", "axial_mean_m",
    "radial_acceleration_rms_m_per_s2", "tension_mean_n",
)  # fmt: skip
PEAK = "axial_peak_hz"
COLUMNS = {"time_step": "time_step_s", "length": "carrier_length_m", "stiffness": "contact_stiffness_n_per_m"}
"""How fields with a unit are called in tables."""
CODE = ("agents.chart.ensembles:run_setting",)


@dataclass(frozen=True)
class Setting:
    """One way to simulate table 2's probe at a constant length, and what is changed of the scene itself."""

    method: str = "imex"
    time_step: float = 2e-4
    nodes_per_pitch: int = 4
    length: float = 50.0
    """Carrier length [m]."""
    stiffness: float = 1e5
    """Of the contact [N/m]."""
    friction: float = 0.15
    walls: str = "both"
    members: int = 16

    @property
    def scene(self) -> Scene:
        """What is simulated."""
        contact = {"stiffness": self.stiffness, "friction": self.friction, "walls": self.walls}
        return Scene.model_validate({"carrier_length": self.length, "contact": contact})

    @property
    def key(self) -> dict[str, Any]:
        """Everything but the number of members, as columns."""
        return {COLUMNS.get(name, name): value for name, value in asdict(self).items() if name != "members"}

    def batch(self, count: int, threads: int | None = None) -> SimulatorBatch:
        """So many runs of it, from slightly different starts."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", StabilityWarning)  # steps beyond the limit are the point
            return SimulatorBatch(
                [self.scene] * count, self.method, self.time_step, self.nodes_per_pitch,
                threads=threads, perturbation=PERTURBATION,
            )  # fmt: skip


LENGTHS = (10.0, 30.0, 50.0)  # [m]
STIFFNESSES = (1e4, 1e5, 1e6)  # [N/m]
REFERENCE_STEP = 2.5e-5  # [s], of imex
STEPS = (1e-4, 1.25e-4, 1e-3 / 7, 1e-3 / 6, 2e-4, 2.5e-4, 5e-4)  # whole parts of the sampling period
MODEL_STEP = 1e-4  # [s], at which model choices are compared with each other
CHOICES: dict[str, dict[str, Any]] = {
    "1 node a pitch": {"nodes_per_pitch": 1},
    "2 nodes a pitch": {"nodes_per_pitch": 2},
    "8 nodes a pitch": {"nodes_per_pitch": 8},
    "16 nodes a pitch": {"nodes_per_pitch": 16},
    "inner wall only": {"walls": "inner"},
    "contact half as stiff": {"stiffness": 5e4},
    "contact twice as stiff": {"stiffness": 2e5},
    "friction 0.14": {"friction": 0.14},
    "friction 0.16": {"friction": 0.16},
}
"""What is changed of table 2's mesh and model, one at a time."""
CONVERGED_STEP, CONVERGED_NODES = 5e-5, 16  # [s], of imex: the mesh and step that everything is measured against
CONVERGED_LENGTHS = {10.0: 8, 30.0: 48, 40.0: 32, 50.0: 32}
"""[m], with members of the converged reference at table 2's stiffness; others have 8."""
LENGTHS_OF_MESHES = (30.0, 40.0, 50.0)  # [m]
PIECE_STEPS = {
    1e4: (1e-4, 2e-4, 2.5e-4, 5e-4),
    1e5: (5e-5, 1e-4, 2e-4, 2.5e-4),
    1e6: (5e-5,),
}
"""[s], of the superelement, by contact stiffness [N/m]: as long as hold."""


def step_settings() -> Iterator[Setting]:
    """Every step on table 2's mesh: what the discretisation in time does. The slow methods' runs are the study's."""
    for stiffness in STIFFNESSES:
        members = 32 if stiffness == Setting.stiffness else 16
        for length in LENGTHS:
            for time_step in (REFERENCE_STEP, 5e-5, *STEPS):
                yield Setting(time_step=time_step, length=length, stiffness=stiffness, members=members)
            for time_step in (5e-5, *STEPS):
                yield Setting("imex32", time_step, length=length, stiffness=stiffness, members=members)
    for length in LENGTHS[1:]:
        yield Setting("implicit", MODEL_STEP, length=length, members=8)


def model_settings() -> Iterator[Setting]:
    """Mesh and model choices at one step of imex."""
    for length in LENGTHS[1:]:
        for change in CHOICES.values():
            yield Setting(**({"time_step": MODEL_STEP, "length": length} | change))


def converged_settings() -> Iterator[Setting]:
    """The converged mesh with a fine step, and what is compared with it; some of them are settings above as well."""
    for length, members in CONVERGED_LENGTHS.items():
        yield converged(length, Setting.stiffness, members)
        for time_step in PIECE_STEPS[Setting.stiffness]:
            many = length != 10.0 and time_step >= 1e-4  # steps among which a preset was chosen
            yield Setting("superelement32", time_step, length=length, members=128 if many else 16)
    for stiffness in (1e4, 1e6):
        for length in LENGTHS:
            yield converged(length, stiffness)
            for time_step in PIECE_STEPS[stiffness]:
                yield Setting("superelement32", time_step, length=length, stiffness=stiffness)
    for length in LENGTHS_OF_MESHES:
        yield Setting("superelement", 2e-4, length=length, members=32)
        yield Setting("superelement", 5e-5, length=length)
        for nodes in (4, 8, 16):
            yield Setting("imex32", 2e-4, nodes, length, members=32)
    yield Setting("imex32", CONVERGED_STEP, CONVERGED_NODES, length=30.0, members=32)


def converged(length: float, stiffness: float, members: int = 8) -> Setting:
    """The reference for the errors of mesh and step together."""
    return Setting("imex", CONVERGED_STEP, CONVERGED_NODES, length, stiffness, members=members)


def run_setting(setting: Setting) -> list[dict[str, Any]]:
    """A row a member: its statistics, none where it diverged."""
    batch = setting.batch(setting.members)
    batch.advance(None, None, SETTLE, SAMPLE_PERIOD)
    window = batch.advance(None, None, DURATION, SAMPLE_PERIOD, keep_samples=True)
    rows = []
    for member in range(setting.members):
        row: dict[str, Any] = setting.key | {"member": member, "diverged": bool(window.diverged[member])}
        rows.append(row | ({} if window.diverged[member] else member_statistics(window, member)))
    return rows


def member_statistics(window: Window, member: int) -> dict[str, float]:
    """``STATISTICS`` and ``PEAK`` (NaN for one at rest) of one run of a batch; the window must hold the samples."""
    assert window.axial is not None
    peaks = dominant_frequencies(window.axial[:, member], SAMPLE_PERIOD, 1)
    values = {name: float(window.statistics[name][member]) for name in STATISTICS}
    return values | {PEAK: peaks[0] if peaks else float("nan")}


def run_ensembles(output: Path) -> pd.DataFrame:
    """All settings that are not stored yet, cheapest first; a row a member in ensembles.csv."""
    store = open_store(output)
    settings = tuple(dict.fromkeys((*step_settings(), *model_settings(), *converged_settings())))

    def stored(setting: Setting) -> bool:
        return store.has(*setting.key.values(), setting.members - 1)

    todo = [setting for setting in settings if not stored(setting)]
    todo.sort(key=_work)
    announce(Work("setting", len(settings), lambda: sum(map(stored, settings)), store.path))
    with tqdm(total=sum(map(_work, todo)), desc="chaos", unit="Gnode-step", unit_scale=1e-9, disable=not todo) as bar:
        for setting in todo:
            store.add(*run_setting(setting))
            bar.update(_work(setting))
    return store.table


def open_store(output: Path) -> Store:
    """The stored runs."""
    return Store(output / "ensembles.csv", (*Setting().key, "member"), lambda row: code_hash(CODE, row["method"]))


def _work(setting: Setting) -> float:
    """Node-steps of all members, weighted by what a method's cost: four lanes as one, without lanes some thirty."""
    method = METHODS[setting.method]
    weight = 4.0 / method.width if method.lanes else 30.0
    nodes = (setting.length + 2.5) / 0.1 * setting.nodes_per_pitch
    return weight * nodes * (SETTLE + DURATION) / setting.time_step * setting.members
