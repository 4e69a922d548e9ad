"""A small plan that tests of evaluations share."""

from probe_agents.evaluation.plan import Plan
from probe_agents.policies.fixed import Constant
from probe_env import Fidelity, load_contexts
from probe_env.envs.task.config import TaskConfig

CONFIG = TaskConfig(growing=False, period=0.1, time_limit=0.3, settle_time=0.1)


def make_plan(contexts=3, feeds=2, seeds=(0, 1), config=CONFIG, **changes) -> Plan:
    """Constant feeds of 0.1, 0.2, ... m/s in tubes of the validation list."""
    constants = {f"feed {k}": Constant(config, feed_speed=0.1 * (k + 1)) for k in range(feeds)}
    arguments = {"policies": constants, "contexts": load_contexts("validation")[:contexts], "seeds": seeds}
    return Plan(**(arguments | {"config": config, "fidelity": Fidelity()} | changes))
