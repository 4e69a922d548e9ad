"""Policies: fixed laws, schedules, the vibration map, planners and trained networks, see ``catalogue``."""

from typing import TYPE_CHECKING

from probe_env.lazy import lazy

if TYPE_CHECKING:
    from probe_agents.policies.bundle import (
        Agent,
        Description,
        StoredNetwork,
        from_sb3,
        load_bundle,
        save_bundle,
        write_bundle,
    )
    from probe_agents.policies.catalogue import NAMES, make_policy, named_policies
    from probe_agents.policies.fixed import Constant, FixedPolicy, Scheduled
    from probe_agents.policies.planner import InsertionPlanner
    from probe_agents.policies.plc_law import Constants, PlcProportional
    from probe_agents.policies.policy import Policy
    from probe_agents.policies.view import View
    from probe_agents.policies.wrappers import Shielded

__all__ = [
    "NAMES", "Agent", "Constant", "Constants", "Description", "FixedPolicy", "InsertionPlanner", "PlcProportional",
    "Policy", "Scheduled", "Shielded", "StoredNetwork", "View", "from_sb3", "load_bundle", "make_policy",
    "named_policies", "save_bundle", "write_bundle",
]  # fmt: skip
__getattr__, __dir__ = lazy(__name__)
