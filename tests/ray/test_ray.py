"""On a real Ray cluster of several nodes, with gymnasium 1.2.2: equal results, a lost node costs time alone."""

import os
import re
import threading
import time
from pathlib import Path

import gymnasium as gym
import pytest
import ray
from gymnasium.utils.env_checker import check_env
from ray.cluster_utils import Cluster

import probe_env
from probe_agents.design.trials import DesignProblem
from probe_agents.evaluation.plan import Plan, run_plan
from probe_agents.evaluation.workers import Workers
from probe_agents.policies.fixed import Constant
from probe_agents.training.config import Training
from probe_agents.training.train import BEST, train_all
from probe_env import Context, Design, Fidelity, load_contexts
from probe_env.envs.task.config import TaskConfig

ROOT = Path(__file__).parents[2]
CONFIG = TaskConfig(growing=False, period=0.1, time_limit=0.3, settle_time=0.1)
COARSE = Fidelity(time_lapse=20.0)


@pytest.fixture
def cluster():
    """A head that takes no work and two nodes of one CPU each."""
    local = Cluster(initialize_head=True, head_node_args={"num_cpus": 0})
    local.nodes = [local.add_node(num_cpus=1) for _ in range(2)]
    local.wait_for_nodes()
    yield local
    ray.shutdown()
    local.shutdown()


def test_gymnasium_is_the_one_that_rllib_pins():
    assert gym.__version__ == "1.2.2"
    assert probe_env.__all__
    for name in ("Insertion", "Snapshot", "Design"):
        check_env(gym.make(f"probe_env/{name}-v1").unwrapped, skip_render_check=True)


def test_an_evaluation_on_the_cluster_equals_the_local_one(cluster, tmp_path):
    policies = {f"{u}": Constant(CONFIG, feed_speed=u) for u in (0.1, 0.2)}
    plan = Plan(policies, load_contexts("validation")[:4], (0,), CONFIG)
    here = run_plan(plan, tmp_path / "here", progress=False)
    there = run_plan(plan, tmp_path / "there", workers=Workers(2, "ray", cluster.address))
    assert there.equals(here)


def test_designs_on_the_cluster_equal_the_local_ones(cluster):
    problem = DesignProblem((Context(), Context(friction=0.2)), "constant")
    point = Design().model_dump()
    assert problem.value(point, Workers(2, "ray", cluster.address)) == problem.value(point)


def test_training_on_the_cluster_equals_the_local_one(cluster, tmp_path):
    training = Training(
        seeds=(0, 1), phases=1, phase_steps=32, learning={"n_steps": 8, "batch_size": 16}, network={"net_arch": (8,)},
        environment={"num_envs": 2, "fidelity": COARSE, "task": {"settle_time": 0.1, "time_limit": 20.0}},
        validation={"limit": 1, "fidelity": COARSE},
    )  # fmt: skip
    there = train_all(training, tmp_path / "there", False, Workers(2, "ray", cluster.address))
    here = train_all(training, tmp_path / "here", False)
    columns = ["seed", "phase", "steps", "reward", "inspection_time_s"]
    assert (there[columns] == here[columns]).all(axis=None)
    assert (tmp_path / "there" / "seed-1" / BEST).exists()


def test_dead_node_of_the_cluster_changes_no_result(cluster):
    def slowly(task):  # inside, so that it travels by value: workers do not have this file
        time.sleep(0.5)
        return 10 * task

    for moment in (0.0, 0.2, 0.5, 1.0, 2.0, 3.5):  # while workers start, and while they work [s]
        kill = threading.Timer(moment, cluster.remove_node, cluster.nodes[:1], {"allow_graceful": False})
        kill.start()
        results = sorted(Workers(2, "ray", cluster.address).map(slowly, range(16)))
        assert results == [(k, 10 * k) for k in range(16)]
        kill.join()
        cluster.nodes = [*cluster.nodes[1:], cluster.add_node(num_cpus=1)]


def test_errors_of_tasks_on_the_cluster_are_the_local_ones(cluster):
    """A task that always ends its worker is one, too."""
    workers = Workers(2, "ray", cluster.address)
    with pytest.raises(ValueError, match=r"^could not convert string to float: 'x'$") as caught:
        list(workers.map(float, ["1", "x"]))
    assert "probe_agents" in str(caught.value.__cause__)  # the trace
    with pytest.raises(RuntimeError, match="no result of a task after 5 attempts: The worker died"):
        list(workers.map(os._exit, [1]))


def test_the_rllib_example_trains():
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "policies.md").read_text(), re.DOTALL)
    (example,) = (block for block in blocks if "rllib" in block)
    space = {}
    exec(compile(example, "docs/policies.md", "exec"), space)
    assert space["result"]["env_runners"]["num_env_steps_sampled_lifetime"] > 0
