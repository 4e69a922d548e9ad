"""Environment steps per second: single, Gymnasium's and SB3's vector environments, and the native batch."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial, wraps
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv
from tqdm import tqdm

from agents.vec_env import ProbeVecEnv
from probe_env import Scene
from probe_env.envs.episodes import Episodes
from probe_env.envs.task import TaskConfig
from probe_env.inspection.meter import Meter

ENV_ID, LENGTH = "probe_env/Snapshot-v1", 27.5  # carrier length [m]: half of an insertion
WORKERS, BATCHES = 8, (1, 8, 16, 64)
EPISODE_PROBES = 16
ROUNDS = 3
"""Of an episode: others on the machine lengthen one, and what is heard in it, by a third."""
FIDELITIES = ("standard", "fast")


class Episode(NamedTuple):
    """Cost of an insertion.

    Attributes:
        seconds: wall time a probe.
        listening: share of it in which signal-to-noise is measured.
    """

    seconds: float
    listening: float


def bench_environments() -> dict[str, Any]:
    """Steps per second of every way to run the environment, shares outside the kernel, cost of an episode."""
    together, alone = ({name: _episode(name, count) for name in FIDELITIES} for count in (EPISODE_PROBES, 1))
    return {
        "steps_per_second": _steps_per_second(),
        "share_outside_kernel": _share_outside_kernel(),
        "episode_s_per_probe": {name: episode.seconds for name, episode in together.items()},
        "episode_s_alone": {name: episode.seconds for name, episode in alone.items()},
        "share_listening": {name: episode.listening for name, episode in together.items()},
        "share_listening_alone": {name: episode.listening for name, episode in alone.items()},
        "carrier_length_m": LENGTH,
    }


def _make() -> gym.Env[Any, Any]:
    return gym.make(ENV_ID, scene=Scene(carrier_length=LENGTH))


def _steps_per_second() -> dict[str, float]:
    """Environment steps (of 0.1 s) per second of wall time; compiled and settled before the clock starts."""
    makers: dict[str, tuple[int, Callable[[], Any]]] = {
        "single": (1, _make),
        f"SyncVectorEnv, {WORKERS}": (WORKERS, lambda: SyncVectorEnv([_make] * WORKERS)),
        f"AsyncVectorEnv, {WORKERS}": (WORKERS, lambda: AsyncVectorEnv([_make] * WORKERS)),
        f"SB3 DummyVecEnv, {WORKERS}": (WORKERS, lambda: DummyVecEnv([_make] * WORKERS)),
        f"SB3 SubprocVecEnv, {WORKERS}": (WORKERS, lambda: SubprocVecEnv([_make] * WORKERS)),
    }
    scene = Scene(carrier_length=LENGTH)
    for count in BATCHES:
        makers[f"native batch, {count}"] = (count, partial(ProbeVecEnv, ENV_ID, count, scene=scene))
    rates = {}
    for name, (count, make) in tqdm(makers.items(), desc="environments", unit="kind"):
        env = make()
        env.reset()
        action = np.zeros((count, 2), dtype=np.float32) if name != "single" else np.zeros(2, dtype=np.float32)
        env.step(action)
        steps = 20
        best = np.inf
        for _ in range(3):  # an episode has 80 steps
            start = time.perf_counter()
            for _ in range(steps):
                env.step(action)
            best = min(best, time.perf_counter() - start)
        rates[name] = count * steps / best
        env.close()
    return rates


def _share_outside_kernel() -> float:
    """Share of a step's time that is not spent in the kernels, for a batch of 16 on one thread."""
    config = {"period": 1.0, "time_limit": 80.0}
    batch = ProbeVecEnv(ENV_ID, 16, config, scene=Scene(carrier_length=LENGTH), threads=1)
    batch.reset()
    action = np.zeros((16, 2), dtype=np.float32)
    batch.step(action)
    inside = batch.kernel_seconds
    start = time.perf_counter()
    for _ in range(3):
        batch.step(action)
    total = time.perf_counter() - start
    return 1.0 - (batch.kernel_seconds - inside) / total


def _episode(fidelity: str, count: int) -> Episode:
    """A whole insertion at 0.2 m/s and 63 m3/h, in a batch of ``count`` on all cores: the middle one of ``ROUNDS``."""
    return sorted(_insertion(fidelity, count) for _ in range(ROUNDS))[ROUNDS // 2]


def _insertion(fidelity: str, count: int) -> Episode:
    config = TaskConfig()
    episodes = Episodes(count, config, fidelity=fidelity)
    rngs = {k: np.random.default_rng(k) for k in range(count)}
    action = np.tile(config.action(0.2, 63.0 / 3600.0), (count, 1))
    with clocked(Meter, "listen") as spent, tqdm(total=275, desc=f"episode, {fidelity}, {count}", unit="s") as bar:
        start = time.perf_counter()
        episodes.reset(range(count), rngs)
        while episodes.running.any():
            episodes.step(action, episodes.running.copy())
            bar.update()
        total = time.perf_counter() - start
    return Episode(total / count, sum(spent) / total)


@contextmanager
def clocked(kind: type, method: str) -> Iterator[list[float]]:
    """Wall times [s] of every call of a method, as long as the context lasts."""
    spent, plain = list[float](), getattr(kind, method)

    @wraps(plain)
    def timed(*args: Any, **named: Any) -> Any:
        start = time.perf_counter()
        try:
            return plain(*args, **named)
        finally:
            spent.append(time.perf_counter() - start)

    setattr(kind, method, timed)
    try:
        yield spent
    finally:
        setattr(kind, method, plain)
