"""Gymnasium environments of the simulator: episodes, tasks, plants, trials of designs and pictures."""

from typing import TYPE_CHECKING

from probe_env.lazy import lazy

if TYPE_CHECKING:
    from probe_env.envs.design_env import DesignEnv
    from probe_env.envs.env import (
        IncrementalInsertionEnv,
        IncrementalInsertionVectorEnv,
        InsertionEnv,
        InsertionVectorEnv,
        InspectionEnv,
        InspectionVectorEnv,
        ProbeEnv,
        ProbeVectorEnv,
        SnapshotEnv,
        SnapshotVectorEnv,
    )
    from probe_env.envs.episodes.starts import EpisodeSettings
    from probe_env.envs.pictures.strip import Motion, Strip, Watch
    from probe_env.envs.task.observations import in_si_units

__all__ = [
    "DesignEnv", "EpisodeSettings", "IncrementalInsertionEnv", "IncrementalInsertionVectorEnv", "InsertionEnv",
    "InsertionVectorEnv", "InspectionEnv", "InspectionVectorEnv", "Motion", "ProbeEnv", "ProbeVectorEnv",
    "SnapshotEnv", "SnapshotVectorEnv", "Strip", "Watch", "in_si_units",
]  # fmt: skip
__getattr__, __dir__ = lazy(__name__)
