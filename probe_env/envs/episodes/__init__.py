"""Episodes of N probes: simulator and task together, for single environments and batches."""

from probe_env.envs.episodes.episodes import START_PERTURBATION, Episodes, Step

__all__ = ["START_PERTURBATION", "Episodes", "Step"]
