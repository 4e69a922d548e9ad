"""Episodes of N probes: simulator and task put together, once for single environments and for many.

Tubes, probes and actions enter, observations, rewards, endings and the figures of an episode leave. ``starts`` draws
what an episode begins with, ``limits`` refuses what cannot be simulated. Imports the task, plants,
contexts, the physics, the sensor, designs and fidelities.
"""

from probe_env.envs.episodes.episodes import START_PERTURBATION, Episodes, Step

__all__ = ["START_PERTURBATION", "Episodes", "Step"]
