"""Commands that must refuse a file, and what is to be damaged: a stored evaluation, a trained agent, a bundle."""

import json
import shutil

import pytest
import torch
from poisons import KPIS, POLICIES, fingerprint

from agents.cli import main
from agents.policies.bundle import Description, Network, build_policy, save_bundle
from agents.policies.catalogue import named_policies
from agents.policies.view import View
from agents.rollouts.plan import Plan, run_plan
from probe_env.envs.contexts import spread_contexts
from probe_env.envs.task import TaskConfig
from probe_env.fidelity import resolve_fidelity


@pytest.fixture
def refused(tmp_path, capsys, monkeypatch):
    """Run a command that must be refused in one line about a file, and change nothing."""
    monkeypatch.chdir(tmp_path)

    def run(arguments, *messages):
        before = fingerprint(tmp_path)
        assert main(list(map(str, arguments))) == 2
        printed = capsys.readouterr()
        assert printed.out == ""
        assert printed.err.count("\n") == 1, printed.err
        assert printed.err.startswith("probe-env: error: ")
        assert printed.err.strip().isprintable()
        for text in messages:
            assert text in printed.err
        assert fingerprint(tmp_path) == before
        return printed.err

    return run


@pytest.fixture(scope="session")
def evaluation(tmp_path_factory):
    """A whole evaluation whose episodes nobody simulated: each has the figures of its place."""
    folder = tmp_path_factory.mktemp("stored") / "evaluation"
    config = TaskConfig().all_shown
    policies, fidelity = named_policies(POLICIES, config), resolve_fidelity("fast")
    plan = Plan(policies, spread_contexts("test", 2), (0,), config, fidelity)
    folder.mkdir()
    (folder / "setting.json").write_text(json.dumps(plan.setting()))
    columns = ("time", "inserted_length", "feed_speed", "air_supply_rate", "radial_rms_m", "tension_mean_n")
    lines = []
    for k, unit in enumerate(plan.units()):
        kpis = dict.fromkeys(KPIS, 1.0 + 0.1 * k) | {"lost_drive": 0.0, "diverged": 0.0, "complete": 1.0}
        profile = {name: [1.0, 2.0, 3.0 + k] for name in columns}
        lines.append(json.dumps({"key": plan.key(unit), "unit": unit, "kpis": kpis, "profile": profile}))
    (folder / "episodes.jsonl").write_text("\n".join(lines) + "\n")
    run_plan(plan, folder, progress=False)
    (folder / "report.json").write_text('{"against": "constant"}')
    return folder


@pytest.fixture
def stored(evaluation, tmp_path):
    return shutil.copytree(evaluation, tmp_path / "evaluation")


@pytest.fixture(scope="session")
def bundle(tmp_path_factory):
    path = tmp_path_factory.mktemp("bundle") / "agent.npz"
    torch.manual_seed(0)
    description = Description(
        algorithm="ppo", network=Network(net_arch=(8,)), view=View(averages=(5.0,)), task=TaskConfig(), trained={}
    )  # fmt: skip
    save_bundle(path, description, build_policy(description))
    return path
