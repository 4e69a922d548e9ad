"""Insertions whose friction, stiffness, drag and damping are known, recorded as a rig would: to learn and test with."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import MappingProxyType
from typing import Any, Final, NamedTuple

import numpy as np

from agents.plant.logs import Log
from probe_env import Context, Fidelity
from probe_env.arrays import FloatArray
from probe_env.envs.episodes import Episodes
from probe_env.envs.task import TaskConfig
from probe_env.envs.task.observations import ACCELEROMETER_FLOOR, RF_FLOOR

RECORDED: Final = {
    "root_tension": ("tension_mean_n", 0.0),
    "radial_acceleration_rms": ("radial_acceleration_rms_m_per_s2", ACCELEROMETER_FLOOR),
    "axial_acceleration_rms": ("axial_acceleration_rms_m_per_s2", ACCELEROMETER_FLOOR),
    "rf_noise_rms": ("radial_rms_m", RF_FLOOR),
}
"""Channel of a log -> statistic of a window, and the sensor's own noise that adds to it (root of the squares)."""


class Specimen(NamedTuple):
    """A tube with a probe in it: context, and the damping time of the cable [s]."""

    context: Context
    damping_time: float


class Insertion(NamedTuple):
    """What came of an insertion.

    Attributes:
        log: without sensor noise but for the floors of ``RECORDED``; it ends before a period that diverged.
        reward: of the episode.
    """

    log: Log
    reward: float


Program = Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]
"""Feed speeds [m/s] and air supplies [m3/s] of N insertions at inserted lengths [m] and times [s], (N,) each."""


def insert(
    specimens: Sequence[Specimen], program: Program, config: TaskConfig, fidelity: Fidelity, seed: Sequence[int]
) -> list[Insertion]:
    """Feed a probe into every tube side by side, to the end of the helix or the time limit, and record it.

    Args:
        specimens: the tubes.
        program: what is fed and blown.
        config: task with the scene that a specimen changes; its control period is that of the log.
        fidelity: of the simulation.
        seed: of the starts.
    """
    count = len(specimens)
    episodes = Episodes(count, config, fidelity=fidelity)
    options = {k: {"context": s.context, "probe": {"damping_time": s.damping_time}} for k, s in enumerate(specimens)}
    rngs = {k: np.random.default_rng([*seed, k]) for k in range(count)}
    _, infos = episodes.reset(range(count), rngs, options)
    length, time = np.array([infos[k]["inserted_length"] for k in range(count)]), np.zeros(count)
    rows: list[list[tuple[float, ...]]] = [[] for _ in range(count)]
    rewards = np.full(count, np.nan)
    while episodes.running.any():
        active = episodes.running.copy()
        step = episodes.step(config.actions(*program(length, time)), active)
        window = episodes.window
        assert window is not None
        after = np.minimum(window.inserted_length, config.scene.tube.helix_length)
        felt = [np.hypot(window.statistics[name], floor) for name, floor in RECORDED.values()]
        felt[0] = window.statistics["tension_mean_n"]  # which may push
        for k in np.flatnonzero(active).tolist():
            if "episode_kpis" in step.infos[k]:
                rewards[k] = step.infos[k]["episode_kpis"]["reward"]
            if window.diverged[k]:
                continue
            fed = (after[k] - length[k]) / config.period
            rows[k].append((time[k], length[k], fed, window.air_supply_rate[k], *(column[k] for column in felt)))
        length, time = np.where(active, after, length), time + config.period * active
    logs = (_log(np.array(listed, dtype=float).reshape(-1, 4 + len(RECORDED))) for listed in rows)
    return [Insertion(log, float(reward)) for log, reward in zip(logs, rewards, strict=True)]


def _log(table: FloatArray) -> Log:
    measured: dict[str, Any] = {name: table[:, 4 + k] for k, name in enumerate(RECORDED)}
    return Log(table[:, 0], table[:, 1], table[:, 2], table[:, 3], MappingProxyType(measured))
