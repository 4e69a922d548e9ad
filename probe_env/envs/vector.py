"""The native vector environment: N probes in the lanes of one batch, for ``gymnasium.make_vec``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Unpack

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from probe_env.arrays import FloatArray
from probe_env.envs.env import (
    InsertionEnv,
    InspectionEnv,
    Observation,
    ProbeEnv,
    SnapshotEnv,
    check_episode_steps,
    spaces_of,
)
from probe_env.envs.episodes.starts import EpisodeSettings, placed
from probe_env.envs.surrogate import make_episodes
from probe_env.envs.task import TaskConfig
from probe_env.settings import in_one_line


class ProbeVectorEnv(gym.vector.VectorEnv[Observation, Observation, Any]):
    """N environments in one batch; each equals a single environment with the seed ``seed + i`` bit for bit.

    Args:
        num_envs: N.
        autoreset_mode: when an ended episode starts anew: ``AutoresetMode.NEXT_STEP`` (default), ``SAME_STEP``
            (with ``final_obs`` and ``final_info`` in the infos) or ``DISABLED`` (``options["reset_mask"]``).
        threads: at most so many; default: all cores.
        config, settings: see ``InsertionEnv``.
        max_episode_steps: an episode is truncated after so many steps, as by ``gymnasium.make``; default: only by the
            task's own time limit, a field of ``config``.
        render_mode: refused: render a single environment.

    Raises:
        ValueError: an argument is not valid.
    """

    single: ClassVar[type[ProbeEnv]] = ProbeEnv

    @in_one_line()
    def __init__(
        self,
        num_envs: int = 1,
        config: TaskConfig | Mapping[str, Any] | None = None,
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        threads: int | None = None,
        max_episode_steps: int | None = None,
        render_mode: str | None = None,
        **settings: Unpack[EpisodeSettings],
    ) -> None:
        check_episode_steps(max_episode_steps)
        if render_mode is not None:
            raise ValueError(f"render_mode = {render_mode!r}: a batch is not rendered; use a single environment")
        self.config, settings = placed(self.single.defaults, config, settings)
        self.episodes = make_episodes(num_envs, self.config, threads=threads, **settings)
        self.num_envs = num_envs
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = self.single.metadata | {"autoreset_mode": self.autoreset_mode}
        self.single_observation_space, self.single_action_space = spaces_of(self.config)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._rngs: dict[int, np.random.Generator] = {}
        self._ended = np.zeros(num_envs, dtype=bool)
        self.max_episode_steps, self._steps = max_episode_steps, np.zeros(num_envs, dtype=int)

    @in_one_line()
    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start episodes: all, or those of ``options["reset_mask"]``. Other options are those of the single one.

        Raises:
            ValueError: seeds, mask or options are not valid.
        """
        options = dict(options or {})
        mask = options.pop("reset_mask", None)
        mask = np.ones(self.num_envs, dtype=bool) if mask is None else np.asarray(mask)
        if mask.shape != (self.num_envs,) or mask.dtype != np.bool_ or not mask.any():
            raise ValueError(f"options['reset_mask'] must be {self.num_envs} booleans, at least one of them true")
        which = np.flatnonzero(mask).tolist()
        seeds = [seed + k for k in range(self.num_envs)] if isinstance(seed, int | np.integer) else seed
        if seeds is not None and len(seeds) != self.num_envs:
            raise ValueError(f"seed has {len(seeds)} entries for {self.num_envs} environments")
        for k in which:
            given = None if seeds is None else seeds[k]
            if given is not None or k not in self._rngs:  # else its generator goes on
                self._rngs[k] = gym.utils.seeding.np_random(given)[0]
        observation, infos = self.episodes.reset(which, self._rngs, dict.fromkeys(which, options))
        self._ended[mask], self._steps[mask] = False, 0
        merged: dict[str, Any] = {}
        for k in which:
            merged = self._add_info(merged, infos[k], k)
        return observation, merged

    def step(
        self, actions: npt.ArrayLike
    ) -> tuple[Observation, FloatArray, npt.NDArray[np.bool_], npt.NDArray[np.bool_], dict[str, Any]]:
        """One control period; ended episodes are handled after ``autoreset_mode``."""
        starting = self._ended.copy()
        if starting.any() and self.autoreset_mode is AutoresetMode.DISABLED:
            raise RuntimeError(f"episode {np.flatnonzero(starting)[0]} has ended: reset it with options['reset_mask']")
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        reward: FloatArray = np.zeros(self.num_envs)
        terminated, truncated = np.zeros_like(starting), np.zeros_like(starting)
        observation = self.episodes.observation.copy()
        if not starting.all():
            step = self.episodes.step(actions, ~starting)
            observation, reward, terminated, truncated = step.observation, step.reward, step.terminated, step.truncated
            infos = step.infos
            self._steps += ~starting
            if self.max_episode_steps is not None:
                truncated = truncated | (~starting & (self._steps >= self.max_episode_steps))
        if starting.any():  # NEXT_STEP: this step is their reset
            observation, started = self._start(np.flatnonzero(starting).tolist())
            for k, info in started.items():
                infos[k] = info
        self._ended = terminated | truncated
        if self._ended.any() and self.autoreset_mode is AutoresetMode.SAME_STEP:
            ended = np.flatnonzero(self._ended).tolist()
            final = observation.copy()
            observation, started = self._start(ended)
            for k in ended:
                infos[k] = started[k] | {"final_obs": final[k], "final_info": infos[k]}
            self._ended[:] = False
        merged: dict[str, Any] = {}
        for k, info in enumerate(infos):
            if info:
                merged = self._add_info(merged, info, k)
        return observation, reward.copy(), terminated.copy(), truncated.copy(), merged

    def _start(self, which: list[int]) -> tuple[Observation, dict[int, dict[str, Any]]]:
        self._steps[which] = 0
        return self.episodes.reset(which, self._rngs)


class InsertionVectorEnv(ProbeVectorEnv):
    """Native batch of ``probe_env/Insertion-v1``."""

    single = InsertionEnv


class SnapshotVectorEnv(ProbeVectorEnv):
    """Native batch of ``probe_env/Snapshot-v1``."""

    single = SnapshotEnv


class InspectionVectorEnv(ProbeVectorEnv):
    """Native batch of ``probe_env/Inspection-v0``."""

    single = InspectionEnv
