"""Moved to ``probe_env.envs.surrogate.vibration_map``."""

from probe_env.envs.surrogate.vibration_map import *  # noqa: F403
