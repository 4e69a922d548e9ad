"""Plants of other bores and lengths: is a policy that decides for itself ever worse than the best fixed schedule?"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any, Final

import pandas as pd

from agents.evaluation.plan import Plan, run_plan
from agents.evaluation.statistics import paired_difference
from agents.plant.recommendation import LAW, NAME, recommended, recommended_law
from agents.plant.response import stored_response
from agents.policies.catalogue import named_policies
from agents.policies.fixed import Scheduled
from agents.policies.law import Lawful
from agents.policies.places import place_of
from agents.policies.policy import OutsideDomain
from agents.processes.workers import Workers
from agents.records.provenance import provenance, write_atomically, write_json
from agents.terminal.tables import print_table
from probe_env import Plant
from probe_env.envs.plants.tables import Between, Supply, Tubes, Walls
from probe_env.fidelity import resolve_fidelity

BORES, LENGTHS, DIAMETERS = (22e-3, 24.2e-3, 26e-3), (40.0, 80.0), (1.0, 1.4, 2.0)  # [m]
FIXED: Final = NAME
"""The best fixed schedule for a plant, by the response."""
DECIDING: Final = (LAW, "tension-scheduled", "adaptive", "ppo")
OURS: Final = ("best-schedule", *DECIDING[1:])


def plants() -> dict[str, Plant]:
    """By bore and length; friction, stiffness and drag are not known exactly."""
    return {
        f"{1e3 * bore:g}-mm-{length:g}-m": Plant(
            tube=Tubes(inner_diameter=bore, helix_length=length, helix_diameter=DIAMETERS),
            contact=Walls(friction=Between(low=0.10, high=0.25), stiffness=Between(low=0.7e5, high=1.4e5)),
            air=Supply(drag_coefficient=Between(low=0.40, high=0.48)),
        )
        for bore in BORES
        for length in LENGTHS
    }


def run_study(limit: int, fidelity: str, output: Path, workers: Workers) -> pd.DataFrame:
    """Simulate the policies on tubes of every plant (resumable in ``output``), store and print the differences.

    Raises:
        ValueError: the limit is out of range.
    """
    episodes, rows = [], []
    for name, plant in plants().items():
        table = _episodes(plant, limit, fidelity, output / name, workers)
        episodes.append(table.assign(plant=name))
        for policy in (*DECIDING, "best-schedule"):
            gain = paired_difference(table, policy, FIXED, "reward")
            rows.append({"plant": name, "policy": policy, "gain": gain.mean, "low": gain.low, "high": gain.high})
    every = pd.concat(episodes)
    write_atomically(output / "episodes.csv", every.to_csv(index=False, float_format="%.6g"))
    summary = pd.DataFrame(rows)
    write_atomically(output / "gains.csv", summary.to_csv(index=False, float_format="%.4g"))
    write_json(output / "provenance.json", provenance(commits=every["commit"]) | {"limit": limit, "fidelity": fidelity})
    print_table(f"Reward over that of the best fixed schedule, {limit} tubes a plant", HEADER, cells(summary))
    return summary


HEADER: Final = ("plant", *DECIDING, "best-schedule")


def cells(summary: pd.DataFrame) -> list[tuple[Any, ...]]:
    """A row a plant: the gains with their 95 % intervals."""
    rows = []
    for plant, part in summary.groupby("plant", sort=False):
        gains = {row.policy: f"{row.gain:+.1f} [{row.low:.1f}, {row.high:.1f}]" for row in part.itertuples()}
        rows.append((plant, *(gains[policy] for policy in HEADER[1:])))
    return rows


def _episodes(plant: Plant, limit: int, fidelity: str, folder: Path, workers: Workers) -> pd.DataFrame:
    """All episodes of a plant; what is recommended for it goes by draws that are not simulated."""
    seen, unseen = place_of(plant, "train"), place_of(plant, "test", limit)
    config, response = unseen.config.all_shown, stored_response()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", OutsideDomain)
        policies = named_policies(OURS, config, unseen.vibration)
    policies[FIXED] = Scheduled(config, recommended(seen.contexts, response, seen.config).schedule)
    policies[LAW] = Lawful(config, law=recommended_law(seen.contexts, response, seen.config))
    plan = Plan(policies, unseen.contexts, config=config, fidelity=resolve_fidelity(fidelity, config.scene))
    return run_plan(plan, folder, workers=workers)
