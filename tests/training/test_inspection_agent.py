"""An agent of the whole shift: trained in Inspection-v0 it acts on both ways, and nowhere else."""

import numpy as np
import pandas as pd
import pytest

from agents.evaluation.plan import Plan, run_plan
from agents.policies.bundle import Agent, Description, Network, build_policy, write_bundle
from agents.policies.catalogue import make_policy
from agents.policies.view import View
from agents.policies.wrappers import BothWays, InSteps
from agents.training.config import Training
from agents.training.train import BEST, train_all
from probe_env import load_contexts
from probe_env.envs.task import TaskConfig
from probe_env.fidelity import BOTH_WAYS, Fidelity
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

VALIDATED = pd.DataFrame({"reward": [1.0], "inspection_time_s": [1.0], "share_within_limit": [1.0], "diverged": [0.0]})


@pytest.mark.slow
def test_an_agent_of_both_passes_is_asked_on_both(tmp_path, monkeypatch):
    """In a helix of 8 m, begun at 5 m: what it says on the way back is what is done there."""
    plans = []
    with monkeypatch.context() as patch:
        patch.setattr("agents.training.train.run_plan", lambda plan, *_, **__: plans.append(plan) or VALIDATED)
        train_all(Training(**TINY | {"validation": {"limit": 1, "fidelity": "fast"}}), tmp_path, resume=False)
    assert {plan.fidelity for plan in plans} == {BOTH_WAYS["fast"]}  # in an insertion ``fast`` cannot go back
    path = str(tmp_path / "seed-0" / BEST)
    config = TaskConfig(
        passes="both", inspects="back", scene={"tube": {"helix_length": 8.0}}, time_limit=100.0
    ).full_observation
    agent = make_policy(path, config)
    assert isinstance(agent, Agent)
    asked, predict, way = [], agent.predict, list(config.observations).index("way")

    def recorded(observation, state=None, episode_start=None, deterministic=False):
        rows = np.atleast_2d(observation)
        asked.extend(rows[:, way].tolist())
        actions, state = predict(observation, state, episode_start, deterministic)
        fast_back = config.action(0.4, 0.02)
        return np.where(rows[:, way : way + 1] < 0.0, fast_back, actions).astype(np.float32), state

    monkeypatch.setattr(agent, "predict", recorded)
    table = run_plan(Plan({"agent": agent}, load_contexts("test")[:1], (0,), config, COARSE), None)
    assert {1.0, -1.0} <= set(asked)
    assert bool(table["complete"].all())
    with pytest.raises(FileError, match=r"observations = way are not .*; an agent that sees the way is for passes ="):
        make_policy(path, TaskConfig().full_observation)
    with pytest.raises(ValueError, match=r"policy = 'shielded:.*agent.safetensors': the shield is for the way in"):
        make_policy(f"shielded:{path}", config)


def test_an_agent_keeps_the_steps_of_the_feed_that_it_was_trained_with(tmp_path):
    """On a device without steps: every change of the feed shakes a probe that is drawn back."""
    task, path = TaskConfig(passes="both", feed_speed_step=0.05), tmp_path / "agent.safetensors"
    view = View(observations=tuple(task.observations))
    description = Description(algorithm="ppo", network=Network(net_arch=(8,)), view=view, task=task, trained={})
    write_bundle(path, description, build_policy(description))
    config = TaskConfig(passes="both").full_observation
    policy = make_policy(str(path), config)
    assert isinstance(policy, InSteps)
    assert policy.domain.helix_length == 60.0
    assert policy.describe()["step"] == 0.05
    rows = np.random.default_rng(0).uniform(-1.0, 1.0, (3, len(config.observations))).astype(np.float32)
    actions, state = policy.predict(rows, deterministic=True)
    own, _ = policy.agent.predict(rows, deterministic=True)
    feed, air = config.targets(actions).T
    wanted, blown = config.targets(own).T
    np.testing.assert_allclose(feed / 0.05, np.round(wanted / 0.05), atol=1e-6)
    np.testing.assert_allclose(air, blown, rtol=1e-6)
    one, _ = policy.predict(rows[0], deterministic=True)
    np.testing.assert_allclose(one, actions[0], rtol=0, atol=1e-6)  # a row's and a table's sums, in single precision
    later, _ = policy.predict(rows, state, np.zeros(3, dtype=bool), deterministic=True)
    assert later.shape == (3, 2)


def test_both_ways_need_a_method_that_goes_back():
    for part in ("environment", "validation"):
        settings = TINY | {part: TINY[part] | {"fidelity": Fidelity()}}
        with pytest.raises(ValueError, match="superelement32 does not simulate the way back; give one of"):
            Training(**settings)
    assert isinstance(make_policy("ppo", TaskConfig(passes="both").full_observation), BothWays)
