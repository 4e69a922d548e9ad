"""With the lowest versions that pyproject.toml accepts: an environment, a short training, an evaluation, a log."""

import tomllib
from importlib.metadata import version
from itertools import chain
from pathlib import Path

import gymnasium as gym
import pandas as pd
import pytest
from gymnasium.utils.env_checker import check_env
from packaging.requirements import Requirement
from packaging.version import Version
from stable_baselines3.common.env_checker import check_env as sb3_check_env

import probe_env
from probe_agents.cli import main

ROOT = Path(__file__).parents[2]
NEWER = {"torch"}
"""Not the lowest: for Linux the index has torch with CUDA alone, gigabytes of it."""
TRAINING = """
seeds = [0]
phases = 1
phase_steps = 64
[environment]
num_envs = 4
fidelity = "surrogate"
task = { time_limit = 20.0 }
[network]
net_arch = [8]
[validation]
limit = 1
fidelity = "fast"
[learning]
n_steps = 16
batch_size = 32
"""


def test_the_versions_are_the_lowest():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = (project["optional-dependencies"][name] for name in ("agents", "app", "commands", "plant"))
    required = [one for one in map(Requirement, chain(project["dependencies"], *extras)) if one.name != "probe-env"]
    floors = {one.name: next(each.version for each in one.specifier if each.operator == ">=") for one in required}
    assert {name for name, floor in floors.items() if Version(version(name)) > Version(floor)} == NEWER


@pytest.mark.parametrize("fidelity", ["fast", "surrogate"])
def test_the_checkers_find_nothing(fidelity):
    env = gym.make("probe_env/Insertion-v1", fidelity=fidelity, contexts=[probe_env.Context()]).unwrapped
    check_env(env, skip_render_check=True)
    sb3_check_env(env)


def test_commands_train_evaluate_and_read_a_log(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("short.toml").write_text(TRAINING)
    for line in (
        "train short.toml --output trained",
        "evaluate constant trained/seed-0/agent.safetensors --limit 1 --fidelity fast --output evaluation",
        "log example-rig --plot log.png",
        "calibrate example-rig --output calibration",
    ):
        assert main(line.split()) == 0, line
    episodes = pd.read_csv("evaluation/episodes.csv")
    assert episodes["policy"].tolist() == ["constant", "agent"]
    assert episodes["inspected_share"][0] == pytest.approx(1.0)
