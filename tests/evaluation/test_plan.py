"""Playing a plan: paired, resumable at any moment, and never mixed with episodes of another setting or commit."""

import json
from collections import deque
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from plans import CONFIG, make_plan

from probe_agents.evaluation import evaluate
from probe_agents.evaluation.folder import read_evaluation
from probe_agents.evaluation.kpis import PROFILE_COLUMNS
from probe_agents.evaluation.plan import Plan, RolloutRunner, core_seconds, per_metre, run_plan
from probe_agents.policies.catalogue import make_policy, named_policies
from probe_agents.policies.fixed import Constant
from probe_agents.terminal.work import Work
from probe_env import Context, Scene, load_contexts
from probe_env.design import RANGES
from probe_env.envs.task.config import TaskConfig
from probe_env.envs.vibration_map import stored_map
from probe_env.fidelity import PRESETS, ROUND_TRIP_PRESETS


def same(one, other):
    pd.testing.assert_frame_equal(one, other, check_exact=True)


def halves(table):
    return [table[table["policy"] == name].reset_index() for name in ("feed 0", "feed 1")]


def test_table_has_every_episode_paired_by_seed(evaluated):
    table = pd.read_parquet(evaluated / "episodes.parquet")
    assert len(table) == 2 * 3 * 2
    first, second = halves(table)
    paired = ["context", "seed", "friction", "helix_diameter", "drag_factor"]
    assert (first[paired] == second[paired]).all(axis=None)
    assert (first["reward"] != second["reward"]).all()
    assert pd.read_csv(evaluated / "episodes.csv")["reward"].to_numpy() == pytest.approx(table["reward"], rel=1e-6)
    profile = pd.read_parquet(evaluated / "profile.parquet")
    assert len(profile) == 12  # one metre each: the length is constant
    assert profile["time"].to_numpy() == pytest.approx(0.3)


def test_the_profile_is_per_metre():
    """Periods that end at 5.4, 5.8, 6.0 and 6.5 m: three in the sixth metre, one in the seventh."""
    periods = [(t, length, 0.2 + 0.1 * (t == 1), 0.02, rms, 4.0, 2.0 * rms, 3.0 * rms) for t, length, rms in
               ((1, 5.4, 3e-4), (2, 5.8, 4e-4), (3, 6.0, 0.0), (4, 6.5, 1e-4))]  # fmt: skip
    profile = per_metre(periods)
    assert profile["inserted_length"].tolist() == [5.5, 6.5]
    assert profile["time"].tolist() == [3.0, 4.0]
    assert profile["radial_rms_m"] == pytest.approx([np.sqrt(25.0 / 3.0) * 1e-4, 1e-4])
    assert profile["noise_rms_m"] == pytest.approx(2.0 * profile["radial_rms_m"])
    assert profile["axial_velocity_rms"] == pytest.approx(3.0 * profile["radial_rms_m"])
    assert profile["feed_speed"] == pytest.approx([0.7 / 3.0, 0.2])
    assert profile["highest_feed"] == pytest.approx([0.3, 0.2])
    assert {len(values) for values in per_metre([]).values()} == {0}


def test_the_profile_of_both_passes_reaches_to_the_turn():
    scene = Scene.model_validate({"tube": {"helix_length": 8.0}, "carrier_length": 4.0})
    config = TaskConfig(passes="both", scene=scene, time_limit=100.0)
    plan = Plan({"in and back": make_policy("fast-in", config)}, [Context()], (0,), config, ROUND_TRIP_PRESETS["fast"])
    runner, lengths, rows = RolloutRunner(plan, deque(plan.episode_ids()), 1, 1), [], []
    while not runner.over:
        if list(runner.step()):
            rows = [row[PROFILE_COLUMNS.index("inserted_length")] for row in runner.profile[0]]
        lengths.append(runner.last.infos[0]["inserted_length"])
    assert rows == lengths[: int(np.argmax(lengths)) + 1]
    assert rows[-1] == pytest.approx(8.0, abs=0.05)


def test_a_policy_with_other_ranges_of_actions_is_refused():
    """Loaded for the task of its training, an agent supplied 30 m3/h where it meant 72.5."""
    narrow = TaskConfig(air_supply_rates=(0.02, 0.036))
    message = r"policy narrow: air_supply_rates = \(0.02, 0.036\) differs from \(0.0083.*make the policy for this task"
    with pytest.raises(ValueError, match=message):
        Plan({"wide": Constant(TaskConfig()), "narrow": Constant(narrow)}, [Context()])


def test_episode_does_not_depend_on_the_batch(evaluated):
    alone = run_plan(make_plan(), None, batch=1, progress=False)
    together = pd.read_parquet(evaluated / "episodes.parquet")
    same(alone.drop(columns="commit"), together.drop(columns="commit"))


def test_folder_of_other_settings_is_refused(stored, monkeypatch):
    monkeypatch.setattr("probe_agents.evaluation.plan.Episodes", None)  # simulating anything would fail
    table, before = pd.read_parquet(stored / "episodes.parquet"), {path: path.read_bytes() for path in stored.iterdir()}
    limit = CONFIG.model_copy(update={"time_limit": 0.5})
    for changes, name in (({"config": limit}, r"task\.time_limit 0\.3, now 0\.5"), ({"probes": "random"}, "probes")):
        with pytest.raises(ValueError, match=rf"these episodes were simulated with other settings \({name}"):
            run_plan(make_plan(**changes), stored, progress=False)
    assert {path: path.read_bytes() for path in stored.iterdir()} == before
    same(run_plan(make_plan(config=CONFIG.full_observation), stored, progress=False), table)


def test_another_map_of_the_surrogate_is_another_setting(tmp_path):
    plan = make_plan(fidelity=PRESETS["surrogate"])
    with plan.folder(tmp_path).open():
        pass
    other = replace(plan, vibration=replace(stored_map(), digest="0123456789abcdef"))
    with pytest.raises(ValueError, match=r"other settings \(surrogate_map "):
        other.folder(tmp_path).check()


def test_random_probes_are_the_same_for_all_policies(evaluated, tmp_path):
    table = run_plan(make_plan(probes="random"), tmp_path, progress=False)
    first, second = halves(table)
    assert (first[list(RANGES)] == second[list(RANGES)]).all(axis=None)
    assert first["line_density"].nunique() == 6  # a probe for each context and seed
    assert (table["radial_rms_m"] != pd.read_parquet(evaluated / "episodes.parquet")["radial_rms_m"]).all()


def test_a_changed_policy_is_played_again_under_its_name(stored):
    """Nothing in the tables says that they are of another: they do not count when it is killed before its first."""
    before = pd.read_parquet(stored / "episodes.parquet")
    changed = make_plan()
    changed.policies["feed 1"] = Constant(CONFIG, feed_speed=0.35)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("probe_agents.evaluation.plan._records", lambda *_: iter(()))
        with pytest.raises(KeyError):
            run_plan(changed, stored, progress=False)
    done = read_evaluation(stored)
    assert set(done.table["policy"]) == {"feed 0"}
    assert done.missing.gaps == (("feed 1", "6 of 6 insertions"),)
    after = run_plan(changed, stored, progress=False)
    same(*(frame[frame["policy"] == "feed 0"] for frame in (before, after)))
    assert (before["reward"] != after["reward"])[before["policy"] == "feed 1"].all()


def test_evaluate_gives_the_table_with_and_without_a_folder(tmp_path):
    (tmp_path / "short.toml").write_text("[tube]\nhelix_length = 7\n")
    arguments = {"tube": tmp_path / "short.toml", "limit": 1, "fidelity": "fast", "seeds": 1}
    table = evaluate(["slow-down", "constant"], **arguments)
    assert table["policy"].tolist() == ["slow-down", "constant"]
    assert table["complete"].tolist() == [1.0, 1.0]
    output = tmp_path / "out"
    stored = evaluate(["slow-down", "constant"], output, against="constant", **arguments)
    same(stored.drop(columns="commit"), table.drop(columns="commit"))
    assert json.loads((output / "report.json").read_text()) == {
        "against": "constant",
        "user_policies": [],
        "plant": "short",
    }
    manifest = json.loads((output / "manifest.json").read_text())
    assert set(manifest["files"]) == {"episodes.csv", "episodes.parquet", "profile.parquet", "setting.json"}
    assert (manifest["seeds"], list(manifest["policies"])) == ([0], ["slow-down", "constant"])


def test_bad_arguments_are_named_and_nothing_is_written(tmp_path):
    def run(specs, limit, seeds, against=None):
        evaluate(specs, tmp_path / "out", contexts="validation", limit=limit, seeds=seeds, against=against)

    for arguments, message in (
        ((["constant"], 99, 1), "limit = 99"),
        ((["constant"], 0, 0), "seeds = 0"),
        (([], 0, 1), "at least one is needed"),
        ((["pi", "pi"], 0, 1), "names must differ"),
        ((["fastest"], 0, 1), "unknown policy 'fastest'"),
        ((["pi"], 1, 1, "slow"), "against = 'slow' is not one of the policies: pi"),
    ):
        with pytest.raises(ValueError, match=message):
            run(*arguments)
    assert not (tmp_path / "out").exists()


def test_estimated_time_scales_with_fidelity_and_planner():
    """Four times the motion at standard; 16 candidates for four of every two periods are 32 more insertions.

    Of eight copies 256.
    """
    config, tube = TaskConfig().full_observation, load_contexts("test")[:1]
    policies = named_policies(["constant", "planner", "planner-averaged"], config)
    fast, standard = (Plan(policies, tube, (0,), config, PRESETS[name]) for name in ("fast", "standard"))
    one = core_seconds(fast, "constant")
    assert core_seconds(standard, "constant") == pytest.approx(4.0 * one)
    assert core_seconds(fast, "planner") == pytest.approx(33.0 * one)
    assert core_seconds(fast, "planner-averaged") == pytest.approx(257.0 * one)
    assert core_seconds(Plan(policies, tube, (0,), config, PRESETS["surrogate"]), "constant") == 0.0


def test_a_time_of_more_than_a_minute_is_announced():
    for seconds, about in ((0.9, ""), (3.0, " about 3 min,"), (180.0, " about 3 h,")):
        for stored, text in ((2, f"60 of 62 episodes to do,{about} stored in out one by one"), (62, "")):
            assert Work("episode", 62, lambda n=stored: n, "out", seconds=seconds).remaining_text() == text
