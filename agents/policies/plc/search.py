"""The law's ten constants: CMA-ES on the vibration map, then in simulation on training tubes, where noise is noise.

The map's part takes minutes and is the same each time, so what is interrupted begins again; simulated insertions are
kept and not played again.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from cmaes import CMA
from tqdm import tqdm

from agents.policies.places import Place, place_of
from agents.policies.plc.law import Constants, PlcLaw
from agents.policies.plc.quasi_steady import quasi_steady_rewards
from agents.processes.workers import Workers
from agents.records.provenance import commit, provenance, write_atomically, write_json
from agents.rollouts.plan import Plan, run_plan
from probe_env.arrays import FloatArray
from probe_env.envs.contexts import SPLIT_SIZES
from probe_env.envs.vibration_map import VibrationMap
from probe_env.fidelity import resolve_fidelity

RANGES: Final[dict[str, tuple[float, float]]] = {
    "average": (3.0, 40.0), "onset_length": (10.0, 60.0), "onset_friction": (0.0, 3.0), "onset_diameter": (0.0, 3.0),
    "slow_feed": (0.05, 0.4), "slow_length": (0.0, 2.0), "slow_friction": (0.0, 2.0), "slow_diameter": (0.0, 2.0),
    "quiet": (1e-6, 2e-4), "shift": (0.0, 0.6),
}  # fmt: skip
"""Where each constant is looked for; those of a magnitude by their logarithm."""
LOGARITHMIC: Final = ("average", "onset_length", "slow_feed", "quiet")
POPULATION: Final = 10
WIDE, NEAR = 0.2, 0.05
"""First spread of a search, as a share of the ranges: on the map, and in simulation around what the map gave."""


def constants_at(x: FloatArray) -> Constants:
    """Of a point (10,) in the unit cube."""
    values = {}
    for share, (name, (low, high)) in zip(x, RANGES.items(), strict=True):
        values[name] = low * (high / low) ** share if name in LOGARITHMIC else low + share * (high - low)
    return Constants.model_validate({name: float(f"{value:.4g}") for name, value in values.items()})


def point_of(constants: Constants) -> FloatArray:
    """The inverse of ``constants_at``, within the cube."""
    shares = []
    for name, (low, high) in RANGES.items():
        value = getattr(constants, name)
        linear = (value - low) / (high - low)
        shares.append(np.log(value / low) / np.log(high / low) if name in LOGARITHMIC else linear)
    return np.asarray(np.clip(shares, 0.0, 1.0))


def run_law_search(
    trials: int, generations: int, limit: int, output: Path, workers: Workers, vibration: VibrationMap
) -> Constants:
    """Find the constants; writes plc-law.json and plc-law-trials.csv.

    Args:
        trials: laws tried on the map, on all training tubes.
        generations: of ``POPULATION`` laws each that are simulated after that.
        limit: training tubes of the simulation, the first, which are balanced.
        output: folder; ``output/episodes`` keeps what was simulated.
        workers: that simulate.
        vibration: the map.
    """
    if not 0 < limit <= SPLIT_SIZES["train"]:
        raise ValueError(f"limit = {limit!r} is outside the accepted range 1 to {SPLIT_SIZES['train']}")
    whole, place = place_of(None, "train", 0, vibration), place_of(None, "train", limit, vibration)
    config = whole.config.all_shown
    rows: list[dict[str, object]] = []

    def by_map(laws: list[Constants]) -> list[float]:
        by_law = [quasi_steady_rewards(PlcLaw(config, law), whole.contexts, vibration) for law in laws]
        return [float(rewards.mean()) for rewards in by_law]

    best = _searched(by_map, point_of(Constants()), WIDE, max(trials // POPULATION, 1), ("map", rows))
    simulated = _Simulated(place, output / "episodes", workers)
    best = _searched(simulated, point_of(best), NEAR, generations, ("simulated", rows)) if generations else best
    table = pd.DataFrame(rows)
    write_atomically(output / "plc-law-trials.csv", table.to_csv(index=False, float_format="%.6g"))
    rewards = {where: float(table[table["where"] == where]["reward"].max()) for where in dict.fromkeys(table["where"])}
    record = {
        "constants": best.model_dump(),
        "rewards": rewards,
        "tubes": {"map": len(whole.contexts), "simulated": limit},
    }
    write_json(output / "plc-law.json", record | {"provenance": provenance(commits=simulated.commits)})
    return best


class _Simulated:
    """Mean rewards of laws on some tubes, by simulation; episodes are kept."""

    def __init__(self, place: Place, folder: Path, workers: Workers) -> None:
        self.place, self.folder, self.workers, self.done = place, folder, workers, 0
        self.commits = [commit()]  # of the laws tried on the map, which are tried anew each time

    def __call__(self, laws: list[Constants]) -> list[float]:
        config = self.place.config.all_shown
        policies = {f"law-{self.done + k}": PlcLaw(config, law) for k, law in enumerate(laws)}
        plan = Plan(policies, self.place.contexts, config=config, fidelity=resolve_fidelity("fast"))
        table = run_plan(plan, self.folder / f"{self.done:04d}", progress=False, workers=self.workers)
        self.done += len(laws)
        self.commits += list(table["commit"])
        means = table.groupby("policy")["reward"].mean()
        return [float(means[name]) for name in policies]


def _searched(
    reward: Callable[[list[Constants]], list[float]],
    start: FloatArray,
    spread: float,
    generations: int,
    record: tuple[str, list[dict[str, object]]],
) -> Constants:
    """The best that a CMA-ES around ``start`` tried; at its end the mean of the search is tried as well."""
    bounds = np.tile([0.0, 1.0], (len(start), 1))
    search = CMA(mean=start, sigma=spread, bounds=bounds, population_size=POPULATION, seed=0)
    where, rows = record
    best, most = constants_at(start), -np.inf
    for _ in tqdm(range(generations), desc=where, unit="generation"):
        points = [search.ask() for _ in range(POPULATION)]
        laws = [constants_at(point) for point in points]
        rewards = reward(laws)
        search.tell([(point, -value) for point, value in zip(points, rewards, strict=True)])
        for law, value in zip(laws, rewards, strict=True):
            rows.append({"where": where, "reward": value, **law.model_dump()})
            if value > most:
                best, most = law, value
    centre = constants_at(np.clip(search.mean, 0.0, 1.0))
    value = reward([centre])[0]
    rows.append({"where": where, "reward": value, **centre.model_dump()})
    return centre if value >= most else best
