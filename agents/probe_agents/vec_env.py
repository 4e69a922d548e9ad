"""Stable-Baselines3's VecEnv over the native batch."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any, Literal, Unpack, cast, get_args

import gymnasium as gym
import numpy as np
from gymnasium.envs.registration import load_env_creator
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.vec_env.base_vec_env import VecEnv, VecEnvObs, VecEnvStepReturn

from probe_env.envs.env import ProbeVectorEnv
from probe_env.envs.episodes.starts import EpisodeSettings
from probe_env.envs.task.config import TaskConfig

__all__ = ["ProbeVecEnv"]
EnvId = Literal[
    "probe_env/Insertion-v1", "probe_env/IncrementalInsertion-v1", "probe_env/Snapshot-v1", "probe_env/Inspection-v0"
]
ENVIRONMENTS: dict[str, type[ProbeVectorEnv]] = {
    env_id: cast(Any, load_env_creator(str(gym.spec(env_id).vector_entry_point))) for env_id in get_args(EnvId)
}
"""Environment id -> native batch."""


class ProbeVecEnv(VecEnv):
    """N environments in one batch for SB3; an ended episode is reset in the same step.

    Its info then has ``terminal_observation`` and ``TimeLimit.truncated``, which PPO needs to bootstrap; the info of
    the reset is in ``reset_infos``.

    Args:
        env_id: a key of ``ENVIRONMENTS``.
        num_envs: N; environment i equals a single one with the seed ``seed + i``.
        config, settings: as ``gymnasium.make_vec``, see ``ProbeVectorEnv``.
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
        self.native = ENVIRONMENTS[env_id](
            num_envs, config, autoreset_mode=AutoresetMode.SAME_STEP, threads=threads,
            max_episode_steps=max_episode_steps, **settings,
        )  # fmt: skip
        arguments = dict(settings) if config is None else {"config": config, **settings}
        self.native.spec = replace(gym.spec(env_id), kwargs=arguments)
        self.spec = self.native.spec  # as gymnasium.make gives it; VecMonitor writes its id
        self.config, self.episodes, self.render_mode = self.native.config, self.native.episodes, None
        super().__init__(num_envs, self.native.single_observation_space, self.native.single_action_space)
        self._actions = np.zeros((num_envs, 2), dtype=np.float32)

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self.episodes!r}>"

    @property
    def kernel_seconds(self) -> float:
        """Total time in the kernels, over all threads [s]."""
        return self.episodes.backend.kernel_seconds

    def reset(self) -> VecEnvObs:
        """Start all episodes, with the seeds of ``seed`` and the options of ``set_options`` if these were called."""
        observation, infos = self.native.start(range(self.num_envs), self._seeds, dict(enumerate(self._options)))
        self.reset_infos = [infos[k] for k in range(self.num_envs)]
        self._reset_seeds()
        self._reset_options()
        return observation

    def step_async(self, actions: np.ndarray) -> None:
        """Store the actions for ``step_wait``."""
        self._actions = np.array(actions, dtype=np.float32)

    def step_wait(self) -> VecEnvStepReturn:
        """Apply the actions to all environments."""
        observation, reward, terminated, truncated, infos = self.native.advance(self._actions)
        for k, info in enumerate(infos):
            if "final_info" in info:
                infos[k] = info.pop("final_info") | {"terminal_observation": info.pop("final_obs")}
                self.reset_infos[k] = info
            infos[k]["TimeLimit.truncated"] = bool(truncated[k] and not terminated[k])
        return observation, reward.astype(np.float32), terminated | truncated, infos

    def close(self) -> None:
        """Nothing to close."""

    def get_attr(self, attr_name: str, indices: int | Iterable[int] | None = None) -> list[Any]:
        """An attribute of the batch (such as ``render_mode``, ``spec`` or ``config``), once for each environment."""
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
