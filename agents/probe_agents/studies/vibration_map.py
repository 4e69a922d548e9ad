"""Fits the vibration map of a plant, a small network, to insertions with random feed and air."""

import sys
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import ClassVar, Final

import numpy as np
import pandas as pd

from probe_agents.evaluation.folder import PROFILE
from probe_agents.evaluation.plan import Plan, run_plan
from probe_agents.evaluation.workers import HERE, Workers
from probe_agents.policies.cases import plant_at
from probe_agents.policies.fixed import FixedPolicy
from probe_agents.records.atomic import write_atomically
from probe_agents.records.manifest import origin, write_json
from probe_agents.records.shipped import file_or_shipped, ships
from probe_agents.records.tables import read_parquet
from probe_agents.terminal.tables import print_line
from probe_env import Scene, load_contexts
from probe_env.arrays import FloatArray
from probe_env.envs.contexts import SPLIT_SIZES
from probe_env.envs.plants import map_file
from probe_env.envs.task.config import TaskConfig
from probe_env.envs.task.scales import value_at
from probe_env.envs.vibration_map import CONTEXT, PROFILED, VibrationMap, features_of, feeds, rms_limit
from probe_env.fidelity import resolve_fidelity
from probe_env.files import escaped

SEGMENT: Final = {"displacement": 3.0, "snr": 6.0}
"""Vibration measure -> length of constant feed and air [m]; "snr" is a running mean over 1.2 s, up to 1.9 m."""
SMEARED: Final = {"displacement": 0.0, "snr": 3.0}
"""Vibration measure -> first part of a segment that is not fitted, as it depends on the segment before [m]."""
EPOCHS, BATCH, HIDDEN = 300, 512, 64
HELD_OUT: Final = 12
"""Number of test tubes, the first of the training list: two of each helix diameter."""
MIN_SPREAD: Final = 0.05
"""Minimum standard deviation of an input, for inputs that do not vary."""


@dataclass
class Wandering(FixedPolicy):
    """Exploration: random feed and air for each ``SEGMENT``, seeded by the first noise of the episode."""

    seed: int = 0
    memory: ClassVar[int] = 1

    def targets(self, measured: dict[str, FloatArray], memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Feed is uniform in its logarithm, air is uniform. Memory: the first noise."""
        memory[:, 0] = np.where(memory[:, 0] > 0.0, memory[:, 0], measured["rf_noise"])
        fractions, segment = np.empty((2, len(memory))), SEGMENT[self.config.vibration_measure]
        for k, (first, length) in enumerate(zip(memory[:, 0], measured["inserted_length"], strict=True)):
            entropy = [self.seed, int(np.float64(first).view(np.uint64)), int(length / segment)]
            fractions[:, k] = np.random.default_rng(entropy).uniform(size=2)
        slow, fast = feeds(self.config)[0], self.config.feed_speeds[1]
        feed = slow * (fast / slow) ** fractions[0]
        return feed, value_at(fractions[1], self.config.air_supply_rates)


def fit_map(
    profile: pd.DataFrame, seed: int = 0, scene: Scene | None = None, measure: str = "displacement"
) -> tuple[VibrationMap, dict[str, float]]:
    """Fit the map to all tubes but the first ``HELD_OUT``, and test it on those.

    Args:
        profile: metres of episodes, with columns ``PROFILE_COLUMNS``, ``CONTEXT`` and ``context``.
        seed: seed of the network.
        scene: scene of a custom plant; default: table 2's.
        measure: vibration measure, one of ``PROFILED``.

    Returns:
        the map; explained variance of log10 rms and mean absolute error [decades] on the held-out tubes.
    """
    import torch

    torch.set_num_threads(1)  # the network is too small for threads
    profile = profile[profile["inserted_length"] % SEGMENT[measure] >= SMEARED[measure]]
    length, feed, air = (profile[n].to_numpy(float) for n in ("inserted_length", "feed_speed", "air_supply_rate"))
    tubes = profile[list(CONTEXT)].to_numpy(float)
    inputs, scaling = features_of(length, feed, air, tubes), None
    if scene is not None:
        scaling = np.array([inputs.mean(axis=0), np.maximum(inputs.std(axis=0), MIN_SPREAD)])
        inputs = (inputs - scaling[0]) / scaling[1]
    logarithm = np.log10(np.maximum(profile[PROFILED[measure]].to_numpy(float), 1e-7) / 1e-4)
    held_out = profile["context"].to_numpy() < HELD_OUT
    layers = tuple(fit_network(inputs[~held_out], logarithm[~held_out, None], seed, EPOCHS, BATCH, (-5.0, 1.0)))
    fitted = VibrationMap(layers)
    if scene is not None:
        fitted = VibrationMap(layers, scene, np.array([tubes.min(axis=0), tubes.max(axis=0)]), scaling, "", measure)
    error = fitted.distribution(inputs[held_out])[0] - logarithm[held_out]
    explained = 1.0 - float((error**2).mean() / logarithm[held_out].var())
    return fitted, {"explained_variance": explained, "mean_absolute_error_decades": float(np.abs(error).mean())}


def fit_network(
    x: FloatArray, y: FloatArray, seed: int, epochs: int, batch: int, clamp: tuple[float, float]
) -> list[tuple[FloatArray, FloatArray]]:
    """Fit a small network for mean and standard deviation of normal targets by maximum likelihood.

    Weights (in, out) and biases (out,) of three layers, tanh between them, for scaled inputs (n, d), targets (n, t).

    The outputs are t means and t logarithms of standard deviations, clamped to ``clamp`` in the loss.
    """
    import torch

    torch.manual_seed(seed)
    inputs, targets = (torch.tensor(values, dtype=torch.float32) for values in (x, y))
    network = torch.nn.Sequential(
        torch.nn.Linear(inputs.shape[1], HIDDEN), torch.nn.Tanh(),
        torch.nn.Linear(HIDDEN, HIDDEN), torch.nn.Tanh(),
        torch.nn.Linear(HIDDEN, 2 * targets.shape[1]),
    )  # fmt: skip
    steps = epochs * max(len(inputs) // batch, 1)
    optimiser = torch.optim.AdamW(network.parameters(), lr=3e-3, weight_decay=1e-3)
    pace = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    for _ in range(steps):
        chosen = torch.randint(len(inputs), (batch,))
        mean, spread = network(inputs[chosen]).chunk(2, dim=1)
        loss = torch.nn.functional.gaussian_nll_loss(mean, targets[chosen], torch.exp(2.0 * spread.clamp(*clamp)))
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        pace.step()
    parts = [layer for layer in network if isinstance(layer, torch.nn.Linear)]
    return [(p.weight.detach().numpy().T.astype(np.float32).copy(), p.bias.detach().numpy().copy()) for p in parts]


def run(output: Path, trials: int = 2, tube: Path | None = None, workers: Workers = HERE) -> Path:
    """Simulate ``trials`` insertions in each training tube (resumable), fit the map, store it in ``target_of``."""
    import_module("torch")  # fails before half an hour of simulation

    seeds, target, plant = range(trials), target_of(output, tube), plant_at(tube)
    changes = {"lost_drive_periods": 1000}  # continue without drive
    config = TaskConfig().model_copy(update=changes) if plant is None else plant.configured(changes=changes)
    rms_limit(config)  # fails for a measure without a map
    contexts = load_contexts("train") if plant is None else plant.contexts(SPLIT_SIZES["train"])
    fast = resolve_fidelity("fast", config.scene)
    plan = Plan({"wandering": Wandering(config)}, contexts, seeds, config, fast)
    episodes = run_plan(plan, output, workers=workers)
    profile = read_parquet(output / "profile.parquet", PROFILE)
    tubes = pd.DataFrame([tube.model_dump() for tube in contexts])[list(CONTEXT)]
    profile[list(CONTEXT)] = tubes.to_numpy()[profile["context"]]
    fitted, quality = fit_map(profile, scene=plant.scene if plant else None, measure=config.vibration_measure)
    write_atomically(target, fitted.to_bytes())
    setting = {"contexts": "train", "episodes": len(episodes), "held_out_tubes": HELD_OUT}
    write_json(target.with_suffix(".json"), origin(commits=episodes["commit"]) | setting | quality)
    print(f"map of {len(episodes)} insertions: explained variance of log rms {quality['explained_variance']:.3f}")
    print_line(f"written: {target}")
    return target


def target_of(output: Path, tube: Path | None) -> Path:
    """File of the map: NAME-map.npz next to a custom tube, in the output folder for a shipped one."""
    target = output / "vibration-map.npz"
    if tube is None:
        return target
    if not ships("tubes", file_or_shipped("tubes", tube)):
        return map_file(tube)
    print(escaped(f"probe-env: note: {tube} is shipped with its map; the new map is {target}"), file=sys.stderr)
    return target
