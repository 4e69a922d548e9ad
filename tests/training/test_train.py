"""Training: the same seed gives the same weights, also when killed; broken settings are named before any work.

An agent of both passes acts on both, and nowhere else.
"""

import hashlib
import io
import json
import shutil
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import torch
from kills import Killed, hook_replace, killed_at, stop
from poisons import ANYWHERE, JSON, Poison, failures_of
from safetensors.numpy import load_file

from probe_agents.evaluation.plan import Plan, run_plan
from probe_agents.policies.bundle import Agent, Description, StoredNetwork, build_policy, load_bundle, write_bundle
from probe_agents.policies.catalogue import make_policy
from probe_agents.policies.fixed import Constant
from probe_agents.policies.view import View
from probe_agents.policies.wrappers import RoundTripPolicy
from probe_agents.records.result_folder import run_lock
from probe_agents.records.shipped import file_or_shipped
from probe_agents.training import train as training_module
from probe_agents.training.config import Training
from probe_agents.training.train import BEST, CHECKPOINT, CURVE, DIGEST, RUN, VALIDATED, train_all
from probe_env import Fidelity, Plant, load_contexts
from probe_env.design import RANGES
from probe_env.envs.task.config import TaskConfig
from probe_env.fidelity import ROUND_TRIP_PRESETS
from probe_env.files import FileError

COARSE = Fidelity(time_lapse=20.0)
SHORT = {"settle_time": 0.1, "time_limit": 20.0}
PPO = {
    "environment": {"num_envs": 4, "fidelity": COARSE, "task": SHORT},
    "network": {"net_arch": (8,)},
    "learning": {"n_steps": 16, "batch_size": 32, "n_epochs": 2},
    "validation": {"limit": 1, "fidelity": COARSE},
    "phases": 2,
    "phase_steps": 64,
}
IMITATING = {**PPO, "imitation": {"teacher": "slow-down", "rounds": 2, "steps": 32, "epochs": 2}}
INCREMENTAL = PPO["environment"] | {"env_id": "probe_env/IncrementalInsertion-v1"}
PRETRAINED = PPO | {"pretraining_steps": 64, "environment": INCREMENTAL}
ONE = PPO | {"phases": 1}
BACK = Fidelity(method="imex", time_step=1.25e-4, time_lapse=20.0)
BOTH = ONE | {
    "environment": PPO["environment"] | {"env_id": "probe_env/Inspection-v0", "fidelity": BACK},
    "imitation": {"teacher": "fast-in", "rounds": 1, "steps": 32, "epochs": 2},
    "validation": {"limit": 1, "fidelity": "fast"},
}
COLUMNS = ["phase", "steps", "reward", "inspection_time_s", "share_within_limit"]


def equal_weights(*folders):
    first, second = (load_file(folder / "seed-0" / BEST) for folder in folders)
    return first.keys() == second.keys() and all((first[name] == second[name]).all() for name in first)


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """Folder of a run of one phase."""
    folder = tmp_path_factory.mktemp("trained")
    train_all(Training(**ONE), folder, resume=False)
    return folder


@pytest.fixture
def run(trained, tmp_path):
    return shutil.copytree(trained, tmp_path / "run")


@pytest.fixture
def validations(monkeypatch):
    """Plans of validations, none of which is played; their rewards are -3, 2, 0.5 and 2."""
    plans, rewards = [], iter([-3.0, 2.0, 0.5, 2.0])

    def validated(plan, *_, **__):
        plans.append(plan)
        return pd.DataFrame({"reward": [next(rewards)]} | dict.fromkeys(VALIDATED, 0.0))

    monkeypatch.setattr(training_module, "run_plan", validated)
    return plans


@pytest.mark.parametrize(
    "settings",
    [PPO, pytest.param(IMITATING, marks=pytest.mark.slow), pytest.param(PRETRAINED, marks=pytest.mark.slow)],
    ids=["alone", "imitating", "pretrained"],
)
def test_resumed_equals_never_stopped(settings, tmp_path):
    """One phase, then the other by resuming, gives the weights and the curve of one go."""
    whole = train_all(Training(**settings), tmp_path / "whole", resume=False)
    train_all(Training(**settings | {"phases": 1}), tmp_path / "parts", resume=False)
    resumed = train_all(Training(**settings), tmp_path / "parts", resume=True)
    assert (whole[COLUMNS] == resumed[COLUMNS]).all(axis=None)
    assert equal_weights(tmp_path / "whole", tmp_path / "parts")
    assert json.loads((tmp_path / "parts" / "seed-0" / RUN).read_text())["config"]["phases"] == 2


def _train(folder, resume):
    train_all(Training(**PPO), folder, resume=resume)


@pytest.mark.slow
def test_training_continues_after_stops_and_kills(tmp_path, monkeypatch):
    """A run's files: run.json, then of each phase the agent, if it is the best so far, checkpoint and curve."""
    _train(tmp_path / "whole", False)
    assert killed_at("probe_agents.training.train.save_checkpoint", 2, _train, tmp_path / "killed", False)
    _train(tmp_path / "killed", True)
    assert equal_weights(tmp_path / "whole", tmp_path / "killed")
    for name, number in ((RUN, 1), (BEST, 1), (CHECKPOINT, 1), (CURVE, 1), (CHECKPOINT, 2), (CURVE, 2)):
        folder = tmp_path / f"{name}-{number}"
        with monkeypatch.context() as patch:
            hook_replace(name, number, stop, patch)
            with pytest.raises(Killed):
                _train(folder, False)
        _train(folder, True)
        assert equal_weights(tmp_path / "whole", folder), (name, number)
        assert pd.read_csv(folder / "seed-0" / CURVE)["phase"].tolist() == [1, 2]


def test_an_existing_run_is_not_overwritten_nor_mixed(run, tmp_path, monkeypatch):
    folder = tmp_path / "other" / "seed-0"
    with run_lock(folder), pytest.raises(ValueError, match="seed-0: another process is working there"):
        train_all(Training(**PPO), folder.parent, resume=False)
    assert not list(folder.iterdir())
    with run_lock(folder):
        pass
    before = (run / "seed-0" / CHECKPOINT).read_bytes()
    other = PPO | {"learning": {"n_steps": 16, "batch_size": 16}}
    for settings, resume, message in (
        (ONE, False, "continue it with --resume"),
        (ONE | {"seeds": (7, 0)}, False, "continue it with --resume"),
        (other, True, r"this agent was trained with other settings \(config\.learning\.batch_size 32, now 16; also"),
    ):
        with pytest.raises(ValueError, match=message):
            train_all(Training(**settings), run, resume=resume)
    monkeypatch.setattr("probe_agents.records.manifest.commit", lambda: "0123456789ab")
    with pytest.raises(ValueError, match=r"since this agent was trained \(commit .*, now 0123456789ab"):
        train_all(Training(**ONE), run, resume=True)
    assert not (run / "seed-7").exists()
    assert (run / "seed-0" / CHECKPOINT).read_bytes() == before


def changed(change):
    """Damage that the checksum does not show."""

    def damage(path):
        state = torch.load(io.BytesIO(path.read_bytes()[DIGEST:]), weights_only=True)
        other, content = change(state), io.BytesIO()
        torch.save(state if other is None else other, content)
        path.write_bytes(hashlib.sha256(content.getvalue()).digest() + content.getvalue())

    return damage


def first_weight(state, value):
    name = "mlp_extractor.policy_net.0.weight"
    state["parameters"]["policy"][name] = value(state["parameters"]["policy"][name])


CHECKPOINTS = {name: ANYWHERE[name] for name in ("pipe", "folder", "huge", "empty", "binary")} | {
    "a byte short": lambda path: path.write_bytes(path.read_bytes()[:-1]),
    "a list": changed(lambda state: [1]),
    "another network": changed(lambda state: first_weight(state, lambda _: torch.zeros(3, 3))),
    "fewer weights": changed(lambda state: state["parameters"]["policy"].clear()),
    "NaN": changed(lambda state: first_weight(state, lambda old: old * float("nan"))),
    "no optimiser": changed(lambda state: state["parameters"].update({"policy.optimizer": None})),
    "another count": changed(lambda state: state.update(steps=7)),
    "no rows": changed(lambda state: state.update(rows=[])),
    "another seed": changed(lambda state: state["rows"][0].update(seed=3)),
}


def test_damaged_files_are_named_and_nothing_in_them_is_run(run):
    def resume(_):
        train_all(Training(**ONE), run, resume=True)

    record, checkpoint, victim = (run / "seed-0" / name for name in (RUN, CHECKPOINT, "victim"))
    another = {"another": lambda path: path.write_text('{"seed": 0}')}
    assert failures_of(record, JSON | another, resume) == []
    code = {"code": changed(lambda state: Poison(victim))}
    assert failures_of(checkpoint, CHECKPOINTS | code, resume) == []
    assert not victim.exists()
    record.unlink()
    with pytest.raises(FileError, match=str(record)):
        resume(run)


def test_flipped_bits_of_a_checkpoint_are_refused(run):
    path, rng = run / "seed-0" / CHECKPOINT, np.random.default_rng(0)
    content = path.read_bytes()
    for position in rng.choice(8 * len(content), size=100, replace=False).tolist():
        damaged = bytearray(content)
        damaged[position // 8] ^= 1 << position % 8
        path.write_bytes(damaged)
        with pytest.raises(FileError, match=r"checkpoint\.pt: not a complete checkpoint .* its checksum does not fit"):
            training_module.restore(SimpleNamespace(seed=0), path)


@pytest.mark.slow
def test_an_agent_of_random_probes_is_validated_on_random_probes(tmp_path, validations):
    environment = PPO["environment"] | {"probes": "random", "task": SHORT | {"observe_probe": True}}
    train_all(Training(**ONE | {"environment": environment}), tmp_path, resume=False)
    assert [plan.probes for plan in validations] == ["random"]
    agent = load_bundle(tmp_path / "seed-0" / BEST)
    assert set(RANGES) < set(agent.description.view.observations)
    with pytest.raises(ValueError, match=r"guide_length.* are not observed in this task"):
        load_bundle(tmp_path / "seed-0" / BEST, TaskConfig())


BACK_TOO = "[environment]\nenv_id = 'probe_env/Inspection-v0'"
BROKEN = {
    "algorithm = 'sac'": "algorithm: Input should be 'ppo'",
    "seeds = [1, 1]": "seeds = ",
    "seeds = [-1]": "seeds.0",
    "phases = 0": "means no training",
    "averages = [0.0]": "averages",
    "colour = 1": "colour",
    "[learning]\nmomentum = 1": "learning.momentum: there is no such field",
    "[learning]\nuse_sde = true": "learning.use_sde",
    "[learning]\nbatch_size = 1": "learning.batch_size: ",
    "[learning]\ngamma = 1.5": "gamma: 1.5 is outside the accepted range 0 to 1",
    "[network]\nnet_arch = [1000000]": "network.net_arch",
    "[environment]\nfidelity = 'fastest'": "fidelity = 'fastest'",
    "[environment]\nfidelity = { time_lapse = 16.0 }": "not a whole number",
    f"{BACK_TOO}\nfidelity = 'reference'": "superelement does not simulate withdrawal; give one of",
    f"{BACK_TOO}\nfidelity = 'fast'\n[validation]\nfidelity = {{}}": "superelement32 does not simulate withdrawal;",
    "[environment]\ncontexts = 'all'": "environment.contexts",
    "[environment]\nenv_id = 'CartPole-v1'": "environment.env_id",
    "[environment.task]\nperiods = 1.0": "periods",
    "[imitation]\nteacher = 'nobody'": "imitation.teacher: ",
    "pretraining_steps = 64\n[imitation]\nrounds = 1": "pretraining_steps and [imitation] exclude each other",
    "least_air_supply_rate = 0.01\n[environment]\nenv_id = 'probe_env/IncrementalInsertion-v1'": "targets for one",
    "[validation]\nlimit = -1": "validation.limit",
    "seeds = [": "not a TOML file",
}


def test_broken_files_are_named_before_any_work(tmp_path, refused):
    path = tmp_path / "broken.toml"
    for text, message in BROKEN.items():
        path.write_text(text.replace("'", '"'))
        refused(["train", path, "--output", "run"], message, str(path))


def test_a_teacher_uses_the_map_of_the_plant(tmp_path):
    file, imitation = file_or_shipped("tubes", "snr"), {"teacher": "tension-scheduled"}
    with pytest.raises(ValueError, match="the map is of displacement"):
        Training.model_validate({"environment": {"tube": Plant.from_toml(file)}, "imitation": imitation})
    training = Training.model_validate({"environment": {"tube": str(file)}, "imitation": imitation})
    assert training.teacher.describe()["policy"]
    assert training.task.vibration_measure == "snr"
    assert Training.model_validate_json(training.model_dump_json()) == training


@pytest.mark.slow
@pytest.mark.processor
def test_short_training_beats_constant_and_no_training(tmp_path):
    """The shipped recipe with a tiny budget and fixed seeds: warm start, then PPO.

    Against 0.2 m/s and its own first weights, which in this range feed at 0.2 m/s, too: what is better is learnt. (PPO
    alone learns nothing in so few steps.)
    """
    lapse, task = Fidelity(time_lapse=10.0), {"settle_time": 0.5, "feed_speeds": (0.1, 0.4)}
    training = Training(
        environment={"num_envs": 8, "fidelity": lapse, "task": task, "reward_scale": 0.2},
        network={"net_arch": (32,)}, phases=1, phase_steps=512, averages=(5.0,), friction_estimate=True,
        least_air_supply_rate=0.0201389,
        learning={"n_steps": 64, "batch_size": 128, "n_epochs": 4, "learning_rate": 1e-4, "gamma": 0.99},
        imitation={"teacher": "tension-scheduled", "rounds": 1, "steps": 1536, "epochs": 30},
        validation={"limit": 1, "fidelity": COARSE},
    )  # fmt: skip
    train_all(training, tmp_path, resume=False)
    config = TaskConfig(**task)
    agent = load_bundle(tmp_path / "seed-0" / BEST, config)
    torch.manual_seed(0)
    untrained = Agent(agent.description, build_policy(agent.description), config, "untrained")
    policies = {"trained": agent, "untrained": untrained, "constant": Constant(config)}
    plan = Plan(policies, load_contexts("test")[:2], (0,), config, lapse)
    reward = run_plan(plan, tmp_path / "evaluation", progress=False).groupby("policy")["reward"].mean()
    assert reward["trained"] > reward["constant"]
    assert reward["trained"] > reward["untrained"]


@pytest.mark.slow
def test_agent_of_both_passes_acts_in_both(tmp_path, validations, monkeypatch):
    """In a helix of 8 m, begun at 5 m: what it says on the way back is what is done there."""
    train_all(Training(**BOTH), tmp_path, resume=False)
    # in an insertion ``fast`` cannot go back
    assert {plan.fidelity for plan in validations} == {ROUND_TRIP_PRESETS["fast"]}
    path, scene = str(tmp_path / "seed-0" / BEST), {"tube": {"helix_length": 8.0}}
    task = TaskConfig(passes="both", scored_pass="withdrawal", scene=scene, time_limit=100.0)
    config = task.full_observation
    agent = make_policy(path, config)
    assert isinstance(agent, Agent)
    asked, predict, way = [], agent.predict, list(config.observations).index("direction")

    def recorded(observation, state=None, episode_start=None, deterministic=False):
        rows = np.atleast_2d(observation)
        asked.extend(rows[:, way].tolist())
        actions, state = predict(observation, state, episode_start, deterministic)
        return np.where(rows[:, [way]] < 0.0, config.action(0.4, 0.02), actions).astype(np.float32), state

    monkeypatch.setattr(agent, "predict", recorded)
    table = run_plan(Plan({"agent": agent}, load_contexts("test")[:1], (0,), config, BACK), None)
    assert {1.0, -1.0} <= set(asked)
    assert bool(table["complete"].all())
    with pytest.raises(FileError, match=r'observations = direction are not .*; "direction" needs passes ='):
        make_policy(path, TaskConfig().full_observation)
    with pytest.raises(ValueError, match=r"policy = 'shielded:.*safetensors': the shield acts on the insertion"):
        make_policy(f"shielded:{path}", config)


def test_agent_of_both_passes_from_a_bundle(tmp_path):
    task, path = TaskConfig(passes="both"), tmp_path / "agent.safetensors"
    view = View(observations=tuple(task.observations))
    description = Description(algorithm="ppo", network=StoredNetwork(net_arch=(8,)), view=view, task=task, trained={})
    write_bundle(path, description, build_policy(description))
    config = task.full_observation
    policy = make_policy(str(path), config)
    assert isinstance(make_policy("ppo", config), RoundTripPolicy)
    assert policy.domain.helix_length == 60.0
    rows = np.random.default_rng(0).uniform(-1.0, 1.0, (3, len(config.observations))).astype(np.float32)
    actions, state = policy.predict(rows, deterministic=True)
    one, _ = policy.predict(rows[0], deterministic=True)
    np.testing.assert_allclose(one, actions[0], rtol=0, atol=1e-6)  # a row's and a table's sums, in single precision
    later, _ = policy.predict(rows, state, np.zeros(3, dtype=bool), deterministic=True)
    assert later.shape == (3, 2)


def test_imitation_data_and_returns():
    """Two environments that count their steps; the second one ends with the second of three steps."""
    ends = np.array([[False, False], [False, True], [False, False]])
    observed = [np.array([[k, 0.0], [k, 1.0]], dtype=np.float32) for k in range(4)]
    steps = iter([(observed[k], np.array([1.0, 10.0]) * k, ended, None) for k, ended in enumerate(ends, start=1)])
    env = SimpleNamespace(num_envs=2, reset=lambda: observed[0], step=lambda _: next(steps), config=None, rows=None)
    env.view = SimpleNamespace(agent_actions=lambda config, action: action)
    taught = iter([2.0 * rows for rows in observed])
    teacher = SimpleNamespace(predict=lambda *_, **__: (next(taught), None))
    policy = SimpleNamespace(predict_values=lambda features: torch.tensor([[100.0], [1000.0]]))
    model = SimpleNamespace(policy=policy, gamma=0.5)
    features, labels, returns = training_module._gather(model, env, teacher, 3, True, lambda steps: None)
    assert (labels == 2.0 * features).all()
    assert features[:, 0].tolist() == [0, 0, 1, 1, 2, 2]
    first = [1.0 + 0.5 * (2.0 + 0.5 * (3.0 + 50.0)), 2.0 + 0.5 * (3.0 + 50.0), 3.0 + 50.0]
    second = [10.0 + 0.5 * 20.0, 20.0, 30.0 + 500.0]
    assert returns.reshape(3, 2).T.tolist() == [first, second]


def test_agent_of_the_best_validation_is_kept(tmp_path, validations):
    """An equal reward later does not replace it."""
    train_all(Training(**PPO | {"phases": 4}), tmp_path, resume=False)
    assert load_bundle(tmp_path / "seed-0" / BEST).description.trained["phase"] == 2


@pytest.mark.slow
def test_the_training_file_ppo_gives_the_same_weights_again(tmp_path):
    """Mean magnitudes of the weights after two rollouts; other processors change them by less than 1e-5."""
    settings = {"seeds": (0,), "pretraining_steps": 4096, "phases": 0, "validation": {"limit": 1, "fidelity": COARSE}}
    training = Training.from_toml(file_or_shipped("train", Path("ppo"))).model_copy(update=settings)
    for folder in ("first", "second"):
        train_all(training, tmp_path / folder, resume=False)
    assert equal_weights(tmp_path / "first", tmp_path / "second")
    weights = load_file(tmp_path / "first" / "seed-0" / BEST)
    means = {
        "action_net.bias": 0.0059763463, "action_net.weight": 0.0063553136, "log_std": 0.024412012,
        "mlp_extractor.policy_net.0.bias": 0.0039305873, "mlp_extractor.policy_net.2.bias": 0.0034556356,
        "mlp_extractor.value_net.0.bias": 0.018715873, "value_net.weight": 0.13237238,
    }  # fmt: skip
    assert {name: np.abs(weights[name]).mean() for name in means} == pytest.approx(means, rel=1e-4)
