"""Episodes of N probes: simulator or prediction, and task together, for single environments and batches."""

from probe_env.envs.episodes.backend import START_PERTURBATION
from probe_env.envs.episodes.episodes import Episodes, Step

__all__ = ["START_PERTURBATION", "Episodes", "Step"]
