"""Policies: observations enter, actions leave; fixed laws, schedules, the vibration map, trained networks.

``catalogue`` finds one by its name or file, ``places`` is where they act, ``domain`` what they were made for. Imports
rollouts, processes, searches, records and terminal, the task, plants, episodes and the physics; torch for trained
networks and the map's fit.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from stable_baselines3.common.base_class import BaseAlgorithm

    from agents.policies.bundle import Agent
    from probe_env.envs.task import TaskConfig

__all__ = ["from_sb3", "save_bundle"]


def from_sb3(model: BaseAlgorithm, config: TaskConfig) -> Agent:
    """A model of Stable-Baselines3 as a policy, see ``agents.policies.sb3``."""
    from agents.policies.sb3 import from_sb3 as policy_of  # and with it torch

    return policy_of(model, config)


def save_bundle(path: str | Path, model: BaseAlgorithm, config: TaskConfig) -> str:
    """Store a model of Stable-Baselines3 as an agent's bundle; returns its hash, see ``agents.policies.sb3``."""
    from agents.policies.sb3 import save_bundle as save

    return save(path, model, config)
