"""Makes the vibration map of some tubes: wandering insertions, and a small network fitted to their metres."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import ClassVar, Final

import numpy as np
import pandas as pd

from agents.evaluation.folder import PROFILE, PROFILE_HEARD
from agents.evaluation.plan import Plan, run_plan
from agents.policies.cases import plant_at
from agents.policies.fixed import FixedPolicy
from agents.records.atomic import write_atomically
from agents.records.manifest import origin, write_json
from agents.records.shipped import file_or_shipped, ships
from agents.records.tables import read_parquet
from agents.studies.builtin import Request
from agents.studies.shipped.network import fit_network
from probe_env import Scene, load_contexts
from probe_env.arrays import FloatArray
from probe_env.envs.contexts import SPLIT_SIZES
from probe_env.envs.plants import map_beside
from probe_env.envs.task import TaskConfig, value_at
from probe_env.envs.vibration_map import CONTEXT, PROFILED, VibrationMap, features_of, feeds, rms_limit
from probe_env.fidelity import resolve_fidelity

SEGMENT: Final = {"displacement": 3.0, "snr": 6.0}
"""[m] of constant feed and air, by the vibration measure: the noise in a flaw's band is a running mean of 1.2 s of
the motion, which at 0.4 m/s and a time-lapse of 4 are 1.9 m,"""
SMEARED: Final = {"displacement": 0.0, "snr": 3.0}
"""[m] of each segment that are not fitted: they still hear the one before."""
EPOCHS, BATCH = 300, 512
SEEDS: Final = 2
"""Insertions on each of the 96 tubes."""
HELD_OUT: Final = 12
"""Tubes, the first of the training list, on which the map is tested and not fitted: two of each helix diameter."""
LEAST_SPREAD: Final = 0.05
"""Of an input over a plant's insertions: one that does not vary there stays near its centre."""


@dataclass
class Wandering(FixedPolicy):
    """Feed and air held for a ``SEGMENT``, then drawn anew: to explore. An episode's own noise seeds its draws."""

    seed: int = 0
    memory: ClassVar[int] = 1

    def targets(self, seen: dict[str, FloatArray], memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Feed is uniform in its logarithm, air in itself. Memory: the first noise that was measured."""
        memory[:, 0] = np.where(memory[:, 0] > 0.0, memory[:, 0], seen["rf_noise"])
        shares, segment = np.empty((2, len(memory))), SEGMENT[self.config.vibration_measure]
        for k, (first, length) in enumerate(zip(memory[:, 0], seen["inserted_length"], strict=True)):
            entropy = [self.seed, int(np.float64(first).view(np.uint64)), int(length / segment)]
            shares[:, k] = np.random.default_rng(entropy).uniform(size=2)
        slow, fast = feeds(self.config)
        feed = slow * (fast / slow) ** shares[0]
        return feed, value_at(shares[1], self.config.air_supply_rates)


def fit_map(
    profile: pd.DataFrame, seed: int = 0, scene: Scene | None = None, measure: str = "displacement"
) -> tuple[VibrationMap, dict[str, float]]:
    """Fit by the likelihood of the metres on all but the first ``HELD_OUT`` tubes, and say how well it tells those.

    Args:
        profile: metres of episodes, with columns of ``evaluate.CARRIED``, ``CONTEXT`` and ``context``.
        seed: of the network's start.
        scene: of a custom plant; default: table 2's.
        measure: of vibration, one of ``PROFILED``.

    Returns:
        the map; explained variance of log10 rms and mean absolute error [decades] on the held-out tubes.
    """
    import torch

    torch.set_num_threads(1)  # a small network: threads would wait for each other
    profile = profile[profile["inserted_length"] % SEGMENT[measure] >= SMEARED[measure]]
    length, feed, air = (profile[n].to_numpy(float) for n in ("inserted_length", "feed_speed", "air_supply_rate"))
    tubes = profile[list(CONTEXT)].to_numpy(float)
    inputs, scaling = features_of(length, feed, air, tubes), None
    if scene is not None:
        scaling = np.array([inputs.mean(axis=0), np.maximum(inputs.std(axis=0), LEAST_SPREAD)])
        inputs = (inputs - scaling[0]) / scaling[1]
    logarithm = np.log10(np.maximum(profile[PROFILED[measure]].to_numpy(float), 1e-7) / 1e-4)
    held = profile["context"].to_numpy() < HELD_OUT
    layers = tuple(fit_network(inputs[~held], logarithm[~held, None], seed, EPOCHS, BATCH, (-5.0, 1.0)))
    fitted = VibrationMap(layers)
    if scene is not None:
        fitted = VibrationMap(layers, scene, np.array([tubes.min(axis=0), tubes.max(axis=0)]), scaling, "", measure)
    error = fitted.distribution(inputs[held])[0] - logarithm[held]
    explained = 1.0 - float((error**2).mean() / logarithm[held].var())
    return fitted, {"explained_variance": explained, "mean_absolute_error_decades": float(np.abs(error).mean())}


def run(request: Request) -> Path:
    """Wander on training tubes (resumable), fit the map, store it in ``target_of``; ``trials``: insertions on each."""
    import_module("torch")  # for the fit, which comes after half an hour of simulation

    request.without("limit")
    seeds, target, plant = range(request.budget("trials", SEEDS, 100)), target_of(request), plant_at(request.tube)
    goes_on = {"lost_drive_periods": 1000}  # without drive: that is seen in the table
    config = TaskConfig().model_copy(update=goes_on) if plant is None else plant.configured(changes=goes_on)
    rms_limit(config)  # refuses a measure that no map tells of, before hours of work
    contexts = load_contexts("train") if plant is None else plant.contexts(SPLIT_SIZES["train"])
    fast = resolve_fidelity("fast", config.scene)
    plan = Plan({"wandering": Wandering(config)}, contexts, seeds, config, fast)
    episodes = run_plan(plan, request.output, workers=request.workers)
    profile = read_parquet(request.output / "profile.parquet", PROFILE, PROFILE_HEARD)
    tubes = pd.DataFrame([tube.model_dump() for tube in contexts])[list(CONTEXT)]
    profile[list(CONTEXT)] = tubes.to_numpy()[profile["context"]]
    fitted, quality = fit_map(profile, scene=plant.scene if plant else None, measure=config.vibration_measure)
    write_atomically(target, fitted.to_bytes())
    setting = {"contexts": "train", "episodes": len(plan.units()), "held_out_tubes": HELD_OUT}
    write_json(target.with_suffix(".json"), origin(commits=episodes["commit"]) | setting | quality)
    print(f"map of {len(plan.units())} insertions: {quality['explained_variance']:.3f} of the variance of log rms told")
    print(f"written: {target}")
    return target


def target_of(request: Request) -> Path:
    """File of the map: beside a tube of your own as NAME-map.npz, in the output folder for one that ships."""
    target = request.output / "vibration-map.npz"
    if request.tube is None:
        return target
    if not ships("tubes", file_or_shipped("tubes", request.tube)):
        return map_beside(request.tube)
    print(f"probe-env: note: {request.tube} ships, and its map stays: the new one is {target}", file=sys.stderr)
    return target
