"""The environments as an agent sees them, for Stable-Baselines3."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from stable_baselines3.common.vec_env.base_vec_env import VecEnv, VecEnvObs, VecEnvStepReturn, VecEnvWrapper

from agents.policies.view import Rows, View
from probe_env.envs.task import TaskConfig


class ViewVecEnv(VecEnvWrapper):
    """The environments as an agent sees them; rewards times ``reward_scale``.

    ``rows`` holds the environment's own observations (N, d) of the last step.
    """

    def __init__(self, venv: VecEnv, view: View, config: TaskConfig, reward_scale: float = 1.0) -> None:
        super().__init__(venv, *view.spaces)
        view.columns(config)
        self.view, self.config, self.reward_scale = view, config, reward_scale
        self.rows: Rows = np.zeros((venv.num_envs, len(config.observations)))
        self._memory: Rows | None = None
        self.guided: npt.NDArray[np.float32] | None = None
        """(N, 2) what the agent's actions correct, see ``View.guided``."""

    def reset(self) -> VecEnvObs:
        """Start all episodes."""
        self.rows = np.asarray(self.venv.reset())
        features, self._memory = self.view.features(self.config, self.rows, None, np.ones(self.num_envs, dtype=bool))
        self.guided = self.view.guided(features)
        return features

    def step_async(self, actions: np.ndarray) -> None:
        """Hand the actions on in the environment's own terms."""
        self.venv.step_async(self.view.env_actions(self.config, actions, self.guided))

    def step_wait(self) -> VecEnvStepReturn:
        """One control period; an ended episode's last features are in ``terminal_observation``."""
        rows, rewards, dones, infos = self.venv.step_wait()
        ended = np.flatnonzero(dones)
        if len(ended):
            assert self._memory is not None
            last = np.array([infos[k]["terminal_observation"] for k in ended])
            features, _ = self.view.features(self.config, last, self._memory[ended], np.zeros(len(ended), dtype=bool))
            for k, terminal in zip(ended, features, strict=True):
                infos[k]["terminal_observation"] = terminal
        self.rows = np.asarray(rows)
        features, self._memory = self.view.features(self.config, self.rows, self._memory, np.asarray(dones))
        self.guided = self.view.guided(features)
        return features, np.asarray(rewards * self.reward_scale, dtype=np.float32), dones, infos
