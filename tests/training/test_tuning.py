"""The search for hyperparameters: killed equals never killed, hopeless trainings end early, what it found is a file."""

import inspect
import json
import os
import signal

import numpy as np
import pandas as pd
import pytest
from kills import killed_at

from probe_agents.cli import main
from probe_agents.policies.bundle import ALGORITHMS
from probe_agents.records.locks import run_lock
from probe_agents.records.shipped import file_or_shipped
from probe_agents.training import tuning as module
from probe_agents.training.config import LIMITS, ROLLOUT, USUAL, Range, Training, axes_of
from probe_agents.training.train import CHECKPOINT, RUN
from probe_agents.training.tuning import STARTUP_TRIALS, Tuning, search
from probe_env.files import FileError

FILE = """
seeds = [3, 4]
phases = 3
phase_steps = 32
averages = [5.0]
[environment]
num_envs = 4
fidelity = { time_lapse = 20.0 }
task = { settle_time = 0.1, time_limit = 20.0 }
[network]
net_arch = [8]
[learning]
n_steps = 8
batch_size = 16
n_epochs = 1
learning_rate = 1e-3
[validation]
limit = 1
fidelity = { time_lapse = 20.0 }
"""
SPACE = """
[search]
learning.learning_rate = { low = 1e-5, high = 1e-1, log = true }
learning.n_epochs = { low = 1, high = 3 }
learning.n_steps = [4, 8]
network.net_arch = [[8], [16, 8]]
"""
PARAMETERS = ["learning.learning_rate", "learning.n_epochs", "learning.n_steps", "network.net_arch"]
TRIALS = 13
"""More than the ten that TPE draws at random."""


def written(folder, text=FILE + SPACE):
    path = folder / "mine.toml"
    path.write_text(text)
    return path


def tuning_of(folder, phases=2, seed=0):
    return Tuning(training=Training.from_toml(written(folder)), phases=phases, seed=seed)


def table_of(folder):
    """Trials; without times, and without commits, which another session may make meanwhile."""
    return pd.read_csv(folder / "trials.csv").drop(columns=["seconds", "commit"])


def reward(training, phase):
    """Rises with every phase, towards a known best."""
    settings = training.learning
    worth = -abs(np.log10(settings["learning_rate"]) + 3.0) - abs(settings["n_epochs"] - 2)
    return worth - (settings["n_steps"] == 4) - (len(training.network.net_arch) == 2) + 0.1 * phase


def stub(training, folder, origin, seed, position, watch):
    """In the place of a training."""
    for phase in range(1, training.phases + 1):
        watch({"phase": phase, "reward": reward(training, phase), "wall_s": 1.0, "validation_s": 0.5})


@pytest.fixture
def stubbed(monkeypatch):
    monkeypatch.setattr(module, "train", stub)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Folder of a search by the stub that nothing disturbed."""
    folder = tmp_path_factory.mktemp("whole")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "train", stub)
        search(tuning_of(folder), TRIALS, folder)
    return folder


def test_points_stay_in_the_space_and_the_first_is_the_file_itself_with_any_seed(tmp_path, whole, stubbed):
    table = table_of(whole)
    assert table.iloc[0][PARAMETERS].tolist() == [1e-3, 1, 8, "8"]
    (begun,) = (whole / "trials" / "0000").glob("seed-*")
    assert begun.name == "seed-3"  # the file's first
    assert table["trial"].tolist() == list(range(TRIALS))
    assert table["learning.learning_rate"].between(1e-5, 1e-1).all()
    for name, values in (("learning.n_epochs", {1, 2, 3}), (ROLLOUT, {4, 8}), ("network.net_arch", {"8", "16x8"})):
        assert set(table[name]) == values  # of this seed
    search(tuning_of(tmp_path, seed=1), 3, tmp_path)
    first, second = (table_of(folder)[PARAMETERS].iloc[:3] for folder in (tmp_path, whole))
    assert first.iloc[0].equals(second.iloc[0])  # the file itself
    assert not first.equals(second)


def test_trainings_below_the_median_of_those_before_end_early(whole):
    """At the first phase of two, after ``STARTUP_TRIALS`` complete trials; the last phase ends by itself."""
    complete, pruned = [], 0
    for row in table_of(whole).itertuples():
        first = row.reward - 0.1 * (row.phases - 1)
        hopeless = len(complete) >= STARTUP_TRIALS and first < np.median(complete) - 1e-9
        assert (row.state, row.phases) == (("pruned", 1) if hopeless else ("complete", 2))
        pruned += hopeless
        complete += [] if hopeless else [first]
    assert pruned >= 2  # of this seed


def test_broken_off_again_and_again_equals_never_broken_off(tmp_path, whole, monkeypatch):
    """In the first trial and the last, in those that are drawn and those that TPE asks for, in either phase."""
    breaks = {(0, 1), (1, 2), (1, 1), (10, 1), (TRIALS - 1, 1)}

    def breaking(training, folder, origin, seed, position, watch):
        def interrupted(row):
            if (point := (int(folder.name), row["phase"])) in breaks:
                breaks.remove(point)
                raise KeyboardInterrupt
            watch(row)

        stub(training, folder, origin, seed, position, interrupted)

    monkeypatch.setattr(module, "train", breaking)
    breaks_off = 0
    while not (tmp_path / "trials.csv").exists() or len(table_of(tmp_path)) < TRIALS:
        try:
            search(tuning_of(tmp_path), TRIALS, tmp_path)
        except KeyboardInterrupt:
            breaks_off += 1
    assert (breaks_off, breaks) == (5, set())
    pd.testing.assert_frame_equal(table_of(tmp_path), table_of(whole), check_exact=True)


def _search(folder):
    search(tuning_of(folder), 2, folder)


@pytest.mark.slow
def test_killed_in_a_training_it_goes_on_from_its_checkpoint(tmp_path):
    """Trainings as they are: killed when the first of two phases of the second trial is stored."""
    for name in ("whole", "killed"):
        (tmp_path / name).mkdir()
    _search(tmp_path / "whole")
    folder, place = tmp_path / "killed", tmp_path / "killed" / "trials" / "0001" / "seed-3"
    assert killed_at("probe_agents.training.train.save_checkpoint", 3, _search, folder, after=True)
    assert (place / CHECKPOINT).exists()
    _search(folder)
    pd.testing.assert_frame_equal(table_of(folder), table_of(tmp_path / "whole"), check_exact=True)
    assert len(json.loads((place / RUN).read_text())["resumed"]) == 1
    assert not list(folder.glob(f"trials/*/seed-*/{CHECKPOINT}"))  # trials that ended need none


def test_a_training_that_breaks_down_is_told_and_the_search_goes_on(tmp_path, monkeypatch, capsys):
    def breaking(training, folder, origin, seed, position, watch):
        if training.learning["learning_rate"] > 2e-3:
            raise ValueError("weights that are not finite")
        stub(training, folder, origin, seed, position, watch)

    monkeypatch.setattr(module, "train", breaking)
    search(tuning_of(tmp_path), 6, tmp_path)
    table = table_of(tmp_path)
    assert len(table) == 6
    assert ((table["state"] == "failed") == (table["learning.learning_rate"] > 2e-3)).all()
    assert table.loc[table["state"] == "failed", "reward"].isna().all()
    assert set(table["state"]) == {"complete", "failed"}  # of this seed
    path = written(tmp_path, (FILE + SPACE).replace("low = 1e-5", "low = 1e-2"))
    assert main(["tune", str(path), "--trials", "2", "--output", str(tmp_path / "all")]) == 2
    assert "error: all 2 trainings failed: weights that are not finite" in capsys.readouterr().err

    def damaged(*_, **__):
        raise FileError("checkpoint.pt", "cut off")

    monkeypatch.setattr(module, "train", damaged)
    with pytest.raises(FileError, match="cut off"):  # not a failed training
        search(tuning_of(tmp_path), 7, tmp_path)


def test_the_command_goes_on_and_leaves_a_training_file_with_the_best_parameters(tmp_path, whole, stubbed, capsys):
    path, output = written(tmp_path), tmp_path / "out"
    arguments = ["tune", str(path), "--phases", "2", "--output", str(output), "--trials"]
    assert main([*arguments, "4"]) == 0
    assert "4 trials to do, stored in" in capsys.readouterr().err
    assert main([*arguments, str(TRIALS)]) == 0
    printed = capsys.readouterr()
    assert f"9 of {TRIALS} trials to do" in printed.err
    assert "The best trials" in printed.out
    (output / "trials.csv").unlink()  # a kill before it was written is made good, though no trial is left to do
    assert main([*arguments, str(TRIALS)]) == 0
    table = table_of(output)
    pd.testing.assert_frame_equal(table, table_of(whole), check_exact=True)
    complete = table[table["state"] == "complete"]
    best = complete.loc[complete["reward"].idxmax()]
    text = (output / "found.toml").read_text()
    tuned, given = Training.from_toml(output / "found.toml"), Training.from_toml(path)
    assert tuned.learning == given.learning | {
        name.removeprefix("learning."): best[name] for name in PARAMETERS if name.startswith("learning.")
    }
    assert "x".join(map(str, tuned.network.net_arch)) == best["network.net_arch"]
    same = {"learning": True, "network": {"net_arch"}, "search": True}
    assert tuned.model_dump(exclude=same) == given.model_dump(exclude=same)
    head = text[: text.index("\n\n")]
    commit = pd.read_csv(output / "trials.csv", dtype={"commit": str})["commit"][best["trial"]]
    assert f"Trial {best['trial']} (commit {commit}): reward {best['reward']:.4g} " in head
    assert "with 2 instead of 3 of them and seed 3 alone" in head
    record = json.loads((output / "manifest.json").read_text())
    assert (record["best"], record["trials"]) == (best["trial"], TRIALS)
    assert set(record["space"]) == set(PARAMETERS)
    assert (output / "search.png").stat().st_size > 5000


def test_an_interrupted_search_says_how_many_trials_are_stored(tmp_path, monkeypatch, capsys):
    def interrupting(training, folder, origin, seed, position, watch):
        if folder.name == "0002":
            os.kill(os.getpid(), signal.SIGINT)
        stub(training, folder, origin, seed, position, watch)

    monkeypatch.setattr(module, "train", interrupting)
    output = tmp_path / "out"
    assert main(["tune", str(written(tmp_path)), "--trials", "5", "--output", str(output)]) == 130
    message = f"probe-env: interrupted: 2 of 5 trials are stored in {output}; the same command continues"
    assert capsys.readouterr().err.splitlines()[-1] == message
    assert len(table_of(output)) == 2


def test_a_folder_holds_one_search(tmp_path, stubbed, capsys):
    output = tmp_path / "out"

    def run(text, *options):
        return main(["tune", str(written(tmp_path, text)), "--trials", "2", "--output", str(output), *options])

    assert run(FILE + SPACE) == 0
    for text, options, name in (
        (FILE + SPACE.replace("high = 3", "high = 4"), (), "search"),
        (FILE.replace("batch_size = 16", "batch_size = 8") + SPACE, (), "learning"),
        (FILE.replace("[3, 4]", "[4, 3]") + SPACE, (), "seeds"),
        (FILE + SPACE, ("--phases", "1"), "phases"),
        (FILE + SPACE, ("--seed", "1"), "seed"),
    ):
        capsys.readouterr()
        assert run(text, *options) == 2
        assert f"{output}: holds a search with other settings ({name}): choose another" in capsys.readouterr().err
    assert run(FILE.replace("[3, 4]", "[3]") + SPACE) == 0  # the others are not trained here
    with run_lock(output):
        assert run(FILE + SPACE) == 2
    message = f"probe-env: error: {output}: another process is working there: wait for it, or choose another folder"
    assert capsys.readouterr().err.splitlines()[-1] == message


RANGE = "is outside the accepted range"
BROKEN = {
    "learning.gamma = { low = 0.9, high = 1.5 }": f"learning.gamma: learning.gamma = 1.5 {RANGE} 0 to 1",
    "learning.gamma = { low = 0.99, high = 0.9 }": "learning.gamma: low = 0.99 is not below high = 0.9",
    "learning.gamma = { low = 0.9 }": "learning.gamma: high: Field required",
    "learning.gamma = { low = 0.9, high = 1.0, step = 2 }": "learning.gamma: step: there is no such field",
    "learning.ent_coef = { low = 0.0, high = 0.1, log = true }": "learning.ent_coef: low = 0.0 is not above 0, as log",
    "learning.gamma = [0.9]": "learning.gamma: (0.9,) is neither two or more different choices",
    "learning.gamma = [0.9, 0.9]": "learning.gamma: (0.9, 0.9) is neither",
    "learning.n_epochs = { low = 0.5, high = 2.5 }": f"learning.n_epochs: learning.n_epochs = 0.5 {RANGE} 1 to 1000",
    "learning.momentum = [0.1, 0.2]": "learning.momentum: learning.momentum is not one of ppo's: learning_rate",
    "learning.n_steps = [8, 24]": "learning.n_steps: 24: the 32 steps of a phase in 4 environments",
    "learning.n_steps = { low = 4, high = 8 }": "learning.n_steps: must be a list of choices",
    "network.net_arch = [[8], [5000]]": "network.net_arch: net_arch.0: Input should be less than or equal to 4096",
    "network.log_std_init = { low = -30.0, high = 0.0 }": f"network.log_std_init: log_std_init: -30.0 {RANGE} -20 to 5",
    "network.lstm_hidden_size = [8, 16]": "network.lstm_hidden_size: is not one of ppo's: net_arch, log_std_init",
    "imitation.epochs = [1, 2]": "imitation: cannot be searched in this file; accepted: learning, network",
    "phases = [1, 2]": "phases: Input should be a valid dictionary (given: (1, 2))",
    "": " is empty",
}


def test_bad_ranges_and_options_are_named_before_any_work(tmp_path, capsys):
    failures = []

    def check(text, options, message):
        path = written(tmp_path, text)
        status = main(["tune", str(path), "--output", str(tmp_path / "out"), *options])
        error = capsys.readouterr().err
        if status != 2 or message not in error or error.count("\n") != 1:
            failures.append((message, error))

    for line, problem in BROKEN.items():
        text = f"{FILE}\n[search]\n{line}\n".replace("'", '"')
        check(text, (), f"search{'.' if line else ':'}{problem}")
    for name, value in (("phases", 4), ("phases", 0), ("trials", 0), ("seed", -1)):
        check(FILE + SPACE, (f"--{name}", str(value)), f"{name} = {value} is outside the accepted range")
    assert failures == []
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_the_usual_ranges_and_own_values_are_what_a_file_may_say(algorithm):
    usual = axes_of(Training(algorithm=algorithm))
    assert usual.keys() >= USUAL[algorithm].keys()
    assert (ROLLOUT in usual) == (algorithm != "sac")
    declared = {}
    for name, axis in usual.items():
        table, field = name.split(".")
        declared.setdefault(table, {})[field] = axis.model_dump() if isinstance(axis, Range) else axis
    assert axes_of(Training(algorithm=algorithm, search=declared)) == usual
    parameters = inspect.signature(ALGORITHMS[algorithm][0].__init__).parameters
    own = {name: parameter.default for name, parameter in parameters.items() if name in LIMITS}
    Training(algorithm=algorithm, learning={k: v for k, v in own.items() if isinstance(v, int | float)})


def test_usual_rollouts_fill_phases_and_shipped_files_can_be_searched_and_written(tmp_path):
    """Of 32 to 512 steps in three environments, phases of 384 steps hold whole rollouts of 32, 64 and 128."""
    assert axes_of(Training(environment={"num_envs": 3}, phase_steps=384))[ROLLOUT] == (32, 64, 128)
    assert ROLLOUT not in axes_of(Training(environment={"num_envs": 5}))
    for name in ("ppo", "student", "ppo-any-probe"):
        training = Training.from_toml(file_or_shipped("train", name))
        assert len(axes_of(training)) == len(USUAL["ppo"]) + 1
        (tmp_path / "again.toml").write_text(training.to_toml())
        assert Training.from_toml(tmp_path / "again.toml") == training
