"""Fits the noise of the surrogate, ``predicted.Noise``, to insertions with random feed and air in training tubes."""

import math
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize
from scipy.spatial.distance import cdist

from probe_agents.evaluation.workers import HERE, Workers
from probe_agents.records.manifest import origin, write_json
from probe_agents.studies.response import RECORDED, Program, Specimen, insert, make_bank
from probe_agents.terminal.tables import print_line
from probe_env import load_contexts
from probe_env.arrays import FloatArray
from probe_env.envs.episodes.predicted import Noise, RandomField, Scatter, features
from probe_env.envs.task.config import TaskConfig
from probe_env.envs.task.scales import geometric_at, value_at
from probe_env.envs.vibration_map import CONTEXT, stored_map
from probe_env.fidelity import PRESETS
from probe_env.physics.closed_forms import entrance_tension, sliding_tension

SIZE: Final = 16
"""Insertions per group."""
FEEDS: Final = (0.08, 0.35)  # [m/s]
AIRS: Final = (60.0 / 3600.0, 126.0 / 3600.0)  # [m3/s]
SEGMENT: Final = 15.0
"""Length with one air supply, and with feeds near one [m]."""
NEAR: Final = 0.12
"""Standard deviation of the logarithm of these feeds, each of which is kept for a metre."""
FIRST: Final = 5.5
"""Shorter insertions are not fitted [m]."""
MIN_RMS: Final = 1e-5
"""Least vibration by the map that is fitted [m], ten times the sensor's noise: less costs nothing."""
SEED: Final = 5
FIDELITY: Final = "standard"
START: Final = (0.1, 0.3, 10.0 / 3600.0, 10.0, 0.1, 20.0, 0.1)
"""Start of the fit of the vibration: deviation and three scales of the field, slow deviation and time [s], quick."""
Rows = dict[str, FloatArray]
"""Columns of seconds, see ``simulated``."""
Missed = Sequence[tuple[FloatArray, FloatArray]]
"""Of each episode: logarithm of the feed, air, length and time (n, 4), and the difference from the map (n,)."""


def run(output: Path, limit: int = 4, workers: Workers = HERE) -> Noise:
    """Simulate ``limit`` groups of insertions (resumable) and fit; writes surrogate-noise.json."""
    parts = list(make_bank(limit, output, simulated, FIDELITY))
    rows = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    noise, target = fit_noise(rows), output / "surrogate-noise.json"
    setting = {"contexts": "train", "insertions": limit * SIZE, "seconds": len(rows["time"]), "fidelity": FIDELITY}
    write_json(target, origin() | setting | {"map": stored_map().digest} | asdict(noise))
    print(noise)
    print_line(f"written: {target}")
    return noise


def task() -> TaskConfig:
    """The task, which continues without drive."""
    return TaskConfig(lost_drive_periods=1000, time_limit=1e4)


def wandering(group: int) -> Program:
    """Random feed and air in each ``SEGMENT``, and in each metre a feed near it, as of a controller that searches."""
    rng, count = np.random.default_rng([SEED, group]), int(task().scene.tube.helix_length) + 1
    fractions, near = rng.random((2, count, SIZE)), rng.normal(0.0, NEAR, (count, SIZE))

    def program(length: FloatArray) -> tuple[FloatArray, FloatArray]:
        k, metre = np.arange(len(length)), length.astype(int)
        feed, air = fractions[:, (length / SEGMENT).astype(int), k]
        return geometric_at(feed, FEEDS) * np.exp(near[metre, k]), value_at(air, AIRS)

    return program


def simulated(group: int) -> Rows:
    """Columns of the seconds of a group: episode, state at the end of the second, ``RECORDED`` and tube."""
    config, tubes = task(), load_contexts("train")[group * SIZE : (group + 1) * SIZE]
    specimens = [Specimen(tube, config.scene.probe.damping_time) for tube in tubes]
    logs = insert(specimens, wandering(group), config, PRESETS[FIDELITY], [SEED, group])
    row = np.repeat(np.arange(len(logs)), [len(log.time) for log in logs])
    names = ("time", "inserted_length", "feed_speed", "air_supply_rate")
    rows = {name: np.concatenate([getattr(log, name) for log in logs]) for name in names}
    rows["inserted_length"] += rows["feed_speed"] * config.period
    for name, (_, floor) in RECORDED.items():
        values = np.concatenate([log.measured[name] for log in logs])
        rows[name] = np.sqrt(np.maximum(values**2 - floor**2, 1e-14)) if floor else values
    rows |= {name: np.array([getattr(tube, name) for tube in tubes])[row] for name in CONTEXT}
    rows["episode"] = group * SIZE + row.astype(float)
    fitted = (rows["inserted_length"] > FIRST) & (rows["inserted_length"] < config.scene.tube.helix_length)
    return {name: values[fitted] for name, values in rows.items()}


def fit_noise(rows: Rows) -> Noise:
    """Noise by maximum likelihood for the vibration, by moments for tension and accelerations."""
    tubes, scene, episode = np.column_stack([rows[name] for name in CONTEXT]), task().scene, rows["episode"]
    steady = sliding_tension(rows["friction"], rows, scene, rows["drag_factor"])
    ratio = (rows["root_tension"] + entrance_tension(scene, rows["helix_diameter"])) / steady
    inputs = features(np.log10(rows["rf_noise_rms"] / 1e-4), rows["feed_speed"], rows["inserted_length"], tubes)
    accelerations: list[Any] = []
    for name in ("radial", "axial"):
        values = np.log10(rows[f"{name}_acceleration_rms"])
        factors = np.linalg.lstsq(inputs, values, rcond=None)[0]
        accelerations += [tuple(factors.tolist()), scatter_of(values - inputs @ factors, episode)]
    return Noise(*fit_vibration(missed_by_map(rows)), scatter_of(np.log(ratio), episode), *accelerations)


def scatter_of(values: FloatArray, episode: FloatArray) -> Scatter:
    """The process of consecutive seconds (n,) of episodes (n,), by its moments; its mean is 0."""
    square, following = float((values**2).mean()), episode[1:] == episode[:-1]
    return Scatter(square**0.5, float((values[1:] * values[:-1])[following].mean()) / square)


def missed_by_map(rows: Rows) -> Missed:
    """Difference of the vibration from the map, where it predicts ``MIN_RMS`` or more."""
    length, feed, air = (rows[name] for name in ("inserted_length", "feed_speed", "air_supply_rate"))
    tubes = np.column_stack([rows[name] for name in CONTEXT])
    predicted = stored_map().predict(length, feed, air, tubes, task().scene)[0]
    missed, seen = np.log10(rows["rf_noise_rms"] / 1e-4) - predicted, predicted >= np.log10(MIN_RMS / 1e-4)
    points = np.column_stack([np.log(feed), air, length, rows["time"]])
    parts = (seen & (rows["episode"] == k) for k in np.unique(rows["episode"]))
    return [(points[part], missed[part]) for part in parts if part.any()]


def fit_vibration(missed: Missed) -> tuple[float, RandomField, Scatter, float]:
    """Bias, field, slow and quick part of the vibration by maximum likelihood."""

    def cost_at(x: FloatArray) -> float:
        return cost(missed, float(x[0]), *np.exp(x[1:]).tolist())

    x = minimize(cost_at, np.array([0.0, *np.log(START)]), method="L-BFGS-B").x
    deviation, feed, air, length, slow, time, quick = np.exp(x[1:]).tolist()
    return float(x[0]), RandomField(deviation, feed, air, length), Scatter(slow, math.exp(-1.0 / time)), quick


def cost(
    missed: Missed,
    bias: float, field: float, feed: float, air: float, length: float, slow: float, time: float, quick: float,
) -> float:  # fmt: skip
    """Negative logarithm of the likelihood of all episodes, each a Gaussian process; parameters as in ``START``."""
    total = 0.0
    for points, values in missed:
        scaled = points / (feed, air, length, time)
        covariance = field**2 * np.exp(-0.5 * cdist(scaled[:, :3], scaled[:, :3], "sqeuclidean"))
        covariance += slow**2 * np.exp(-cdist(scaled[:, 3:], scaled[:, 3:]))
        factor = cho_factor(covariance + quick**2 * np.eye(len(values)), lower=True)
        total += 0.5 * (values - bias) @ cho_solve(factor, values - bias) + np.log(np.diag(factor[0])).sum()
    return float(total)
