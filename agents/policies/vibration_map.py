"""How loud the probe is: radial vibration over length, feed, air and tube, from wandering insertions on training tubes.

The probe answers within a second or two to a change of feed or air, so the vibration at a length depends on what is
fed and blown there. A small network fitted to that (the map) tells what any schedule would cost on any tube, so the
searches for schedules take seconds, and a controller that knows the tube can look up its best feed.
"""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np
import pandas as pd

from agents.policies.fixed import FixedPolicy
from agents.records.arrays import read_arrays
from agents.records.models import Quality
from agents.records.provenance import provenance, write_atomically, write_json
from agents.records.reading import FileError, read_json, read_parquet
from agents.records.tables import PROFILE
from agents.rollouts.plan import Plan, run_plan
from probe_env import Context, load_contexts
from probe_env.arrays import FloatArray
from probe_env.envs.task import TaskConfig, capped_square, metre_cost
from probe_env.fidelity import PRESETS

SEGMENT: Final = 3.0  # [m] of constant feed and air
FEEDS: Final = (0.04, 0.4)  # [m/s]; slower ones would take most of the time and ring least
CONTEXT: Final = ("friction", "contact_stiffness", "drag_factor", "helix_diameter")
HIDDEN, EPOCHS, BATCH = 64, 300, 512
HELD_OUT: Final = 12
"""Tubes, the first of the training list, on which the map is tested and not fitted: two of each helix diameter."""
STORED: Final = Path(__file__).parent / "data" / "vibration-map.npz"


@dataclass
class Wandering(FixedPolicy):
    """Feed and air held for ``SEGMENT``, then drawn anew: to explore. An episode's own noise seeds its draws."""

    seed: int = 0
    memory: ClassVar[int] = 1

    def targets(self, seen: dict[str, FloatArray], memory: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Feed is uniform in its logarithm, air in itself. Memory: the first noise that was measured."""
        memory[:, 0] = np.where(memory[:, 0] > 0.0, memory[:, 0], seen["rf_noise"])
        shares = np.empty((2, len(memory)))
        for k, (first, length) in enumerate(zip(memory[:, 0], seen["inserted_length"], strict=True)):
            entropy = [self.seed, int(np.float64(first).view(np.uint64)), int(length / SEGMENT)]
            shares[:, k] = np.random.default_rng(entropy).uniform(size=2)
        least, most = self.config.air_supply_rates
        feed = FEEDS[0] * (FEEDS[1] / FEEDS[0]) ** shares[0]
        return feed, least + shares[1] * (most - least)


@dataclass(frozen=True)
class VibrationMap:
    """Radial rms of a metre [m] as a log-normal distribution: mean and deviation of its decadic logarithm.

    Attributes:
        layers: weights (inputs, outputs) and biases (outputs,) of three layers, tanh between them.
    """

    layers: tuple[tuple[FloatArray, FloatArray], ...]

    def distribution(self, features: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean and standard deviation (n,) of log10(radial rms / 0.1 mm) at ``features`` (n, 7)."""
        values = features
        for weights, biases in self.layers[:-1]:
            values = np.tanh(values @ weights + biases)
        weights, biases = self.layers[-1]
        values = values @ weights + biases
        return values[:, 0], np.exp(np.clip(values[:, 1], -5.0, 1.0))

    @classmethod
    def load(cls, path: Path = STORED) -> VibrationMap:
        """Read a stored map (plain arrays only, no pickles).

        Raises:
            FileNotFoundError: no such file.
            FileError: not a map: other arrays, or shapes that do not follow on each other.
        """
        arrays = read_arrays(path, lambda name: "f" if re.fullmatch(r"(weights|biases)[0-2]", name, re.ASCII) else "")
        sizes = [len(CONTEXT) + 3]
        for k in range(3):
            weights, biases = (arrays.get(f"{part}{k}", np.zeros(())) for part in ("weights", "biases"))
            sizes.append(weights.shape[-1] if weights.ndim == 2 and k < 2 else 2)
            if weights.shape != (sizes[-2], sizes[-1]) or biases.shape != (sizes[-1],):
                raise FileError(path, f"layer {k}: not a map of vibration: its arrays are missing or of other shapes")
        return cls(tuple((arrays[f"weights{k}"], arrays[f"biases{k}"]) for k in range(3)))

    def save(self, path: Path) -> None:
        """Write it atomically."""
        buffer = io.BytesIO()
        arrays = {f"weights{k}": w for k, (w, _) in enumerate(self.layers)}
        arrays |= {f"biases{k}": b for k, (_, b) in enumerate(self.layers)}
        np.savez(buffer, **arrays)  # type: ignore[arg-type]
        write_atomically(path, buffer.getvalue())


@lru_cache
def stored_map() -> VibrationMap:
    """The shipped map."""
    return VibrationMap.load()


def features_of(length: FloatArray, feed: FloatArray, air: FloatArray, context: FloatArray) -> FloatArray:
    """(n, 7) inputs of the map, each within some -2 to 2.

    Args:
        length: (n,) inserted length [m].
        feed: (n,) feed speed [m/s].
        air: (n,) air supply [m3/s].
        context: (n, 4) in the order of ``CONTEXT``, SI units.
    """
    return np.column_stack(
        [
            length / 30.0 - 1.0,
            np.log(feed / 0.12),
            (air * 3600.0 - 80.0) / 30.0,
            (context[:, 0] - 0.175) / 0.04,
            (context[:, 1] - 1.05e5) / 2e4,
            (context[:, 2] - 1.0) / 0.06,
            (1.0 / context[:, 3] - 0.65) / 0.2,
        ]
    )


def expected_cost(
    mean: FloatArray, deviation: FloatArray, feed: FloatArray, air: FloatArray, config: TaskConfig
) -> FloatArray:
    """Expected cost (n,) of a metre (progress left out): vibration, time and air, by the task's weights.

    Args:
        mean: (n,) of log10(radial rms / 0.1 mm), which is normal.
        deviation: (n,) of the same.
        feed: (n,) feed speed [m/s].
        air: (n,) air supply [m3/s].
        config: the task; its vibration measure must be the displacement.
    """
    if config.vibration_measure != "displacement":
        raise ValueError(f"vibration_measure = {config.vibration_measure!r}: the map knows displacement only")
    nodes, weights = np.polynomial.hermite_e.hermegauss(7)
    logarithms = mean[:, None] + deviation[:, None] * nodes
    squares = capped_square(config, 10.0**logarithms * 1e-4 / config.limit) @ (weights / weights.sum())
    return metre_cost(config, squares, feed, air)


def fit_map(profile: pd.DataFrame, seed: int = 0) -> tuple[VibrationMap, dict[str, float]]:
    """Fit by the likelihood of the metres on all but the first ``HELD_OUT`` tubes, and say how well it tells those.

    Args:
        profile: metres of episodes, with columns of ``evaluate.CARRIED``, ``CONTEXT`` and ``context``.
        seed: of the network's start.

    Returns:
        the map; share of the variance of log10 rms explained and the mean absolute error [decades] on the tubes
        that were left out.
    """
    import torch

    torch.manual_seed(seed)
    length, feed, air = (profile[n].to_numpy(float) for n in ("inserted_length", "feed_speed", "air_supply_rate"))
    inputs = features_of(length, feed, air, profile[list(CONTEXT)].to_numpy(float))
    logarithm = np.log10(np.maximum(profile["radial_rms_m"].to_numpy(float), 1e-7) / 1e-4)
    held = profile["context"].to_numpy() < HELD_OUT
    x, y = (torch.tensor(values, dtype=torch.float32) for values in (inputs[~held], logarithm[~held]))
    network = torch.nn.Sequential(
        torch.nn.Linear(x.shape[1], HIDDEN), torch.nn.Tanh(),
        torch.nn.Linear(HIDDEN, HIDDEN), torch.nn.Tanh(),
        torch.nn.Linear(HIDDEN, 2),
    )  # fmt: skip
    optimiser = torch.optim.AdamW(network.parameters(), lr=3e-3, weight_decay=1e-3)
    steps = EPOCHS * max(len(x) // BATCH, 1)
    pace = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
    for _ in range(steps):
        chosen = torch.randint(len(x), (BATCH,))
        out = network(x[chosen])
        loss = torch.nn.functional.gaussian_nll_loss(out[:, 0], y[chosen], torch.exp(2.0 * out[:, 1].clamp(-5, 1)))
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        optimiser.step()
        pace.step()
    parts = [layer for layer in network if isinstance(layer, torch.nn.Linear)]
    layers = tuple(
        (p.weight.detach().numpy().T.astype(np.float32).copy(), p.bias.detach().numpy().copy()) for p in parts
    )
    fitted = VibrationMap(layers)
    error = fitted.distribution(inputs[held])[0] - logarithm[held]
    explained = 1.0 - float((error**2).mean() / logarithm[held].var())
    return fitted, {"explained_variance": explained, "mean_absolute_error_decades": float(np.abs(error).mean())}


def make_map(seeds: int, output: Path, target: Path) -> VibrationMap:
    """Wander on all training contexts (resumable in ``output``), fit the map, store it in ``target``.

    Raises:
        ValueError: the number of seeds is out of range.
    """
    if not 1 <= seeds <= 100:
        raise ValueError(f"seeds = {seeds!r} is outside the accepted range 1 to 100")
    config = TaskConfig(lost_drive_periods=1000)  # goes on without drive: that is seen in the table
    contexts = load_contexts("train")
    plan = Plan({"wandering": Wandering(config)}, contexts, range(seeds), config, PRESETS["fast"])
    run_plan(plan, output)
    fitted, quality = fit_map(with_contexts(read_parquet(output / "profile.parquet", PROFILE), contexts))
    fitted.save(target)
    setting = {"contexts": "train", "episodes": len(plan.units()), "held_out_tubes": HELD_OUT}
    write_json(target.with_suffix(".json"), provenance() | setting | quality)
    print(f"map of {len(plan.units())} insertions: {quality['explained_variance']:.3f} of the variance of log rms told")
    return fitted


def with_contexts(profile: pd.DataFrame, contexts: Sequence[Context]) -> pd.DataFrame:
    """The profile with the columns of ``CONTEXT``."""
    values = np.array([[getattr(c, name) for name in CONTEXT] for c in contexts])
    columns: dict[str, Any] = {name: values[profile["context"], k] for k, name in enumerate(CONTEXT)}
    return profile.assign(**columns)


def load_quality(path: Path = STORED) -> dict[str, Any]:
    """How the stored map was made and how well it tells."""
    return read_json(path.with_suffix(".json"), Quality).model_dump()
