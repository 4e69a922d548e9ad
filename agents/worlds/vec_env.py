"""The world of the map for Stable-Baselines3."""

from __future__ import annotations

from typing import Final, Unpack, cast

from agents.vec_env import ProbeVecEnv
from agents.worlds.map_episodes import MapEpisodes
from probe_env.envs.episodes import Episodes
from probe_env.envs.episodes.starts import EpisodeSettings
from probe_env.envs.task import TaskConfig

MAP: Final = "map"
"""Name of this fidelity."""


class MapVecEnv(ProbeVecEnv):
    """``ProbeVecEnv`` in the world of the map: the same spaces, rewards and endings, no simulation."""

    def _begun(self, num_envs: int, config: TaskConfig, threads: int | None, settings: EpisodeSettings) -> Episodes:
        return cast(Episodes, MapEpisodes(num_envs, config, **settings))

    @property
    def kernel_seconds(self) -> float:
        """None are spent in kernels [s]."""
        return 0.0


def vec_env(
    env_id: str, num_envs: int, config: TaskConfig, threads: int | None = None, **settings: Unpack[EpisodeSettings]
) -> ProbeVecEnv:
    """Environments of a fidelity, which may be ``MAP``; arguments as of ``ProbeVecEnv``.

    Raises:
        ValueError: an argument is not valid, or asks for what the map does not tell of.
    """
    kind = MapVecEnv if settings.get("fidelity") == MAP else ProbeVecEnv
    return kind(env_id, num_envs, config, threads=threads, **settings)
