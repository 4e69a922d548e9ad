"""The search for hyperparameters: interrupted equals uninterrupted, poor trainings end early, the result is a file."""

import json
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pandas as pd
import pytest

from probe_agents.cli import main
from probe_agents.records.result_folder import run_lock
from probe_agents.records.shipped import file_or_shipped
from probe_agents.training import tuning as module
from probe_agents.training.config import Training
from probe_agents.training.tuning import ROLLOUT, SPACE, STARTUP_TRIALS, Tuning, search
from probe_env.files import FileError

FILE = """
seeds = [3, 4]
phases = 3
phase_steps = 256
averages = [5.0]
environment = { num_envs = 4, fidelity = { time_lapse = 20.0 }, task = { settle_time = 0.1, time_limit = 20.0 } }
network = { net_arch = [32, 32], log_std_init = -2.0 }
learning = { n_steps = 64, batch_size = 64, n_epochs = 2, learning_rate = 1e-3 }
validation = { limit = 1, fidelity = { time_lapse = 20.0 } }
"""
PARAMETERS = [*SPACE, ROLLOUT]
TRIALS = 13
"""More than the ten that TPE draws at random."""


def written(folder, text=FILE):
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
    worth = -abs(np.log10(settings.learning_rate) + 4.0) - 0.2 * abs(settings.n_epochs - 6)
    return worth - (settings.n_steps == 32) - (training.network.net_arch == (32, 32)) + 0.1 * phase


def stub(training, folder, origin, seed, position, watch):
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


def test_first_trial_is_the_file_for_every_search_seed(tmp_path, whole, stubbed):
    """Values that the file does not give are PPO's; its clip_range is 0.2, its ent_coef = 0 is not in the space."""
    table = table_of(whole)
    first = table.iloc[0]
    given = {"gamma": 0.99, "batch_size": 64, "learning_rate": 1e-3, "n_epochs": 2, "clip_range": 0.2, "n_steps": 64}
    assert {name: first[f"learning.{name}"] for name in given} == given
    assert (first["network.net_arch"], first["network.log_std_init"]) == ("32x32", -2.0)
    (begun,) = (whole / "trials" / "0000").glob("seed-*")
    assert begun.name == "seed-3"  # the file's first
    assert table["trial"].tolist() == list(range(TRIALS))
    for name, values in Tuning(training=Training.from_toml(whole / "mine.toml"), phases=2).space.items():
        assert all(values._contains(values.to_internal_repr(value)) for value in table[name].tolist())
    search(tuning_of(tmp_path, seed=1), 3, tmp_path)
    other = table_of(tmp_path)
    assert other.iloc[0].drop("learning.ent_coef").equals(first.drop("learning.ent_coef"))
    assert not other.iloc[1:].equals(table.iloc[1:3])


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


def test_often_interrupted_tuning_equals_an_uninterrupted_one(tmp_path, whole, monkeypatch):
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
    for left in (4, 3, 2, 1, 0):
        with pytest.raises(KeyboardInterrupt):
            search(tuning_of(tmp_path), TRIALS, tmp_path)
        assert len(breaks) == left
    search(tuning_of(tmp_path), TRIALS, tmp_path)
    pd.testing.assert_frame_equal(table_of(tmp_path), table_of(whole), check_exact=True)


def test_failed_training_is_reported_and_search_continues(tmp_path, monkeypatch, capsys):
    def breaking(training, folder, origin, seed, position, watch):
        if training.learning.learning_rate > 1e-4:
            raise ValueError("weights that are not finite")
        stub(training, folder, origin, seed, position, watch)

    monkeypatch.setattr(module, "train", breaking)
    search(tuning_of(tmp_path), 6, tmp_path)
    table = table_of(tmp_path)
    assert len(table) == 6
    assert ((table["state"] == "failed") == (table["learning.learning_rate"] > 1e-4)).all()
    assert table.loc[table["state"] == "failed", "reward"].isna().all()
    assert set(table["state"]) == {"complete", "failed"}  # of this seed
    monkeypatch.setattr(module, "train", Mock(side_effect=ValueError("weights that are not finite")))
    assert main(["tune", str(written(tmp_path)), "--trials", "2", "--output", str(tmp_path / "all")]) == 2
    assert "error: all 2 trainings failed: weights that are not finite" in capsys.readouterr().err
    monkeypatch.setattr(module, "train", Mock(side_effect=FileError("checkpoint.pt", "cut off")))
    with pytest.raises(FileError, match="cut off"):  # not a failed training
        search(tuning_of(tmp_path), 7, tmp_path)


def test_tune_resumes_and_writes_the_best_training_file(tmp_path, whole, stubbed, capsys):
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
    chosen = {name.removeprefix("learning."): best[name].item() for name in PARAMETERS if "learning." in name}
    assert tuned.learning == given.learning.model_copy(update=chosen)
    assert "x".join(map(str, tuned.network.net_arch)) == best["network.net_arch"]
    same = {"learning": True, "network": True}
    assert tuned.model_dump(exclude=same) == given.model_dump(exclude=same)
    head = text[: text.index("\n\n")]
    commit = pd.read_csv(output / "trials.csv", dtype={"commit": str})["commit"][best["trial"]]
    assert f"Trial {best['trial']} (commit {commit}): reward {best['reward']:.4g} " in head
    assert "with 2 instead of 3 of them and seed 3 alone" in head
    record = json.loads((output / "manifest.json").read_text())
    assert (record["best"], record["trials"]) == (best["trial"], TRIALS)
    assert set(record["space"]) == set(PARAMETERS)
    assert (output / "search.png").stat().st_size > 5000


def test_a_folder_holds_one_search(tmp_path, stubbed, capsys, refused):
    output = tmp_path / "out"
    run = ["tune", str(written(tmp_path)), "--trials", "2", "--output", str(output)]
    assert main(run) == 0
    capsys.readouterr()
    for text, options, name in (
        (FILE.replace("batch_size = 64", "batch_size = 8"), (), "learning.batch_size 64, now 8"),
        (FILE.replace("[3, 4]", "[4, 3]"), (), "seeds [3], now [4]"),
        (FILE, ("--phases", "1"), "phases 2, now 1"),
        (FILE, ("--seed", "1"), "seed 0, now 1"),
    ):
        written(tmp_path, text)
        refused([*run, *options], f"{output}: these trials were trained with other settings ({name}): choose")
    written(tmp_path, FILE.replace("[3, 4]", "[3]"))
    assert main(run) == 0  # the others are not trained here
    capsys.readouterr()
    with run_lock(output):
        refused(run, f"{output}: another process is working there: wait for it, or choose another folder\n")


def test_options_and_a_search_table_are_refused(tmp_path, refused):
    for text, options, message in (
        (FILE + "[search]\nlearning.gamma = [0.9, 0.99]\n", (), "search: there is no such field"),
        *((FILE, (f"--{name}", value), f"{name} = {value} is outside the accepted range")
          for name, value in (("phases", 4), ("phases", 0), ("trials", 0), ("seed", -1))),
    ):  # fmt: skip
        refused(["tune", written(tmp_path, text), "--output", "out", *options], message)


def test_rollouts_fill_phases_and_shipped_files_can_be_written(tmp_path):
    """Of 32 to 512 steps in three environments, phases of 384 steps hold whole rollouts of 32, 64 and 128."""
    for num_envs, phase_steps, choices in ((3, 384, (32, 64, 128)), (5, 16_384, None)):
        training = Training(environment={"num_envs": num_envs}, phase_steps=phase_steps)
        assert getattr(Tuning(training=training, phases=1).space.get(ROLLOUT), "choices", None) == choices
    for name in ("ppo", "student"):
        training = Training.from_toml(file_or_shipped("train", Path(name)))
        (tmp_path / "again.toml").write_text(training.to_toml())
        assert Training.from_toml(tmp_path / "again.toml") == training
