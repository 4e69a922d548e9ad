"""The searched schedules: what a point is, the search finds a known optimum, stored schedules are the best trials."""

import json

import numpy as np
import pandas as pd
import pytest

from probe_agents.policies.catalogue import BY_DIAMETER, DATA, make_policy
from probe_agents.records.manifest import commit
from probe_agents.studies.builtin import Request
from probe_agents.studies.shipped import best_schedules as optimise
from probe_agents.studies.shipped.best_schedules import AIR_KNOTS, FAMILIES, KNOTS, MapCost, run_search
from probe_env.envs.contexts import HELIX_DIAMETERS
from probe_env.envs.task import TaskConfig
from probe_env.envs.vibration_map import stored_map
from probe_env.files import FileError
from probe_env.schedule import Schedule

CONFIG = TaskConfig(privileged=True)
SIMULATED_AT = "0123456789ab"
SIMULATED = pd.DataFrame({"reward": [0.0], "commit": [SIMULATED_AT]})


def test_a_point_of_the_search_is_a_schedule():
    low = FAMILIES["best-constant"].schedule([0.0, 0.0], CONFIG)
    assert (low.feed_speed[0], low.air_supply_rate[0]) == pytest.approx((0.04, 45.0 / 3600.0))
    high = FAMILIES["best-schedule"].schedule([1.0] * len(KNOTS) + [0.0] * (len(AIR_KNOTS) - 1) + [1.0], CONFIG)
    assert high.feed_speed == pytest.approx([0.4] * len(high.position))
    assert set(high.position) == {*KNOTS, *AIR_KNOTS}
    assert high.air_supply_rate[0] == pytest.approx(45.0 / 3600.0)
    assert high.air_supply_rate[-1] == pytest.approx(130.0 / 3600.0)


@pytest.mark.parametrize("name", ["best-constant", "best-schedule", "best-schedule-d1.2"])
def test_stored_schedules_are_the_best_of_their_trials(name):
    trials, record = pd.read_csv(DATA / f"{name}-trials.csv"), json.loads((DATA / f"{name}.json").read_text())
    assert len(trials) == record["trials"]
    best = trials[trials["reward"] == trials["reward"].max()]  # four digits are stored, in which some are equal
    assert best["reward"].iloc[0] == pytest.approx(record["reward_by_map"], rel=1e-3)
    stored = Schedule.read(DATA / f"{name}.csv")
    points = best[[f"x{k}" for k in range(len(FAMILIES[name].start))]].to_numpy().tolist()
    schedules = [FAMILIES[name].schedule(point, CONFIG) for point in points]
    assert any(
        expected.feed_speed == pytest.approx(stored.feed_speed, rel=3e-3)
        and expected.air_supply_rate == pytest.approx(stored.air_supply_rate, rel=3e-3)
        for expected in schedules
    )


def test_the_schedule_of_the_nearest_diameter_is_taken():
    policy = make_policy(BY_DIAMETER, CONFIG)
    observation = np.zeros((len(HELIX_DIAMETERS), len(CONFIG.observations)), dtype=np.float32)
    names = list(CONFIG.observations)
    observation[:, names.index("helix_diameter")] = (np.array(HELIX_DIAMETERS) + 0.04) / 2.5
    observation[:, names.index("inserted_length")] = 40.0 / 60.0
    feed = CONFIG.targets(policy.predict(observation)[0])[:, 0]
    expected = [float(Schedule.read(DATA / f"best-schedule-d{d:g}.csv").at(40.0)[0]) for d in HELIX_DIAMETERS]
    assert feed == pytest.approx(expected, rel=1e-4)


def test_search_finds_a_known_optimum_and_is_the_same_each_time(tmp_path, monkeypatch):
    """Reward -(u - 0.1)^2 - (3600 Q - 80)^2 of the constant: the best is 0.1 m/s and 80 m3/h."""

    def reward(_, schedule):
        return -((schedule.feed_speed[0] - 0.1) ** 2) * 100.0 - (schedule.air_supply_rate[0] * 3600.0 - 80.0) ** 2 / 1e3

    monkeypatch.setattr(MapCost, "reward", reward)
    monkeypatch.setattr(optimise, "run_plan", lambda *_, **__: SIMULATED)
    folders = [tmp_path / name for name in ("once", "again")]
    for folder in folders:
        best = run_search("best-constant", 250, Request(folder), stored_map(), None)
    trials = [pd.read_csv(folder / "best-constant-trials.csv") for folder in folders]
    pd.testing.assert_frame_equal(*trials, check_exact=True)
    made_at = json.loads((folders[0] / "best-constant.json").read_text())["commit"]
    assert made_at.split(", ") == [SIMULATED_AT, commit()]
    assert len(trials[0]) == 256  # whole generations of 16
    assert best.feed_speed[0] == pytest.approx(0.1, rel=0.02)
    assert best.air_supply_rate[0] * 3600.0 == pytest.approx(80.0, rel=0.02)


def test_damaged_episodes_are_refused_before_anything_is_tried(tmp_path, monkeypatch):
    monkeypatch.setattr(MapCost, "reward", lambda *_: pytest.fail("a schedule was tried"))
    for name in ("setting.json", "episodes.jsonl"):
        file = tmp_path / name / "simulated" / "best-constant" / name
        file.parent.mkdir(parents=True)
        file.write_text("seven\n")
        with pytest.raises(FileError, match=name):
            run_search("best-constant", 16, Request(tmp_path / name), stored_map(), None)
        assert [path.name for path in file.parent.iterdir()] == [name]


def test_a_shorter_search_begins_as_a_longer_one():
    """What an interrupt left undone is all that differs: nothing of an earlier search is needed to go on."""

    def rewards_of(x):
        return list(-((x[:, 0] - 0.3) ** 2) - x[:, 1] ** 2)

    both = [optimise.search(rewards_of, (0.5, 0.5), generations, "test")[0] for generations in (3, 6)]
    assert (both[0] == both[1][:48]).all()
