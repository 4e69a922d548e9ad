"""What the root's place in a pitch does to the vibration, as an ensemble: held at its places, and growing past them.

The floats lie every pitch from the tip, so the root lies at a float's place only when the inserted length is a whole
number of pitches (docs/simulation/root.md).
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import pandas as pd
from tqdm import tqdm

from agents.records.code_hash import code_hash
from agents.records.store import Store
from agents.study.cases import DURATION, PERTURBATION
from agents.study.members import KEYS, load_members
from agents.terminal.work import Work, announce
from probe_env import Scene
from probe_env.physics.simulation.batch import SimulatorBatch

CODE: Final = ("agents.study.roots:run_root",)
SCENE: Final = "fig11_l30"
"""Table 2's probe; each case has a length of its own."""
SETTLING: Final = 0.25
"""Share of a run that is left out of its statistics."""
KEPT: Final = (
    "radial_rms_m", "axial_rms_m", "radial_acceleration_rms_m_per_s2", "lift_off_share", "tension_mean_n",
)  # fmt: skip


@dataclass(frozen=True)
class Root:
    """A probe whose root lies somewhere between two places of floats.

    Attributes:
        carrier_length: to the last float's place at or before the root; of a growing one, its mean [m].
        place: of the root beyond it, as a share of the pitch; 1 is the place of the next float.
        method: of the simulation.
        time_step: [s].
        nodes_per_pitch: places in a pitch that the root can have.
        grows: fed in with the scene's speed instead of held, so that the root passes all places.
    """

    carrier_length: int
    place: float = 0.0
    method: str = "superelement32"
    time_step: float = 2e-4
    nodes_per_pitch: int = 4
    grows: bool = False

    @property
    def name(self) -> str:
        """Of its rows."""
        place = "grows" if self.grows else f"{self.place:g}"
        return f"l{self.carrier_length}-{self.method}-{self.time_step:g}-{self.nodes_per_pitch}-{place}"


PLACES: Final = (0.0, 0.25, 0.5, 0.75, 1.0)
LENGTHS: Final = (10, 20, 30, 40, 50)
MESHES: Final = (("superelement32", 4), ("imex32", 4), ("imex32", 8), ("imex32", 16))
FINE_STEP: Final = 5e-5
NEAR: Final = (0.0, 0.0625, 0.125, 0.25, 0.5, 0.75, 0.875, 0.9375)
"""Places that sixteen nodes have, close to a float's."""
HELD: Final = tuple(Root(length, place) for length in LENGTHS for place in PLACES)
GROWING: Final = tuple(Root(length, grows=True) for length in LENGTHS)
ON_MESHES: Final = tuple(
    Root(30, place, method, FINE_STEP, nodes) for (method, nodes), place in itertools.product(MESHES, (0.0, 0.5))
)
CLOSE: Final = tuple(Root(10, place, "imex32", 1e-4, 16) for place in NEAR)
CASES: Final = (*HELD, *GROWING, *ON_MESHES, *CLOSE)
SUBSET: Final = tuple(case.name for case in (*HELD, *GROWING) if case.carrier_length == 10)


def run_root(
    case: Root, scenes: Path, members: tuple[int, ...], duration: float, threads: int = 1
) -> list[dict[str, object]]:
    """Members of a case as rows: statistics of the sensor after ``SETTLING``, or the time when it diverged.

    A member has the same digits whatever others run beside it.
    """
    scene = Scene.from_toml(scenes / f"{SCENE}.toml")
    before = round(SETTLING * duration, 2)
    half_way = before + 0.5 * (duration - before)
    ahead = scene.feed_speed * half_way if case.grows else 0.0
    pitch = scene.probe.float_pitch
    start = round((case.carrier_length - ahead) / pitch) * pitch  # where it will be half-way through the statistics
    batch = SimulatorBatch(
        [scene.model_copy(update={"carrier_length": start})] * len(members), case.method, case.time_step,
        case.nodes_per_pitch, threads=threads, seeds=members, growing=True, perturbation=PERTURBATION,
    )  # fmt: skip
    for simulator in batch.simulators:
        if not case.grows:
            simulator.move_root(round(case.place * case.nodes_per_pitch))  # a chain that could grow has the nodes
            simulator.hold_length()
    batch.advance(duration=before)
    window = batch.advance(duration=duration - before)
    rows: list[dict[str, object]] = []
    for k, member in enumerate(members):
        lost = bool(window.diverged[k])
        row: dict[str, object] = {"case": case.name, "member": member, "duration_s": duration}
        row["diverged_at_s"] = batch.simulators[k].time if lost else float("nan")
        row |= {name: float("nan") if lost else float(window.statistics[name][k]) for name in KEPT}
        rows.append(row)
    return rows


def run_roots(
    scenes: Path, output: Path, members: int, duration: float, names: tuple[str, ...] = (), jobs: int = 2
) -> pd.DataFrame:
    """Members 1, ..., ``members`` of the named cases (default: all), stored in ``output``/root.csv as they finish.

    Rows that are stored already, for the same duration and code, are not run again.
    """
    chosen = [case for case in CASES if not names or case.name in names]
    store = open_store(output)
    numbers = range(1, members + 1)
    wanted = [(case.name, member, duration) for case in chosen for member in numbers]
    announce(Work("run", len(wanted), lambda: sum(store.has(*key) for key in wanted), store.path))
    for case in tqdm(chosen, desc="study", unit="case"):
        missing = tuple(member for member in numbers if not store.has(case.name, member, duration))
        if missing:
            store.add(*run_root(case, scenes, missing, duration, jobs))
    return load_rows(output, duration)


def open_store(output: Path) -> Store:
    """The stored runs."""
    methods = {case.name: case.method for case in CASES}
    return Store(output / "root.csv", KEYS, lambda row: code_hash(CODE, methods.get(row["case"])))


def load_rows(output: Path, duration: float = DURATION) -> pd.DataFrame:
    """Stored rows of a duration [s]; none if there is no file."""
    return load_members(output / "root.csv", duration)
