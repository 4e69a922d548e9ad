"""An agent of the whole shift: trained in Inspection-v0 it acts on both ways, and nowhere else."""

import numpy as np
import pytest

from agents.learning.config import Training
from agents.learning.train import BEST, train_all
from agents.policies.both_ways import BothWays
from agents.policies.bundle import Agent
from agents.policies.catalogue import make_policy
from probe_env.envs.task import TaskConfig
from probe_env.fidelity import Fidelity, resolve_fidelity
from probe_env.files import FileError

COARSE = Fidelity(method="imex", time_step=1.25e-4, time_lapse=20.0)
TINY = {
    "environment": {"env_id": "probe_env/Inspection-v0", "num_envs": 4, "fidelity": COARSE,
                    "task": {"settle_time": 0.1, "time_limit": 20.0}},
    "network": {"net_arch": (8,)},
    "learning": {"n_steps": 16, "batch_size": 32, "n_epochs": 2},
    "imitation": {"teacher": "fast-in", "rounds": 1, "steps": 32, "epochs": 2},
    "validation": {"limit": 1, "fidelity": COARSE},
    "phases": 1,
    "phase_steps": 64,
}  # fmt: skip


def test_an_agent_of_both_passes_acts_on_both(tmp_path):
    train_all(Training(**TINY), tmp_path, resume=False)
    path, config = str(tmp_path / "seed-0" / BEST), TaskConfig(passes="both").all_shown
    agent = make_policy(path, config)
    assert isinstance(agent, Agent)
    names = list(config.observations)
    rows = np.full((2, len(names)), 0.5, dtype=np.float32)
    rows[1, names.index("way")] = -1.0
    actions, _ = agent.predict(rows, deterministic=True)
    assert (actions[0] != actions[1]).any()  # it sees which way it is on
    with pytest.raises(FileError, match="way"):
        make_policy(path, TaskConfig().all_shown)
    with pytest.raises(ValueError, match=r"policy = 'shielded:.*agent.npz': the shield is for the way in"):
        make_policy(f"shielded:{path}", config)


def test_an_agent_of_the_way_in_is_drawn_back():
    config = TaskConfig(passes="both").all_shown
    assert isinstance(make_policy("ppo", config), BothWays)


def test_a_method_that_cannot_go_back_is_refused_before_any_work():
    for part in ("environment", "validation"):
        settings = TINY | {part: TINY[part] | {"fidelity": Fidelity()}}
        with pytest.raises(ValueError, match="superelement32 does not simulate the way back; give one of"):
            Training(**settings)
    assert resolve_fidelity("fast", both_ways=True).time_lapse == 4.0
    fast = TINY | {part: TINY[part] | {"fidelity": "fast"} for part in ("environment", "validation")}
    assert Training(**fast).task.returns
