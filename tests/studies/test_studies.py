"""Studies: a file becomes settings with columns, runs resume, and rows are paired tube by tube."""

import inspect
from importlib import import_module
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from probe_agents.cli import main
from probe_agents.evaluation import plan as plans
from probe_agents.evaluation.statistics import paired_difference
from probe_agents.policies.cases import with_probe
from probe_agents.policies.catalogue import named_policies
from probe_agents.policies.fixed import PI, Constant
from probe_agents.records.shipped import shipped_folder, shipped_names
from probe_agents.studies import readme
from probe_agents.studies import run as runs
from probe_agents.studies.builtin import BUILT_IN
from probe_agents.studies.compare import _cell, baselines, compare, key_columns
from probe_agents.studies.run import expand
from probe_agents.studies.spec import Study
from probe_env import load_contexts
from probe_env.envs.task.config import TaskConfig
from probe_env.fidelity import PRESETS

SHORT = """
question = "Does a slower ramp change anything in a short tube?"
policies = ["constant", { name = "pi", level = [3e-5, 6e-5] }]
limit = 2

[set]
"plant.tube.helix_length" = 8.0

[vary]
"task.ramp" = [0.5, 0.05]

[compare]
metrics = ["reward", "a90_95_percent_wall"]
baseline = [{ policy = "constant" }, { "task.ramp" = 0.5 }]
"""


def study_of(text, path):
    path.write_text(text)
    return Study.from_toml(path)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The short study, run by the command with two workers."""
    folder = tmp_path_factory.mktemp("studies")
    (folder / "short.toml").write_text(SHORT)
    assert main(["study", str(folder / "short.toml"), "--output", str(folder / "out"), "--jobs", "2"]) == 0
    return folder


def test_rows_are_episodes_of_an_evaluation(folder):
    table = pd.read_csv(folder / "out" / "episodes.csv")
    assert list(table.columns[:6]) == ["policy", "policy.level", "fidelity", "task.ramp", "context", "seed"]
    rows = table[["policy", "policy.level", "task.ramp", "context"]].fillna(0.0).itertuples(index=False, name=None)
    levels = (("constant", 0.0), ("pi", 3e-5), ("pi", 6e-5))
    assert list(rows) == [(*policy, ramp, k) for ramp in (0.5, 0.05) for policy in levels for k in range(2)]
    tube = folder / "tube.toml"
    tube.write_text("[tube]\nhelix_length = 8.0\n[feed]\nramp = 0.05\n")
    arguments = ["constant", "--tube", str(tube), "--limit", "2", "--fidelity", "fast", "--output", str(folder / "one")]
    assert main(["evaluate", *arguments]) == 0
    alone = pd.read_csv(folder / "one" / "episodes.csv")
    same = table[(table["policy"] == "constant") & (table["task.ramp"] == 0.05)].reset_index(drop=True)
    for name in ("reward", "inspection_time_s", "radial_rms_m", "a90_percent_wall", "cost", "friction"):
        np.testing.assert_allclose(same[name], alone[name], rtol=1e-5)  # six digits are stored
    slower = table[table["task.ramp"] == 0.5].reset_index(drop=True)
    assert (slower["radial_rms_m"] != table[table["task.ramp"] == 0.05].reset_index(drop=True)["radial_rms_m"]).any()


def test_differences_are_paired_over_tubes(folder):
    table, rows = (pd.read_csv(folder / "out" / name) for name in ("episodes.csv", "comparison.csv"))
    keys = ["policy", "policy.level", "task.ramp"]
    rewards = {key: part.set_index("context")["reward"] for key, part in table.fillna(0.0).groupby(keys)}
    rows = rows.fillna({"policy.level": 0.0})
    assert len(rows) == 6 * 2 * 2
    for row in rows[rows["metric"] == "reward"].to_dict("records"):
        key = tuple(row[name] for name in keys)
        other = ("constant", 0.0, key[2]) if row["baseline"] == "policy = constant" else (*key[:2], 0.5)
        differences = rewards[key] - rewards[other]
        assert row["difference"] == pytest.approx(differences.mean(), abs=1e-4)
        assert row["mean"] == pytest.approx(rewards[key].mean(), rel=1e-5)
        assert differences.min() - 1e-4 <= row["difference_low"] <= row["difference"] + 1e-4
        assert row["difference"] - 1e-4 <= row["difference_high"] <= differences.max() + 1e-4
    assert (rows.groupby(["task.ramp", "metric", "baseline"])["rank"].min() == 1.0).all()
    assert (folder / "out" / "comparison.png").stat().st_size > 10_000


def test_it_resumes(folder, monkeypatch, capsys):
    """Nothing is run again; with one more ramp only that is."""
    before = (folder / "out" / "comparison.csv").read_bytes()
    played, play = [], plans._records
    monkeypatch.setattr(plans, "_records", lambda plan, new, *rest: played.append(len(new)) or play(plan, new, *rest))
    assert main(["study", str(folder / "short.toml"), "--output", str(folder / "out")]) == 0
    assert played == []
    assert (folder / "out" / "comparison.csv").read_bytes() == before
    more = SHORT.replace("[0.5, 0.05]", "[0.5, 0.1, 0.05]")
    (folder / "more.toml").write_text(more.replace("limit = 2", 'figure = ["reward", "a90_95_percent_wall"]'))
    drawn = (folder / "out" / "comparison.png").read_bytes()
    assert main(["study", str(folder / "more.toml"), "--output", str(folder / "out"), "--limit", "1"]) == 0
    assert played == [3]
    assert (folder / "out" / "comparison.png").read_bytes() != drawn
    assert "ramp" in capsys.readouterr().out


def test_bad_files_name_file_field_and_value(tmp_path, refused):
    """Before anything is run."""
    cases = {
        ('"task.ramp" = [', '"task.rampe" = ['): "rampe: there is no such field; accepted: scene, sensor",
        ('"task.ramp" = [', '"ramp" = ['): "vary: 'ramp' is not one of fidelity, probe, task.FIELD",
        ("0.05]", "-1.0]"): "ramp: -1.0 m/s2 is outside the accepted range 0.001 to 1000 m/s2",
        ("0.05]", "0.5]"): "vary: two settings are equal",
        ("[0.5, 0.05]", "[]"): "every field of vary needs at least one value",
        ('"reward"', '"rewrd"'): "compare.metrics: unknown metrics: rewrd; accepted: a90_95",
        ("level =", "levl ="): "pi has no parameter 'levl'; accepted: level, proportional",
        ("[3e-5, 6e-5]", '"low"'): "pi: level = 'low' is of another type",
        ('name = "pi"', 'nam = "pi"'): "a table of a policy needs a name",
        ('"constant", ', '"constnt", '): "unknown policy 'constnt'",
        ('"constant", ', '"constant", "constant", '): "policies: constant occurs twice",
        ('{ policy = "constant" }', '{ policy = "slow" }'): "compare.baseline: policy = 'slow' is not one of constant",
        ('{ policy = "constant" }', '{ policy = "pi" }'): "the study has no row of policy = pi",
        ('{ "task.ramp" = 0.5 }', '{ "task.ramp" = 0.4 }'): "compare.baseline: task.ramp = 0.4 is not one of 0.5",
        ('{ "task.ramp" = 0.5 }', "{ ramp = 0.4 }"): "compare.baseline: 'ramp' is not one of policy",
        ("limit = 2", "limit = 49"): "limit = 49 is outside the accepted range 0 (all) to 48",
        ("limit = 2", 'limit = 2\nfidelity = "fats"'): "fidelity = 'fats' is not one of",
        ("limit = 2", 'limit = 2\nfigure = ["reward", "cost"]'): "figure must be two of compare.metrics",
        ("helix_length", "helix_lenth"): "helix_lenth: there is no such field",
        ("question", "questio"): "question: Field required",
    }
    path = tmp_path / "bad.toml"
    for (old, new), message in cases.items():
        assert old in SHORT
        path.write_text(SHORT.replace(old, new, 1))
        refused(["study", path, "--output", tmp_path / "out"], f"probe-env: error: {path}: ", message)


def test_fields_change_what_they_say(tmp_path):
    """Of task, scene, sensor, fidelity, probe and plant; columns are read back from what is simulated."""
    text = """
    question = "?"
    policies = ["pi"]
    limit = 1
    policies_know = "unvaried task"
    vary = [{}, { "task.delay_periods" = 2 }, { "scene.tube.ovality" = 0.1 }, { "sensor.quiet_snr" = 15.0 },
            { "fidelity.time_step" = 1e-4 }, { probe = "improved" }, { fidelity = "standard" }]
    """
    settings = expand(study_of(text, tmp_path / "fields.toml"))
    usual = TaskConfig().full_observation
    tasks = [setting.plan.config for setting in settings]
    assert tasks[0] == tasks[4] == tasks[6] == usual
    assert tasks[1].delay_periods == 2
    assert tasks[2].scene.tube.ovality == 0.1
    assert tasks[3].sensor.quiet_snr == 15.0
    assert tasks[5] == with_probe(usual, "improved")
    assert settings[4].plan.fidelity == PRESETS["fast"].model_copy(update={"time_step": 1e-4})
    assert settings[6].plan.fidelity == PRESETS["standard"]
    columns = pd.DataFrame([setting.values for setting in settings])
    assert columns["task.delay_periods"].tolist() == [0, 2, 0, 0, 0, 0, 0]
    assert columns["probe"].tolist() == ["scene"] * 5 + ["improved", "scene"]
    assert columns["fidelity"].tolist() == ["fast"] * 6 + ["standard"]
    assert columns["fidelity.time_step"].tolist() == [2e-4] * 4 + [1e-4, 2e-4, 2e-4]
    played = [policy for setting in settings for policy in setting.plan.policies.values()]
    assert [(type(policy), policy.config == usual) for policy in played] == [(PI, True)] * 7
    assert settings[0].plan.contexts == load_contexts("test")[:1]


def test_surrogate_runs_and_refuses_what_its_map_lacks(tmp_path, capsys):
    """A setting that the map does not predict is refused before any other is run."""
    text = """
    question = "?"
    policies = ["constant"]
    fidelity = ["surrogate", "fast"]
    limit = 2
    [vary]
    "task.ramp" = [0.5, 0.1]
    [compare]
    metrics = ["reward", "a90_95_percent_wall"]
    """
    path, output = tmp_path / "surrogate.toml", tmp_path / "out"
    path.write_text(text)
    command = ["study", str(path), "--fidelity", "surrogate", "--output", str(output)]
    assert main(command) == 0
    assert len(pd.read_csv(output / "episodes.csv")) == 4
    compared = pd.read_csv(output / "comparison.csv").pivot(index="task.ramp", columns="metric", values="mean")
    assert compared.notna().all().to_dict() == {"reward": True, "a90_95_percent_wall": False}
    path.write_text(text.replace('"task.ramp" = [0.5, 0.1]', '"task.friction_drift" = [0.0, 0.2]'))
    assert main([*command[:-1], str(tmp_path / "none")]) == 2
    assert "without friction_drift" in capsys.readouterr().err
    assert not (tmp_path / "none").exists()


def test_sweep_has_one_policy_and_averages_training_seeds(tmp_path):
    text = """
    question = "?"
    policies = [
      { name = "planner", periods = [2, 8], every = 2 }, "mine@0=fast-in", "mine@1=steady-back", "shielded:pi",
    ]
    limit = 1
    """
    study = study_of(text, tmp_path / "sweeps.toml")
    (setting,) = expand(study)
    names = [columns["policy"] for columns in setting.members.values()]
    assert names == ["planner", "planner", "mine@0", "mine@1", "shielded-pi"]
    assert [policy.periods for policy in list(setting.plan.policies.values())[:2]] == [2, 8]  # type: ignore[attr-defined]
    assert key_columns([setting]) == ["policy", "policy.periods", "policy.every", "fidelity"]
    assert baselines(study, [setting]) == [{"policy": "planner", "policy.periods": 2, "policy.every": 2}]


def episodes_of(settings, reward):
    """Made-up episodes in six tubes."""
    members = [columns | setting.values for setting in settings for columns in setting.members.values()]
    return pd.DataFrame(
        values | {"context": tube, "seed": 0, "reward": reward(values, tube), "commit": "x"}
        for values in members for tube in range(6)
    )  # fmt: skip


def test_fraction_of_an_upper_bound_and_ranks(tmp_path):
    text = """
    question = "?"
    policies = ["planner", "best-schedule", "pi"]
    vary = [{ "task.ramp" = 0.5 }, { "task.ramp" = 0.1 }]
    [compare]
    metrics = ["reward"]
    baseline = { policy = "best-schedule" }
    upper = { policy = "planner" }
    """
    study = study_of(text, tmp_path / "share.toml")
    settings = expand(study)
    worth = {"planner": 10.0, "best-schedule": 2.0, "pi": 4.0}
    table = episodes_of(settings, lambda row, tube: worth[row["policy"]] * (1.0 + row["task.ramp"]) + tube)
    compared = compare(study, settings, table)
    rows = {(row["policy"], row["task.ramp"]): row for row in compared.to_dict("records")}
    for policy, fraction, rank in (("planner", 1.0, 1), ("best-schedule", 0.0, 3), ("pi", 0.25, 2)):
        for ramp in (0.5, 0.1):
            row = rows[policy, ramp]
            assert row["share_of_lead"] == pytest.approx(fraction)
            assert row["rank"] == rank
            assert row["difference"] == pytest.approx((worth[policy] - 2.0) * (1.0 + ramp))
    expected = paired_difference(table[table["task.ramp"] == 0.1], "pi", "best-schedule", "reward")
    assert rows["pi", 0.1]["difference_low"] == pytest.approx(expected.low)
    study = study_of(text.replace('["reward"]', '["reward", "back_reward"]'), tmp_path / "missing.toml")
    with pytest.raises(ValueError, match="back_reward is not measured in this task"):
        compare(study, settings, table)


def test_all_studies_that_ship_can_be_run(capsys, monkeypatch):
    """Every file expands, its baselines are rows, and the list has it with its question."""
    with_parameters = runs._with_parameters
    monkeypatch.setattr(runs, "_recommended", lambda name, config, plant: Constant(config))  # searched elsewhere
    monkeypatch.setattr(runs, "named_policies", lambda names, config, _: {names[0]: Constant(config)})
    monkeypatch.setattr(runs, "_with_parameters", lambda policy, name, parameters: policy)
    for name in shipped_names("studies"):
        study = Study.from_toml(shipped_folder("studies") / f"{name}.toml").changed(1, (), (), None)
        settings = expand(study)
        baselines(study, settings)
        for member, parameters in study.members():
            if member not in ("ppo", "student", *runs.RECOMMENDED):  # trained networks load for seconds
                for policy in named_policies([member], settings[0].plan.config).values():
                    assert with_parameters(policy, member, parameters)
    assert main(["study", "--list"]) == 0
    listed = capsys.readouterr().out
    assert not [name for name in (*shipped_names("studies"), *BUILT_IN) if f"  {name} " not in listed]
    for study_ in BUILT_IN.values():
        module, _, function = study_.function.partition(".")
        parameters = inspect.signature(getattr(import_module(f"probe_agents.studies.{module}"), function)).parameters
        assert {"output", "workers", *study_.options} == set(parameters)


def test_options_take_the_place_of_the_file_s(tmp_path):
    study = study_of(SHORT, tmp_path / "short.toml")
    changed = study.changed(1, ("slow",), ("standard",), Path("example"))
    assert changed.policies == ("constant", "slow")  # what it compares with stays
    assert (changed.limit, changed.fidelity, changed.tube) == (1, ("standard",), "example")
    with pytest.raises(ValueError, match="limit = 49"):
        study.changed(49, (), (), None)


@pytest.mark.slow
def test_policies_of_a_plant_are_recommended_for_it(tmp_path):
    """``recommended`` differs between plants and is the same for the same plant."""
    text = """
    question = "?"
    policies = ["recommended"]
    limit = 1
    [vary]
    "plant.tube.inner_diameter" = [22e-3, 26e-3]
    """
    settings = expand(study_of(text, tmp_path / "plants.toml"))
    described = [setting.plan.policies["recommended"].describe() for setting in settings]
    assert described[0] != described[1]
    for setting in settings:
        assert setting.plan.config.scene.tube.inner_diameter == setting.values["plant.tube.inner_diameter"]
        assert list(named_policies(["pi"], setting.plan.config)) == ["pi"]


def test_cells_of_one_tube_and_of_the_baseline():
    ends = [f"difference{end}" for end in ("", "_low", "_high")]
    none = (np.nan, np.nan)
    for values, text in (((2, 1, 3), "5 (+2 [1, 3])"), ((2, *none), "5 (+2)"), ((0, 0, 0), "5"), ((0, *none), "5")):
        assert _cell({"metric": "reward", "mean": 5.0} | dict(zip(ends, values, strict=True))) == text


@pytest.mark.slow
def test_recipes_are_trained_and_tested(tmp_path, monkeypatch):
    """Of Stable-Baselines3 and of sb3-contrib."""
    short = {name: recipe._replace(steps=(2048, 4096)) for name, recipe in readme.RECIPES.items()}
    monkeypatch.setattr(readme, "RECIPES", short)
    table = readme.learn(tmp_path, limit=1, trials=1)
    named = [f"{name}-0-{steps}" for name in short for steps in (2048, 4096)]
    assert table["policy"].tolist() == [*readme.RIVALS, *named]
    assert table["reward"].notna().all()
    assert {path.name for path in tmp_path.iterdir()} == {"curve.csv", "manifest.json", "models"}
