"""Stable-Baselines3's VecEnv over the native batch."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Literal, Unpack

import gymnasium as gym
import numpy as np
from stable_baselines3.common.vec_env.base_vec_env import VecEnv, VecEnvObs, VecEnvStepReturn

from probe_env.envs.env import (
    IncrementalInsertionEnv,
    InsertionEnv,
    InspectionEnv,
    ProbeEnv,
    SnapshotEnv,
    check_episode_steps,
    make_episodes,
    spaces_of,
)
from probe_env.envs.episodes.decisions import decide
from probe_env.envs.episodes.starts import DEFAULTS, EpisodeSettings, resolve_settings
from probe_env.envs.task import TaskConfig, as_actions
from probe_env.settings import check_keywords

EnvId = Literal[
    "probe_env/Insertion-v1", "probe_env/IncrementalInsertion-v1", "probe_env/Snapshot-v1", "probe_env/Inspection-v0"
]
ENVIRONMENTS: dict[str, type[ProbeEnv]] = {
    "probe_env/Insertion-v1": InsertionEnv,
    "probe_env/IncrementalInsertion-v1": IncrementalInsertionEnv,
    "probe_env/Snapshot-v1": SnapshotEnv,
    "probe_env/Inspection-v0": InspectionEnv,
}
"""Environment id -> class."""


class ProbeVecEnv(VecEnv):
    """N environments in one batch for SB3; an ended episode is reset in the same step.

    Its info then has ``terminal_observation`` and ``TimeLimit.truncated``, which PPO needs to bootstrap; the info of
    the reset is in ``reset_infos``.

    Args:
        env_id: a key of ``ENVIRONMENTS``.
        num_envs: N; environment i equals a single one with the seed ``seed + i``.
        threads: largest number of threads; default: all cores.
        max_episode_steps: steps after which an episode is truncated, as in ``gymnasium.make``; default: only by the
            task's time limit, a field of ``config``.
        config, settings: see ``InsertionEnv``.

    Raises:
        ValueError: an argument is not valid.
    """

    def __init__(
        self,
        env_id: str = "probe_env/Insertion-v1",
        num_envs: int = 16,
        config: TaskConfig | Mapping[str, Any] | None = None,
        *,
        threads: int | None = None,
        max_episode_steps: int | None = None,
        **settings: Unpack[EpisodeSettings],
    ) -> None:
        if env_id not in ENVIRONMENTS:
            raise ValueError(f"env_id = {env_id!r} is not one of {', '.join(ENVIRONMENTS)}")
        check_episode_steps(max_episode_steps)
        self.config, settings = resolve_settings(ENVIRONMENTS[env_id].defaults, config, settings)
        check_keywords(type(self).__name__, settings, ("config", *DEFAULTS))
        self.episodes = make_episodes(num_envs, self.config, threads=threads, **settings)
        self.render_mode = None
        super().__init__(num_envs, *spaces_of(self.config))
        self._rngs: dict[int, np.random.Generator] = {}
        self._actions = np.zeros((num_envs, 2), dtype=np.float32)
        self.max_episode_steps, self._steps = max_episode_steps, np.zeros(num_envs, dtype=int)

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self.episodes!r}>"

    @property
    def kernel_seconds(self) -> float:
        """Total time in the kernels, over all threads [s]."""
        return self.episodes.kernel_seconds

    def reset(self) -> VecEnvObs:
        """Start all episodes, with the seeds of ``seed`` and the options of ``set_options`` if these were called."""
        every = list(range(self.num_envs))
        for k in every:
            if self._seeds[k] is not None or k not in self._rngs:
                self._rngs[k] = gym.utils.seeding.np_random(self._seeds[k])[0]
        observation, infos = self.episodes.reset(every, self._rngs, dict(enumerate(self._options)))
        self._steps[:] = 0
        self.reset_infos = [infos[k] for k in every]
        self._reset_seeds()
        self._reset_options()
        return observation

    def step_async(self, actions: np.ndarray) -> None:
        """Store the actions for ``step_wait``."""
        self._actions = as_actions(actions, (self.num_envs, 2)).astype(np.float32)

    def step_wait(self) -> VecEnvStepReturn:
        """Apply the actions to all environments."""
        step = decide(self.episodes, self._actions)
        self._steps += 1
        late = self._steps >= self.max_episode_steps if self.max_episode_steps else np.zeros_like(step.truncated)
        truncated = step.truncated | (late & ~step.terminated)
        done = step.terminated | truncated
        observation, infos = step.observation, step.infos
        for k, info in enumerate(infos):
            info["TimeLimit.truncated"] = bool(truncated[k])
        if ended := np.flatnonzero(done).tolist():
            for k in ended:
                infos[k]["terminal_observation"] = step.observation[k].copy()
            self._steps[ended] = 0
            first, started = self.episodes.reset(ended, self._rngs)
            observation[ended] = first[ended]
            for k in ended:
                self.reset_infos[k] = started[k]
        return observation, step.reward.astype(np.float32), done, infos

    def close(self) -> None:
        """Nothing to close."""

    def get_attr(self, attr_name: str, indices: int | Iterable[int] | None = None) -> list[Any]:
        """An attribute of the batch (such as ``render_mode`` or ``config``), once for each environment."""
        return [getattr(self, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: int | Iterable[int] | None = None) -> None:
        """Set an attribute of the batch; raises ValueError for a part of the environments, since it is shared."""
        if len(list(self._get_indices(indices))) != self.num_envs:
            raise ValueError(f"{attr_name} is shared by all environments of the batch: leave indices out")
        setattr(self, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: int | Iterable[int] | None = None, **method_kwargs: Any
    ) -> list[Any]:
        """Raises AttributeError: a native batch has no single environments."""
        raise AttributeError(f"{method_name}: a native batch has no single environments to call methods of")

    def env_is_wrapped(
        self, wrapper_class: type[gym.Wrapper[Any, Any, Any, Any]], indices: int | Iterable[int] | None = None
    ) -> list[bool]:
        """False: a native batch has no wrapped environments."""
        return [False for _ in self._get_indices(indices)]

    def get_images(self) -> Sequence[np.ndarray | None]:
        """None for each environment: only a single environment can be rendered."""
        return [None] * self.num_envs
