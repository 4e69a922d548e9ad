"""The study's scenes as an ensemble: perturbed members of every case, run two at a time, resumable.

Beyond about 30 m the motion is chaotic, so a claim is judged on the statistics of several members that
differ by a start perturbation of 0.1 micrometre, never on one trajectory. Member 0 is the study's start.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from agents.records.code_hash import code_hash
from agents.records.store import Store
from agents.study.members import KEYS, load_members, run_members
from probe_env import Scene, SimulationError, Simulator, StabilityWarning
from probe_env.physics.simulation.signals import point_statistics

PERTURBATION = 1e-7  # [m]; a float rests a few micrometres deep in its contact spring
DURATION = 8.0  # [s] of the published runs
CODE = ("agents.study.cases:run_case",)


@dataclass(frozen=True)
class Case:
    """One scene file with the method that runs it; statistics are taken from ``statistics_from`` [s] on."""

    name: str
    scene: str
    method: str = "newmark"
    time_step: float = 1e-4
    walls: str = "both"
    settles: bool = False  # statistics of the last third only
    root_offset: int = 0  # nodes between the root and the place of a float


CASES = (
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
    Case("l30-imex", "fig11_l30", method="imex", time_step=2e-4),
    Case("l50-imex", "fig11_l50", method="imex", time_step=2e-4),
    Case("l30-imex32", "fig11_l30", method="imex32", time_step=2e-4),
    Case("l50-imex32", "fig11_l50", method="imex32", time_step=2e-4),
    *(Case(f"l{length}-explicit", f"fig11_l{length}", method="explicit", time_step=5e-6) for length in (30, 50)),
    *(Case(f"l{length}-implicit", f"fig11_l{length}", method="implicit", time_step=2.5e-5) for length in (30, 50)),
    Case("l30-offset", "fig11_l30", root_offset=2),
    Case("l30-imex-offset", "fig11_l30", method="imex", time_step=2e-4, root_offset=2),
)
SUBSET = ("l10", "l30", "l50", "u0", "improved")


def run_case(case: Case, scenes: Path, member: int, duration: float) -> dict[str, object]:
    """One member of a case as a row: statistics of the sensor, tip and root, or the time it diverged."""
    scene = Scene.from_toml(scenes / f"{case.scene}.toml").model_copy(update={"contact": {"walls": case.walls}})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", StabilityWarning)  # cases beyond the limit are there on purpose
        simulator = Simulator(
            scene,
            case.method,
            case.time_step,
            growing=case.root_offset > 0,
            perturbation=PERTURBATION if member else 0.0,
            seed=member,
        )
    simulator.move_root(case.root_offset)  # a chain that could grow has the nodes; it keeps its length
    simulator.hold_length()
    row: dict[str, object] = {
        "case": case.name,
        "member": member,
        "duration_s": duration,
        "diverged_at_s": float("nan"),
    }
    try:
        run = simulator.advance(duration=duration, points=("sensor", "tip", "root"))
    except SimulationError as error:
        return row | {"diverged_at_s": error.time}
    start = duration * (2.0 / 3.0 if case.settles else 0.25)
    row |= point_statistics(run, "sensor", start)
    row["tip_radial_max_m"] = float(run.radial[:, run.column("tip")].max())  # the start's swing included
    row["root_tension_mean_n"] = point_statistics(run, "root", start)["tension_mean_n"]
    return row


def run_study(
    scenes: Path, output: Path, members: int, duration: float, names: tuple[str, ...] = (), jobs: int = 2
) -> pd.DataFrame:
    """All members of the named cases (default: all), stored in ``output``/ensemble.csv as they finish.

    Rows that are stored already, for the same duration and code, are not run again.
    """
    chosen = [case for case in CASES if not names or case.name in names]
    store = open_store(output)
    for case in chosen:
        code_hash(CODE, case.method)  # here, and not in the threads
    wanted = [(case, member) for member in range(members) for case in chosen]
    return run_members(wanted, lambda case, member: run_case(case, scenes, member, duration), store, duration, jobs)


def open_store(output: Path) -> Store:
    """The stored runs."""
    methods = {case.name: case.method for case in CASES}
    return Store(output / "ensemble.csv", KEYS, lambda row: code_hash(CODE, methods.get(row["case"])))


def load_rows(output: Path, duration: float = DURATION) -> pd.DataFrame:
    """Stored rows of a duration [s]; none if there is no file."""
    return load_members(output / "ensemble.csv", duration)
