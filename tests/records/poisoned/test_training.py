"""Damaged runs and checkpoints of training: one line that names the file, and nothing is unpickled."""

import json
import shutil
import zipfile
from pathlib import Path

import pytest
import torch
from poisons import ANYWHERE, JSON

from agents.cli import main
from agents.learning.checkpoints import RUN
from agents.learning.config import Training
from agents.learning.train import CHECKPOINT, train_all

TRAINING = """
phases = 1
phase_steps = 64
averages = [5.0]
[environment]
num_envs = 4
fidelity = { time_lapse = 20.0 }
[environment.task]
settle_time = 0.1
time_limit = 20.0
[network]
net_arch = [8]
[validation]
limit = 1
fidelity = { time_lapse = 20.0 }
[learning]
n_steps = 16
batch_size = 32
n_epochs = 1
"""


@pytest.fixture(scope="session")
def trained(tmp_path_factory):
    folder = tmp_path_factory.mktemp("trained")
    (folder / "train.toml").write_text(TRAINING)
    train_all(Training.from_toml(folder / "train.toml"), folder / "run", resume=False)
    return folder


@pytest.fixture
def run(trained, tmp_path):
    return shutil.copytree(trained, tmp_path / "trained")


def resumed(run):
    return ["train", run / "train.toml", "--output", run / "run", "--resume"]


@pytest.mark.parametrize("damage", [*JSON, "missing", "another seed's settings"])
def test_notes_of_runs(damage, run, refused):
    path = run / "run" / "seed-0" / RUN
    others = {"missing": Path.unlink, "another seed's settings": lambda path: path.write_text('{"seed": 0}')}
    (JSON | others)[damage](path)
    refused(resumed(run), str(path))


class Poison:
    """Unpickled, it would write a file."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return (open, (str(self.path), "w"))


def state_changed(change):
    def damage(path):
        state = torch.load(path, weights_only=True)
        change(state)
        torch.save(state, path)

    return damage


def first_weight(state, value):
    name = "mlp_extractor.policy_net.0.weight"
    state["parameters"]["policy"][name] = value(state["parameters"]["policy"][name])


def optimiser_state(state, value):
    entry = state["parameters"]["policy.optimizer"]["state"][0]
    entry["exp_avg"] = value(entry["exp_avg"])


def other_archive(path):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("archive/data.pkl", b"\0" * (1 << 25))


CHECKPOINTS = {name: ANYWHERE[name] for name in ("pipe", "folder", "huge", "empty", "binary")} | {
    "cut off": lambda path: path.write_bytes(path.read_bytes()[: path.stat().st_size // 2]),
    "a byte short": lambda path: path.write_bytes(path.read_bytes()[:-1]),
    "a bomb": other_archive,
    "a list": lambda path: torch.save([1], path),
    "nothing": lambda path: torch.save({}, path),
    "code": lambda path: torch.save(Poison(path.with_name("victim")), path),
    "another network": state_changed(lambda state: first_weight(state, lambda _: torch.zeros(3, 3))),
    "fewer weights": state_changed(lambda state: state["parameters"]["policy"].popitem()),
    "NaN": state_changed(lambda state: first_weight(state, lambda old: old * float("nan"))),
    "double": state_changed(lambda state: first_weight(state, lambda old: old.double())),
    "complex": state_changed(lambda state: first_weight(state, lambda old: old + 1j)),
    "a number for weights": state_changed(lambda state: first_weight(state, lambda _: 1.0)),
    "a huge view": state_changed(lambda state: optimiser_state(state, lambda _: torch.zeros(1).expand(10**12))),
    "NaN in the optimiser": state_changed(lambda state: optimiser_state(state, lambda old: old * float("nan"))),
    "other optimiser": state_changed(
        lambda state: state["parameters"]["policy.optimizer"]["param_groups"][0].update(betas=(0.1, 0.2))
    ),
    "an attribute": state_changed(lambda state: state["counts"].update(policy=1)),
    "a count of truths": state_changed(lambda state: state["counts"].update(num_timesteps=True)),
    "another count": state_changed(lambda state: state["counts"].update(num_timesteps=7)),
    "no rows": state_changed(lambda state: state.update(rows=[])),
    "rows of text": state_changed(lambda state: state.update(rows=["a"])),
    "another seed": state_changed(lambda state: [row.update(seed=3) for row in state["rows"]]),
    "a phase too few": state_changed(lambda state: state["rows"].append(state["rows"][0])),
    "other settings": state_changed(lambda state: state.update(config=_settings(gamma=0.5))),
    "settings of text": state_changed(lambda state: state.update(config="{")),
}


def _settings(**learning):
    training = Training.model_validate_json(json.dumps({"learning": {"n_steps": 16, "batch_size": 32} | learning}))
    return training.model_dump_json()


@pytest.mark.parametrize("damage", CHECKPOINTS)
def test_checkpoints(damage, run, refused):
    path = run / "run" / "seed-0" / CHECKPOINT
    CHECKPOINTS[damage](path)
    refused(resumed(run), str(path))
    assert not path.with_name("victim").exists()


def test_the_whole_checkpoint_goes_on(run):
    assert main(list(map(str, resumed(run)))) == 0
