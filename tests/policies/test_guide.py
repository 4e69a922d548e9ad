"""An agent that corrects a law: what it does nothing about is the law's."""

from pathlib import Path

import numpy as np
import pytest
import torch

from probe_agents.policies.bundle import Agent, Description, Network, build_policy, load_bundle, write_bundle
from probe_agents.policies.plc_law import Constants, PlcProportional, read_constants
from probe_agents.policies.view import View
from probe_agents.training.config import Training
from probe_env.envs.env import InsertionVectorEnv
from probe_env.envs.task import TaskConfig

TASK = TaskConfig().full_observation
OWN = Constants(onset_length=12.0, slow_feed=0.11)


def agent(view: View, network: Network, task: TaskConfig = TASK, weight: float | None = None) -> Agent:
    """With new weights, or all of them the same."""
    torch.manual_seed(0)
    description = Description(algorithm="ppo", network=network, view=view, task=task, trained={})
    policy = build_policy(description)
    if weight is not None:
        for value in policy.parameters():
            value.data.fill_(weight)
    return Agent(description, policy, task)


def test_an_agent_that_does_nothing_acts_as_its_law() -> None:
    """Through a real insertion and the beginning of another, to the rounding of an action in single precision."""
    guided = agent(View(guide=OWN, least_air_supply_rate=0.0125), Network(net_arch=(8,)), weight=0.0)
    law = PlcProportional(TASK, OWN)
    env = InsertionVectorEnv(2, TASK, fidelity="fast")
    observation, _ = env.reset(seed=3)
    states, start = [None, None], np.ones(2, dtype=bool)
    done = []
    for _ in range(40):
        actions = []
        for k, policy in enumerate((guided, law)):
            action, states[k] = policy.predict(observation, states[k], start, deterministic=True)
            actions.append(action)
        assert actions[0] == pytest.approx(actions[1], abs=5e-7)  # four units of single precision
        observation, _, terminated, truncated, _ = env.step(actions[1])
        start = terminated | truncated
        start[1] |= len(done) == 30  # whoever plays may begin anew at any time
        done.append(start)
    assert np.any(done)


def test_a_correction_is_added_in_the_agent_s_own_terms() -> None:
    view = View(guide=OWN)
    guided = np.array([[0.5, -1.0], [0.9, 0.2]], dtype=np.float32)
    both = view.env_actions(TASK, np.array([[0.25, 0.5], [0.25, 0.5]]), guided)
    assert both == pytest.approx(view.env_actions(TASK, np.array([[0.75, -0.5], [1.0, 0.7]])), abs=1e-6)
    asked = view.env_actions(TASK, np.array([[0.6, -0.4], [0.7, 0.1]]))
    assert view.agent_actions(TASK, asked, guided) == pytest.approx(
        np.array([[0.1, 0.6], [-0.2, -0.1]]), abs=1e-4
    )  # an action of the environment has seven digits of the feed, its logarithm fewer


def test_a_bundle_keeps_the_law_that_it_was_trained_on(tmp_path: Path) -> None:
    saved = agent(View(guide=OWN), Network(net_arch=(8,), noise_interval=4))
    write_bundle(tmp_path / "agent.safetensors", saved.description, saved.policy)
    loaded = load_bundle(tmp_path / "agent.safetensors")
    assert loaded.description.view.guide == OWN != read_constants()
    rows = np.random.default_rng(0).uniform(0.1, 1.0, (3, len(TASK.observations)))
    assert (loaded.predict(rows, deterministic=True)[0] == saved.predict(rows, deterministic=True)[0]).all()


def test_a_guide_is_named_and_needs_its_feeds_and_its_observations() -> None:
    training = Training.model_validate({"guide": "plc-proportional"})
    assert training.view.guide == read_constants()
    assert training.view.size == View(friction_estimate=False).size + 2
    with pytest.raises(ValueError, match="guide"):
        Training.model_validate({"guide": "moon"})
    guided = agent(View(guide=OWN), Network(net_arch=(8,)))
    with pytest.raises(ValueError, match=r"feed_speeds = .* differs from .* the range of the agent's guide"):
        Agent(guided.description, guided.policy, TaskConfig(feed_speeds=(0.02, 0.3)).full_observation)
    with pytest.raises(ValueError, match="guide needs the observations root_tension, helix_diameter"):
        View(guide=OWN, observations=("inserted_length", "feed_speed", "air_supply_rate", "rf_noise"))
