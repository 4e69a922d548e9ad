"""Training: the same seed gives the same weights, also when killed; broken settings are named before any work."""

import numpy as np
import pandas as pd
import pytest
import torch
from agents.rollouts.plan import Plan, run_plan
from kills import kill, killed, killed_at

from agents.cli import main
from agents.learning.alone import alone_in
from agents.learning.config import Training
from agents.learning.train import BEST, CHECKPOINT, CURVE, train_all
from agents.policies.bundle import Agent, build_policy, load_bundle
from agents.policies.fixed import Constant
from probe_env import Fidelity, load_contexts
from probe_env.design import RANGES
from probe_env.envs.task import TaskConfig

COARSE = Fidelity(time_lapse=20.0)
LAPSE = Fidelity(time_lapse=10.0)
SHORT = {"settle_time": 0.1, "time_limit": 20.0}
TINY = {
    "environment": {"num_envs": 4, "fidelity": COARSE, "task": SHORT},
    "network": {"net_arch": (8,)},
    "validation": {"limit": 1, "fidelity": COARSE},
    "phases": 2,
    "phase_steps": 64,
}
PPO = {**TINY, "learning": {"n_steps": 16, "batch_size": 32, "n_epochs": 2}}
IMITATING = {**PPO, "imitation": {"teacher": "slow-down", "rounds": 2, "steps": 32, "epochs": 2}}
GUIDED = {
    **PPO, "guide": "plc-law", "network": {"net_arch": (8,), "noise_interval": 4},
    "imitation": {"teacher": "plc-law", "rounds": 1, "steps": 32, "epochs": 2},
}  # fmt: skip
RECURRENT = {**PPO, "algorithm": "recurrent-ppo"}
SAC = {**TINY, "algorithm": "sac", "learning": {"learning_starts": 16, "buffer_size": 256, "batch_size": 8}}


VALIDATED = pd.DataFrame(
    {"reward": [1.0], "inspection_time_s": [1.0], "share_within_limit": [1.0], "diverged": [0.0]}
)  # fmt: skip


def weights(folder):
    with np.load(folder / "seed-0" / BEST) as file:
        return {name: file[name] for name in file.files if name.startswith("weight:")}


def equal(first, second):
    return first.keys() == second.keys() and all((first[name] == second[name]).all() for name in first)


@pytest.mark.parametrize("settings", [IMITATING, GUIDED, RECURRENT, SAC], ids=["ppo", "guided", "recurrent-ppo", "sac"])
def test_resumed_equals_never_stopped(settings, tmp_path):
    """Half of the phases, then the rest by resuming, gives the weights and the curve of one go."""
    one_go = train_all(Training(**settings), tmp_path / "whole", resume=False)
    half = Training(**settings | {"phases": 1})
    train_all(half, tmp_path / "parts", resume=False)
    resumed = train_all(Training(**settings), tmp_path / "parts", resume=True)
    columns = ["phase", "steps", "reward", "inspection_time_s", "share_within_limit"]
    assert (one_go[columns] == resumed[columns]).all(axis=None)
    assert equal(weights(tmp_path / "whole"), weights(tmp_path / "parts"))
    agent = load_bundle(tmp_path / "whole" / "seed-0" / BEST)
    action, _ = agent.predict(np.full(len(agent.config.observations), 0.5, dtype=np.float32), deterministic=True)
    assert (np.abs(action) <= 1.0).all()


def _hold_and_kill(folder):
    with alone_in(folder):
        kill()


def test_one_training_a_folder(tmp_path):
    """Another is refused before anything is written; one that was killed holds nothing."""
    folder = tmp_path / "seed-0"
    with alone_in(folder), pytest.raises(ValueError, match="seed-0: another process trains there"):
        train_all(Training(**PPO), tmp_path, resume=False)
    assert not list(folder.iterdir())
    killed(_hold_and_kill, folder)
    with alone_in(folder):
        pass
    assert not list(folder.iterdir())


def _train(folder, resume):
    train_all(Training(**IMITATING), folder, resume=resume)


@pytest.fixture(scope="module")
def never_killed(tmp_path_factory):
    """Folder of a run of three phases that nothing disturbed."""
    folder = tmp_path_factory.mktemp("whole")
    _train(folder, False)
    return folder


@pytest.mark.parametrize("number", range(1, 11))
def test_killed_before_any_file_is_in_its_place_it_goes_on(number, never_killed, tmp_path):
    """A run's files: run.json, then of each phase the agent, if it is the best so far, the curve and the checkpoint.

    What a kill elsewhere leaves is what one of these leaves: nothing else is kept.
    """
    folder = tmp_path / "killed"
    was_killed = killed_at("os.replace", number, _train, folder, False, within=str(folder))
    files = len(list(never_killed.glob("seed-0/*.*")))
    assert was_killed or number > 1 + 2 * (files - 1)
    _train(folder, True)
    assert equal(weights(never_killed), weights(folder))
    assert pd.read_csv(folder / "seed-0" / CURVE)["phase"].tolist() == [0, 1, 2]


def test_an_agent_of_random_probes_is_validated_on_random_probes(tmp_path, monkeypatch):
    """With what the design space says of the probe among its features."""
    plans = []
    monkeypatch.setattr("agents.learning.train.run_plan", lambda plan, *_, **__: plans.append(plan) or VALIDATED)
    environment = PPO["environment"] | {"probes": "random", "task": SHORT | {"observe_probe": True}}
    train_all(Training(**PPO | {"environment": environment, "phases": 1}), tmp_path, resume=False)
    assert [plan.probes for plan in plans] == ["random"]
    agent = load_bundle(tmp_path / "seed-0" / BEST)
    assert set(RANGES) < set(agent.description.view.observations)
    with pytest.raises(ValueError, match=r"guide_length.* not shown by this task"):
        load_bundle(tmp_path / "seed-0" / BEST, TaskConfig())


def test_an_existing_run_is_not_overwritten_nor_mixed(tmp_path):
    training = Training(**PPO | {"phases": 1})
    train_all(training, tmp_path, resume=False)
    before = (tmp_path / "seed-0" / CHECKPOINT).read_bytes()
    with pytest.raises(ValueError, match="give --resume"):
        train_all(training, tmp_path, resume=False)
    both = Training(**PPO | {"phases": 1, "seeds": (7, 0)})
    with pytest.raises(ValueError, match="give --resume"):
        train_all(both, tmp_path, resume=False)
    assert not (tmp_path / "seed-7").exists()
    other = Training(**PPO | {"learning": {"n_steps": 16, "batch_size": 16}})
    with pytest.raises(ValueError, match=r"other settings \(learning\)"):
        train_all(other, tmp_path, resume=True)
    assert (tmp_path / "seed-0" / CHECKPOINT).read_bytes() == before


BROKEN = {
    "algorithm = 'a2c'": "algorithm: ",
    "seeds = [1, 1]": "seeds = ",
    "seeds = []": "seeds = ",
    "seeds = [-1]": "seeds.0",
    "phases = -1": "phases: ",
    "phases = 0": "leaves nothing to train",
    "phase_steps = 0": "phase_steps",
    "averages = [0.0]": "averages",
    "colour = 1": "colour",
    "[learning]\nmomentum = 1": "learning.momentum is not one of ppo's",
    "[learning]\npolicy = 1": "learning.policy",
    "[learning]\nuse_sde = true": "learning.use_sde",
    "[learning]\nbatch_size = 1": "learning.batch_size = 1",
    "[environment]\nenv_id = 'probe_env/Snapshot-v1'": "needs a growing probe",
    "[network]\nnet_arch = [1000000]": "network.net_arch",
    "[environment]\nnum_envs = 0": "environment.num_envs",
    "[environment]\nfidelity = 'fastest'": "fidelity = 'fastest'",
    "[environment]\nfidelity = { time_lapse = 16.0 }": "not a whole number",
    "[environment]\ncontexts = 'all'": "environment.contexts",
    "[environment]\nenv_id = 'CartPole-v1'": "environment.env_id",
    "[environment.task]\nperiods = 1.0": "periods",
    "[network]\nnet_arch = ['wide']": "network.net_arch",
    "algorithm = 'sac'\n[imitation]\nrounds = 1": "imitation needs algorithm = 'ppo'",
    "[imitation]\nrounds = 0": "imitation.rounds",
    "[imitation]\nteacher = 'nobody'": "teacher",
    "[validation]\nlimit = -1": "validation.limit",
    "seeds = [": "not a TOML file",
}


@pytest.mark.parametrize("text", BROKEN)
def test_broken_files_are_named_before_any_work(text, tmp_path, capsys):
    path = tmp_path / "broken.toml"
    path.write_text(text.replace("'", '"'))
    assert main(["train", str(path), "--output", str(tmp_path / "run")]) == 2
    printed = capsys.readouterr().err
    assert BROKEN[text] in printed
    assert str(path) in printed
    assert not (tmp_path / "run").exists()


@pytest.mark.processor
def test_smoke_training_beats_the_study_s_constant_and_no_training(tmp_path):
    """The shipped recipe with a tiny budget and fixed seeds: warm start, then PPO.

    Against 0.2 m/s and its own first weights, which in this range feed at 0.2 m/s, too: what is better is learnt. (PPO
    alone learns nothing in so few steps.)
    """
    task = {"settle_time": 0.5, "feed_speeds": (0.1, 0.4)}
    training = Training(
        environment={"num_envs": 8, "fidelity": LAPSE, "task": task, "reward_scale": 0.2},
        network={"net_arch": (32,)}, phases=1, phase_steps=512, averages=(5.0,), friction_estimate=True,
        learning={"n_steps": 64, "batch_size": 128, "n_epochs": 4, "learning_rate": 1e-4, "gamma": 0.99},
        imitation={"teacher": "tension-scheduled", "rounds": 1, "steps": 1536, "epochs": 30},
        validation={"limit": 1, "fidelity": COARSE},
    )  # fmt: skip
    train_all(training, tmp_path, resume=False)
    config = TaskConfig(**task)
    trained = load_bundle(tmp_path / "seed-0" / BEST, config)
    torch.manual_seed(0)
    untrained = Agent(trained.description, build_policy(trained.description), config, "untrained")
    policies = {"trained": trained, "untrained": untrained, "constant": Constant(config)}
    plan = Plan(policies, load_contexts("test")[:2], (0,), config, LAPSE)
    reward = run_plan(plan, tmp_path / "evaluation", progress=False).groupby("policy")["reward"].mean()
    print(reward)
    assert reward["trained"] > reward["constant"]
    assert reward["trained"] > reward["untrained"]
