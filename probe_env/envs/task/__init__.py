"""The control task: actions, observations, rewards, costs and endings of N probes; no simulator."""

from probe_env.envs.task.config import MEASURES, VISIBLE_FIELDS, Measure, ScoredPass, TaskConfig, describe, ungrouped
from probe_env.envs.task.rules import (
    COSTS,
    END_TOLERANCE,
    ENDINGS,
    FAILURES,
    Score,
    air_used,
    any_ending,
    capped_square,
    consecutive_slack,
    cost_terms,
    drive_counts,
    ending,
    metre_cost,
    metre_reward,
    reward_terms,
    slack,
    uninspected_weight,
)  # fmt: skip
from probe_env.envs.task.scales import action_in, action_of, as_actions, share_between, share_of, value_at

__all__ = [
    "COSTS", "ENDINGS", "END_TOLERANCE", "FAILURES", "MEASURES", "VISIBLE_FIELDS", "Measure", "Score", "ScoredPass",
    "TaskConfig", "action_in", "action_of", "air_used", "any_ending", "as_actions", "capped_square",
    "consecutive_slack", "cost_terms", "describe", "drive_counts", "ending", "metre_cost", "metre_reward",
    "reward_terms", "share_between", "share_of", "slack", "ungrouped", "uninspected_weight", "value_at",
]  # fmt: skip
