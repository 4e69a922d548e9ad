"""Moved to ``probe_env.envs.vibration_map``."""

from probe_env.envs.vibration_map import *  # noqa: F403
