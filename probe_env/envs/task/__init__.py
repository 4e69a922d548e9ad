"""The control task: all rules, and no simulator.

Actions and what was measured enter, targets, observations, rewards, costs and endings leave. Imports scenes, the
sensor, the ranges of designs and settings. Everything is for N probes at once, one row or entry a probe.
"""

from probe_env.envs.task.config import MEASURES, SHOWN, Inspects, Measure, TaskConfig, describe, scene_of
from probe_env.envs.task.metre import capped_square, costs, metre_cost, metre_reward
from probe_env.envs.task.ranges import action_in, action_of, share_between, share_of, value_at
from probe_env.envs.task.rules import (
    END_TOLERANCE,
    ENDINGS,
    FAILURES,
    Ending,
    Outcome,
    air_used,
    drive_counts,
    ending,
    reward_terms,
    slack,
    slack_in_a_row,
    travel,
)

__all__ = [
    "ENDINGS",
    "END_TOLERANCE",
    "FAILURES",
    "MEASURES",
    "SHOWN",
    "Ending",
    "Inspects",
    "Measure",
    "Outcome",
    "TaskConfig",
    "action_in",
    "action_of",
    "air_used",
    "capped_square",
    "costs",
    "describe",
    "drive_counts",
    "ending",
    "metre_cost",
    "metre_reward",
    "reward_terms",
    "scene_of",
    "share_between",
    "share_of",
    "slack",
    "slack_in_a_row",
    "travel",
    "value_at",
]
