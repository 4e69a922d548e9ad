"""Fits what the vibration map misses, ``probe_env.envs.surrogate.MEASURED``, to simulated insertions.

Usage: python docs/surrogate.py (5 minutes on two cores); the likelihood is that of a Gaussian process per episode.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from probe_agents.vec_env import ProbeVecEnv
from probe_env import TaskConfig
from probe_env.arrays import FloatArray
from probe_env.envs.vibration_map import CONTEXT, stored_map

PROBES, SECONDS = 64, 330
SLOWEST, FASTEST, LEAST, MOST = 0.08, 0.35, 0.0167, 0.035  # m/s, m3/s
NAMES = ("field", "feed", "air", "length", "slow", "time", "quick")
START = (0.15, 0.3, 10.0 / 3600.0, 20.0, 0.1, 6.0, 0.15)


def insertions() -> tuple[FloatArray, FloatArray]:
    """Seconds of insertions with random feed and air.

    Number and second of the episode (n, 2); inserted length, feed, air, radial rms and tube (n, 8), SI units.
    """
    config, rng = TaskConfig().full_observation, np.random.default_rng(5)
    env = ProbeVecEnv("probe_env/Insertion-v1", PROBES, config, fidelity="fast", contexts="train")
    env.seed(11)
    env.reset()

    def drawn(count: int | None = PROBES) -> FloatArray:
        """Random feeds, equally distributed in their logarithm."""
        return np.asarray(np.exp(rng.uniform(np.log(SLOWEST), np.log(FASTEST), count)))

    base, episode = drawn(), np.arange(PROBES)
    feed, air = base.copy(), rng.uniform(LEAST, MOST, PROBES)
    times, rows = [], []
    for second in range(SECONDS):
        near = rng.random(PROBES) < 1.0 / 6.0
        feed = np.where(near, np.clip(base * np.exp(rng.normal(0.0, 0.12, PROBES)), 0.05, 0.4), feed)
        base = np.where(rng.random(PROBES) < 1.0 / 90.0, drawn(), base)
        air = np.where(rng.random(PROBES) < 1.0 / 90.0, rng.uniform(LEAST, MOST, PROBES), air)
        tubes = [[getattr(context, name) for name in CONTEXT] for context in env.episodes.context]
        _, _, ended, infos = env.step(config.actions(feed, air).astype(np.float32))
        for k, info in enumerate(infos):
            times.append((episode[k], second))
            state = (info[name] for name in ("inserted_length", "feed_speed", "air_supply_rate", "radial_rms_m"))
            rows.append((*state, *tubes[k]))
            if ended[k]:
                feed[k] = base[k] = drawn(None)
        episode = np.where(ended, episode + PROBES, episode)
    return np.array(times), np.array(rows)


def fit() -> None:
    """Print deviations [decades], scales and the gain of the field in log-likelihood."""
    times, rows = insertions()
    length, feed, air, rms, tubes = *rows[:, :4].T, rows[:, 4:]
    predicted = stored_map().predict(length, feed, air, tubes, TaskConfig().scene)[0]
    missed = np.log10(np.maximum(rms, 1e-9) / 1e-4) - predicted
    valid = (length > 5.0) & (feed > 0.04)
    groups = [valid & (times[:, 0] == episode) for episode in np.unique(times[:, 0])]
    variables = np.column_stack([np.log(feed), air, length, times[:, 1]])
    data = [(variables[group], missed[group]) for group in groups if group.sum() > 30]

    def cost(bias: float, field: float, scales: FloatArray, slow: float, time: float, quick: float) -> float:
        """Negative logarithm of the likelihood of all episodes."""
        total = 0.0
        for points, values in data:
            apart = points[:, None] - points[None]
            squares = ((apart[..., :3] / scales) ** 2).sum(axis=2)
            covariance = field**2 * np.exp(-0.5 * squares) + slow**2 * np.exp(-np.abs(apart[..., 3]) / time)
            factor = cho_factor(covariance + quick**2 * np.eye(len(points)), lower=True)
            total += 0.5 * (values - bias) @ cho_solve(factor, values - bias) + np.log(np.diag(factor[0])).sum()
        return float(total)

    def with_field(values: FloatArray) -> float:
        field, *scales, slow, time, quick = np.exp(values[1:])
        return cost(values[0], field, np.array(scales), slow, time, quick)

    def without(values: FloatArray) -> float:
        return cost(values[0], 0.0, np.ones(3), *np.exp(values[1:]))

    full = minimize(with_field, [-0.08, *np.log(START)], method="L-BFGS-B")
    plain = minimize(without, [-0.08, *np.log(START[4:])], method="L-BFGS-B")
    print(f"{len(missed)} seconds, {len(data)} episodes; bias {full.x[0]:.4f}")
    print(*(f"{name} {value:.4g}" for name, value in zip(NAMES, np.exp(full.x[1:]), strict=True)))
    print(f"slow, correlation of a second: {np.exp(-1.0 / np.exp(full.x[6])):.4f}")
    print(f"log-likelihood gained by the field: {plain.fun - full.fun:.1f}")


if __name__ == "__main__":
    fit()
